//! What a verdict was computed from: enough to compute it again, and to notice when something is not the same.

use flankscope_metrology::verdict::{Code, Reason};
use flankscope_profilometry::decode::GridKind;
use flankscope_profilometry::head::Sensor;
use flankscope_profilometry::{Accumulator, PatternSet};
use serde::{Deserialize, Serialize};

use flankscope_foundation::files;
use flankscope_metrology::view::{PlannedView, StatedPose};

/// How a check looks at a tool, beside what its files say.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Recipe {
    /// Teeth in the middle of the views.
    pub teeth: Vec<u32>,
    /// Patterns.
    pub pattern_set: String,
    /// Share of all mirrors' light that each pass of the patterns gives; none: they are shown once, by all mirrors.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub lit_ratios: Vec<f64>,
    /// Exposures, µs.
    pub exposures_us: Vec<u32>,
    /// What a point is made of.
    pub grid: GridKind,
    /// Temperature of the tool, degrees C, where it is known.
    pub temperature_degc: Option<f64>,
    /// Of recorded frames, where they were not taken as tool and head file say.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recorded: Option<RecordedRecipe>,
}

/// What an index and its plan say of recorded frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RecordedRecipe {
    /// Where the stages stood.
    pub views: Vec<PlannedView>,
    /// Patterns.
    pub patterns: PatternSet,
    /// Whether a dark frame preceded each view.
    pub dark_frame: bool,
    /// The sensor, where it is not the one of the head's file.
    pub sensor: Option<Sensor>,
    /// Where the camera stood, by view from 0, where somebody else than the stages said so.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub poses: Vec<(usize, StatedPose)>,
}

impl Recipe {
    /// BLAKE3 of its JSON.
    #[must_use]
    pub fn hash(&self) -> String {
        files::hash(&serde_json::to_vec(self).unwrap_or_default())
    }
}

/// Where the verdict on one view comes from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Evidence {
    /// Tooth in the middle of the view.
    pub tooth: u32,
    /// BLAKE3 of the phasors of each capture of the view, in order; none when it was not captured whole.
    pub phasors: Vec<String>,
    /// Why there are none.
    #[serde(flatten)]
    pub problem: Option<Problem>,
}

/// Why a view was not captured whole, as it is stored: enough for the same verdict to follow from it again.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Problem {
    /// In one sentence.
    #[serde(rename = "problem")]
    pub sentence: String,
    /// What kind of reason.
    pub code: Code,
}

impl From<&Reason> for Problem {
    fn from(reason: &Reason) -> Self {
        Self {
            sentence: reason.to_string(),
            code: reason.code(),
        }
    }
}

impl From<&Problem> for Reason {
    fn from(problem: &Problem) -> Self {
        Self::instrument(problem.code, &problem.sentence)
    }
}

/// The sums of one capture of one view.
#[derive(Clone, Debug)]
pub struct Phasors {
    /// BLAKE3 of the bytes.
    pub blake3: String,
    /// See [`flankscope_profilometry::Accumulator::to_bytes`].
    pub bytes: Vec<u8>,
}

impl Phasors {
    /// Sums of one capture, as bytes with their digest.
    #[must_use]
    pub fn of(sums: &Accumulator) -> Self {
        let bytes = sums.to_bytes();
        Self {
            blake3: files::hash(&bytes),
            bytes,
        }
    }
}
