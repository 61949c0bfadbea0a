//! A head from views of plates of certified pose on the stages.
//!
//! First pinholes with Brown's distortion, then, from there, with the residual field of both lenses as well.

use nalgebra::DMatrix;

use super::CalibrateError;
use super::bundle::{Bundle, FIRST_SIGMA_PX, Reweighting, beyond, mean_squares_px2, settle};
use super::model::{
    CAMERA_FOCAL, CAMERA_PRINCIPAL, COORDINATES, PROJECTOR_FOCAL, PlateModel, Scene, Setting,
};
use super::sighting::Sighting;
use super::target::Target;
use super::uncertainty::{Lit, apart_sigma_mm, farther_sigma_mm, volume_sigma_mm};
use crate::head::HeadModel;

/// A head with the quality of its adjustment.
#[derive(Clone, Debug)]
pub struct Adjusted {
    /// The head.
    pub head: HeadModel,
    /// The same without residual fields.
    pub without_field: HeadModel,
    /// Views that took part.
    pub views: usize,
    /// Marks that took part.
    pub marks: usize,
    /// Marks left out because they do not fit.
    pub dropped: usize,
    /// Residuals of the dots' pixels, root mean square per axis.
    pub camera_rms_px: f64,
    /// Residuals of their projector columns, root mean square.
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

/// Least number of views that leaves any redundancy.
pub(super) const LEAST_VIEWS: usize = 6;
/// Residual fields need several rounds, since the size of their coefficients is estimated anew in each. Before the weights are final, a
/// minimum is near enough where a step gains one of ten thousand residuals. Weights that change by less than 2 % are final.
const REWEIGHTING: Reweighting = Reweighting {
    rounds: 5,
    unfinished: 1e-4,
    same: 0.02,
};
/// First guess of the standard deviation of the fields' coefficients, camera and projector.
const FIRST_FIELD_SIGMA_PX: [f64; 2] = [0.1, 0.1];
/// Largest share of dots that may be left out.
const MOST_OUTLIERS_PERCENT: usize = 5;
/// Largest residuals of an instrument that measures micrometres: a quarter pixel is 2 um in the field.
const LIMIT_PX: [f64; 2] = [0.25, 0.5];
/// Largest uncertainties of what the views must determine: a focal length (of itself), the principal point in px.
const FOCAL_LIMIT: f64 = 0.005;
const PRINCIPAL_LIMIT_PX: f64 = 10.0;

/// Adjusts the head to `sightings` of `target`, starting from `start` (drawing values are near enough).
///
/// `stage_sigma` is the standard uncertainty of the rotary stage in rad and of the vertical one in mm.
///
/// # Errors
/// [`CalibrateError`]: too few views, unknowns that they do not determine, residuals beyond noise.
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
    let plates = target.plate.len();
    for (view, sighting) in sightings.iter().enumerate() {
        if sighting.plate >= plates {
            return Err(CalibrateError::NoSuchPlate {
                view,
                got: sighting.plate,
                plates,
            });
        }
    }
    let setting = Setting::new(start, &hand_eye, target, sightings, stage_sigma);
    let mut kept = setting.observations();
    let all: usize = kept.iter().map(Vec::len).sum();
    let first = PlateModel::new(&setting, FIRST_FIELD_SIGMA_PX);
    let plain = settle(first, FIRST_SIGMA_PX, &mut kept, REWEIGHTING)?;
    let without_field = plain.model.head(start);
    let with_fields = plain.model.with_fields(&without_field);
    let settled = settle(with_fields, plain.sigma_px, &mut kept, REWEIGHTING)?;
    let covariance = settled.covariance;
    let bundle = Bundle {
        model: settled.model,
        kept: &kept,
        sigma_px: settled.sigma_px,
    };
    let rms_px = mean_squares_px2(bundle.all_residuals(), COORDINATES).map(f64::sqrt);
    let model = bundle.model;
    let marks = kept.iter().map(Vec::len).sum();
    check_fit(all - marks, all, rms_px)?;
    let head = model.head(start);
    head.check()?;
    let mut sigmas_mm = Vec::new();
    let mut by_each = Vec::new();
    for (projector, scene) in model.scenes.iter().enumerate() {
        let positions = model.head_positions(projector);
        let of_scene = covariance
            .select_rows(&positions)
            .select_columns(&positions);
        check_determined(scene, &of_scene)?;
        let lit = Lit::new(&scene.head(start), scene, positions);
        sigmas_mm.push(volume_sigma_mm(&head, &lit, &covariance));
        by_each.push(lit);
    }
    // Points may come from either projector alone, so the larger uncertainty counts.
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

fn check_fit(dropped: usize, all: usize, rms_px: [f64; 2]) -> Result<(), CalibrateError> {
    if dropped * 100 > all * MOST_OUTLIERS_PERCENT {
        return Err(CalibrateError::Outliers {
            got: dropped,
            of: all,
            limit_percent: MOST_OUTLIERS_PERCENT as u32,
        });
    }
    match beyond([0, 1].map(|image| (["dots", "fringes"][image], rms_px[image], LIMIT_PX[image]))) {
        None => Ok(()),
        Some((what, got_px, limit_px)) => Err(CalibrateError::Residual {
            what,
            got_px,
            limit_px,
        }),
    }
}

fn check_determined(scene: &Scene, covariance: &DMatrix<f64>) -> Result<(), CalibrateError> {
    let sigma = |unknown: usize| covariance[(unknown, unknown)].sqrt();
    let of_camera = sigma(CAMERA_FOCAL) / scene.rig.camera.focal_px[0];
    let of_projector = sigma(PROJECTOR_FOCAL) / scene.rig.projector.focal_px[0];
    let [column, row] = [0, 1].map(|axis| sigma(CAMERA_PRINCIPAL + axis));
    #[rustfmt::skip]
    let unknowns = [
        ("the camera's focal length (relative)", of_camera, FOCAL_LIMIT),
        ("the camera's principal column (px)", column, PRINCIPAL_LIMIT_PX),
        ("the camera's principal row (px)", row, PRINCIPAL_LIMIT_PX),
        ("a projector's focal length (relative)", of_projector, FOCAL_LIMIT),
    ];
    match beyond(unknowns) {
        None => Ok(()),
        Some((unknown, sigma, limit)) => Err(CalibrateError::Degenerate {
            unknown,
            sigma,
            limit,
        }),
    }
}
