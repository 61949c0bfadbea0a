//! A die other than the tool file's, as if the wrong one had been mounted.

use flankscope_gear_cad::{GearSpec, MeshError, Meshing};

use super::CHORD_ERROR_MM;
use crate::world::WorldConfig;

/// Teeth and module of another die of the same kind and height.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OtherDie {
    teeth: u32,
    module_mm: f64,
}

/// The text is not a die.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{text} is no die; TEETHxMODULE_MM is, such as 83x0.9869")]
pub struct OtherDieError {
    text: String,
}

impl std::str::FromStr for OtherDie {
    type Err = OtherDieError;

    fn from_str(text: &str) -> Result<Self, OtherDieError> {
        let parts = text.split_once('x').and_then(|(teeth, module)| {
            let die = Self {
                teeth: teeth.parse().ok()?,
                module_mm: module.parse().ok()?,
            };
            (die.teeth > 0 && die.module_mm > 0.0).then_some(die)
        });
        parts.ok_or_else(|| OtherDieError { text: text.into() })
    }
}

impl OtherDie {
    /// Replaces the tool file's die at the same position.
    ///
    /// # Errors
    /// No such gear can be made.
    pub fn replace(&self, config: &mut WorldConfig) -> Result<(), MeshError> {
        let radius_mm = 0.5 * self.module_mm * f64::from(self.teeth);
        config.gear = GearSpec {
            teeth: self.teeth,
            module_mm: self.module_mm,
            tip_radius_mm: radius_mm - self.module_mm,
            root_radius_mm: radius_mm + 1.25 * self.module_mm,
            ..config.gear.clone()
        };
        config.cad = config.gear.mesh(&Meshing {
            chord_error_mm: CHORD_ERROR_MM,
            ..Meshing::default()
        })?;
        Ok(())
    }
}
