//! The equations of an adjustment: every unknown from every mark.
//!
//! A view in the light of a second projector counts as a view of its own, of the same plate with the stages where they were: first
//! all views by the first projector, then all by the second.
//!
//! With a few dozen plates and views the unknowns are some hundreds, so the normal equations are solved whole. A mark depends on
//! a few of them, and only those are summed.

use nalgebra::{DVector, Isometry3, UnitQuaternion, Vector3};
use rayon::prelude::*;

use super::least_squares::{Normal, Problem};
use super::model::{
    FIELD, OF_PLATE, OF_VIEW, Observation, SHARED, Scene, head_unknowns, projector_places,
};
use super::sighting::{Mark, Sighting, StagePose};
use super::target::Target;
use flankscope_foundation::order::{SIGMA_PER_MAD, quantile};

/// What does not change.
pub(crate) struct Setting<'a> {
    pub target: &'a Target,
    pub sightings: &'a [Sighting],
    /// Places of the plates by their certificate.
    pub certified: Vec<Isometry3<f64>>,
    pub start: Scene,
    /// Its second projector's lens and place.
    pub start_of_second: Option<Scene>,
    /// Standard uncertainty of the stages: rad, mm.
    pub stage_sigma: [f64; 2],
}

/// All unknowns: those of the head, of the plates, of the stages in each view.
#[derive(Clone)]
pub(crate) struct State {
    pub shared: Scene,
    /// A second projector's lens and place.
    pub second: Option<Scene>,
    pub plates: Vec<Isometry3<f64>>,
    pub stage_errors: Vec<[f64; 2]>,
}

/// What is believed of the marks, and of the fields.
#[derive(Clone, Copy)]
pub(crate) struct Weights {
    /// Standard uncertainty of a dot's place and of its column.
    pub sigma_px: [f64; 2],
    /// How large the coefficients of the residual fields are, camera and projector; without effect where the scene has none.
    pub field_sigma_px: [f64; 2],
}

/// The equations about a state.
#[derive(Clone)]
pub(crate) struct Bundle<'a> {
    pub setting: &'a Setting<'a>,
    pub state: State,
    /// Marks that take part, view by view; those by a second projector behind all others.
    pub kept: &'a [Vec<Mark>],
    pub weights: Weights,
}

impl State {
    /// The scene in the light of the second projector.
    pub fn scene_of_second(&self) -> Option<Scene> {
        Some(self.shared.lit_by(self.second.as_ref()?))
    }

    /// Where the head's unknowns of a scene stand among all, first and second projector's; nothing without such a projector.
    pub fn head_places(&self, by_second: bool) -> Vec<usize> {
        let mut places: Vec<usize> = (0..head_unknowns(&self.shared).count()).collect();
        if by_second {
            let first = places.len();
            for (number, place) in projector_places(&self.shared).enumerate() {
                places[place] = first + number;
            }
        }
        places
    }

    /// Unknowns of the head; they stand first.
    pub fn of_head(&self) -> usize {
        let own = self.second.as_ref();
        head_unknowns(&self.shared).count()
            + own.map_or(0, |_| projector_places(&self.shared).count())
    }
}

impl Bundle<'_> {
    fn unknowns(&self) -> usize {
        self.of_head()
            + OF_PLATE * self.state.plates.len()
            + OF_VIEW * self.state.stage_errors.len()
    }

    pub fn of_head(&self) -> usize {
        self.state.of_head()
    }

    /// Number of a view's sighting, and whether it is by the second projector.
    fn sighting(&self, view: usize) -> (usize, bool) {
        let sightings = self.setting.sightings.len();
        (view % sightings, view >= sightings)
    }

    fn of_fields(&self) -> usize {
        if self.state.shared.has_fields() {
            FIELD
        } else {
            0
        }
    }

    /// Where the unknowns that a view depends on, in the order of [`Scene::step`], stand among all.
    fn places(&self, view: usize) -> Vec<usize> {
        let (view, by_second) = self.sighting(view);
        let plate = self.of_head() + OF_PLATE * self.setting.sightings[view].plate;
        let stages = self.of_head() + OF_PLATE * self.state.plates.len() + OF_VIEW * view;
        let own = (plate..plate + OF_PLATE).chain(stages..stages + OF_VIEW);
        let head = self.state.head_places(by_second);
        let (shared, fields) = head.split_at(SHARED);
        let (shared, fields) = (shared.iter().copied(), fields.iter().copied());
        shared.chain(own).chain(fields).collect()
    }

    fn scene(&self, view: usize) -> Scene {
        let (view, by_second) = self.sighting(view);
        let shared = &self.state.shared;
        let lit = match &self.state.second {
            Some(second) if by_second => shared.lit_by(second),
            _ => shared.clone(),
        };
        Scene {
            tool_from_plate: self.state.plates[self.setting.sightings[view].plate],
            stage_error: self.state.stage_errors[view],
            ..lit
        }
    }

    /// Where the stages were told to stand.
    fn stage(&self, view: usize) -> StagePose {
        self.setting.sightings[self.sighting(view).0].stage
    }

    /// Where a scene puts the kept marks of a view.
    fn predicted(&self, view: usize, scene: &Scene) -> Option<Vec<Observation>> {
        let dots = &self.setting.target.dots;
        let pose = scene.camera_from_plate(self.stage(view));
        self.kept[view]
            .iter()
            .map(|mark| {
                let at_mm = mark.place.map(|n| f64::from(n) * dots.pitch_mm);
                scene.observation(&pose, at_mm, dots.radius_mm(mark.place))
            })
            .collect()
    }

    /// What a view's marks are off by; `None` where a mark would lie behind the head.
    fn residuals(&self, view: usize) -> Option<Vec<Observation>> {
        let predicted = self.predicted(view, &self.scene(view))?;
        let off = |(seen, mark): (Observation, &Mark)| {
            [
                seen[0] - mark.pixel[0],
                seen[1] - mark.pixel[1],
                seen[2] - mark.column_px,
            ]
        };
        Some(
            predicted
                .into_iter()
                .zip(&self.kept[view])
                .map(off)
                .collect(),
        )
    }

    fn sigmas(&self) -> Observation {
        let [dot, fringe] = self.weights.sigma_px;
        [dot, dot, fringe]
    }

    /// Prior knowledge about all unknowns: place, offset, sigma.
    fn priors(&self) -> Vec<(usize, f64, f64)> {
        let Setting {
            target,
            certified,
            start,
            start_of_second,
            stage_sigma,
            ..
        } = self.setting;
        let mut priors = self.state.shared.priors(start, self.weights.field_sigma_px);
        let second = self.state.scene_of_second();
        if let Some((now, then)) = second.zip(start_of_second.as_ref()) {
            // What it shares with the first projector is believed once.
            let places = self.state.head_places(true);
            let its_own = now.priors(then, self.weights.field_sigma_px).into_iter();
            let its_own = its_own.filter(|(place, ..)| places[*place] != *place);
            priors.extend(its_own.map(|(place, off, sigma)| (places[place], off, sigma)));
        }
        for (plate, (now, then)) in self.state.plates.iter().zip(certified).enumerate() {
            let turn = (now.rotation * then.rotation.inverse()).scaled_axis();
            let shift = now.translation.vector - then.translation.vector;
            for axis in 0..3 {
                let at = self.of_head() + OF_PLATE * plate + axis;
                priors.push((at, turn[axis], target.pose_sigma_rad));
                priors.push((at + 3, shift[axis], target.pose_sigma_mm));
            }
        }
        let first = self.of_head() + OF_PLATE * self.state.plates.len();
        for (view, errors) in self.state.stage_errors.iter().enumerate() {
            for axis in 0..OF_VIEW {
                let at = first + OF_VIEW * view + axis;
                priors.push((at, errors[axis], stage_sigma[axis]));
            }
        }
        priors
    }

    fn cost(&self) -> f64 {
        let sigmas = self.sigmas();
        let of_view = |view: usize| -> f64 {
            let Some(residuals) = self.residuals(view) else {
                return f64::INFINITY;
            };
            residuals
                .iter()
                .flat_map(|off| (0..3).map(|k| (off[k] / sigmas[k]).powi(2)))
                .sum()
        };
        let views: f64 = (0..self.kept.len()).map(of_view).sum();
        let priors: f64 = self
            .priors()
            .iter()
            .map(|(_, off, sigma)| (off / sigma).powi(2))
            .sum();
        views + priors
    }

    /// Robust standard deviations of dots and fringes.
    pub fn scatter(&self) -> [f64; 2] {
        let (mut dots, mut fringes) = (Vec::new(), Vec::new());
        for off in (0..self.kept.len())
            .filter_map(|view| self.residuals(view))
            .flatten()
        {
            dots.extend([off[0].abs(), off[1].abs()]);
            fringes.push(off[2].abs());
        }
        // A thousandth of a pixel is nobody's noise, and keeps perfect data from being weighed infinitely.
        [dots, fringes]
            .map(|mut off| (SIGMA_PER_MAD * quantile(&mut off, 0.5).unwrap_or(0.0)).max(1e-3))
    }

    /// Whether each kept mark, view by view, agrees with the others to `outlier` standard deviations.
    pub fn fits(&self, outlier: f64, sigma_px: [f64; 2]) -> Vec<bool> {
        let [dot, fringe] = sigma_px.map(|sigma| outlier * sigma);
        (0..self.kept.len())
            .flat_map(|view| self.residuals(view).unwrap_or_default())
            .map(|off| off[0].abs() < dot && off[1].abs() < dot && off[2].abs() < fringe)
            .collect()
    }

    pub fn rms(&self) -> [f64; 2] {
        let (mut count, mut squares) = (0.0, [0.0; 2]);
        for off in (0..self.kept.len())
            .filter_map(|view| self.residuals(view))
            .flatten()
        {
            count += 1.0;
            squares[0] += 0.5 * (off[0] * off[0] + off[1] * off[1]);
            squares[1] += off[2] * off[2];
        }
        squares.map(|sum: f64| (sum / count).sqrt())
    }

    /// One view's share of the equations about the unknowns that it depends on; of the symmetric part the lower half.
    fn of_view(&self, view: usize) -> Normal {
        const PLAIN: usize = SHARED + OF_PLATE + OF_VIEW;
        let unknowns = PLAIN + self.of_fields();
        let mut share = Normal::zero(unknowns);
        let scene = self.scene(view);
        let stepped = |unknown: usize, sign: f64| {
            let mut scene = scene.clone();
            scene.step(unknown, sign * Scene::small_step(unknown));
            self.predicted(view, &scene)
        };
        let sides: Option<Vec<_>> = (0..PLAIN)
            .map(|unknown| Some((stepped(unknown, 1.0)?, stepped(unknown, -1.0)?)))
            .collect();
        let (Some(residuals), Some(sides)) = (self.residuals(view), sides) else {
            share.cost = f64::INFINITY;
            return share;
        };
        let dots = &self.setting.target.dots;
        let pose = scene.camera_from_plate(self.stage(view));
        let mut slopes: Vec<(usize, f64)> = Vec::with_capacity(unknowns);
        for (number, (mark, off)) in self.kept[view].iter().zip(&residuals).enumerate() {
            let at_mm = mark.place.map(|n| f64::from(n) * dots.pitch_mm);
            let fields = scene.field_slopes(&pose, at_mm, dots.radius_mm(mark.place));
            for (k, sigma) in self.sigmas().into_iter().enumerate() {
                let plain = sides.iter().enumerate().map(|(unknown, (plus, minus))| {
                    let change = plus[number][k] - minus[number][k];
                    (unknown, change / (2.0 * Scene::small_step(unknown) * sigma))
                });
                let of_part = fields.iter().filter(|(_, part, _)| *part == k);
                slopes.clear();
                slopes.extend(plain.chain(of_part.map(|&(at, _, slope)| (at, slope / sigma))));
                let residual = off[k] / sigma;
                share.cost += residual * residual;
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

impl Problem for Bundle<'_> {
    fn normal(&self) -> Normal {
        let mut normal = Normal::zero(self.unknowns());
        let shares: Vec<_> = (0..self.kept.len())
            .into_par_iter()
            .map(|view| self.of_view(view))
            .collect();
        for (view, share) in shares.into_iter().enumerate() {
            normal.add(&share, &self.places(view));
        }
        for (at, off, sigma) in self.priors() {
            normal.add_prior(at, off, sigma);
        }
        normal
    }

    fn stepped(&self, step: &DVector<f64>) -> (Self, f64) {
        let mut next = self.clone();
        let places = self.state.head_places(true);
        for (place, unknown) in head_unknowns(&self.state.shared).enumerate() {
            next.state.shared.step(unknown, step[place]);
            if let Some(second) = &mut next.state.second
                && places[place] != place
            {
                second.step(unknown, step[places[place]]);
            }
        }
        for (plate, pose) in next.state.plates.iter_mut().enumerate() {
            let at = self.of_head() + OF_PLATE * plate;
            let part = |first: usize| Vector3::new(step[first], step[first + 1], step[first + 2]);
            pose.rotation = UnitQuaternion::from_scaled_axis(part(at)) * pose.rotation;
            pose.translation.vector += part(at + 3);
        }
        let first = self.of_head() + OF_PLATE * next.state.plates.len();
        for (view, errors) in next.state.stage_errors.iter_mut().enumerate() {
            for axis in 0..OF_VIEW {
                errors[axis] += step[first + OF_VIEW * view + axis];
            }
        }
        let cost = next.cost();
        (next, cost)
    }
}
