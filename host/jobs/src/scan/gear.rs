//! Profile, helix and pitch of every tooth from every point of a scan, in the views' final poses, one view in memory after the
//! other.

use std::collections::BTreeMap;

use flankscope_foundation::normal::COVERAGE_95;
use flankscope_metrology::gear::GearData;
use flankscope_metrology::gear::evaluation::{
    EvaluationSettings, Gathering, GearEvaluation, GearEvaluationError,
};
use serde::Serialize;

use super::full_cloud::{points_in_tool, registered};
use super::result::Scan;
use super::session::{Session, SessionError};

/// Why no gear was evaluated.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ScanGearError {
    /// What was scanned is not known to be where it was laid.
    #[error("the views do not stand where a gear could be read from them: {reason}")]
    NotLaid {
        /// The scan's own reason.
        reason: String,
    },
    /// No flank has an uncertainty.
    #[error("no flank was measured of which the uncertainty is known: {reason}")]
    NoUncertainty {
        /// The scan's own reason.
        reason: String,
    },
    /// The points make no gear.
    #[error(transparent)]
    Evaluation(#[from] GearEvaluationError),
    /// The session folder cannot be read.
    #[error(transparent)]
    Session(#[from] SessionError),
}

/// A scan read as a gear.
#[derive(Clone, Debug, Serialize)]
pub struct ScanGear {
    /// Expanded uncertainty (95 %) of a deviation, µm, by what its points share; their scatter is every trace's own `noise_um`.
    pub u95_um: f64,
    /// Its parts: standard uncertainties, µm.
    pub budget_um: BTreeMap<&'static str, f64>,
    /// Range around the turn of what the solve found to be the rotary stage's error, as a length along the pitch circle, µm: views are
    /// laid on their own teeth, so a cumulative pitch deviation of the die cannot be told from it.
    pub stage_um: f64,
    /// Expanded uncertainty of F_p and F_r, µm: with all of that.
    pub cumulative_u95_um: f64,
    /// The figures.
    #[serde(flatten)]
    pub evaluation: GearEvaluation,
}

impl ScanGear {
    /// Expanded uncertainty (95 %) of a deviation, µm: what all share, and the scatter of its own points.
    #[must_use]
    pub fn u95_with_um(&self, noise_um: f64) -> f64 {
        self.u95_um.hypot(COVERAGE_95 * noise_um)
    }
}

/// Terms of a flank's uncertainty budget that all of its points share and that act on its form. The term of the die's turn is left out
/// because a turn is no deviation of profile, helix or pitch; the term of hidden wear, because it concerns wear alone.
const SHARED: [&str; 4] = ["registration", "calibration", "cad", "film"];

/// Reads the gear from a scan that was laid on the CAD in one solve.
pub(super) fn evaluate(
    scan: &Scan,
    session: &Session,
    gear: &GearData,
) -> Result<ScanGear, ScanGearError> {
    let laid = scan.adjustment.as_ref().is_some_and(|found| found.settled);
    // Of a die that is not the CAD's, no flank is told.
    if !laid || scan.flank_means.is_empty() {
        let reason = scan.reason.clone();
        return Err(ScanGearError::NotLaid { reason });
    }
    let budgets = scan.features.iter().filter_map(|of| of.detail.as_ref());
    let mut budget_um: BTreeMap<&'static str, f64> = BTreeMap::new();
    for (&name, &um) in budgets.flat_map(|detail| &detail.budget_um) {
        if SHARED.contains(&name) {
            // No number at all where one is none.
            let worst = budget_um.entry(name).or_insert(um);
            if um > *worst || um.is_nan() {
                *worst = um;
            }
        }
    }
    if budget_um.is_empty() {
        let reason = scan.reason.clone();
        return Err(ScanGearError::NoUncertainty { reason });
    }
    let squares: f64 = budget_um.values().map(|um| um * um).sum();
    let u95_um = COVERAGE_95 * squares.sqrt();
    let stage_um = stage_rad(scan) * 1e3 * gear.pitch_radius_mm();
    let cumulative_u95_um = u95_um + stage_um;
    let settings = EvaluationSettings {
        u95_um,
        cumulative_u95_um: Some(cumulative_u95_um),
        ..EvaluationSettings::for_gear(gear)
    };
    let mut gathering = Gathering::new(gear, &settings)?;
    for (view, tool_from_camera) in registered(scan) {
        let located = points_in_tool(session, view, tool_from_camera)?;
        let points: Vec<[f64; 3]> = located.map(|(point, _)| point).collect();
        gathering.add(&points);
    }
    Ok(ScanGear {
        u95_um,
        budget_um,
        stage_um,
        cumulative_u95_um,
        evaluation: gathering.evaluated()?,
    })
}

/// Range around the turn of the rotary stage's error as it was found: harmonics that all views share, and what each has of its own.
fn stage_rad(scan: &Scan) -> f64 {
    let range = |mdeg: &mut dyn Iterator<Item = f64>| {
        let ends = (f64::INFINITY, f64::NEG_INFINITY);
        let (low, high) = mdeg.fold(ends, |(low, high), of| (low.min(of), high.max(of)));
        (high - low).max(0.0)
    };
    let harmonics = scan
        .adjustment
        .iter()
        .map(|found| found.found.harmonics_mdeg);
    let shared: f64 = harmonics
        .map(|of_turn| {
            let at = |degree: u32| {
                let per_turn = of_turn.iter().zip(1_u8..).map(|([cosine, sine], times)| {
                    let (sin, cos) = (f64::from(times) * f64::from(degree).to_radians()).sin_cos();
                    cosine * cos + sine * sin
                });
                per_turn.sum::<f64>()
            };
            range(&mut (0..360).map(at))
        })
        .sum();
    let own = scan.registration.iter();
    let own = range(&mut own.filter_map(|view| view.residual_turn_mdeg));
    (1e-3 * (shared + own)).to_radians()
}
