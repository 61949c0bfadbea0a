//! Two checks of a die compared: what changed from the one to the other.

use serde::Serialize;

use super::{Expanded, Feature, FeatureId, FlankMap};

/// What changed on every flank between two stored checks of one die, both computed again from their phasors.
#[derive(Clone, Debug, Serialize)]
pub struct Comparison {
    /// The earlier check.
    pub before: ComparedCheck,
    /// The later one.
    pub after: ComparedCheck,
    /// Name of the tool.
    pub tool: String,
    /// Every flank of the later check.
    pub flanks: Vec<ComparedFlank>,
    /// Link of the later check.
    pub link: String,
    /// Whether one of the two looked at the simulated bench.
    pub simulated: bool,
    /// Station of the later check.
    pub station: String,
}

/// One of the two checks.
#[derive(Clone, Debug, Serialize)]
pub struct ComparedCheck {
    /// Its number in the history.
    pub id: i64,
    /// Date and time, UTC.
    pub date: String,
    /// Press cycles, by the controller's counter.
    pub cycles: i64,
    /// Deviation maps of its flanks.
    #[serde(skip)]
    pub maps: Vec<FlankMap>,
}

/// One flank in both checks.
#[derive(Clone, Debug, Serialize)]
pub struct ComparedFlank {
    /// Which flank or patch.
    #[serde(flatten)]
    pub id: FeatureId,
    /// Wear against CAD in the earlier check, µm, if it was measured.
    pub before_um: Option<Expanded>,
    /// Wear against CAD in the later check, µm, if it was measured.
    pub after_um: Option<Expanded>,
    /// Loss from the one to the other, as a check with the earlier one as its baseline states it.
    pub since: Feature,
}
