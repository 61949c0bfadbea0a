//! Profile, helix and pitch of every tooth from all points of a scan, in the views' final poses, with one view in memory at a time.

use std::collections::BTreeMap;

use flankscope_foundation::normal::COVERAGE_95;
use flankscope_metrology::gear::GearData;
use flankscope_metrology::gear::evaluation::{EvaluationSettings, Gathering, GearEvaluationError};

use super::full_cloud::{points_in_tool, registered};
use super::session::{Session, SessionError};
use flankscope_record::document::scan::{Scan, ScanGear};

/// Why the gear was not evaluated.
#[derive(Debug, thiserror::Error)]
pub enum ScanGearError {
    /// The views are not registered reliably.
    #[error("the views do not stand where a gear could be read from them: {reason}")]
    NotLaid {
        /// Reason given by the scan.
        reason: String,
    },
    #[error("no flank was measured of which the uncertainty is known: {reason}")]
    NoUncertainty {
        /// Reason given by the scan.
        reason: String,
    },
    /// The points do not form a gear.
    #[error(transparent)]
    Evaluation(#[from] GearEvaluationError),
    /// The session folder cannot be read.
    #[error(transparent)]
    Session(#[from] SessionError),
}

/// Terms of a flank's uncertainty budget that are common to its points and act on its form. Excluded are the term of the die's
/// rotation, because a rotation is no deviation of profile, helix or pitch, and the term of hidden wear, because it concerns wear
/// alone.
const SHARED: [&str; 4] = ["registration", "calibration", "cad", "film"];

/// Evaluates the gear from a scan that was registered to the CAD in one solution.
pub(super) fn evaluate(
    scan: &Scan,
    session: &Session,
    gear: &GearData,
) -> Result<ScanGear, ScanGearError> {
    let laid = scan.adjustment.as_ref().is_some_and(|found| found.settled);
    // If the die is not that of the CAD, no flank is evaluated.
    if !laid || scan.flank_means.is_empty() {
        let reason = scan.reason.clone();
        return Err(ScanGearError::NotLaid { reason });
    }
    let budgets = scan.features.iter().filter_map(|of| of.detail.as_ref());
    let mut budget_um: BTreeMap<&'static str, f64> = BTreeMap::new();
    for (&name, &um) in budgets.flat_map(|detail| &detail.budget_um) {
        if SHARED.contains(&name) {
            // NaN if one of them is NaN.
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

/// Range over a revolution of the rotary stage's error as found: common harmonics, and the residual of each view.
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
