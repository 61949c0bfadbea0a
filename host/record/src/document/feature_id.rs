//! Which flank or patch a figure is of.

use std::fmt;

use flankscope_metrology::gear::Flank;
use serde::Serialize;

/// A flank of a tooth, or a patch.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct FeatureId {
    /// Tooth number, 1 is the first; of a patch, its place among those of the tool file.
    pub tooth: u32,
    /// Side of the tooth, or the face of a patch.
    pub flank: Flank,
    /// Name of the patch, where it is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub patch: Option<String>,
}

impl FeatureId {
    /// Which side of its tooth it is, or the name of its patch.
    #[must_use]
    pub fn side(&self) -> &str {
        self.patch.as_deref().unwrap_or(self.flank.word())
    }

    /// Whether both are the same: a patch goes by its name, since its place in the file changes when others are added.
    #[must_use]
    pub fn is_same(&self, other: &Self) -> bool {
        match (&self.patch, &other.patch) {
            (None, None) => self.tooth == other.tooth && self.flank == other.flank,
            (one, two) => one == two,
        }
    }
}

/// What it is called in a sentence.
impl fmt::Display for FeatureId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.patch {
            Some(name) => write!(f, "patch {name}"),
            None => write!(f, "tooth {} {}", self.tooth, self.flank),
        }
    }
}
