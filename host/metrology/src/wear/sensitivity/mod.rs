//! Effect of pose and temperature on the figures of a flank, beside its points.
//!
//! Two callers, one result ([`PoseSensitivity`]):
//!
//! | file | view | leakage | form of other flanks | temperature |
//! |---|---|---|---|---|
//! | `view` | one view with its fit (check) | through the fit's response | through the response, flank by flank | through the response |
//! | `scan` | views of an adjustment | through the response about the adjusted pose | uniform leakage of every flank in view | upper bound, nothing taken up by the poses |
//!
//! A scan keeps a sample of each view's points and its adjusted pose, but no fit of its own: it bounds what a check computes.

mod scan;
mod view;

use std::sync::Arc;

use nalgebra::{Vector3, Vector6};

use super::PoseEvidence;
use super::leakage::Leakage;

pub use scan::{HeldView, ScanSensitivity, ScanView, registration_mm};
pub use view::{FittedView, FoundMount, LEAST_POINTS};

/// Effect of pose and temperature on one flank.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseSensitivity {
    /// Leakage of the pose.
    pub leakage: Leakage,
    /// Evidence of the view about its own pose's turn about the axis; none where the pose rests on a datum that does not wear.
    pub evidence: Option<Arc<PoseEvidence>>,
    /// Loss that the datum under the pose hides by its own wear, mm: what the stages contradict of it; zero without a datum of bands.
    pub datum_hides_mm: f64,
    /// Standard deviation of the form from flank to flank, mm, where all flanks of a die show it; zero where only the settings'
    /// as-built form is known.
    pub form_scatter_mm: f64,
    /// Root of the sum of squares of the judged flank's change by a unit error in the form of each other flank.
    pub others_form: f64,
    /// Standard uncertainty of the flank's deviation by that of the temperature, mm.
    pub temperature_mm: f64,
}

/// Thermal expansion of a tool with the uncertainty of its temperature.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExpansionUncertainty {
    /// Thermal expansion, 1/K.
    pub per_k: f64,
    /// Standard uncertainty of the temperature, K.
    pub u_k: f64,
}

/// Derivatives of a point's deviation by a small motion about `centre`: rotation (mm per rad), then translation.
pub(super) fn motion_row(point: [f64; 3], normal: [f64; 3], centre: Vector3<f64>) -> Vector6<f64> {
    let normal = Vector3::from(normal);
    let turn = (Vector3::from(point) - centre).cross(&normal);
    Vector6::new(turn.x, turn.y, turn.z, normal.x, normal.y, normal.z)
}
