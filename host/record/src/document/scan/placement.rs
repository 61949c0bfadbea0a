//! How the die sits relative to an earlier scan.

use flankscope_metrology::multiview::tooth_identity::Comparison;
use flankscope_metrology::verdict::{Code, Reason};
use serde::Serialize;

/// Rotation of the die relative to the earlier scan.
#[derive(Clone, Debug, Serialize)]
pub struct Placement {
    /// `same`, `turned` (by whole teeth), or `unknown`: the flanks' own deviations are not distinctive enough.
    pub status: &'static str,
    /// Explanation in one sentence.
    pub reason: String,
    /// Teeth by which the die was rotated since, positive counter-clockwise seen from above; absent if unknown.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub turned_teeth: Option<i64>,
    /// Correlation of the flanks' deviations at the best shift.
    pub correlation: Option<f64>,
    /// Teeth that both scans show at this shift.
    pub common_teeth: Option<usize>,
    /// Standard deviations above unrelated patterns, at the best and at the second best shift.
    pub sigmas: Vec<f64>,
}

impl Placement {
    /// From a comparison of both scans' flanks; `None` if they cannot be compared.
    #[must_use]
    pub fn new(found: Option<Comparison>) -> Self {
        let turned_teeth = found.and_then(|found| found.turned_teeth());
        let (status, reason) = match turned_teeth {
            Some(0) => ("same", "every tooth is the one that it was in the earlier scan".to_string()),
            Some(teeth) => (
                "turned",
                format!(
                    "the die sits {} {} further {} than in the earlier scan: put it down as it was, or tooth numbers mean other \
                     teeth",
                    teeth.abs(),
                    if teeth.abs() == 1 { "tooth" } else { "teeth" },
                    if teeth > 0 { "counter-clockwise" } else { "clockwise" },
                ),
            ),
            None => (
                "unknown",
                "whether the die sits as in the earlier scan cannot be told: the flanks' own deviations are too small, too \
                 few, too regular, or another die's"
                    .to_string(),
            ),
        };
        let sigmas = found.map(|found| {
            let rival = found.rival.map(|rival| rival.sigmas);
            std::iter::once(found.best.sigmas).chain(rival).collect()
        });
        Self {
            status,
            reason,
            turned_teeth,
            correlation: found.map(|found| found.best.correlation),
            common_teeth: found.map(|found| found.best.common_teeth),
            sigmas: sigmas.unwrap_or_default(),
        }
    }

    /// Why the scan is not a "go", if so: its teeth are not the ones that their numbers say.
    pub fn objection(&self) -> Option<Reason> {
        let turned = self.turned_teeth.is_some_and(|teeth| teeth != 0);
        turned.then(|| Reason::instrument(Code::TurnedDie, &self.reason))
    }
}
