//! Profile, helix and pitch of the teeth, read from a scan.

use std::collections::BTreeMap;

use flankscope_foundation::normal::COVERAGE_95;
use flankscope_metrology::gear::evaluation::GearEvaluation;
use serde::Serialize;

/// Gear evaluation of a scan.
#[derive(Clone, Debug, Serialize)]
pub struct ScanGear {
    /// Expanded uncertainty (95 %) of a deviation, µm, common to all of its points; their scatter is every trace's own `noise_um`.
    pub u95_um: f64,
    /// Its contributions: standard uncertainties, µm.
    pub budget_um: BTreeMap<&'static str, f64>,
    /// Range over a revolution of the rotary stage's error by the joint solution, as a length along the pitch circle, µm. Views
    /// are registered to their own teeth, so a cumulative pitch deviation of the die cannot be distinguished from it.
    pub stage_um: f64,
    /// Expanded uncertainty of F_p and F_r, µm, including `stage_um`.
    pub cumulative_u95_um: f64,
    /// The results.
    #[serde(flatten)]
    pub evaluation: GearEvaluation,
}

impl ScanGear {
    /// Expanded uncertainty (95 %) of a deviation, µm: the common part, and the scatter of its own points.
    #[must_use]
    pub fn u95_with_um(&self, noise_um: f64) -> f64 {
        self.u95_um.hypot(COVERAGE_95 * noise_um)
    }
}
