//! `head.toml`: lenses, where they are, and which patterns they show.

use std::path::Path;

use nalgebra::Isometry3;
use serde::Deserialize;

use super::{FileError, Placement, read};
use crate::world::{
    Fringes, HeadDesign, HeadOptics, Pinhole, Remainder, SecondProjector, Unevenness,
};

/// The bench's part of a head file.
#[derive(Clone, Debug, Deserialize)]
pub struct HeadFile {
    /// Name of the pattern set; without it that of the head as it was made.
    pub pattern_set: Option<String>,
    /// Frequencies of that set, where it is the head's own.
    #[serde(default)]
    pub fringes: Vec<Fringes>,
    /// Objective and sensor.
    pub camera: Lens,
    /// Objective and DMD.
    pub projector: Lens,
    /// Projector against camera.
    pub projector_from_camera: Placement,
    /// Another projector.
    pub second_projector: Option<SecondLens>,
    /// Camera on the stages; without it, where the head as it was made has it.
    pub stage_from_camera: Option<Placement>,
}

/// A second projector.
#[derive(Clone, Debug, Deserialize)]
pub struct SecondLens {
    /// Objective and DMD.
    pub projector: Lens,
    /// Against the camera.
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
    /// What the lens does beyond that.
    pub residual: Option<Box<Remainder>>,
}

impl HeadFile {
    /// Reads `head.toml`.
    ///
    /// # Errors
    /// [`FileError`].
    pub fn load(path: &Path) -> Result<Self, FileError> {
        read(path)
    }

    /// A head as a file would state it.
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

    /// Puts the head into the optics of a world.
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
