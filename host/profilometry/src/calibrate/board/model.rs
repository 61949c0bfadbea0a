//! Camera, projector and a board before them: the unknowns, and where they put a point of the board.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use crate::calibrate::model::{middle_of_image, turn_about_origin};
use crate::head::Pinhole;

/// Unknowns of a lens: focal lengths, principal point, k1, k2, p1, p2.
pub(super) const OF_LENS: usize = 8;
/// First unknowns of the projector and of its place, and their number.
pub(super) const PROJECTOR: usize = OF_LENS;
const PLACE: usize = 2 * OF_LENS;
pub(super) const OF_RIG: usize = PLACE + OF_POSE;
/// Unknowns of a pose: a turn about the board's origin, and its place.
pub(super) const OF_POSE: usize = 6;

/// What the unknowns are called, with their units.
pub(super) const NAMES: [&str; OF_RIG] = [
    "camera.focal_px[0]",
    "camera.focal_px[1]",
    "camera.principal_px[0]",
    "camera.principal_px[1]",
    "camera.k1",
    "camera.k2",
    "camera.p1",
    "camera.p2",
    "projector.focal_px[0]",
    "projector.focal_px[1]",
    "projector.principal_px[0]",
    "projector.principal_px[1]",
    "projector.k1",
    "projector.k2",
    "projector.p1",
    "projector.p2",
    "projector_from_camera.turn_rad[0]",
    "projector_from_camera.turn_rad[1]",
    "projector_from_camera.turn_rad[2]",
    "projector_from_camera.translation_mm[0]",
    "projector_from_camera.translation_mm[1]",
    "projector_from_camera.translation_mm[2]",
];

/// The unknowns that all poses share.
#[derive(Clone, Debug)]
pub(super) struct Rig {
    pub camera: Pinhole,
    pub projector: Pinhole,
    pub projector_from_camera: Isometry3<f64>,
}

/// Where a point appears: column and row of the camera, column and row of the projector.
pub(super) type Seen = [f64; 4];

impl Rig {
    /// Moves an unknown.
    pub fn step(&mut self, unknown: usize, by: f64) {
        match unknown {
            0..PROJECTOR => step_lens(&mut self.camera, unknown, by),
            PROJECTOR..PLACE => step_lens(&mut self.projector, unknown - PROJECTOR, by),
            _ => step_pose(&mut self.projector_from_camera, unknown - PLACE, by),
        }
    }

    /// A step that moves a point by about a hundredth of a pixel; lengths are those of boards `size_mm` large.
    pub fn small_step(unknown: usize, size_mm: f64) -> f64 {
        match unknown {
            0..PLACE => match unknown % OF_LENS {
                0..4 => 1e-2,
                _ => 1e-4,
            },
            _ => small_pose_step(unknown - PLACE, size_mm),
        }
    }

    /// Where a point of a board appears; of a circle the middle of its elliptic image . `None` behind a lens.
    pub fn seen(
        &self,
        camera_from_board: &Isometry3<f64>,
        at_mm: [f64; 2],
        radius_mm: f64,
    ) -> Option<Seen> {
        let p_camera = middle_of_image(camera_from_board, at_mm, radius_mm);
        let p_projector = self.projector_from_camera * p_camera;
        if !(p_camera.z > 0.0 && p_projector.z > 0.0) {
            return None;
        }
        let [u, v] = self
            .camera
            .pixel([p_camera.x / p_camera.z, p_camera.y / p_camera.z]);
        let [column, row] = self
            .projector
            .pixel([p_projector.x / p_projector.z, p_projector.y / p_projector.z]);
        Some([u, v, column, row])
    }
}

fn step_lens(lens: &mut Pinhole, unknown: usize, by: f64) {
    match unknown {
        0 | 1 => lens.focal_px[unknown] += by,
        2 | 3 => lens.principal_px[unknown - 2] += by,
        _ => lens.distortion[unknown - 4] += by,
    }
}

/// Moves an unknown of a pose.
pub(super) fn step_pose(pose: &mut Isometry3<f64>, unknown: usize, by: f64) {
    match unknown {
        0..3 => {
            turn_about_origin(
                pose,
                UnitQuaternion::from_scaled_axis(Vector3::ith(unknown, by)),
            );
        }
        _ => pose.translation.vector[unknown - 3] += by,
    }
}

pub(super) fn small_pose_step(unknown: usize, size_mm: f64) -> f64 {
    match unknown {
        0..3 => 1e-5,
        _ => 1e-5 * size_mm,
    }
}
