//! Which die a check is of: a no-go stands against the die, whatever its tool file calls it.

use serde::{Deserialize, Serialize};

/// What a die is known by.
///
/// Two checks are of the same die when both name a serial number and it is the same; where one of them names none, when
/// either the tool's name or its geometry is the same. So a no-go is not shed by another name, nor by another CAD alone;
/// dies of one design are told apart by their serial numbers.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DieKey {
    /// Name of the tool.
    pub tool: String,
    /// BLAKE3 of CAD and gear data.
    pub geometry: String,
    /// Serial number in the tool file.
    pub serial: Option<String>,
}

impl DieKey {
    /// Whether it may be the same die.
    #[must_use]
    pub fn is_same(&self, other: &Self) -> bool {
        match (&self.serial, &other.serial) {
            (Some(one), Some(two)) => one == two,
            _ => self.tool == other.tool || self.geometry == other.geometry,
        }
    }
}
