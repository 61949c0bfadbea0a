//! All unknowns from all marks together: bundle adjustment.
//!
//! With a few dozen plates and views the unknowns are some hundred and fifty, so the normal equations are solved whole; each
//! view touches 34 of them, and only those are summed.

use nalgebra::{DMatrix, DVector, Isometry3, SMatrix, SVector, UnitQuaternion, Vector3};
use rayon::prelude::*;

use super::CalibrateError;
use super::dots::quantile;
use super::least_squares::{NoMinimum, Normal, Problem, minimise};
use super::model::{
    CAMERA_FOCAL, CAMERA_PRINCIPAL, LOCAL, Look, OF_PLATE, OF_VIEW, PROJECTOR_FOCAL, SHARED, Scene,
    certified,
};
use super::sighting::{Mark, Sighting};
use super::target::Target;
use crate::calibration::HeadModel;
use crate::triangulate::Triangulator;

/// A head that explains its marks.
#[derive(Clone, Debug)]
pub struct Adjusted {
    /// The head.
    pub head: HeadModel,
    /// Views that took part.
    pub views: usize,
    /// Marks that took part.
    pub marks: usize,
    /// Marks left out because they do not fit.
    pub dropped: usize,
    /// What is left over of the dots' pixels, root mean square per axis.
    pub camera_rms_px: f64,
    /// What is left over of their projector columns.
    pub projector_rms_px: f64,
    /// Standard uncertainty of a point's depth by the calibration alone, root mean square over the measuring volume,
    /// in the stage frame.
    pub depth_sigma_mm: f64,
    /// The same across the view.
    pub lateral_sigma_mm: f64,
    /// Covariance of the shared unknowns.
    covariance: DMatrix<f64>,
    scene: Scene,
}

/// Fewer views than this leave no redundancy worth the name.
const LEAST_VIEWS: usize = 6;
const MAX_STEPS: usize = 100;
/// Rounds of weighing and of leaving out what does not fit.
const ROUNDS: usize = 4;
/// First guess of what a dot's centre and its column are known to.
const FIRST_SIGMA_PX: [f64; 2] = [0.1, 0.1];
/// A mark farther off than this many standard deviations does not fit.
const OUTLIER: f64 = 5.0;
const MOST_OUTLIERS_PERCENT: usize = 5;
/// Largest residuals of an instrument that measures micrometres: a quarter pixel is 2 um in the field.
const LIMIT_PX: [f64; 2] = [0.25, 0.5];
/// Largest uncertainties of what the views must determine: a focal length (of itself), the principal point in px.
const FOCAL_LIMIT: f64 = 0.005;
const PRINCIPAL_LIMIT_PX: f64 = 10.0;

/// Finds the head that `sightings` of `target` ask for, starting from `start` (drawing values are near enough).
///
/// `stage_sigma` is the standard uncertainty of the rotary stage in rad and of the vertical one in mm.
///
/// # Errors
/// [`CalibrateError`]: too few views, unknowns that they leave open, residuals beyond noise.
pub fn adjust(
    start: &HeadModel,
    target: &Target,
    sightings: &[Sighting],
    stage_sigma: [f64; 2],
) -> Result<Adjusted, CalibrateError> {
    if sightings.len() < LEAST_VIEWS {
        return Err(CalibrateError::FewViews {
            got: sightings.len(),
            limit: LEAST_VIEWS,
        });
    }
    let hand_eye = start.stage_from_camera.ok_or(CalibrateError::HeadLacks {
        what: "stage_from_camera",
    })?;
    let plates = certified(target);
    for (view, sighting) in sightings.iter().enumerate() {
        if sighting.plate >= plates.len() {
            return Err(CalibrateError::NoSuchPlate {
                view,
                got: sighting.plate,
                plates: plates.len(),
            });
        }
    }
    let setting = Setting {
        target,
        sightings,
        certified: plates.clone(),
        start: Scene::new(start, &hand_eye),
        stage_sigma,
    };
    let mut kept: Vec<Vec<Mark>> = sightings.iter().map(|s| s.marks.clone()).collect();
    let all: usize = kept.iter().map(Vec::len).sum();
    let mut bundle = Bundle {
        setting: &setting,
        shared: setting.start.clone(),
        plates,
        stage_errors: vec![[0.0; 2]; sightings.len()],
        kept: &kept,
        sigma_px: FIRST_SIGMA_PX,
    };
    let mut minimum = solve(bundle)?;
    for _ in 0..ROUNDS {
        let sigma_px = minimum.state.scatter();
        let fits = minimum.state.fits(sigma_px);
        let state = minimum.state;
        let (shared, plates, stage_errors) = (state.shared, state.plates, state.stage_errors);
        let mut fits = fits.into_iter();
        for marks in &mut kept {
            marks.retain(|_| fits.next().unwrap_or(false));
        }
        bundle = Bundle {
            setting: &setting,
            shared,
            plates,
            stage_errors,
            kept: &kept,
            sigma_px,
        };
        minimum = solve(bundle)?;
    }
    let state = &minimum.state;
    let [camera_rms_px, projector_rms_px] = state.rms();
    let marks = kept.iter().map(Vec::len).sum();
    check_fit(all - marks, all, [camera_rms_px, projector_rms_px])?;
    let covariance = minimum
        .covariance
        .view((0, 0), (SHARED, SHARED))
        .into_owned();
    check_determined(&state.shared, &covariance)?;
    let head = state.shared.head(start);
    head.check()?;
    let mut adjusted = Adjusted {
        head,
        views: sightings.len(),
        marks,
        dropped: all - marks,
        camera_rms_px,
        projector_rms_px,
        depth_sigma_mm: 0.0,
        lateral_sigma_mm: 0.0,
        covariance,
        scene: state.shared.clone(),
    };
    [adjusted.depth_sigma_mm, adjusted.lateral_sigma_mm] = adjusted.volume_sigma_mm();
    Ok(adjusted)
}

fn solve<'a>(
    bundle: Bundle<'a>,
) -> Result<super::least_squares::Minimum<Bundle<'a>>, CalibrateError> {
    minimise(bundle, MAX_STEPS).map_err(|why| match why {
        NoMinimum::Singular => CalibrateError::Singular,
        NoMinimum::NotSettled(limit) => CalibrateError::NotSettled { limit },
    })
}

fn check_fit(dropped: usize, all: usize, rms_px: [f64; 2]) -> Result<(), CalibrateError> {
    if dropped * 100 > all * MOST_OUTLIERS_PERCENT {
        return Err(CalibrateError::Outliers {
            got: dropped,
            of: all,
            limit_percent: MOST_OUTLIERS_PERCENT as u32,
        });
    }
    for ((what, got_px), limit_px) in ["dots", "fringes"].into_iter().zip(rms_px).zip(LIMIT_PX) {
        // Written so that a NaN fails.
        if !(got_px <= limit_px) {
            return Err(CalibrateError::Residual {
                what,
                got_px,
                limit_px,
            });
        }
    }
    Ok(())
}

fn check_determined(scene: &Scene, covariance: &DMatrix<f64>) -> Result<(), CalibrateError> {
    let sigma = |unknown: usize| covariance[(unknown, unknown)].sqrt();
    let unknowns = [
        (
            "the camera's focal length (relative)",
            sigma(CAMERA_FOCAL) / scene.camera.focal_px[0],
            FOCAL_LIMIT,
        ),
        (
            "the camera's principal column (px)",
            sigma(CAMERA_PRINCIPAL),
            PRINCIPAL_LIMIT_PX,
        ),
        (
            "the camera's principal row (px)",
            sigma(CAMERA_PRINCIPAL + 1),
            PRINCIPAL_LIMIT_PX,
        ),
        (
            "the projector's focal length (relative)",
            sigma(PROJECTOR_FOCAL) / scene.projector.focal_px[0],
            FOCAL_LIMIT,
        ),
    ];
    for (unknown, sigma, limit) in unknowns {
        if !(sigma <= limit) {
            return Err(CalibrateError::Degenerate {
                unknown,
                sigma,
                limit,
            });
        }
    }
    Ok(())
}

/// What does not change.
struct Setting<'a> {
    target: &'a Target,
    sightings: &'a [Sighting],
    certified: Vec<Isometry3<f64>>,
    start: Scene,
    stage_sigma: [f64; 2],
}

/// All unknowns.
#[derive(Clone)]
struct Bundle<'a> {
    setting: &'a Setting<'a>,
    shared: Scene,
    plates: Vec<Isometry3<f64>>,
    stage_errors: Vec<[f64; 2]>,
    kept: &'a [Vec<Mark>],
    sigma_px: [f64; 2],
}

impl Bundle<'_> {
    fn unknowns(&self) -> usize {
        SHARED + OF_PLATE * self.plates.len() + OF_VIEW * self.stage_errors.len()
    }

    /// Where the unknowns that a view feels stand among all.
    fn places(&self, view: usize) -> [usize; LOCAL] {
        let plate = SHARED + OF_PLATE * self.setting.sightings[view].plate;
        let stages = SHARED + OF_PLATE * self.plates.len() + OF_VIEW * view;
        std::array::from_fn(|k| match k {
            0..SHARED => k,
            SHARED..32 => plate + k - SHARED,
            _ => stages + k - SHARED - OF_PLATE,
        })
    }

    fn scene(&self, view: usize) -> Scene {
        Scene {
            tool_from_plate: self.plates[self.setting.sightings[view].plate],
            stage_error: self.stage_errors[view],
            ..self.shared.clone()
        }
    }

    /// How the kept marks of a view look in a scene.
    fn looks(&self, view: usize, scene: &Scene) -> Option<Vec<Look>> {
        let dots = &self.setting.target.dots;
        let pose = scene.camera_from_plate(self.setting.sightings[view].stage);
        self.kept[view]
            .iter()
            .map(|mark| {
                let at_mm = mark.place.map(|n| f64::from(n) * dots.pitch_mm);
                scene.look(&pose, at_mm, dots.radius_mm(mark.place))
            })
            .collect()
    }

    /// What a view's marks are off by; `None` where a mark would lie behind the head.
    fn residuals(&self, view: usize) -> Option<Vec<Look>> {
        let looks = self.looks(view, &self.scene(view))?;
        let off = |(look, mark): (Look, &Mark)| {
            [
                look[0] - mark.pixel[0],
                look[1] - mark.pixel[1],
                look[2] - mark.column_px,
            ]
        };
        Some(looks.into_iter().zip(&self.kept[view]).map(off).collect())
    }

    fn sigmas(&self) -> Look {
        let [dot, fringe] = self.sigma_px;
        [dot, dot, fringe]
    }

    /// Beliefs about all unknowns: place, offset, sigma.
    fn beliefs(&self) -> Vec<(usize, f64, f64)> {
        let Setting {
            target,
            certified,
            start,
            stage_sigma,
            ..
        } = self.setting;
        let mut beliefs = self.shared.beliefs(start);
        for (plate, (now, then)) in self.plates.iter().zip(certified).enumerate() {
            let turn = (now.rotation * then.rotation.inverse()).scaled_axis();
            let shift = now.translation.vector - then.translation.vector;
            for axis in 0..3 {
                let at = SHARED + OF_PLATE * plate + axis;
                beliefs.push((at, turn[axis], target.pose_sigma_rad));
                beliefs.push((at + 3, shift[axis], target.pose_sigma_mm));
            }
        }
        let first = SHARED + OF_PLATE * self.plates.len();
        for (view, errors) in self.stage_errors.iter().enumerate() {
            for axis in 0..OF_VIEW {
                let at = first + OF_VIEW * view + axis;
                beliefs.push((at, errors[axis], stage_sigma[axis]));
            }
        }
        beliefs
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
        let beliefs: f64 = self
            .beliefs()
            .iter()
            .map(|(_, off, sigma)| (off / sigma).powi(2))
            .sum();
        views + beliefs
    }

    /// Robust standard deviations of dots and fringes.
    fn scatter(&self) -> [f64; 2] {
        let (mut dots, mut fringes) = (Vec::new(), Vec::new());
        for off in (0..self.kept.len())
            .filter_map(|view| self.residuals(view))
            .flatten()
        {
            dots.extend([off[0].abs(), off[1].abs()]);
            fringes.push(off[2].abs());
        }
        // A thousandth of a pixel is nobody's noise, and keeps perfect data from being weighed infinitely.
        [dots, fringes].map(|mut off| (1.483 * quantile(&mut off, 0.5).unwrap_or(0.0)).max(1e-3))
    }

    /// Whether each kept mark, view by view, agrees with the others.
    fn fits(&self, sigma_px: [f64; 2]) -> Vec<bool> {
        let [dot, fringe] = sigma_px.map(|sigma| OUTLIER * sigma);
        (0..self.kept.len())
            .flat_map(|view| self.residuals(view).unwrap_or_default())
            .map(|off| off[0].abs() < dot && off[1].abs() < dot && off[2].abs() < fringe)
            .collect()
    }

    fn rms(&self) -> [f64; 2] {
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

    /// One view's share of the equations about the unknowns that it feels.
    fn of_view(&self, view: usize) -> (f64, SMatrix<f64, LOCAL, LOCAL>, SVector<f64, LOCAL>) {
        let mut cost = 0.0;
        let mut hessian = SMatrix::<f64, LOCAL, LOCAL>::zeros();
        let mut gradient = SVector::<f64, LOCAL>::zeros();
        let scene = self.scene(view);
        let nudged = |unknown: usize, sign: f64| {
            let mut scene = scene.clone();
            scene.nudge(unknown, sign * Scene::small_step(unknown));
            self.looks(view, &scene)
        };
        let sides: Option<Vec<_>> = (0..LOCAL)
            .map(|unknown| Some((nudged(unknown, 1.0)?, nudged(unknown, -1.0)?)))
            .collect();
        let (Some(residuals), Some(sides)) = (self.residuals(view), sides) else {
            return (f64::INFINITY, hessian, gradient);
        };
        for (mark, off) in residuals.iter().enumerate() {
            for (k, sigma) in self.sigmas().into_iter().enumerate() {
                let row = SVector::<f64, LOCAL>::from_fn(|unknown, _| {
                    let (plus, minus) = &sides[unknown];
                    let change = plus[mark][k] - minus[mark][k];
                    change / (2.0 * Scene::small_step(unknown) * sigma)
                });
                let residual = off[k] / sigma;
                cost += residual * residual;
                hessian.ger(1.0, &row, &row, 1.0);
                gradient.axpy(residual, &row, 1.0);
            }
        }
        (cost, hessian, gradient)
    }
}

impl Problem for Bundle<'_> {
    fn normal(&self) -> Normal {
        let unknowns = self.unknowns();
        let mut normal = Normal {
            cost: 0.0,
            hessian: DMatrix::zeros(unknowns, unknowns),
            gradient: DVector::zeros(unknowns),
        };
        let shares: Vec<_> = (0..self.kept.len())
            .into_par_iter()
            .map(|view| self.of_view(view))
            .collect();
        for (view, (cost, hessian, gradient)) in shares.into_iter().enumerate() {
            let places = self.places(view);
            normal.cost += cost;
            for (i, &row) in places.iter().enumerate() {
                normal.gradient[row] += gradient[i];
                for (j, &column) in places.iter().enumerate() {
                    normal.hessian[(row, column)] += hessian[(i, j)];
                }
            }
        }
        for (at, off, sigma) in self.beliefs() {
            normal.cost += (off / sigma).powi(2);
            normal.gradient[at] += off / (sigma * sigma);
            normal.hessian[(at, at)] += 1.0 / (sigma * sigma);
        }
        normal
    }

    fn stepped(&self, step: &DVector<f64>) -> (Self, f64) {
        let mut next = self.clone();
        for unknown in 0..SHARED {
            next.shared.nudge(unknown, step[unknown]);
        }
        for (plate, pose) in next.plates.iter_mut().enumerate() {
            let at = SHARED + OF_PLATE * plate;
            let part = |first: usize| Vector3::new(step[first], step[first + 1], step[first + 2]);
            pose.rotation = UnitQuaternion::from_scaled_axis(part(at)) * pose.rotation;
            pose.translation.vector += part(at + 3);
        }
        let first = SHARED + OF_PLATE * next.plates.len();
        for (view, errors) in next.stage_errors.iter_mut().enumerate() {
            for axis in 0..OF_VIEW {
                errors[axis] += step[first + OF_VIEW * view + axis];
            }
        }
        let cost = next.cost();
        (next, cost)
    }
}

impl Adjusted {
    /// Uncertainty of a point by the calibration alone, root mean square over the measuring volume: depth, across.
    fn volume_sigma_mm(&self) -> [f64; 2] {
        let Some(volume) = self.head.volume else {
            return [f64::NAN; 2];
        };
        let radius_px = self
            .head
            .image_circle
            .map_or(0.5 * f64::from(self.head.camera.height_px), |circle| {
                circle.radius_px
            });
        let heads: Vec<[HeadModel; 2]> = (0..SHARED)
            .map(|unknown| {
                [1.0, -1.0].map(|sign| {
                    let mut scene = self.scene.clone();
                    scene.nudge(unknown, sign * Scene::small_step(unknown));
                    scene.head(&self.head)
                })
            })
            .collect();
        let view = self.scene.stage_from_camera.rotation * Vector3::z();
        let (mut count, mut squares) = (0.0, [0.0; 2]);
        for depth_mm in [
            volume.near_mm,
            0.5 * (volume.near_mm + volume.far_mm),
            volume.far_mm,
        ] {
            for [x, y] in SAMPLES {
                let pixel = [
                    self.head.camera.principal_px[0] + 0.7 * radius_px * x,
                    self.head.camera.principal_px[1] + 0.7 * radius_px * y,
                ];
                let Some(covariance) = self.point_covariance(&heads, pixel, depth_mm) else {
                    continue;
                };
                let along = view.dot(&(covariance * view));
                count += 1.0;
                squares[0] += along;
                squares[1] += 0.5 * (covariance.trace() - along);
            }
        }
        squares.map(|sum: f64| (sum / count).sqrt())
    }

    /// Covariance of the point that a pixel sees at a depth, in the stage frame.
    fn point_covariance(
        &self,
        heads: &[[HeadModel; 2]],
        pixel: [f64; 2],
        depth_mm: f64,
    ) -> Option<SMatrix<f64, 3, 3>> {
        let ray = self.head.camera.undistort(pixel)?;
        let (column_px, _) = Triangulator::new(&self.head).column(ray, depth_mm)?;
        let point = |head: &HeadModel| -> Option<Vector3<f64>> {
            let ray = head.camera.undistort(pixel)?;
            let z = Triangulator::new(head).intersect(ray, column_px)?.depth_mm;
            Some(Vector3::from(head.stage_from_camera?.point([
                ray[0] * z,
                ray[1] * z,
                z,
            ])))
        };
        let mut jacobian = DMatrix::zeros(3, SHARED);
        for (unknown, [plus, minus]) in heads.iter().enumerate() {
            let change = (point(plus)? - point(minus)?) / (2.0 * Scene::small_step(unknown));
            jacobian.set_column(unknown, &change);
        }
        let covariance = &jacobian * &self.covariance * jacobian.transpose();
        Some(SMatrix::from_fn(|row, column| covariance[(row, column)]))
    }
}

/// Where in the field, in parts of 0.7 of its radius.
const SAMPLES: [[f64; 2]; 5] = [[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 0.7], [0.0, -0.7]];
