//! From stored checks to the wear of each flank against cycles.

use std::collections::BTreeMap;

use flankscope_foundation::normal::COVERAGE_95;
use flankscope_metrology::gear::Flank;
use flankscope_metrology::verdict::{Code, Word};

use super::rows::Check;
use crate::document::FeatureId;

/// Wear of one flank or patch over the tool's present life.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// Which flank or patch; a patch with the number that it had last.
    pub id: FeatureId,
    /// Latest warn limit, µm.
    pub warn_um: f64,
    /// Latest stop limit, µm.
    pub limit_um: f64,
    /// Its figures, cycles never descending.
    pub points: Vec<Point>,
}

/// One figure.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Point {
    /// Check that it is of.
    pub check: i64,
    /// Press cycles that the tool had done.
    pub cycles: f64,
    /// Wear, µm.
    pub wear_um: f64,
    /// Its standard uncertainty, µm.
    pub u_um: f64,
}

/// The checks that can be compared with the last one: of the same life of the tool, which begins anew where its cycles
/// fall back, with the same serial number, and judged by the same baseline.
pub fn present_life(checks: &[Check]) -> impl Iterator<Item = &Check> {
    let fallen = checks
        .windows(2)
        .rposition(|pair| pair[1].tool_cycles < pair[0].tool_cycles);
    let like = |check: &Check| (check.baseline.clone(), check.serial.clone());
    let last = checks.last().map(like);
    checks[fallen.map_or(0, |at| at + 1)..]
        .iter()
        .filter(move |check| Some(like(check)) == last)
}

/// The measured figures of every flank, by tooth and flank, and of every patch, by name.
///
/// A figure that is only too near to a limit to be decided is as good as any other; leaving it out would bend the trend
/// where it matters. What was indeterminate for another reason is left out.
#[must_use]
pub fn series(checks: &[Check]) -> Vec<Series> {
    // Flanks in order of teeth, then patches by name.
    let mut flanks: BTreeMap<(Option<&str>, u32, Flank), Series> = BTreeMap::new();
    for check in present_life(checks) {
        for flank in &check.flanks {
            let FeatureId {
                tooth,
                flank: side,
                patch,
            } = &flank.id;
            // The place of a patch in its file changes when others are added; its name stays.
            let place = if patch.is_some() { 0 } else { *tooth };
            let series = flanks
                .entry((patch.as_deref(), place, *side))
                .or_insert_with(|| Series {
                    id: flank.id.clone(),
                    warn_um: flank.warn_um,
                    limit_um: flank.limit_um,
                    points: Vec::new(),
                });
            series.id.tooth = *tooth;
            (series.warn_um, series.limit_um) = (flank.warn_um, flank.limit_um);
            let measured =
                flank.verdict != Word::Indeterminate || flank.code == Some(Code::Undecidable);
            if let (true, Some(wear_um), Some(u95_um)) = (measured, flank.wear_um, flank.u95_um) {
                series.points.push(Point {
                    check: check.id,
                    cycles: check.tool_cycles as f64,
                    wear_um,
                    u_um: u95_um / COVERAGE_95,
                });
            }
        }
    }
    flanks.into_values().collect()
}
