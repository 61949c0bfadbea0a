//! Observation model of an ordinary board in unknown poses: all of both lenses, the pose between them and the board's poses.

use nalgebra::{DVector, Isometry3};

use super::{BoardMark, Geometry};
use crate::calibrate::bundle::{DISTORTION_SIGMA, Observation, ObservationModel, Prior, ViewState};
use crate::calibrate::rig::{Rig, step_lens, step_pose};

/// Unknowns of a lens: focal lengths, principal point, k1, k2, p1, p2.
const OF_LENS: usize = 8;
/// First unknowns of the projector and of the pose between camera and projector, and the number of all.
pub(super) const PROJECTOR: usize = OF_LENS;
const POSE: usize = 2 * OF_LENS;
pub(super) const OF_RIG: usize = POSE + OF_POSE;
/// Unknowns of a pose: turns about its origin, and its translation.
const OF_POSE: usize = 6;

/// Names of the unknowns, with their units.
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

/// Coordinates of an image point that are observed.
pub(super) const COORDINATES: usize = 4;

/// The dots of some poses.
pub(super) fn observations(views: &[Vec<BoardMark>], geometry: Geometry) -> Vec<Vec<Observation>> {
    let observation = |mark: &BoardMark| Observation {
        at_mm: mark.at_mm(geometry.pitch_mm),
        radius_mm: geometry.radius_mm,
        seen_px: [mark.pixel[0], mark.pixel[1], mark.lit_px[0], mark.lit_px[1]],
    };
    let of_view = |marks: &Vec<BoardMark>| marks.iter().map(observation).collect();
    views.iter().map(of_view).collect()
}

/// Which unknowns are adjusted besides the poses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Free {
    /// None: the poses, by the camera's image.
    Poses,
    /// The camera's, by its own image.
    Camera,
    /// All, by both images.
    All,
}

impl Free {
    /// Number of unknowns that all poses share.
    fn shared(self) -> usize {
        match self {
            Self::Poses => 0,
            Self::Camera => PROJECTOR,
            Self::All => OF_RIG,
        }
    }
}

/// The unknowns of the rig, and the board's poses in the camera frame.
#[derive(Clone)]
pub(super) struct BoardModel {
    pub free: Free,
    pub rig: Rig,
    pub poses: Vec<Isometry3<f64>>,
}

/// The unknowns of one pose: the free ones of the rig, and its own.
#[derive(Clone)]
pub(super) struct BoardPose {
    free: Free,
    rig: Rig,
    camera_from_board: Isometry3<f64>,
}

fn step_rig(rig: &mut Rig, unknown: usize, by: f64) {
    match unknown {
        0..PROJECTOR => step_lens(&mut rig.camera, unknown, by),
        PROJECTOR..POSE => step_lens(&mut rig.projector, unknown - PROJECTOR, by),
        _ => step_pose(&mut rig.projector_from_camera, unknown - POSE, by),
    }
}

impl ViewState for BoardPose {
    fn rig(&self) -> &Rig {
        &self.rig
    }

    fn camera_from_plate(&self) -> Isometry3<f64> {
        self.camera_from_board
    }

    fn stepped(&self) -> usize {
        self.free.shared() + OF_POSE
    }

    fn step(&mut self, unknown: usize, by: f64) {
        match unknown.checked_sub(self.free.shared()) {
            None => step_rig(&mut self.rig, unknown, by),
            Some(own) => step_pose(&mut self.camera_from_board, own, by),
        }
    }

    fn small_step(&self, unknown: usize) -> f64 {
        let of_pose = match unknown.checked_sub(self.free.shared()) {
            None => unknown.checked_sub(POSE),
            own => own,
        };
        match of_pose {
            None if unknown % OF_LENS < 4 => 1e-2,
            None => 1e-4,
            Some(0..3) => 1e-5,
            // Lengths in proportion to the distance of the board: boards and heads are of any size.
            Some(_) => 1e-5 * self.camera_from_board.translation.vector.norm(),
        }
    }
}

impl ObservationModel for BoardModel {
    type View = BoardPose;

    fn coordinates(&self) -> usize {
        match self.free {
            Free::Poses | Free::Camera => 2,
            Free::All => COORDINATES,
        }
    }

    fn unknowns(&self) -> usize {
        self.free.shared() + OF_POSE * self.poses.len()
    }

    fn head_unknowns(&self) -> usize {
        self.free.shared()
    }

    fn view(&self, view: usize) -> BoardPose {
        BoardPose {
            free: self.free,
            rig: self.rig.clone(),
            camera_from_board: self.poses[view],
        }
    }

    fn positions(&self, view: usize) -> Vec<usize> {
        let own = self.free.shared() + OF_POSE * view;
        (0..self.free.shared()).chain(own..own + OF_POSE).collect()
    }

    /// Holds coefficients of distortion near zero where no point determines them.
    fn priors(&self) -> Vec<Prior> {
        let lenses = [(0, &self.rig.camera), (PROJECTOR, &self.rig.projector)];
        let priors = lenses.into_iter().flat_map(|(first, lens)| {
            let sigmas = DISTORTION_SIGMA.into_iter().enumerate();
            sigmas.map(move |(k, sigma)| Prior {
                unknown: first + 4 + k,
                off: lens.distortion[k],
                sigma,
            })
        });
        priors
            .filter(|prior| prior.unknown < self.free.shared())
            .collect()
    }

    fn step(&mut self, step: &DVector<f64>) {
        let shared = self.free.shared();
        for unknown in 0..shared {
            step_rig(&mut self.rig, unknown, step[unknown]);
        }
        for (pose, camera_from_board) in self.poses.iter_mut().enumerate() {
            for own in 0..OF_POSE {
                step_pose(camera_from_board, own, step[shared + OF_POSE * pose + own]);
            }
        }
    }
}
