//! The article's outlook on a fast comparison: both clouds unrolled onto a cylinder, resampled layer by layer, subtracted.
//!
//! Each layer's points are put in order of their angle and their radii interpolated linearly at the columns' angles; the
//! difference of two such pictures is read as the deviation. It takes no search for a nearest point. But it measures along the
//! radius, where a flank's normal lies almost across it, and it interpolates over edges; [`compare`] says what that costs.

use rayon::prelude::*;

use crate::deviation::{Statistics, statistics};
use crate::gear::GearKind;
use crate::multiview::cylinder::{CylinderMap, Layout};

/// Neighbours in angle that are farther apart than so many columns have a gap between them.
const MOST_GAP: f64 = 2.0;

/// Radius at every cell's middle angle, mm, row by row; `None` where the layer has no points nearby.
pub fn unroll(layout: &Layout, points: &[[f64; 3]]) -> Vec<Option<f64>> {
    let turn = std::f64::consts::TAU;
    let mut layers: Vec<Vec<(f64, f64)>> = vec![Vec::new(); layout.rows];
    for &[x, y, z] in points {
        if let Some(row) = layout.row_of(z) {
            layers[row].push((y.atan2(x), x.hypot(y)));
        }
    }
    let most_gap = MOST_GAP * turn / layout.columns as f64;
    let rows: Vec<Vec<Option<f64>>> = layers
        .into_par_iter()
        .map(|mut layer| {
            layer.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
            // The circle closes: one neighbour beyond either end.
            if let (Some(&first), Some(&last)) = (layer.first(), layer.last()) {
                layer.insert(0, (last.0 - turn, last.1));
                layer.push((first.0 + turn, first.1));
            }
            let mut next = 0;
            (0..layout.columns)
                .map(|column| {
                    let at = layout.angle_rad(column);
                    while layer.get(next).is_some_and(|(angle, _)| *angle < at) {
                        next += 1;
                    }
                    let (before, after) = (layer.get(next.checked_sub(1)?)?, layer.get(next)?);
                    let gap = after.0 - before.0;
                    let share = if gap > 0.0 {
                        (at - before.0) / gap
                    } else {
                        0.5
                    };
                    let radius_mm = before.1 + share * (after.1 - before.1);
                    (gap <= most_gap).then_some(radius_mm)
                })
                .collect()
        })
        .collect();
    rows.concat()
}

/// Difference of two unrolled clouds, mm: positive where the measured one stands proud of the reference.
pub fn subtract(
    kind: GearKind,
    measured: &[Option<f64>],
    reference: &[Option<f64>],
) -> Vec<Option<f64>> {
    let proud = match kind {
        GearKind::Internal => -1.0,
        GearKind::External => 1.0,
    };
    measured
        .iter()
        .zip(reference)
        .map(|(measured, reference)| Some(proud * ((*measured)? - (*reference)?)))
        .collect()
}

/// Error of the raster's deviations against the exact distances.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct RasterError {
    /// On surfaces that face the axis: tip and root lands.
    pub lands: Option<Statistics>,
    /// On flanks.
    pub flanks: Option<Statistics>,
}

/// Compares a raster with the exact deviations of the same cells.
pub fn compare(raster_mm: &[Option<f64>], map: &CylinderMap) -> RasterError {
    let columns = map.layout().columns;
    let (mut lands, mut flanks) = (Vec::new(), Vec::new());
    for (index, raster_mm) in raster_mm.iter().enumerate() {
        let (Some(raster_mm), Some(cell)) = (raster_mm, map.cell(index / columns, index % columns))
        else {
            continue;
        };
        let [x, y, _] = cell.point;
        let facing = (cell.normal[0] * x + cell.normal[1] * y).abs() / x.hypot(y);
        let off_mm = raster_mm - cell.deviation_mm;
        if facing > std::f64::consts::FRAC_1_SQRT_2 {
            lands.push(off_mm);
        } else {
            flanks.push(off_mm);
        }
    }
    RasterError {
        lands: statistics(&lands),
        flanks: statistics(&flanks),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::uniform;

    const LAYOUT: Layout = Layout {
        columns: 360,
        rows: 4,
        height_mm: [0.0, 4.0],
        around: crate::multiview::cylinder::Around::Angle,
    };

    fn wall(seed: u64, radius_mm: impl Fn(f64) -> f64) -> Vec<[f64; 3]> {
        (0..40_000)
            .map(|i| {
                let angle = std::f64::consts::TAU * (uniform(seed, 2 * i) - 0.5);
                let radius = radius_mm(angle);
                let z = 4.0 * uniform(seed, 2 * i + 1);
                [radius * angle.cos(), radius * angle.sin(), z]
            })
            .collect()
    }

    #[test]
    fn a_bore_that_is_too_small_stands_proud_by_that() {
        let form = |angle: f64| 40.0 + 0.01 * (2.0 * angle).cos();
        let reference = unroll(&LAYOUT, &wall(1, form));
        let measured = unroll(&LAYOUT, &wall(2, |angle| form(angle) - 0.003));
        for off in subtract(GearKind::Internal, &measured, &reference) {
            // Chords of some 0.1 degrees under this form: (0.0017)² / 8 * 0.04 mm is nothing.
            assert!((off.unwrap() - 0.003).abs() < 1e-6, "{off:?}");
        }
        let outer = subtract(GearKind::External, &measured, &reference);
        assert!((outer[0].unwrap() + 0.003).abs() < 1e-6);
    }

    #[test]
    fn a_gap_stays_one_and_the_seam_is_none() {
        let mut points = wall(1, |_| 40.0);
        points.retain(|[x, y, _]| !(0.5..0.7).contains(&y.atan2(*x)));
        let radius = unroll(&LAYOUT, &points);
        let column = |angle: f64| ((angle / std::f64::consts::TAU + 0.5) * 360.0) as usize;
        assert_eq!(radius[column(0.6)], None);
        for at in [column(0.45), column(0.75), 0, 359] {
            assert!((radius[at].unwrap() - 40.0).abs() < 1e-9);
        }
        assert!(unroll(&LAYOUT, &[]).iter().all(Option::is_none));
    }
}
