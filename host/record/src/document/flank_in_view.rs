//! A flank that was in view but not requested.

use flankscope_metrology::verdict::Word;
use serde::Serialize;

use super::FeatureId;

/// A flank that was in view but not requested.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FlankInView {
    #[serde(flatten)]
    pub id: FeatureId,
    /// Tooth in the middle of the view.
    pub view: u32,
    /// Wear of its visible part, µm, positive for loss; absent if the baseline does not have the flank.
    pub wear_um: Option<f64>,
    /// Expanded uncertainty of the wear (95 %), µm.
    pub u95_um: Option<f64>,
    /// Fraction of the zone that was measured, 0..1.
    pub coverage_ratio: f64,
    /// `no-go` if proven; `warn` by the estimate alone; `go` if enough of the flank was visible; else `indeterminate`, which does
    /// not affect the check.
    pub verdict: Word,
    /// Why it is not go.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
}
