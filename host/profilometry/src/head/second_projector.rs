//! A second projector, on the other side of the camera.

use serde::{Deserialize, Serialize};

use flankscope_foundation::textfile::BadValue;

use super::{HeadModel, ImageCircle, Mirrors, Pinhole, RigidTransform};

/// Lens and place of a projector that shows the same patterns after the first. Units as in [`HeadModel`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SecondProjector {
    /// Its lens, as an inverse camera.
    pub projector: Pinhole,
    /// Arrangement of its DMD's mirrors; absent: orthogonal.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mirrors: Option<Mirrors>,
    /// The part of its DMD whose fringes count; absent: all of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub circle: Option<ImageCircle>,
    /// `X_projector = rotation X_camera + translation_mm`.
    pub projector_from_camera: RigidTransform,
}

impl SecondProjector {
    pub(super) fn check(&self) -> Result<(), BadValue> {
        self.projector.check("second_projector.projector")?;
        let mut mirrors = self.mirrors.iter();
        mirrors.try_for_each(|mirrors| mirrors.check(&self.projector))?;
        let mut circle = self.circle.iter();
        circle.try_for_each(|circle| circle.check("second_projector.circle"))?;
        let key = "second_projector.projector_from_camera";
        self.projector_from_camera.check(key)
    }
}

impl HeadModel {
    /// The head with one of its projectors alone, counted from 1. The calibration record applies to both.
    #[must_use]
    pub fn with_projector(&self, number: u8) -> Option<Self> {
        let mut alone = self.clone();
        match (number, alone.second_projector.take()) {
            (1, None) => return Some(alone),
            (1, Some(_)) => {}
            (2, Some(second)) => {
                alone.projector = second.projector;
                alone.mirrors = second.mirrors;
                alone.projector_circle = second.circle;
                alone.projector_from_camera = second.projector_from_camera;
            }
            _ => return None,
        }
        (alone.calibration, alone.seal, alone.self_test) = (None, None, None);
        Some(alone)
    }

    /// Number of projectors.
    #[must_use]
    pub fn projectors(&self) -> usize {
        1 + usize::from(self.second_projector.is_some())
    }
}
