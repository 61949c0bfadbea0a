//! Extracts the wear of each flank against cycles from stored checks.

use std::collections::BTreeMap;

use flankscope_foundation::normal::COVERAGE_95;
use flankscope_metrology::gear::Flank;
use flankscope_metrology::verdict::{Code, Word};

use super::rows::Check;
use crate::document::FeatureId;

/// Wear of one flank or patch over the tool's present life.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// Which flank or patch; a patch has its latest number.
    pub id: FeatureId,
    /// Latest warn limit, µm.
    pub warn_um: f64,
    /// Latest stop limit, µm.
    pub limit_um: f64,
    /// Its values, in order of cycles.
    pub points: Vec<Point>,
}

/// One value.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Point {
    /// Number of its check.
    pub check: i64,
    /// Press cycles done with the tool.
    pub cycles: f64,
    /// Wear, µm.
    pub wear_um: f64,
    /// Its standard uncertainty, µm.
    pub u_um: f64,
}

/// The checks that can be compared with the last one: the same life of the tool (a new one begins where its cycles decrease), the
/// same serial number, and the same baseline.
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

/// The measured values of every flank, by tooth and flank, and of every patch, by name.
///
/// A value that is indeterminate only because it is too near to a limit is included; omitting it would bias the trend near the
/// limit. Values that are indeterminate for other reasons are omitted.
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
            // The position of a patch in its file changes when others are added, so the name identifies it.
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

/// For each side of which several teeth are looked at, the mean over them at every check that measured all, and the one that wore most.
/// Their errors are mostly shared, so that the mean is as uncertain as they are.
#[must_use]
pub fn sides(series: &[Series]) -> Vec<(Series, &Series)> {
    let of_side = |side: Flank| {
        let is_of = |of: &&Series| of.id.patch.is_none() && of.id.flank == side;
        let teeth: Vec<&Series> = series.iter().filter(is_of).collect();
        let first = teeth.first().filter(|_| teeth.len() > 1)?;
        let at = |point: &Point| {
            let is_same = |other: &&Point| other.check == point.check;
            let all = teeth.iter().map(|tooth| tooth.points.iter().find(is_same));
            let all = all.collect::<Option<Vec<&Point>>>()?;
            let mean = |value: fn(&Point) -> f64| {
                all.iter().map(|point| value(point)).sum::<f64>() / all.len() as f64
            };
            Some(Point {
                wear_um: mean(|point| point.wear_um),
                u_um: mean(|point| point.u_um),
                ..*point
            })
        };
        let last_um = |of: &Series| of.points.last().map_or(f64::NEG_INFINITY, |at| at.wear_um);
        let worst = teeth
            .iter()
            .copied()
            .max_by(|a, b| last_um(a).total_cmp(&last_um(b)))?;
        let mean = Series {
            id: worst.id.clone(),
            points: first.points.iter().filter_map(at).collect(),
            ..**first
        };
        Some((mean, worst))
    };
    Flank::BOTH.into_iter().filter_map(of_side).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flank(tooth: u32, side: Flank, values: &[(i64, f64)]) -> Series {
        let point = |&(check, wear_um): &(i64, f64)| Point {
            check,
            cycles: 10.0 * check as f64,
            wear_um,
            u_um: f64::from(tooth) / 10.0,
        };
        Series {
            id: FeatureId {
                tooth,
                flank: side,
                patch: None,
            },
            warn_um: 30.0,
            limit_um: 50.0,
            points: values.iter().map(point).collect(),
        }
    }

    #[test]
    fn mean_of_a_side_is_that_of_checks_which_measured_all_of_it() {
        let series = [
            flank(12, Flank::Left, &[(1, 1.0), (2, 3.0), (3, 5.0)]),
            flank(40, Flank::Left, &[(1, 2.0), (3, 9.0)]),
            flank(40, Flank::Right, &[(1, 0.0)]),
        ];
        let sides = sides(&series);
        let [(mean, worst)] = &sides[..] else {
            panic!("one side has two teeth: {sides:?}")
        };
        assert_eq!(worst.id.tooth, 40);
        let points: Vec<(i64, f64, f64)> = mean
            .points
            .iter()
            .map(|at| (at.check, at.wear_um, at.u_um))
            .collect();
        assert_eq!(points, [(1, 1.5, 2.6), (3, 7.0, 2.6)]);
        assert!(super::sides(&series[1..]).is_empty());
    }
}
