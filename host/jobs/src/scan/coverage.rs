//! Planned fields of flanks that were not measured: a flank without points is never a "go".

use std::collections::{BTreeMap, BTreeSet};

use flankscope_metrology::gear::{Flank, GearData};
use flankscope_metrology::multiview::cylinder::{CylinderMap, Layout};
use flankscope_record::document::scan::{Coverage, Hole};

use flankscope_metrology::view::PlannedView;

/// Smallest fraction of a field that must be measured; below it the field is a hole. About five cells lie across a judged flank;
/// a tilted die hides one or two of them at an edge.
pub(super) const LEAST_COVERAGE: f64 = 0.6;
/// Height above and below its middle that a view must cover of its tooth, as a fraction of the field's width. If every tooth is
/// in the middle of a view, layers at most twice this apart cover everything between them. Farther out, the round rims of the
/// fields leave parts of flanks unmeasured that no neighbouring view shows.
pub(super) const ASKED_PER_FIELD: f64 = 0.4;

/// Number of map cells across a flank between two radii, by the gear's own involute.
fn cells_across(gear: &GearData, layout: &Layout, radius_mm: [f64; 2]) -> f64 {
    let [from, to] = radius_mm.map(|r| gear.half_tooth_rad(r.max(gear.base_radius_mm())));
    let span_rad = (to.unwrap_or(0.0) - from.unwrap_or(0.0)).abs();
    (span_rad / std::f64::consts::TAU * layout.columns as f64).max(1.0)
}

/// Counts the measured cells of every field between these radii.
pub(super) fn coverage(
    map: &CylinderMap,
    gear: &GearData,
    radius_mm: [f64; 2],
    planned: &[PlannedView],
    (field_mm, least_ratio): (f64, f64),
) -> Coverage {
    let asked_mm = ASKED_PER_FIELD * field_mm;
    let layout = map.layout();
    // Measured cells of every flank by row of the map.
    let mut seen: BTreeMap<(u32, Flank), Vec<usize>> = BTreeMap::new();
    for cell in map.cells() {
        if let (Some(at), Some(row)) = (
            gear.place(cell.point, cell.normal),
            layout.row_of(cell.point[2]),
        ) && (radius_mm[0]..=radius_mm[1]).contains(&at.radius_mm)
        {
            let rows = seen
                .entry((at.tooth, at.flank))
                .or_insert_with(|| vec![0; layout.rows]);
            rows[row] += 1;
        }
    }
    let [low, high] = layout.height_mm;
    let row_mm = (high - low) / layout.rows as f64;
    let across = cells_across(gear, &layout, radius_mm);
    let ratio = |tooth: u32, flank: Flank, vertical_mm: f64| {
        let row = |z: f64| ((z - low) / row_mm).clamp(0.0, layout.rows as f64) as usize;
        let rows = row(vertical_mm - asked_mm)..row(vertical_mm + asked_mm);
        let all = rows.len().max(1) as f64 * across;
        let cells = seen.get(&(tooth, flank)).and_then(|of| of.get(rows));
        let cells = cells.map_or(0, |cells| cells.iter().sum::<usize>());
        (cells as f64 / all).min(1.0)
    };
    let fields: Vec<Hole> = planned
        .iter()
        .flat_map(|view| Flank::BOTH.map(|flank| (view.tooth, flank, view.vertical_mm)))
        .map(|(tooth, flank, vertical_mm)| Hole {
            tooth,
            flank,
            vertical_mm,
            seen_ratio: ratio(tooth, flank, vertical_mm),
        })
        .collect();
    let worst_ratio = fields.iter().map(|field| field.seen_ratio);
    let worst_ratio = worst_ratio.reduce(f64::min).unwrap_or(0.0);
    let mut heights: Vec<f64> = planned.iter().map(|view| view.vertical_mm).collect();
    heights.sort_by(f64::total_cmp);
    heights.dedup();
    let mut teeth: BTreeSet<u32> = planned.iter().map(|view| view.tooth).collect();
    let count = fields.len();
    let is_hole = |field: &Hole| field.seen_ratio < least_ratio;
    let holes: Vec<Hole> = fields.into_iter().filter(is_hole).collect();
    for hole in &holes {
        teeth.remove(&hole.tooth);
    }
    Coverage {
        fields: count,
        teeth: teeth.len(),
        of_teeth: gear.teeth,
        heights: heights.len(),
        least_ratio,
        worst_ratio,
        holes,
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use flankscope_metrology::multiview::cylinder::{Around, CellObservation, Layout};

    const TEETH: u32 = 84;

    pub fn gear() -> GearData {
        GearData {
            kind: flankscope_metrology::gear::GearKind::Internal,
            teeth: TEETH,
            module_mm: 1.0,
            pressure_angle_deg: 20.0,
            tip_radius_mm: 41.0,
            root_radius_mm: 43.25,
            first_tooth_centre_deg: 180.0 / 84.0,
            height_mm: [0.0, 66.0],
            radial_threshold_mm: 50.0,
        }
    }

    /// A map with every flank measured at every height except where `lost` is true.
    fn map(lost: impl Fn(u32, f64) -> bool) -> CylinderMap {
        let (layout, gear) = (
            Layout {
                columns: 24 * TEETH as usize,
                rows: 264,
                height_mm: [0.0, 66.0],
                around: Around::Angle,
            },
            gear(),
        );
        let mut map = CylinderMap::new(layout);
        for tooth in 1..=TEETH {
            for flank in Flank::BOTH {
                for row in 0..layout.rows {
                    let z = 0.25 * (row as f64 + 0.5);
                    if lost(tooth, z) {
                        continue;
                    }
                    for radius in [41.2, 41.6, 42.0, 42.4, 42.8] {
                        let point = gear
                            .flank_point(tooth, flank, radius, z)
                            .expect("on the flank");
                        let angle = point[1].atan2(point[0]);
                        let side = flank.sign();
                        let column = ((angle / std::f64::consts::TAU + 0.5) * layout.columns as f64)
                            .rem_euclid(layout.columns as f64)
                            as usize;
                        let observation = CellObservation {
                            cell: (row * layout.columns + column) as u32,
                            weight: 1e6,
                            deviation_mm: 0.0,
                            point: point.map(|c| c as f32),
                            normal: [
                                (-side * angle.sin()) as f32,
                                (side * angle.cos()) as f32,
                                0.0,
                            ],
                        };
                        map.add_view(&[observation], |_| 0.0);
                    }
                }
            }
        }
        map
    }

    fn plan() -> Vec<PlannedView> {
        (0..7_u32)
            .flat_map(|layer| {
                (1..=TEETH).map(move |tooth| PlannedView {
                    tooth,
                    rotation_rad: 0.0,
                    vertical_mm: 66.0 * (f64::from(layer) + 0.5) / 7.0,
                })
            })
            .collect()
    }

    fn of(map: &CylinderMap) -> Coverage {
        coverage(
            map,
            &gear(),
            gear().active_flank_mm(),
            &plan(),
            (10.0, LEAST_COVERAGE),
        )
    }

    #[test]
    fn a_whole_map_has_no_hole_and_an_empty_one_nothing_else() {
        let whole = of(&map(|_, _| false));
        assert_eq!((whole.fields, whole.holes.len()), (2 * 588, 0));
        assert_eq!(whole.objection(), None);
        assert_eq!((whole.teeth, whole.heights), (84, 7));
        let said = whole.looked_at(0.8485, 0.1234);
        assert_eq!(
            said,
            "84 of 84 teeth at 7 heights (84.9 % of their face width), 12.3 % of the bore"
        );
        let nothing = of(&map(|_, _| true));
        assert_eq!((nothing.holes.len(), nothing.teeth), (2 * 588, 0));
        assert_eq!(nothing.worst_ratio, 0.0);
        assert!(nothing.objection().is_some());
    }

    #[test]
    fn every_hole_is_named_and_one_is_enough() {
        // The third layer (18.9..28.3 mm) of one tooth.
        let one = of(&map(|tooth, z| tooth == 20 && (18.9..28.3).contains(&z)));
        assert_eq!((one.holes.len(), one.teeth), (2, 83));
        assert_eq!((one.holes[0].tooth, one.holes[0].seen_ratio), (20, 0.0));
        let why = one.objection().expect("a hole").to_string();
        assert!(
            why.contains("2 of 1176") && why.contains("tooth 20"),
            "{why}"
        );
    }

    #[test]
    fn a_map_of_which_little_is_seen_everywhere_is_no_go() {
        // Every third row is missing: all fields are equally bad, and none is sufficient.
        let sparse = of(&map(|_, z| !((z / 0.25) as usize).is_multiple_of(3)));
        assert_eq!(sparse.holes.len(), sparse.fields);
        assert!(sparse.objection().is_some());
    }
}
