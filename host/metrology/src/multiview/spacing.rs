//! Distances between teeth on opposite sides of the bore: the check of a scan's scale and of how its views hold together all
//! the way round.
//!
//! A tooth stands where its flanks and lands together were seen: a shift in the plane across the axis is fitted to its
//! cells' deviations along their normals.

use std::collections::BTreeMap;

use nalgebra::{Matrix2, Vector2};

use crate::gear::GearData;
use crate::multiview::cylinder::Cell;

/// Least number of cells that determine a tooth's position.
const LEAST_CELLS: usize = 20;
/// The cells' normals must tell radial from tangential shifts: least share of the weaker direction.
const LEAST_SHARE: f64 = 0.02;

/// Two teeth across the bore.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spacing {
    /// The teeth.
    pub teeth: [u32; 2],
    /// Distance of the points on their centre lines at the pitch circle, mm.
    pub distance_mm: f64,
    /// The same less that of the CAD, mm.
    pub deviation_mm: f64,
    /// Standard uncertainty of both by the cells, mm. A tooth's cells share what is wrong with its views: it does not
    /// average out.
    pub sigma_mm: f64,
}

/// Normal equations of a tooth's shift, from its cells.
#[derive(Debug, Clone, Copy, Default)]
struct ToothSums {
    cells: usize,
    matrix: Matrix2<f64>,
    right: Vector2<f64>,
    variance_mm2: f64,
}

/// The distances of all teeth, in order, from those half a turn on (a tooth less where their number is odd), where both were
/// seen.
pub fn opposite(gear: &GearData, cells: impl Iterator<Item = Cell>) -> Vec<Spacing> {
    let mut sums: BTreeMap<u32, ToothSums> = BTreeMap::new();
    for cell in cells {
        let [x, y, _] = cell.point;
        let across = Vector2::new(cell.normal[0], cell.normal[1]);
        let of_tooth = sums.entry(gear.tooth_at(y.atan2(x))).or_default();
        of_tooth.cells += 1;
        of_tooth.matrix += across * across.transpose();
        of_tooth.right += across * cell.deviation_mm;
        of_tooth.variance_mm2 += cell.sigma_mm * cell.sigma_mm;
    }
    let shifts: BTreeMap<u32, (Vector2<f64>, f64)> = sums
        .into_iter()
        .filter(|(_, of)| {
            let weaker = of.matrix.symmetric_eigenvalues().min();
            of.cells >= LEAST_CELLS && weaker > LEAST_SHARE * of.cells as f64
        })
        .filter_map(|(tooth, of)| {
            let shift = of.matrix.cholesky()?.solve(&of.right);
            Some((tooth, (shift, of.variance_mm2 / of.cells as f64)))
        })
        .collect();
    let place = |tooth: u32| {
        let (sin, cos) = gear.tooth_centre_rad(tooth).sin_cos();
        Vector2::new(cos, sin) * gear.pitch_radius_mm()
    };
    let half = gear.teeth / 2;
    (1..=half)
        .filter_map(|tooth| {
            let other = tooth + half;
            let nominal_mm = (place(other) - place(tooth)).norm();
            let (there, here) = (shifts.get(&other)?, shifts.get(&tooth)?);
            let shift = there.0 - here.0;
            let distance_mm = (place(other) - place(tooth) + shift).norm();
            Some(Spacing {
                teeth: [tooth, other],
                distance_mm,
                deviation_mm: distance_mm - nominal_mm,
                sigma_mm: (there.1 + here.1).sqrt(),
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gear::Flank;
    use crate::gear::tests::ring84;

    /// Cells on flanks and root lands of a toothing whose parts are displaced by `shift`.
    fn cells(gear: &GearData, shift: impl Fn(f64) -> [f64; 2]) -> Vec<Cell> {
        let mut cells = Vec::new();
        for tooth in 1..=gear.teeth {
            let centre = gear.tooth_centre_rad(tooth);
            let [dx, dy] = shift(centre);
            let mut push = |point: [f64; 3], normal: [f64; 3]| {
                cells.push(Cell {
                    point,
                    normal,
                    deviation_mm: normal[0] * dx + normal[1] * dy,
                    sigma_mm: 1e-3,
                    views: 3,
                    inconsistent: false,
                });
            };
            for step in 0..12 {
                let radius = gear.tip_radius_mm + 0.1 + 0.12 * f64::from(step);
                for flank in Flank::BOTH {
                    let on = |r: f64| gear.flank_point(tooth, flank, r, 30.0).unwrap();
                    let (a, b) = (on(radius - 1e-4), on(radius + 1e-4));
                    let length = (b[0] - a[0]).hypot(b[1] - a[1]);
                    let sign = flank.sign();
                    let normal = [
                        -sign * (b[1] - a[1]) / length,
                        sign * (b[0] - a[0]) / length,
                        0.0,
                    ];
                    push(on(radius), normal);
                }
                let tip = [
                    gear.tip_radius_mm * centre.cos(),
                    gear.tip_radius_mm * centre.sin(),
                    30.0,
                ];
                push(tip, [-centre.cos(), -centre.sin(), 0.0]);
            }
        }
        cells
    }

    #[test]
    fn an_oval_bore_is_as_wide_as_it_was_made_whatever_the_whole_was_moved_by() {
        let gear = ring84();
        // 20 µm of ovality, and everything 40 and -70 µm aside.
        let shift = |angle: f64| {
            let out = 10e-3 * (2.0 * angle).cos();
            [out * angle.cos() + 40e-3, out * angle.sin() - 70e-3]
        };
        let found = opposite(&gear, cells(&gear, shift).into_iter());
        assert_eq!(found.len(), 42);
        for pair in found {
            let angle = gear.tooth_centre_rad(pair.teeth[0]);
            let expected = 20e-3 * (2.0 * angle).cos();
            assert!(
                (pair.deviation_mm - expected).abs() < 1e-6,
                "{pair:?}, not {expected}"
            );
            assert!(
                (pair.distance_mm - 84.0 - expected).abs() < 1e-6,
                "{pair:?}"
            );
            // Two teeth, 1 µm each.
            assert!(
                (pair.sigma_mm - 2f64.sqrt() * 1e-3).abs() < 1e-12,
                "{pair:?}"
            );
        }
    }

    #[test]
    fn a_tooth_that_was_not_seen_or_from_one_side_only_has_no_distance() {
        let gear = ring84();
        let all = cells(&gear, |_| [0.0; 2]);
        let without = all
            .iter()
            .copied()
            .filter(|c| gear.tooth_at(c.point[1].atan2(c.point[0])) != 7);
        let found = opposite(&gear, without);
        assert_eq!(found.len(), 41);
        assert!(found.iter().all(|pair| pair.teeth[0] != 7));
        // Tip lands alone say nothing about sideways.
        let lands = all
            .into_iter()
            .filter(|c| gear.place(c.point, c.normal).is_none());
        assert!(opposite(&gear, lands).is_empty());
    }
}
