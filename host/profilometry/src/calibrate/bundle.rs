//! Bundle adjustment: all unknowns of a head and of its plates from all dots of all views, with robust weights.
//!
//! Two calibrations use it, each with an [`ObservationModel`] of its own: plates of certified pose on the stages
//! ([`model`](super::model)), and an ordinary board in unknown poses ([`board`](super::board)).
//!
//! With a few dozen plates and views the unknowns are some hundreds, so the normal equations are solved whole. A dot depends on
//! a few of them, and only those are summed.

use nalgebra::{DMatrix, DMatrixView, DVector, Isometry3};
use rayon::prelude::*;

use super::least_squares::{NoMinimum, Normal, Problem, SETTLED, minimise};
use super::rig::{ImagePoint, Rig};
use flankscope_foundation::order::{SIGMA_PER_MAD, quantile};

pub(crate) const MAX_STEPS: usize = 100;
/// First guess of the standard uncertainty of a dot's place in the camera's and in the projector's image.
pub(crate) const FIRST_SIGMA_PX: [f64; 2] = [0.1, 0.1];
/// A dot farther off than this many standard deviations does not fit.
const OUTLIER: f64 = 5.0;
/// Standard uncertainties by which coefficients of distortion (k1, k2, p1, p2) are held where no dot determines them.
pub(crate) const DISTORTION_SIGMA: [f64; 4] = [1.0, 10.0, 0.05, 0.05];

/// A dot of a plate, observed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Observation {
    /// Its place on the plate.
    pub at_mm: [f64; 2],
    /// Its radius; 0 for a crossing of squares.
    pub radius_mm: f64,
    /// Where it was seen; coordinates that were not observed stand last.
    pub seen_px: ImagePoint,
}

/// The values of all unknowns that the dots of one view depend on.
pub(crate) trait ViewState: Clone {
    fn rig(&self) -> &Rig;
    fn camera_from_plate(&self) -> Isometry3<f64>;
    /// Number of unknowns by which derivatives are computed numerically. Coefficients of the residual fields follow behind them.
    fn stepped(&self) -> usize;
    /// Adds to one of the unknowns.
    fn step(&mut self, unknown: usize, by: f64);
    /// A step that moves a dot in the images by about a hundredth of a pixel.
    fn small_step(&self, unknown: usize) -> f64;
}

/// Knowledge about an unknown before any observation.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Prior {
    /// Position among all unknowns.
    pub unknown: usize,
    /// Its present value less the expected one.
    pub off: f64,
    /// Standard uncertainty of the expected value.
    pub sigma: f64,
}

/// The values of all unknowns, and how views depend on them.
pub(crate) trait ObservationModel: Clone + Sync {
    type View: ViewState;
    /// How many of an image point's coordinates are observed.
    fn coordinates(&self) -> usize;
    /// Number of all unknowns.
    fn unknowns(&self) -> usize;
    /// Number of those of the head, which stand first.
    fn head_unknowns(&self) -> usize;
    fn view(&self, view: usize) -> Self::View;
    /// Positions, among all unknowns, of those that a view depends on.
    fn positions(&self, view: usize) -> Vec<usize>;
    fn priors(&self) -> Vec<Prior>;
    /// Adds to all unknowns.
    fn step(&mut self, step: &DVector<f64>);
    /// Estimates standard uncertainties of priors anew, from the unknowns at a minimum and the covariance of the head's; whether
    /// none changed by more than the part `same`.
    fn update_priors(&mut self, _covariance: &DMatrixView<'_, f64>, _same: f64) -> bool {
        true
    }
}

/// The equations about a state.
#[derive(Clone)]
pub(crate) struct Bundle<'a, M> {
    pub model: M,
    /// Dots that take part, view by view.
    pub kept: &'a [Vec<Observation>],
    /// Standard uncertainty of a coordinate in the camera's and in the projector's image.
    pub sigma_px: [f64; 2],
}

impl<M: ObservationModel> Bundle<'_, M> {
    /// Where the kept dots of a view appear; `None` where one would lie behind the head.
    fn images(&self, view: usize, state: &M::View) -> Option<Vec<ImagePoint>> {
        let (rig, pose) = (state.rig(), state.camera_from_plate());
        self.kept[view]
            .iter()
            .map(|dot| rig.image(&pose, dot.at_mm, dot.radius_mm))
            .collect()
    }

    /// Computed less observed coordinates of a view's dots; `None` where one would lie behind the head.
    pub fn residuals(&self, view: usize) -> Option<Vec<ImagePoint>> {
        let images = self.images(view, &self.model.view(view))?;
        let off = |(image, dot): (ImagePoint, &Observation)| {
            std::array::from_fn(|k| image[k] - dot.seen_px[k])
        };
        Some(images.into_iter().zip(&self.kept[view]).map(off).collect())
    }

    /// The same of all views; none of a view with a dot behind the head.
    pub fn all_residuals(&self) -> impl Iterator<Item = ImagePoint> {
        (0..self.kept.len())
            .filter_map(|view| self.residuals(view))
            .flatten()
    }

    /// Sum of weighted squares of residuals.
    fn squares(&self, residuals: &[ImagePoint]) -> f64 {
        let of_dot = |off: &ImagePoint| {
            let off = *off;
            (0..self.model.coordinates()).map(move |k| (off[k] / self.sigma_px[k / 2]).powi(2))
        };
        residuals.iter().flat_map(of_dot).sum()
    }

    fn cost(&self) -> f64 {
        let views = (0..self.kept.len()).map(|view| match self.residuals(view) {
            Some(residuals) => self.squares(&residuals),
            None => f64::INFINITY,
        });
        let priors = self.model.priors();
        let priors = priors.iter().map(|prior| (prior.off / prior.sigma).powi(2));
        views.sum::<f64>() + priors.sum::<f64>()
    }

    /// Robust standard deviations of the coordinates in both images.
    pub fn scatter_px(&self) -> [f64; 2] {
        let mut off_px = [Vec::new(), Vec::new()];
        for off in self.all_residuals() {
            for k in 0..self.model.coordinates() {
                off_px[k / 2].push(off[k].abs());
            }
        }
        // A floor of a thousandth of a pixel, below any camera's noise, so that perfect data get finite weights.
        off_px.map(|mut off| (SIGMA_PER_MAD * quantile(&mut off, 0.5).unwrap_or(0.0)).max(1e-3))
    }

    /// Whether each kept dot of a view agrees with the others.
    fn fits(&self, view: usize, sigma_px: [f64; 2]) -> Vec<bool> {
        let fits = |off: &ImagePoint| {
            (0..self.model.coordinates()).all(|k| off[k].abs() < OUTLIER * sigma_px[k / 2])
        };
        let residuals = self.residuals(view).unwrap_or_default();
        residuals.iter().map(fits).collect()
    }

    /// One view's share of the equations about the unknowns that it depends on; of the symmetric part the lower half.
    fn view_equations(&self, view: usize) -> Normal {
        let state = self.model.view(view);
        let unknowns = self.model.positions(view).len();
        let mut share = Normal::zero(unknowns);
        let stepped = |unknown: usize, by: f64| {
            let mut state = state.clone();
            state.step(unknown, by);
            self.images(view, &state)
        };
        let sides: Option<Vec<_>> = (0..state.stepped())
            .map(|unknown| {
                let step = state.small_step(unknown);
                Some((stepped(unknown, step)?, stepped(unknown, -step)?, step))
            })
            .collect();
        let (Some(residuals), Some(sides)) = (self.residuals(view), sides) else {
            share.cost = f64::INFINITY;
            return share;
        };
        share.cost = self.squares(&residuals);
        let (rig, pose) = (state.rig(), state.camera_from_plate());
        let mut slopes: Vec<(usize, f64)> = Vec::with_capacity(unknowns);
        for (number, (dot, off)) in self.kept[view].iter().zip(&residuals).enumerate() {
            let fields = rig.field_slopes(&pose, dot.at_mm, dot.radius_mm);
            for k in 0..self.model.coordinates() {
                let sigma = self.sigma_px[k / 2];
                let numeric = sides
                    .iter()
                    .enumerate()
                    .map(|(unknown, (plus, minus, step))| {
                        let change = plus[number][k] - minus[number][k];
                        (unknown, change / (2.0 * step * sigma))
                    });
                let of_fields = fields
                    .iter()
                    .filter(|(_, coordinate, _)| *coordinate == k)
                    .map(|&(coefficient, _, slope)| (sides.len() + coefficient, slope / sigma));
                slopes.clear();
                slopes.extend(numeric.chain(of_fields));
                let residual = off[k] / sigma;
                for (position, &(i, by_i)) in slopes.iter().enumerate() {
                    share.gradient[i] += residual * by_i;
                    let column = share.hessian.column_mut(i);
                    let column = column.data.into_slice_mut();
                    for &(j, by_j) in &slopes[position..] {
                        column[j] += by_i * by_j;
                    }
                }
            }
        }
        share
    }
}

impl<M: ObservationModel> Problem for Bundle<'_, M> {
    fn normal(&self) -> Normal {
        let mut normal = Normal::zero(self.model.unknowns());
        let shares: Vec<_> = (0..self.kept.len())
            .into_par_iter()
            .map(|view| self.view_equations(view))
            .collect();
        for (view, share) in shares.into_iter().enumerate() {
            normal.add(&share, &self.model.positions(view));
        }
        for Prior {
            unknown,
            off,
            sigma,
        } in self.model.priors()
        {
            normal.add_prior(unknown, off, sigma);
        }
        normal
    }

    fn stepped(&self, step: &DVector<f64>) -> (Self, f64) {
        let mut next = self.clone();
        next.model.step(step);
        let cost = next.cost();
        (next, cost)
    }
}

/// Mean squares of the observed coordinates in both images, px².
pub(crate) fn mean_squares_px2(
    residuals: impl Iterator<Item = ImagePoint>,
    coordinates: usize,
) -> [f64; 2] {
    let (mut count, mut squares) = (0.0, [0.0; 2]);
    for off in residuals {
        count += 1.0;
        for image in 0..2 {
            let observed = &off[2 * image..coordinates.min(2 * image + 2)];
            squares[image] += observed.iter().map(|x| x * x).sum::<f64>();
        }
    }
    [0, 1]
        .map(|image| squares[image] / (count * coordinates.saturating_sub(2 * image).min(2) as f64))
}

/// The first figure (name, value, limit) that exceeds its limit or is NaN.
pub(crate) fn beyond<W, const N: usize>(figures: [(W, f64, f64); N]) -> Option<(W, f64, f64)> {
    figures.into_iter().find(|(_, got, limit)| !(got <= limit))
}

/// How often dots are weighed anew, and how near to the minimum that is done.
#[derive(Clone, Copy)]
pub(crate) struct Reweighting {
    /// Most times.
    pub rounds: usize,
    /// Relative improvement below which a minimum is near enough before the weights are final; then it is [`SETTLED`].
    pub unfinished: f64,
    /// Weights that change by less than this part are final; 0 for all rounds.
    pub same: f64,
}

/// A minimum with weights that agree with the residuals there.
pub(crate) struct Settled<M> {
    pub model: M,
    pub sigma_px: [f64; 2],
    /// Of the head's unknowns.
    pub covariance: DMatrix<f64>,
}

/// Solves, weighs the dots by what they then scatter, drops those that do not fit from `kept`, and so on.
pub(crate) fn settle<M: ObservationModel>(
    mut model: M,
    mut sigma_px: [f64; 2],
    kept: &mut [Vec<Observation>],
    reweighting: Reweighting,
) -> Result<Settled<M>, NoMinimum> {
    let (mut round, mut is_last) = (0, false);
    loop {
        let bundle = Bundle {
            model,
            kept: &*kept,
            sigma_px,
        };
        let near = if is_last {
            SETTLED
        } else {
            reweighting.unfinished
        };
        let minimum = minimise(bundle, MAX_STEPS, near)?;
        let bundle = minimum.state;
        let of_head = bundle.model.head_unknowns();
        let covariance = minimum.covariance.view((0, 0), (of_head, of_head));
        if is_last {
            return Ok(Settled {
                covariance: covariance.into_owned(),
                model: bundle.model,
                sigma_px,
            });
        }
        let scatter_px = bundle.scatter_px();
        let fits: Vec<_> = (0..kept.len())
            .map(|view| bundle.fits(view, scatter_px))
            .collect();
        model = bundle.model;
        let same_priors = model.update_priors(&covariance, reweighting.same);
        let same_weights =
            (0..2).all(|k| (scatter_px[k] / sigma_px[k] - 1.0).abs() < reweighting.same);
        round += 1;
        is_last = round == reweighting.rounds || (same_priors && same_weights);
        sigma_px = scatter_px;
        for (dots, fits) in kept.iter_mut().zip(fits) {
            let mut fits = fits.into_iter();
            dots.retain(|_| fits.next().unwrap_or(false));
        }
    }
}
