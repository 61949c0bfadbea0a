//! One view, compressed to its information about the pose.

use nalgebra::{Matrix6, Point3, Vector3, Vector6};

use super::CameraPose;
use super::model::Pose;
use crate::surface::{Closest, Surface};

/// Largest distance to the surface of points that determine the pose, mm.
const REACH_MM: f64 = 0.15;
/// Form deviation that a real piece has from place to place, mm: neighbouring points share it, so that ten thousand of them
/// do not say more about the pose than ...
const FORM_MM: f64 = 0.010;
/// ... this many patches of about 1 mm², which a field of 10 mm holds.
const PATCHES: f64 = 80.0;

/// Information of a view about its pose, linearised at it: the cost of a small motion d (rotation about `centre_mm` in rad, then
/// translation in mm, tool frame) is dᵀHd/2 + gᵀd.
#[derive(Debug, Clone)]
pub struct ViewInformation {
    /// Commanded stage positions.
    pub at: Pose,
    /// The pose.
    pub tool_from_camera: CameraPose,
    /// Centre of the points, tool frame, mm.
    pub centre_mm: [f64; 3],
    /// H.
    pub information: Matrix6<f64>,
    /// g.
    pub gradient: Vector6<f64>,
    /// Root mean square distance of the points that took part, mm.
    pub rms_mm: f64,
    /// Share of the points that took part.
    pub share: f64,
}

impl ViewInformation {
    /// The small motion that takes the view from where it was laid to `pose`: rotation (rad) about its centre, translation
    /// (mm).
    pub fn motion_to(&self, pose: &CameraPose) -> Vector6<f64> {
        offset(&self.tool_from_camera, pose, self.centre_mm.into())
    }
}

/// Lays `points` (camera frame, mm) on the surface at a pose; `None` when fewer than six of them touch it.
pub fn compress(
    surface: &Surface,
    points: &[[f64; 3]],
    at: Pose,
    tool_from_camera: CameraPose,
) -> Option<ViewInformation> {
    let there: Vec<[f64; 3]> = points.iter().map(|&p| tool_from_camera.apply(p)).collect();
    compress_laid(&there, &surface.closest_many(&there), at, tool_from_camera)
}

/// As [`compress`], of points (tool frame, mm) that were laid on the surface before.
pub fn compress_laid(
    points: &[[f64; 3]],
    closest: &[Closest],
    at: Pose,
    tool_from_camera: CameraPose,
) -> Option<ViewInformation> {
    let sum: Vector3<f64> = points.iter().map(|&p| Vector3::from(p)).sum();
    let centre = sum / (points.len().max(1) as f64);
    let (mut information, mut gradient) = (Matrix6::zeros(), Vector6::zeros());
    let (mut count, mut squares) = (0.0_f64, 0.0);
    for (p, hit) in points.iter().zip(closest) {
        let off_mm = hit.signed_distance_mm;
        if !hit.is_smooth() || off_mm.abs() > REACH_MM {
            continue;
        }
        let normal = Vector3::from(hit.normal);
        let turn = (Vector3::from(*p) - centre).cross(&normal);
        let row = Vector6::new(turn.x, turn.y, turn.z, normal.x, normal.y, normal.z);
        information += row * row.transpose();
        gradient += row * off_mm;
        count += 1.0;
        squares += off_mm * off_mm;
    }
    if count < 6.0 {
        return None;
    }
    let variance = (squares / count).max(FORM_MM * FORM_MM);
    let weight = PATCHES / count / variance;
    Some(ViewInformation {
        at,
        tool_from_camera,
        centre_mm: centre.into(),
        information: information * weight,
        gradient: gradient * weight,
        rms_mm: (squares / count).sqrt(),
        share: count / points.len() as f64,
    })
}

/// Rotation vector and translation at `centre` of the motion that takes `from` to `to`.
pub(super) fn offset(from: &CameraPose, to: &CameraPose, centre: Vector3<f64>) -> Vector6<f64> {
    let motion = to.isometry() * from.isometry().inverse();
    let turn = motion.rotation.scaled_axis();
    let shift = (motion * Point3::from(centre)).coords - centre;
    Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z)
}
