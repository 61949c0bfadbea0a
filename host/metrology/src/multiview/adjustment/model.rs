//! Camera pose from the commanded stage positions.

use flankscope_foundation::rigid::{Camera, Rigid, Stage};
use nalgebra::{Isometry3, SVector, Translation3, UnitQuaternion, Vector3};

use super::CameraPose;

use crate::view::PlannedView;

/// Number of shared parameters.
pub const PARAMETERS: usize = 20;

/// Commanded stage positions of a view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Commanded angle of the rotary stage, rad.
    pub rotation_rad: f64,
    /// Commanded height of the head, mm.
    pub vertical_mm: f64,
}

impl From<&PlannedView> for Pose {
    fn from(view: &PlannedView) -> Self {
        Self {
            rotation_rad: view.rotation_rad,
            vertical_mm: view.vertical_mm,
        }
    }
}

/// Geometry that all views share: parameters in units of their prior standard deviations, and the nominal hand-eye.
#[derive(Debug, Clone)]
pub struct Stages {
    stage_from_camera: Rigid<Stage, Camera>,
    /// Parameters; all zero is what the files say.
    pub parameters: SVector<f64, PARAMETERS>,
}

/// Names of the parameters, in their order.
pub(super) const NAMES: [&str; PARAMETERS] = [
    "die turn x",
    "die turn y",
    "die turn z",
    "die shift x",
    "die shift y",
    "die shift z",
    "head turn x",
    "head turn y",
    "head turn z",
    "head shift x",
    "head shift y",
    "head shift z",
    "vertical axis along the wall",
    "vertical axis towards the wall",
    "encoder cos 1",
    "encoder sin 1",
    "encoder cos 2",
    "encoder sin 2",
    "encoder cos 3",
    "encoder sin 3",
];

const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// Prior standard deviation of where the head stands, each way, mm.
pub const HEAD_SIGMA_MM: f64 = 0.5;

/// Prior standard deviations, mm and rad: a die put down by hand, a hand-eye known to a degree and half a millimetre, a
/// vertical axis as assembled along the wall and as aligned with a straight edge towards it, an encoder within its data
/// sheet. How the vertical axis leans towards the wall looks like a conical die in every view: it stays where it was aligned,
/// and is an uncertainty of the taper.
pub(super) const SIGMA: [f64; PARAMETERS] = {
    let (turn, head, encoder) = (0.2 * DEGREE, DEGREE, 10e-3 * DEGREE);
    [
        turn,
        turn,
        turn,
        0.5,
        0.5,
        0.05,
        head,
        head,
        head,
        HEAD_SIGMA_MM,
        HEAD_SIGMA_MM,
        HEAD_SIGMA_MM,
        500e-6,
        10e-6,
        encoder,
        encoder,
        encoder,
        encoder,
        encoder,
        encoder,
    ]
};

impl Stages {
    /// Everything as the files say.
    pub fn nominal(stage_from_camera: Rigid<Stage, Camera>) -> Self {
        Self {
            stage_from_camera,
            parameters: SVector::zeros(),
        }
    }

    /// A parameter in its own unit (rad or mm).
    pub(super) fn value(&self, index: usize) -> f64 {
        self.parameters[index] * SIGMA[index]
    }

    /// Eccentricity of the die on the table, mm.
    pub fn eccentricity_mm(&self) -> f64 {
        self.value(3).hypot(self.value(4))
    }

    /// Tilt of the die on the table, rad.
    pub fn tilt_rad(&self) -> f64 {
        self.value(0).hypot(self.value(1))
    }

    /// Intersection of the rotation axis with the die's plane at a height, mm in the tool frame; the origin for a die that runs
    /// true.
    pub fn axis_at_mm(&self, height_mm: f64) -> [f64; 2] {
        let above = height_mm - self.value(5);
        [
            self.value(3) + self.value(1) * above,
            self.value(4) - self.value(0) * above,
        ]
    }

    /// Turn (rad) and shift (mm) of the head against its file.
    pub fn head_error(&self) -> ([f64; 3], [f64; 3]) {
        (
            [6, 7, 8].map(|i| self.value(i)),
            [9, 10, 11].map(|i| self.value(i)),
        )
    }

    /// Lean of the vertical axis against the rotation axis: along the wall that the head looks at, and towards it, rad. The
    /// second is known no better than before.
    pub fn vertical_lean_rad(&self) -> [f64; 2] {
        [self.value(12), self.value(13)]
    }

    /// Cosine and sine amplitudes of the encoder's first three harmonics, rad.
    pub fn harmonics_rad(&self) -> [[f64; 2]; 3] {
        std::array::from_fn(|m| [self.value(14 + 2 * m), self.value(15 + 2 * m)])
    }

    /// Tool frame from camera frame.
    pub fn tool_from_camera(&self, at: Pose) -> CameraPose {
        let value = |i| self.value(i);
        let vector = |i| Vector3::new(value(i), value(i + 1), value(i + 2));
        let motion = |turn, shift| {
            Isometry3::from_parts(
                Translation3::from(vector(shift)),
                UnitQuaternion::from_scaled_axis(vector(turn)),
            )
        };
        let error_rad: f64 = (1_u8..)
            .zip(self.harmonics_rad())
            .map(|(order, [cosine, sine])| {
                let (sin, cos) = (f64::from(order) * at.rotation_rad).sin_cos();
                cosine * cos + sine * sin
            })
            .sum();
        let turned =
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -(at.rotation_rad + error_rad));
        let [along, towards] = self.vertical_lean_rad();
        let travel = Vector3::new(towards, along, 1.0) * at.vertical_mm;
        let stage_from_camera = self.stage_from_camera.isometry();
        Rigid::from_isometry(
            motion(0, 3) * turned * Translation3::from(travel) * stage_from_camera * motion(6, 9),
        )
    }
}
