//! Where one view is taken: commanded by the stages, or stated by somebody who moved the camera.

use flankscope_foundation::rigid::{Camera, Rigid, RigidError, Stage, Tool};
use serde::{Deserialize, Serialize};

use crate::gear::Flank;
use crate::kinematics::tool_from_camera;

/// One view: which tooth or patch is in its middle, and where the stages must stand.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlannedView {
    /// Tooth, or number of the patch, in the middle of the field.
    pub tooth: u32,
    /// Angle by which the die is turned before the head, rad ([`crate::kinematics`]); the rotary stage's commanded angle where it
    /// turns the die.
    pub rotation_rad: f64,
    /// Commanded position of the vertical stage, mm.
    pub vertical_mm: f64,
}

/// A view of a planned view's tooth from another place, for what that view does not show.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FurtherView {
    /// The flank that it is for; none for both.
    pub flank: Option<Flank>,
    /// Its tooth, and where the stages must stand.
    #[serde(flatten)]
    pub view: PlannedView,
}

impl PlannedView {
    /// Pose of the camera with the stages where they were commanded.
    #[must_use]
    pub fn tool_from_camera(&self, stage_from_camera: Rigid<Stage, Camera>) -> Rigid<Tool, Camera> {
        tool_from_camera(self.rotation_rad, self.vertical_mm, stage_from_camera)
    }
}

/// Pose of the camera as stated by whoever moved it, with its uncertainty.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StatedPose {
    /// Tool frame from camera frame, row-major, mm; the numbers as stated, so that a replay reads the same.
    pub tool_from_camera: [[f64; 4]; 4],
    /// Standard uncertainty in each direction, mm.
    pub u_mm: f64,
    /// Standard uncertainty about each axis, mrad.
    pub u_mrad: f64,
}

impl StatedPose {
    /// The pose as a rigid transform.
    ///
    /// # Errors
    /// The matrix is no rigid transform.
    pub fn rigid(&self) -> Result<Rigid<Tool, Camera>, RigidError> {
        Rigid::from_rows(&self.tool_from_camera)
    }
}
