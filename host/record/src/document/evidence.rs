//! The data that a verdict was computed from: enough to compute it again and to detect changes.

use flankscope_metrology::verdict::{Code, Reason};
use flankscope_profilometry::decode::GridKind;
use flankscope_profilometry::head::Sensor;
use flankscope_profilometry::{Accumulator, PatternSet};
use serde::{Deserialize, Serialize};

use flankscope_foundation::files;
use flankscope_metrology::view::{FurtherView, PlannedView, StatedPose};

/// Measurement settings of a check that are not in its files.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Recipe {
    /// Teeth in the middle of the views.
    pub teeth: Vec<u32>,
    /// Name of the pattern set.
    pub pattern_set: String,
    /// Fraction of the light of all mirrors that each pass of the patterns gives; empty: shown once, by all mirrors.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub lit_ratios: Vec<f64>,
    /// Exposure times, µs.
    pub exposures_us: Vec<u32>,
    /// How pixels are grouped into points.
    pub grid: GridKind,
    /// Temperature of the tool, °C, if known.
    pub temperature_degc: Option<f64>,
    /// For recorded frames that were not taken as tool and head file say: how they were taken.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recorded: Option<RecordedRecipe>,
}

/// How recorded frames were taken, by their index and plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RecordedRecipe {
    /// Position of the stages for each view.
    pub views: Vec<PlannedView>,
    /// Position of the stages for each further view.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub further: Vec<FurtherView>,
    pub patterns: PatternSet,
    /// Whether a dark frame preceded each view.
    pub dark_frame: bool,
    /// The sensor, if it is not the one in the head file.
    pub sensor: Option<Sensor>,
    /// Pose of the camera by view from 0, if it does not come from the stages.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub poses: Vec<(usize, StatedPose)>,
}

impl Recipe {
    /// BLAKE3 of its JSON.
    pub fn hash(&self) -> String {
        files::hash(&serde_json::to_vec(self).unwrap_or_default())
    }
}

/// Data from which the verdict of one view was computed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Evidence {
    /// Tooth in the middle of the view.
    pub tooth: u32,
    /// BLAKE3 of the phasors of each capture of the view, in order; empty if it was not captured completely.
    pub phasors: Vec<String>,
    /// Captures of further views of its tooth.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub further: Vec<FurtherEvidence>,
    /// Why there are no phasors.
    #[serde(flatten)]
    pub problem: Option<Problem>,
}

/// A capture of a further view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FurtherEvidence {
    /// Number of the view, counted from the plan's first view: the further views come after all others.
    pub view: usize,
    /// BLAKE3 of its phasors.
    pub phasors: String,
}

/// Why a view was not captured completely, as it is stored: from it the same verdict follows again.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Problem {
    #[serde(rename = "problem")]
    pub sentence: String,
    /// Class of the reason.
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

/// The phasor sums of one capture of one view.
#[derive(Clone, Debug)]
pub struct Phasors {
    /// BLAKE3 of the bytes.
    pub blake3: String,
    /// See [`flankscope_profilometry::Accumulator::to_bytes`].
    pub bytes: Vec<u8>,
}

impl Phasors {
    /// Serialises the sums of one capture and computes their digest.
    #[must_use]
    pub fn of(sums: &Accumulator) -> Self {
        let bytes = sums.to_bytes();
        Self {
            blake3: files::hash(&bytes),
            bytes,
        }
    }
}
