//! A flank that was in view and not asked for.

use flankscope_metrology::verdict::Word;
use serde::Serialize;

use super::FeatureId;

/// A flank that was in view and not asked for.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FlankInView {
    /// Which one.
    #[serde(flatten)]
    pub id: FeatureId,
    /// Tooth in the middle of the view.
    pub view: u32,
    /// Wear of what was seen of it, µm, positive for loss; absent where the baseline does not know the flank.
    pub wear_um: Option<f64>,
    /// Expanded uncertainty of the wear (95 %), µm.
    pub u95_um: Option<f64>,
    /// Part of the zone that was measured, 0..1.
    pub coverage_ratio: f64,
    /// `no-go` where that is shown, `warn` by the estimate, `go` where the flank was seen well enough for it, else `indeterminate`,
    /// which does not count.
    pub verdict: Word,
    /// Why it is not go.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
}
