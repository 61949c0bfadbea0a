//! A pose measured by a head that was adjusted without it.

use nalgebra::Isometry3;

use super::adjust::{head_of, rms_px};
use super::model::{BoardModel, Free, observations};
use super::{BoardView, Geometry, closed_form};
use crate::calibrate::bundle::{Bundle, FIRST_SIGMA_PX, MAX_STEPS};
use crate::calibrate::form;
use crate::calibrate::least_squares::{SETTLED, minimise};
use crate::calibrate::rig::{ImagePoint, Rig};
use crate::head::HoldOut;
use crate::triangulate::HeadTriangulator;

/// A pose measured by a head that was adjusted without it.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct LeftOut {
    /// Residuals in the camera's image when only the pose is fitted: root mean square per axis.
    pub camera_rms_px: f64,
    /// Residuals in the projector's image with that pose, to which nothing is fitted: root mean square per axis.
    pub projector_rms_px: f64,
    /// Distances of the triangulated points from a plane, root mean square.
    pub flatness_rms_um: f64,
    /// Largest minus smallest of them, without the farthest 0.3 %.
    pub flatness_um: f64,
    /// Distances of the triangulated points from where they are printed, after a rigid motion, root mean square.
    pub points_rms_um: f64,
}

impl LeftOut {
    /// Measures a pose; `None` if a lens does not see all of it.
    pub(super) fn measure(view: &BoardView, geometry: Geometry, rig: &Rig) -> Option<Self> {
        let pairs: Vec<_> = view
            .marks
            .iter()
            .map(|mark| (mark.at_mm(geometry.pitch_mm), mark.pixel))
            .collect();
        let start = closed_form::pose(&closed_form::homography(&pairs)?, &rig.camera)?;
        let off = after_the_pose(view, geometry, rig, start)?;
        let [[camera_rms_px, _], [projector_rms_px, _]] = rms_px(&off);
        let triangulator_head = head_of(rig, "");
        let triangulator = HeadTriangulator::new(&triangulator_head);
        let pairs: Vec<_> = view
            .marks
            .iter()
            .filter_map(|mark| {
                let [x, y] = mark.at_mm(geometry.pitch_mm);
                Some((triangulator.point(mark.pixel, mark.lit_px[0])?, [x, y, 0.0]))
            })
            .collect();
        let points: Vec<_> = pairs.iter().map(|pair| pair.0).collect();
        let flatness = form::plane(&points)?;
        Some(Self {
            camera_rms_px,
            projector_rms_px,
            flatness_rms_um: 1e3 * flatness.rms_mm(),
            flatness_um: 1e3 * flatness.range_mm(),
            points_rms_um: 1e3 * form::rigid_rms_mm(&pairs)?,
        })
    }
}

/// Residuals in both images when only the pose of the board is fitted, to the camera's image.
fn after_the_pose(
    view: &BoardView,
    geometry: Geometry,
    rig: &Rig,
    start: Isometry3<f64>,
) -> Option<Vec<ImagePoint>> {
    let bundle = Bundle {
        model: BoardModel {
            free: Free::Poses,
            rig: rig.clone(),
            poses: vec![start],
        },
        kept: &observations(std::slice::from_ref(&view.marks), geometry),
        sigma_px: FIRST_SIGMA_PX,
    };
    minimise(bundle, MAX_STEPS, SETTLED)
        .ok()?
        .state
        .residuals(0)
}

/// All poses together, with the number of points of each.
pub(super) fn hold_out(forms: &[(f64, LeftOut)]) -> Option<HoldOut> {
    let points: f64 = forms.iter().map(|(count, _)| count).sum();
    let rms = |of: fn(&LeftOut) -> f64| {
        let squares: f64 = forms
            .iter()
            .map(|(count, out)| count * of(out).powi(2))
            .sum();
        (squares / points).sqrt()
    };
    (points > 0.0).then(|| HoldOut {
        views: forms.len() as u32,
        flatness_rms_um: rms(|out| out.flatness_rms_um),
        flatness_um: forms
            .iter()
            .map(|(_, out)| out.flatness_um)
            .fold(0.0, f64::max),
        dots_rms_um: rms(|out| out.points_rms_um),
    })
}
