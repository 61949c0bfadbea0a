//! The mask: what its threshold leaves, and what that is worth (figure 14, section 7.2).

use flankscope_metrology::multiview::cylinder::Layout;
use flankscope_metrology::surface::Closest;
use serde::Serialize;

use crate::ViewPoint;

/// Steps of the curves.
const STEPS: usize = 40;
/// Side of the picture, pixels.
const PICTURE: usize = 160;
/// The curves end where so few points are left.
const LEAST_SHARE: f64 = 0.01;

/// What a threshold leaves.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Left {
    /// Least smoothed standard deviation of the fringes, counts.
    pub threshold_dn: f64,
    /// Share of the points that it leaves.
    pub points_ratio: f64,
    /// Share of the cells of the unrolled bore in which it leaves any.
    pub cells_ratio: f64,
    /// Standard deviation of the exact deviations of what it leaves, µm.
    pub noise_um: f64,
}

/// How much the fringes oscillate over a view, in the camera's frame.
#[derive(Clone, Debug)]
pub struct MaskPicture {
    /// View, by its number.
    pub view: usize,
    /// From the left to the right and from the lower to the upper end, mm.
    pub range_mm: [[f64; 2]; 2],
    /// Pixels of a row, and rows.
    pub size: [usize; 2],
    /// Largest of its points in every pixel, counts, row by row from the top.
    pub fringes_dn: Vec<Option<f32>>,
}

/// A measured point, as far as the mask goes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rated {
    fringes_dn: f32,
    deviation_mm: f64,
    cell: Option<u32>,
}

/// Points of a view that lie on the surface.
pub(crate) fn rated(points: &[ViewPoint], closest: &[Closest], layout: &Layout) -> Vec<Rated> {
    let each = points.iter().zip(closest);
    each.map(|(point, found)| Rated {
        fringes_dn: point[4],
        deviation_mm: found.signed_distance_mm,
        cell: layout.cell_of(found.point).map(|cell| cell as u32),
    })
    .collect()
}

/// What thresholds leave of these points, from none up to where next to nothing is left.
pub(crate) fn curve(mut points: Vec<Rated>) -> Vec<Left> {
    points.sort_by(|a, b| a.fringes_dn.total_cmp(&b.fringes_dn));
    let all = points.len();
    let Some(last) = points.get(((1.0 - LEAST_SHARE) * all as f64) as usize) else {
        return Vec::new();
    };
    let most_dn = f64::from(last.fringes_dn);
    let mut best_of_cell = std::collections::BTreeMap::new();
    for point in &points {
        // In ascending order: what stays is the largest.
        if let Some(cell) = point.cell {
            best_of_cell.insert(cell, point.fringes_dn);
        }
    }
    let mut cells: Vec<f32> = best_of_cell.into_values().collect();
    cells.sort_by(f32::total_cmp);
    // Mean and squares of all points from one on, about zero: deviations are some µm, of numbers without an offset.
    let mut sums = vec![[0.0; 2]; all + 1];
    for (at, point) in points.iter().enumerate().rev() {
        let [sum, squares] = sums[at + 1];
        sums[at] = [
            sum + point.deviation_mm,
            squares + point.deviation_mm * point.deviation_mm,
        ];
    }
    (0..=STEPS)
        .map(|step| {
            let threshold_dn = most_dn * step as f64 / STEPS as f64;
            let from = points.partition_point(|p| f64::from(p.fringes_dn) < threshold_dn);
            let cells_from = cells.partition_point(|&dn| f64::from(dn) < threshold_dn);
            let left = (all - from) as f64;
            let [sum, squares] = sums[from];
            let mean = sum / left;
            Left {
                threshold_dn,
                points_ratio: left / all as f64,
                cells_ratio: (cells.len() - cells_from) as f64 / cells.len().max(1) as f64,
                noise_um: 1e3 * (squares / left - mean * mean).max(0.0).sqrt(),
            }
        })
        .collect()
}

pub(crate) fn picture(view: usize, points: &[ViewPoint]) -> MaskPicture {
    let span = |axis: usize| {
        let values = points.iter().map(|p| f64::from(p[axis]));
        values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], v| {
            [low.min(v), high.max(v)]
        })
    };
    let (x, y) = (span(0), span(1));
    let pixel = |value: f32, [low, high]: [f64; 2]| {
        let share = (f64::from(value) - low) / (high - low);
        ((share * PICTURE as f64) as usize).min(PICTURE - 1)
    };
    let mut fringes_dn: Vec<Option<f32>> = vec![None; PICTURE * PICTURE];
    for point in points {
        let (column, row) = (pixel(point[0], x), pixel(point[1], y));
        let of = &mut fringes_dn[(PICTURE - 1 - row) * PICTURE + column];
        *of = Some(of.map_or(point[4], |dn| dn.max(point[4])));
    }
    MaskPicture {
        view,
        range_mm: [x, y],
        size: [PICTURE; 2],
        fringes_dn,
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;

    #[test]
    fn a_curve_is_what_counting_at_every_threshold_gives_and_never_rises() {
        let points: Vec<Rated> = (0..5000_u32)
            .map(|i| {
                let mixed = i.wrapping_mul(2_654_435_761) >> 7;
                Rated {
                    fringes_dn: (mixed % 1000) as f32,
                    deviation_mm: 1e-3 * f64::from(mixed % 77) - 0.03,
                    cell: (i % 9 > 0).then_some(mixed % 300),
                }
            })
            .collect();
        let curve = curve(points.clone());
        assert_eq!(curve.len(), 41);
        assert_eq!((curve[0].points_ratio, curve[0].cells_ratio), (1.0, 1.0));
        assert!((curve[40].points_ratio - LEAST_SHARE).abs() < 2e-3);
        let cells = |of: &[&Rated]| {
            of.iter()
                .filter_map(|p| p.cell)
                .collect::<HashSet<_>>()
                .len()
        };
        let all_cells = cells(&points.iter().collect::<Vec<_>>()) as f64;
        for pair in curve.windows(2) {
            assert!(pair[1].points_ratio <= pair[0].points_ratio);
            assert!(pair[1].cells_ratio <= pair[0].cells_ratio);
        }
        for of in &curve {
            let left: Vec<&Rated> = points
                .iter()
                .filter(|p| f64::from(p.fringes_dn) >= of.threshold_dn)
                .collect();
            assert_eq!(of.points_ratio, left.len() as f64 / 5000.0);
            assert_eq!(of.cells_ratio, cells(&left) as f64 / all_cells);
            let mean = left.iter().map(|p| p.deviation_mm).sum::<f64>() / left.len() as f64;
            let squares = left.iter().map(|p| (p.deviation_mm - mean).powi(2));
            let std_um = 1e3 * (squares.sum::<f64>() / left.len() as f64).sqrt();
            assert!((of.noise_um - std_um).abs() < 1e-9);
        }
        assert!(super::curve(Vec::new()).is_empty());
    }
}
