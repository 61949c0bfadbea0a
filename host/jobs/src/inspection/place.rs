//! Pose from which a view is captured, and its uncertainty before registration.

use std::sync::Arc;

use flankscope_foundation::rigid::{Camera, Cloud, Rigid, Tool as ToolFrame};
use flankscope_metrology::registration::Prior;
use flankscope_metrology::surface::Surface;
use flankscope_metrology::wear::{Approaches, Zone};
use nalgebra::Matrix6;

use flankscope_instrument::settings::Stages;

/// Pose from which a view is captured, and the surface that is visible from it.
#[derive(Clone)]
pub(super) struct Place {
    pub tooth: u32,
    /// Judged zone of its sides.
    pub zone: Zone,
    pub tool_from_camera: Rigid<ToolFrame, Camera>,
    pub surface: Arc<Surface>,
    /// Standard uncertainties of a stated pose: mm, mrad. `None` for a pose by the stages.
    pub stated: Option<[f64; 2]>,
}

impl Place {
    /// The expected pose relative to a tool that is `scale` times as large as its CAD.
    pub fn tool_from_cold_camera(&self, scale: f64) -> Rigid<ToolFrame, Cloud> {
        let mut pose = *self.tool_from_camera.isometry();
        pose.translation.vector /= scale;
        Rigid::from_isometry(pose)
    }

    /// Expected pose of the view and its covariance, from the stages or from a stated pose.
    pub fn prior(&self, expected: Rigid<ToolFrame, Cloud>, stages: &Stages) -> Prior {
        match self.stated {
            Some([u_mm, u_mrad]) => Prior::independent(expected, [u_mrad / 1e3; 3], [u_mm; 3]),
            None => stage_prior(expected, stages),
        }
    }

    /// Part of that covariance that is random at every approach of the same position; zero for a stated pose, which does not separate it.
    /// What a baseline `measured` of it counts where the station states nothing smaller.
    pub fn approach(&self, stages: &Stages, measured: Option<&Approaches>) -> Matrix6<f64> {
        match self.stated {
            Some(_) => Matrix6::zeros(),
            None => approach_covariance(stages, measured),
        }
    }
}

/// Prior of a view's pose from the stages.
fn stage_prior(expected: Rigid<ToolFrame, Cloud>, stages: &Stages) -> Prior {
    let (mount_mm, mount_rad) = stages.mount_sigma();
    Prior::independent(
        expected,
        [
            mount_rad,
            mount_rad,
            stages.rotation_sigma_rad().hypot(mount_rad),
        ],
        [
            mount_mm,
            mount_mm,
            stages.vertical_sigma_mm().hypot(mount_mm),
        ],
    )
}

/// Covariance of the stages' random errors at every approach. The remaining part of the prior repeats with every approach of the
/// same position: the stages' systematic errors, and the mounting of head and die.
fn approach_covariance(stages: &Stages, measured: Option<&Approaches>) -> Matrix6<f64> {
    let (stated_rad, vertical_mm) = stages.approach_sigma();
    let rotation_rad = match (measured, stages.rotation_repeatability_mdeg) {
        (Some(measured), None) => measured.rotation_u_rad(),
        (Some(measured), Some(_)) => measured.rotation_u_rad().max(stated_rad),
        (None, _) => stated_rad,
    };
    let mut covariance = Matrix6::zeros();
    covariance[(2, 2)] = rotation_rad * rotation_rad;
    covariance[(5, 5)] = vertical_mm * vertical_mm;
    covariance
}
