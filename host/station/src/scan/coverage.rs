//! What should have been seen and was not: a flank that nobody looked at is never a go.

use std::collections::BTreeMap;

use flankscope_metrology::cylinder::CylinderMap;
use flankscope_metrology::gear::{Flank, GearData};
use serde::Serialize;

use crate::inspection::PlannedView;

/// A field of which less than this share was seen is a hole. Some six cells lie across a flank, of which a die that stands askew
/// hides one or two at an edge.
pub(super) const LEAST_COVERAGE: f64 = 0.6;
/// More holes than this, share of all fields, and the scan is no go.
pub(super) const MOST_HOLES: f64 = 0.05;
/// A view answers for at most so much of its tooth above and below its middle, mm: its field is 10 mm wide and round.
const HALF_FIELD_MM: f64 = 4.0;

/// Fields that the plan promises: both flanks of every view's middle tooth, over the view's height.
#[derive(Clone, Debug, Serialize)]
pub struct Coverage {
    /// How many.
    pub fields: usize,
    /// Least share of a field that has to be seen, of what the best one shows.
    pub least_ratio: f64,
    /// Those that were not.
    pub holes: Vec<Hole>,
}

/// A field that was not seen.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Hole {
    /// Tooth.
    pub tooth: u32,
    /// `left` or `right`.
    pub flank: String,
    /// Height of the view's middle, mm.
    pub vertical_mm: f64,
    /// Share that was seen, of what the best field shows.
    pub seen_ratio: f64,
}

impl Coverage {
    /// Counts the cells of every field.
    pub(super) fn of(
        map: &CylinderMap,
        gear: &GearData,
        planned: &[PlannedView],
        least_ratio: f64,
    ) -> Self {
        let layout = map.layout();
        // Cells of every flank by row of the map.
        let mut seen: BTreeMap<(u32, Flank), Vec<usize>> = BTreeMap::new();
        for cell in map.cells() {
            if let (Some(at), Some(row)) = (
                gear.place(cell.point, cell.normal),
                layout.row_of(cell.point[2]),
            ) {
                let rows = seen
                    .entry((at.tooth, at.flank))
                    .or_insert_with(|| vec![0; layout.rows]);
                rows[row] += 1;
            }
        }
        let [low, high] = layout.height_mm;
        let row_mm = (high - low) / layout.rows as f64;
        let count = |tooth: u32, flank: Flank, vertical_mm: f64| {
            let row = |z: f64| ((z - low) / row_mm).clamp(0.0, layout.rows as f64) as usize;
            let rows = row(vertical_mm - HALF_FIELD_MM)..row(vertical_mm + HALF_FIELD_MM);
            let cells = seen.get(&(tooth, flank)).and_then(|of| of.get(rows));
            cells.map_or(0, |cells| cells.iter().sum::<usize>())
        };
        let fields: Vec<(u32, Flank, f64, usize)> = planned
            .iter()
            .flat_map(|view| Flank::BOTH.map(|flank| (view.tooth, flank, view.vertical_mm)))
            .map(|(tooth, flank, z)| (tooth, flank, z, count(tooth, flank, z)))
            .collect();
        let most = fields.iter().map(|field| field.3).max().unwrap_or(0).max(1) as f64;
        let holes = fields
            .iter()
            .filter_map(|&(tooth, flank, vertical_mm, cells)| {
                let seen_ratio = cells as f64 / most;
                (seen_ratio < least_ratio).then(|| Hole {
                    tooth,
                    flank: flank.to_string(),
                    vertical_mm,
                    seen_ratio,
                })
            });
        Self {
            fields: fields.len(),
            least_ratio,
            holes: holes.collect(),
        }
    }

    /// Share of the fields that are holes.
    #[must_use]
    pub fn hole_ratio(&self) -> f64 {
        self.holes.len() as f64 / self.fields.max(1) as f64
    }

    /// Why the scan cannot be a go, if it cannot.
    pub(super) fn objection(&self) -> Option<String> {
        let first = self.holes.first()?;
        (self.hole_ratio() > MOST_HOLES).then(|| {
            format!(
                "{} of {} planned flank fields were seen to less than {:.0} %, at most {:.0} % of them may be; the first is tooth {} {} at {:.1} mm with {:.0} %",
                self.holes.len(),
                self.fields,
                100.0 * self.least_ratio,
                100.0 * MOST_HOLES,
                first.tooth,
                first.flank,
                first.vertical_mm,
                100.0 * first.seen_ratio,
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flankscope_metrology::cylinder::{Layout, Witness};

    const TEETH: u32 = 84;

    fn gear() -> GearData {
        GearData {
            kind: flankscope_metrology::gear::Kind::Internal,
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

    /// Every flank seen at every height but for what `lost` says.
    fn map(lost: impl Fn(u32, f64) -> bool) -> CylinderMap {
        let (layout, gear) = (
            Layout {
                columns: 24 * TEETH as usize,
                rows: 264,
                height_mm: [0.0, 66.0],
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
                    let point = gear
                        .flank_point(tooth, flank, 42.0, z)
                        .expect("on the flank");
                    let angle = point[1].atan2(point[0]);
                    let side = flank.sign();
                    let column = ((angle / std::f64::consts::TAU + 0.5) * layout.columns as f64)
                        .rem_euclid(layout.columns as f64)
                        as usize;
                    let witness = Witness {
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
                    map.add_view(&[witness], |_| 0.0);
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

    #[test]
    fn a_whole_map_has_no_hole_and_an_empty_one_nothing_else() {
        let whole = Coverage::of(&map(|_, _| false), &gear(), &plan(), LEAST_COVERAGE);
        assert_eq!((whole.fields, whole.holes.len()), (2 * 588, 0));
        assert_eq!(whole.objection(), None);
        let nothing = Coverage::of(&map(|_, _| true), &gear(), &plan(), LEAST_COVERAGE);
        assert_eq!(nothing.hole_ratio(), 1.0);
        assert!(nothing.objection().is_some());
    }

    #[test]
    fn a_hole_is_named_and_too_many_of_them_are_no_go() {
        // The third layer (18.9..28.3 mm) of five teeth: 10 of 1176 fields.
        let third = |tooth: u32, z: f64| (20..25).contains(&tooth) && (18.9..28.3).contains(&z);
        let few = Coverage::of(&map(third), &gear(), &plan(), LEAST_COVERAGE);
        assert_eq!(few.holes.len(), 10);
        assert_eq!((few.holes[0].tooth, few.holes[0].seen_ratio), (20, 0.0));
        assert_eq!(few.objection(), None, "below one percent");
        // Five teeth over the whole height: 70 of 1176, 6 %.
        let five = Coverage::of(
            &map(|tooth, _| (20..25).contains(&tooth)),
            &gear(),
            &plan(),
            LEAST_COVERAGE,
        );
        assert_eq!(five.holes.len(), 70);
        let why = five.objection().expect("too many");
        assert!(
            why.contains("70 of 1176") && why.contains("tooth 20"),
            "{why}"
        );
    }
}
