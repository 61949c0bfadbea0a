//! Identifies the flank or patch that a result belongs to.

use std::fmt;

use flankscope_metrology::gear::Flank;
use serde::Serialize;

/// A flank of a tooth, or a patch.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct FeatureId {
    /// Tooth number from 1; for a patch, its position in the tool file.
    pub tooth: u32,
    /// Side of the tooth; for a patch, its face.
    pub flank: Flank,
    /// Name, for a patch.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub patch: Option<String>,
}

impl FeatureId {
    /// Side of its tooth, or the name of its patch.
    pub fn side(&self) -> &str {
        self.patch.as_deref().unwrap_or(self.flank.word())
    }

    /// Whether both are the same. A patch is compared by name, because its position in the file changes when others are added.
    #[must_use]
    pub fn is_same(&self, other: &Self) -> bool {
        match (&self.patch, &other.patch) {
            (None, None) => self.tooth == other.tooth && self.flank == other.flank,
            (one, two) => one == two,
        }
    }
}

/// Name in a sentence.
impl fmt::Display for FeatureId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.patch {
            Some(name) => write!(f, "patch {name}"),
            None => write!(f, "tooth {} {}", self.tooth, self.flank),
        }
    }
}
