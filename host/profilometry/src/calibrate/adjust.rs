//! All unknowns from all marks together: bundle adjustment.
//!
//! First pinholes with Brown's distortion, then, from there, with the residual field of both lenses as well.

use nalgebra::{DMatrix, DMatrixView};

use super::CalibrateError;
use super::bundle::{Bundle, Setting, State, Weights};
use super::least_squares::{NoMinimum, SETTLED, minimise};
use super::model::{CAMERA_FOCAL, CAMERA_PRINCIPAL, PROJECTOR_FOCAL, SHARED, Scene, certified};
use super::sighting::{Mark, Sighting};
use super::target::Target;
use super::uncertainty::{Lit, apart_sigma_mm, farther_sigma_mm, volume_sigma_mm};
use crate::head::HeadModel;

/// A head that explains its marks.
#[derive(Clone, Debug)]
pub struct Adjusted {
    /// The head.
    pub head: HeadModel,
    /// The same marks explained without residual fields.
    pub without_field: HeadModel,
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
    /// Standard uncertainty of how much farther the (first) projector's pinhole is from the middle of the measuring volume than the
    /// camera's, each along its axis.
    pub farther_sigma_mm: Option<f64>,
    /// Standard uncertainty, by the calibration alone, of how far the depths by both projectors are apart; of a head with two.
    pub apart_sigma_mm: Option<f64>,
}

/// Fewer views than this leave no redundancy worth the name.
pub(super) const LEAST_VIEWS: usize = 6;
const MAX_STEPS: usize = 100;
/// Rounds of weighing and of leaving out what does not fit.
const ROUNDS: usize = 4;
/// More of them for the fields: how large they are believed to be comes nearer step by step.
const FIELD_ROUNDS: usize = 4;
/// First guess of their coefficients, camera and projector, and what they may be believed to be.
const FIRST_FIELD_SIGMA_PX: [f64; 2] = [0.1, 0.1];
const FIELD_SIGMA_LIMITS_PX: [f64; 2] = [1e-3, 2.0];
/// Before the weights are found, a minimum may be as near as this: of ten thousand residuals, one.
const UNFINISHED: f64 = 1e-4;
/// Weights that differ by less make no difference.
const SAME_WEIGHT: f64 = 0.02;
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
    let by_second = start.with_projector(2);
    let setting = Setting {
        target,
        sightings,
        certified: plates.clone(),
        start: Scene::new(start, &hand_eye),
        start_of_second: by_second.map(|head| Scene::new(&head, &hand_eye)),
        stage_sigma,
    };
    let mut kept: Vec<Vec<Mark>> = sightings.iter().map(|s| s.marks.clone()).collect();
    if setting.start_of_second.is_some() {
        kept.extend(sightings.iter().map(|s| s.by_second.clone()));
    }
    let all: usize = kept.iter().map(Vec::len).sum();
    let first = State {
        shared: setting.start.clone(),
        second: setting.start_of_second.clone(),
        plates,
        stage_errors: vec![[0.0; 2]; sightings.len()],
    };
    let weights = Weights {
        sigma_px: FIRST_SIGMA_PX,
        field_sigma_px: FIRST_FIELD_SIGMA_PX,
    };
    let plain = settle(&setting, first, weights, &mut kept, ROUNDS)?;
    let without_field = plain.state.head(start);
    let with_fields = |scene: Scene| scene.with_fields(&without_field);
    let with_fields = State {
        shared: with_fields(plain.state.shared),
        second: plain.state.second.map(with_fields),
        ..plain.state
    };
    let Settled {
        state,
        covariance,
        rms_px,
        ..
    } = settle(
        &setting,
        with_fields,
        plain.weights,
        &mut kept,
        FIELD_ROUNDS,
    )?;
    let marks = kept.iter().map(Vec::len).sum();
    check_fit(all - marks, all, rms_px)?;
    let head = state.head(start);
    head.check()?;
    let mut sigmas_mm = Vec::new();
    let mut by_each = Vec::new();
    for (number, scene) in [Some(state.shared.clone()), state.scene_of_second()]
        .into_iter()
        .flatten()
        .enumerate()
    {
        let places = state.head_places(number == 1);
        let of_scene = covariance.select_rows(&places).select_columns(&places);
        check_determined(&scene, &of_scene)?;
        let projector = Lit::new(&scene.head(start), &scene, places);
        sigmas_mm.push(volume_sigma_mm(&head, &projector, &covariance));
        by_each.push(projector);
    }
    // A point may be either's alone.
    let worst = |along: usize| {
        sigmas_mm
            .iter()
            .map(|sigma| sigma[along])
            .fold(f64::NAN, f64::max)
    };
    let (depth_sigma_mm, lateral_sigma_mm) = (worst(0), worst(1));
    let apart_sigma_mm = match &by_each[..] {
        [first, second] => Some(apart_sigma_mm(&head, [first, second], &covariance)),
        _ => None,
    };
    let farther_sigma_mm = by_each
        .first()
        .and_then(|first| farther_sigma_mm(&head, first, &covariance));
    Ok(Adjusted {
        head,
        without_field,
        views: sightings.len(),
        marks,
        dropped: all - marks,
        camera_rms_px: rms_px[0],
        projector_rms_px: rms_px[1],
        depth_sigma_mm,
        lateral_sigma_mm,
        farther_sigma_mm,
        apart_sigma_mm,
    })
}

impl State {
    /// The head of these values.
    fn head(&self, start: &HeadModel) -> HeadModel {
        let second = self.second.as_ref().zip(start.second_projector.as_ref());
        HeadModel {
            second_projector: second.map(|(scene, start)| scene.second_projector(start)),
            ..self.shared.head(start)
        }
    }
}

/// A minimum, with weights that agree with what is left over there.
struct Settled {
    state: State,
    weights: Weights,
    /// Of the head's unknowns.
    covariance: DMatrix<f64>,
    rms_px: [f64; 2],
}

/// Solves, weighs the marks by what they then scatter, leaves out those that do not fit, and so on.
fn settle(
    setting: &Setting<'_>,
    mut state: State,
    mut weights: Weights,
    kept: &mut [Vec<Mark>],
    rounds: usize,
) -> Result<Settled, CalibrateError> {
    let mut round = 0;
    let mut settled = UNFINISHED;
    loop {
        let bundle = Bundle {
            setting,
            state,
            kept,
            weights,
        };
        let minimum = minimise(bundle, MAX_STEPS, settled).map_err(|why| match why {
            NoMinimum::Singular => CalibrateError::Singular,
            NoMinimum::NotSettled(limit) => CalibrateError::NotSettled { limit },
        })?;
        let bundle = minimum.state;
        let of_head = bundle.state.of_head();
        let covariance = minimum.covariance.view((0, 0), (of_head, of_head));
        if settled == SETTLED {
            return Ok(Settled {
                covariance: covariance.into_owned(),
                rms_px: bundle.rms(),
                state: bundle.state,
                weights,
            });
        }
        let next = Weights {
            sigma_px: bundle.scatter(),
            field_sigma_px: believed_fields_px(&bundle.state, &covariance, weights),
        };
        if round == rounds || next.agrees_with(&weights) {
            settled = SETTLED;
        }
        weights = next;
        let mut fits = bundle.fits(OUTLIER, weights.sigma_px).into_iter();
        state = bundle.state;
        for marks in kept.iter_mut() {
            marks.retain(|_| fits.next().unwrap_or(false));
        }
        round += 1;
    }
}

impl Weights {
    /// Whether nothing would change noticeably with these weights instead.
    fn agrees_with(&self, other: &Self) -> bool {
        let all = |w: &Self| [w.sigma_px, w.field_sigma_px];
        let (own, others) = (all(self), all(other));
        own.as_flattened()
            .iter()
            .zip(others.as_flattened())
            .all(|(a, b)| (a / b - 1.0).abs() < SAME_WEIGHT)
    }
}

/// How large the coefficients of the fields are, from the coefficients found: sum of squares over the number of them that the
/// marks determine rather than the prior (MacKay 1992, Bayesian interpolation). Lenses without irregularities end near zero.
fn believed_fields_px(
    state: &State,
    covariance: &DMatrixView<'_, f64>,
    weights: Weights,
) -> [f64; 2] {
    let [camera, first] = state.shared.field_px();
    let mut places = SHARED..;
    let mut lenses = [camera, first]
        .map(|px| -> Vec<(f64, usize)> { px.into_iter().zip(places.by_ref()).collect() });
    if let Some(scene) = &state.second {
        let [_, second] = scene.field_px();
        let first_of_field = state.of_head() - second.len();
        lenses[1].extend(second.into_iter().zip(first_of_field..));
    }
    let mut believed_px = weights.field_sigma_px;
    for (sigma_px, coefficients) in believed_px.iter_mut().zip(lenses) {
        let (mut squares, mut determined) = (0.0, 0.0);
        for (px, place) in coefficients {
            squares += px * px;
            determined += 1.0 - covariance[(place, place)] / (*sigma_px * *sigma_px);
        }
        if determined > 0.0 {
            *sigma_px = f64::sqrt(squares / determined)
                .clamp(FIELD_SIGMA_LIMITS_PX[0], FIELD_SIGMA_LIMITS_PX[1]);
        }
    }
    believed_px
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
            "a projector's focal length (relative)",
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
