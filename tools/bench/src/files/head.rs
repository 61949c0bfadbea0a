//! `head.toml`: lenses, their poses, and the patterns.

use std::path::Path;

use nalgebra::Isometry3;
use serde::Deserialize;

use super::{FileError, Placement, read};
use crate::world::{
    Fringes, HeadDesign, HeadOptics, Pinhole, Remainder, SecondProjector, Unevenness,
};

/// The part of a head file that the bench uses.
#[derive(Clone, Debug, Deserialize)]
pub struct HeadFile {
    /// Name of the pattern set; by default that of the head's design.
    pub pattern_set: Option<String>,
    /// Frequencies of that set, if it is specific to the head.
    #[serde(default)]
    pub fringes: Vec<Fringes>,
    /// Objective and sensor.
    pub camera: Lens,
    /// Objective and DMD.
    pub projector: Lens,
    /// Pose of the camera relative to the projector.
    pub projector_from_camera: Placement,
    pub second_projector: Option<SecondLens>,
    /// Pose of the camera on the stages; by default that of the head's design.
    pub stage_from_camera: Option<Placement>,
}

/// A second projector.
#[derive(Clone, Debug, Deserialize)]
pub struct SecondLens {
    /// Objective and DMD.
    pub projector: Lens,
    /// Pose of the camera relative to it.
    pub projector_from_camera: Placement,
}

/// Pinhole with Brown's distortion, in OpenCV's order.
#[derive(Clone, Debug, Deserialize)]
pub struct Lens {
    /// Focal length along columns and rows.
    pub focal_px: [f64; 2],
    /// Principal point: column, row.
    pub principal_px: [f64; 2],
    /// k1, k2, p1, p2, k3.
    #[serde(default)]
    pub distortion: [f64; 5],
    /// Residual distortion beyond that model.
    pub residual: Option<Box<Remainder>>,
}

impl HeadFile {
    /// Reads `head.toml`.
    pub fn load(path: &Path) -> Result<Self, FileError> {
        read(path)
    }

    /// The head file that describes a design exactly.
    #[must_use]
    pub fn of(made: &HeadDesign) -> Self {
        let optics = made.optics();
        let lens = |of: &Pinhole| Lens {
            focal_px: of.focal_px,
            principal_px: of.centre_px,
            distortion: of.distortion,
            residual: None,
        };
        Self {
            pattern_set: Some(made.pattern_set.clone()),
            fringes: made.fringes.clone(),
            camera: lens(&optics.camera),
            projector: lens(&optics.projector),
            projector_from_camera: (&optics.projector_from_camera).into(),
            second_projector: optics.second_projector.as_ref().map(|second| SecondLens {
                projector: lens(&second.projector),
                projector_from_camera: (&second.projector_from_camera).into(),
            }),
            stage_from_camera: Some((&optics.stage_from_camera).into()),
        }
    }

    /// Sets the optics of a world to this head.
    pub fn impose(&self, optics: &mut HeadOptics) {
        optics.camera = self.camera.pinhole();
        optics.projector = self.projector.pinhole();
        optics.projector_from_camera = (&self.projector_from_camera).into();
        optics.second_projector = self
            .second_projector
            .as_ref()
            .map(|second| SecondProjector {
                projector: second.projector.pinhole(),
                projector_from_camera: (&second.projector_from_camera).into(),
            });
        if let Some(hand_eye) = &self.stage_from_camera {
            optics.stage_from_camera = Isometry3::from(hand_eye);
        }
    }
}

impl Lens {
    fn pinhole(&self) -> Pinhole {
        Pinhole {
            focal_px: self.focal_px,
            centre_px: self.principal_px,
            distortion: self.distortion,
            uneven: self
                .residual
                .as_deref()
                .map(|field| Unevenness::stated(field, self.focal_px)),
        }
    }
}
