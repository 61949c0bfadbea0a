//! Identity of a die. A no-go applies to the die, independent of the name in its tool file.

use serde::{Deserialize, Serialize};

/// Properties that identify a die.
///
/// Two checks are of the same die if both name a serial number and these are equal. If one of them names none, they are if the
/// tool's name or its geometry is equal. So neither renaming the tool nor replacing the CAD alone clears a no-go. Dies of one
/// design are told apart by their serial numbers.
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
