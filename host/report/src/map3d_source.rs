//! What the page in space shows of a check and of a scan.

use flankscope_metrology::gear::{Flank, GearData, GearKind};
use flankscope_metrology::multiview::cylinder::{Cell, CylinderMap};

use super::map3d::{Grid, Map3d, Part};
use super::{check, limits_um, ring, scan};
use flankscope_record::document::scan::Scan;
use flankscope_record::document::{Feature, FeatureId, FlankMap, Inspection, Toothing};

/// Name of a gear's lengths and of a patch's.
const OF_FLANK: [&str; 2] = [
    "along the profile from the zone's smaller radius / mm",
    "mm up",
];
const OF_PATCH: [&str; 2] = ["along the patch / mm", "mm up"];

fn part(id: &FeatureId, features: &[Feature], outward: [f64; 3]) -> Part {
    let feature = features.iter().find(|feature| feature.id.is_same(id));
    let wear = match feature {
        Some(of) if of.at_least_um.is_some() => {
            format!("wear {} µm (95 %)", crate::wear_in_words(of))
        }
        Some(of) if of.wear_um.is_some() => format!("wear {} µm (U95)", crate::wear_in_words(of)),
        Some(_) => "wear not measured".into(),
        None => "wear not judged".into(),
    };
    Part {
        name: id.to_string(),
        mark: id.patch.clone().unwrap_or_else(|| id.tooth.to_string()),
        wear,
        verdict: feature.map(|of| of.verdict),
        outward,
    }
}

/// The maps of a check.
pub(super) fn from_check(inspection: &Inspection) -> Map3d {
    let maps = &inspection.pictures.maps;
    let patches = maps.iter().any(|map| map.id.patch.is_some());
    let toothing = inspection.pictures.toothing.as_ref();
    let heights: Vec<f64> = maps.iter().flat_map(ends_mm).collect();
    let ends_mm = [f64::min, f64::max].map(|choice| heights.iter().copied().reduce(choice));
    let lines_mm = match (toothing, ends_mm) {
        (Some(toothing), [Some(low), Some(high)]) => outline(&toothing.gear, [low, high]),
        _ => Vec::new(),
    };
    Map3d {
        what: "In-situ check",
        tool: inspection.tool.clone(),
        date: inspection.date.clone(),
        verdict: inspection.verdict,
        reason: inspection.reason.clone(),
        simulated: inspection.origin.simulated,
        facts: check::facts_of(inspection),
        full_um: check::full_scale_um(inspection),
        limits_um: limits_um(&inspection.features),
        axes: if patches { OF_PATCH } else { OF_FLANK },
        bore: false,
        parts: maps
            .iter()
            .map(|map| part(&map.id, &inspection.features, map.outward))
            .collect(),
        grids: maps
            .iter()
            .enumerate()
            .map(|(number, map)| grid(number, map))
            .collect(),
        lines_mm,
    }
}

/// Lower and upper end of a map of a flank in the tool, mm.
fn ends_mm(map: &FlankMap) -> [f64; 2] {
    let middle =
        [map.middles_mm.first(), map.middles_mm.last()].map(|of| of.map_or(f64::NAN, |of| of[2]));
    let half = 0.5 * map.size_mm[1] / map.rows as f64;
    [middle[1] - half, middle[0] + half]
}

fn grid(number: usize, map: &FlankMap) -> Grid {
    let [wide_mm, high_mm] = map.size_mm;
    let [across_mm, down_mm] = [wide_mm / map.columns as f64, high_mm / map.rows as f64];
    // A patch may lie flat, so that its height is that above its zone's lower end.
    let top_mm = match map.id.patch {
        Some(_) => high_mm,
        None => ends_mm(map)[1],
    };
    Grid {
        part: Some(number),
        along_mm: (0..map.columns)
            .map(|column| (column as f64 + 0.5) * across_mm)
            .collect(),
        up_mm: [top_mm - 0.5 * down_mm, -down_mm],
        middles_mm: map.middles_mm.clone(),
        deviation_um: map.deviation_um.clone(),
    }
}

/// Lines along the toothing between two heights: around it at both, and up every edge of a tooth.
fn outline(gear: &GearData, ends_mm: [f64; 2]) -> Vec<Vec<[f64; 3]>> {
    let [left, right] = Flank::BOTH.map(|flank| ring::profile(gear, flank));
    let at = |tooth: u32, [radius, angle]: [f64; 2], height_mm: f64| {
        let (sin, cos) = (gear.tooth_centre_rad(tooth) + angle).sin_cos();
        [radius * cos, radius * sin, height_mm]
    };
    let around = |height_mm: f64| {
        // Flanks from root to tip and back, tooth after tooth, and back to the first.
        let points = (1..=gear.teeth).flat_map(|tooth| {
            let places = right.iter().rev().chain(&left);
            places.map(move |&place| at(tooth, place, height_mm))
        });
        let mut points: Vec<[f64; 3]> = points.collect();
        points.extend(points.first().copied());
        points
    };
    let edges = [left.first(), left.last(), right.first(), right.last()];
    let up = edges.into_iter().flatten().flat_map(|&place| {
        (1..=gear.teeth).map(move |tooth| ends_mm.map(|height| at(tooth, place, height)).to_vec())
    });
    ends_mm.map(around).into_iter().chain(up).collect()
}

/// The map of a scan, flank by flank.
pub(super) fn from_scan(scan: &Scan) -> Map3d {
    let (parts, grids) = match &scan.toothing {
        Some(toothing) => flank_by_flank(&scan.map, toothing, &scan.features),
        None => (
            Vec::new(),
            vec![columns(
                &scan.map,
                &(0..scan.map.layout().columns).collect::<Vec<_>>(),
                None,
            )],
        ),
    };
    let internal = |of: &Toothing| of.gear.kind == GearKind::Internal;
    Map3d {
        what: "Scan",
        tool: scan.tool.clone(),
        date: scan.date.clone(),
        verdict: scan.verdict,
        reason: scan.reason.clone(),
        simulated: scan.origin.simulated,
        facts: scan::facts_of(scan),
        full_um: scan::full_scale_um(scan),
        limits_um: limits_um(&scan.features),
        axes: OF_FLANK,
        bore: scan.toothing.as_ref().is_none_or(internal),
        parts,
        grids,
        lines_mm: Vec::new(),
    }
}

/// The flank on which most of a column's cells lie; none on lands.
fn flank_of(map: &CylinderMap, gear: &GearData, column: usize) -> Option<(u32, Flank)> {
    let cells = (0..map.layout().rows).filter_map(|row| map.cell(row, column));
    // A column crosses few flanks; of equal counts the flank highest up is taken, as it is moved to the end with every cell.
    let mut counts: Vec<(Option<(u32, Flank)>, usize)> = Vec::new();
    for cell in cells {
        let place = gear.place(cell.point, cell.normal);
        let flank = place.map(|at| (at.tooth, at.flank));
        let before = counts.iter().position(|(of, _)| *of == flank);
        let count = before.map_or(0, |at| counts.remove(at).1);
        counts.push((flank, count + 1));
    }
    counts.into_iter().max_by_key(|(_, count)| *count)?.0
}

fn flank_by_flank(
    map: &CylinderMap,
    toothing: &Toothing,
    features: &[Feature],
) -> (Vec<Part>, Vec<Grid>) {
    let gear = &toothing.gear;
    let around = map.layout().columns;
    let flanks: Vec<Option<(u32, Flank)>> = (0..around)
        .map(|column| flank_of(map, gear, column))
        .collect();
    // The seam of the unrolled bore may lie in a flank, so the first column is one where another flank or land begins.
    let first =
        (0..around).find(|&column| flanks[column] != flanks[(column + around - 1) % around]);
    let places: Vec<usize> = (0..around)
        .map(|place| (first.unwrap_or(0) + place) % around)
        .collect();
    let (mut parts, mut grids) = (Vec::new(), Vec::new());
    for run in places.chunk_by(|a, b| flanks[*a] == flanks[*b]) {
        let flank = flanks[run[0]];
        let mut grid = columns(map, run, flank.map(|_| parts.len()));
        if let Some((tooth, flank)) = flank {
            let from_mm = gear.profile_mm(toothing.zone_radius_mm[0]);
            for (column, along_mm) in grid.along_mm.iter_mut().enumerate() {
                let seen = grid.middles_mm.iter().skip(column).step_by(run.len());
                let radius_mm = seen
                    .map(|[x, y, _]| x.hypot(*y))
                    .find(|radius| radius.is_finite());
                *along_mm = radius_mm.map_or(*along_mm, |radius| gear.profile_mm(radius) - from_mm);
            }
            let middle = grid.middles_mm.get(grid.middles_mm.len() / 2).copied();
            let id = FeatureId {
                tooth,
                flank,
                patch: None,
            };
            parts.push(part(
                &id,
                features,
                gear.flank_normal(flank, middle.unwrap_or([1.0, 0.0, 0.0])),
            ));
        }
        grids.push(grid);
    }
    (parts, grids)
}

/// Some neighbouring columns of a bore. A cell that was not seen stands where its column was seen at other heights, because the
/// toothing is straight; a column that was never seen has no place.
fn columns(map: &CylinderMap, run: &[usize], part: Option<usize>) -> Grid {
    let layout = map.layout();
    let [low, high] = layout.height_mm;
    let step_mm = (high - low) / layout.rows as f64;
    let height = |row: usize| low + (row as f64 + 0.5) * step_mm;
    let mean_mm = |column: usize| {
        let feet = (0..layout.rows).filter_map(|row| Some(map.cell(row, column)?.point));
        let (sum, count) = feet.fold(([0.0; 2], 0.0), |([x, y], count), foot| {
            ([x + foot[0], y + foot[1]], count + 1.0)
        });
        sum.map(|sum: f64| sum / count)
    };
    let standing: Vec<[f64; 2]> = run.iter().map(|&column| mean_mm(column)).collect();
    let cells =
        || (0..layout.rows).flat_map(move |row| (0..run.len()).map(move |place| (row, place)));
    let cell = |(row, place): (usize, usize)| -> Option<Cell> { map.cell(row, run[place]) };
    let mut along = 0.0;
    Grid {
        part,
        along_mm: (0..run.len())
            .map(|place| {
                let before = standing[place.saturating_sub(1)];
                let [x, y] = standing[place];
                let step = (x - before[0]).hypot(y - before[1]);
                along += if step.is_finite() { step } else { 0.0 };
                along
            })
            .collect(),
        up_mm: [height(0), step_mm],
        middles_mm: cells()
            .map(|at| match cell(at) {
                Some(cell) => cell.point,
                None => [standing[at.1][0], standing[at.1][1], height(at.0)],
            })
            .collect(),
        deviation_um: cells()
            .map(|at| cell(at).map_or(f64::NAN, |cell| 1e3 * cell.deviation_mm))
            .collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::super::bars::tests::toothing;
    use flankscope_metrology::multiview::cylinder::{Around, CellObservation, Layout};

    use super::*;

    fn gear() -> GearData {
        GearData {
            first_tooth_centre_deg: 180.0 / 84.0,
            ..toothing().gear
        }
    }

    #[test]
    fn a_map_of_a_check_stands_where_its_flank_is() {
        let gear = gear();
        let place = |cell: usize| {
            let [column, row] = [cell % 4, cell / 4].map(|at| at as f64 + 0.5);
            gear.flank_point(40, Flank::Left, 41.2 + 0.4 * column, 36.0 - row)
                .unwrap()
        };
        let map = FlankMap {
            id: FeatureId {
                tooth: 40,
                flank: Flank::Left,
                patch: None,
            },
            columns: 4,
            rows: 6,
            size_mm: [1.6, 6.0],
            deviation_um: (0..24).map(f64::from).collect(),
            middles_mm: (0..24).map(place).collect(),
            outward: [0.0, 1.0, 0.0],
        };
        let grid = grid(0, &map);
        assert_eq!(grid.up_mm, [35.5, -1.0]);
        let along_mm: Vec<f64> = grid
            .along_mm
            .iter()
            .map(|mm| (mm * 1e6).round() / 1e6)
            .collect();
        assert_eq!(along_mm, [0.2, 0.6, 1.0, 1.4]);
        let [low, high] = ends_mm(&map);
        assert!(
            (low - 30.0).abs() < 1e-9 && (high - 36.0).abs() < 1e-9,
            "{low} {high}"
        );
    }

    #[test]
    fn a_scan_is_cut_into_its_flanks_and_a_cell_that_was_not_seen_stands_in_its_column() {
        let gear = gear();
        let layout = Layout {
            columns: 48 * 84,
            rows: 4,
            height_mm: [0.0, 8.0],
            around: Around::Angle,
        };
        // Every flank from tip to root, and the second row of tooth 7's right flank not seen.
        let cells = (0..layout.columns * layout.rows).filter_map(|cell| {
            let [column, row] = [cell % layout.columns, cell / layout.columns];
            let angle = layout.angle_rad(column);
            let tooth = gear.tooth_at(angle);
            let flank = |flank: Flank| {
                let off = |radius: f64| {
                    gear.involute_deviation_mm(
                        tooth,
                        flank,
                        [radius * angle.cos(), radius * angle.sin(), 0.0],
                    )
                };
                let radii = (0..=225).map(|step| 41.0 + 0.01 * f64::from(step));
                let nearest = radii
                    .min_by(|a, b| off(*a).unwrap().abs().total_cmp(&off(*b).unwrap().abs()))
                    .unwrap();
                (off(nearest).unwrap().abs() < 0.01).then_some((flank, nearest))
            };
            let (side, radius) = Flank::BOTH.into_iter().find_map(flank)?;
            if (tooth, side, row) == (7, Flank::Right, 1) {
                return None;
            }
            let point = [
                radius * angle.cos(),
                radius * angle.sin(),
                2.0 * row as f64 + 1.0,
            ];
            Some(CellObservation {
                cell: cell as u32,
                weight: 1e6,
                deviation_mm: -1e-3 * tooth as f32,
                point: point.map(|c| c as f32),
                normal: gear.flank_normal(side, point).map(|c| c as f32),
            })
        });
        let mut map = CylinderMap::new(layout);
        map.add_view(&cells.collect::<Vec<_>>(), |_| 0.0);
        let toothing = Toothing {
            gear: gear.clone(),
            zone_radius_mm: [41.1, 43.0],
        };
        let (parts, grids) = flank_by_flank(&map, &toothing, &[]);
        assert_eq!(parts.len(), 2 * 84);
        assert!(parts.iter().all(|part| part.verdict.is_none()));
        for grid in grids.iter().filter(|grid| grid.part.is_some()) {
            let part = &parts[grid.part.unwrap()];
            let unseen = grid.deviation_um.iter().filter(|um| um.is_nan()).count();
            let hole = if part.name == "tooth 7 right" {
                grid.along_mm.len()
            } else {
                0
            };
            assert_eq!(unseen, hole, "{}", part.name);
            let expected_um = -part.mark.parse::<f64>().unwrap();
            for (&[x, y, z], um) in grid.middles_mm.iter().zip(&grid.deviation_um) {
                assert!(um.is_nan() || (um - expected_um).abs() < 1e-3);
                assert!((41.0 - 1e-3..43.26).contains(&x.hypot(y)) && (0.0..8.0).contains(&z));
            }
            let span = |mm: f64| (-0.2..2.5).contains(&mm);
            assert!(
                grid.along_mm.iter().copied().all(span),
                "{:?}",
                grid.along_mm
            );
        }
    }
}
