//! Sums of one view per cell of the grid: small enough to be kept until the poses of all views are known.

use flankscope_foundation::rigid::{Rigid, Tool};
use nalgebra::{Point3, Vector3};

use super::{LEAST_VIEW_SIGMA_MM, Layout};
use crate::surface::Closest;

/// Largest distance of points that belong to the surface, mm.
const REACH_MM: f64 = 0.5;

/// Sums of one view in one cell.
#[derive(Debug, Clone, Copy, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct CellObservation {
    /// Number of the cell.
    pub cell: u32,
    /// Sum of the points' inverse variances, 1/mm².
    pub weight: f32,
    /// Their weighted mean deviation, mm.
    pub deviation_mm: f32,
    /// Their mean foot on the CAD, mm.
    pub point: [f32; 3],
    /// Mean outward normal there.
    pub normal: [f32; 3],
}

impl CellObservation {
    /// Variance of its deviation by its points alone, and what no pose is believed to be surer than, mm².
    pub fn variance_mm2(&self) -> f64 {
        1.0 / f64::from(self.weight) + LEAST_VIEW_SIGMA_MM * LEAST_VIEW_SIGMA_MM
    }
}

/// A view once it has moved by a little, tool frame: to first order the deviations change by what the points move along the
/// normal. A shift s along a surface of curvature radius r leaves out s²/2r: for 10 µm on 1 mm that is 0.05 µm. Along the axis
/// the whole view moves by the same number of rows, so that no cell is left out and none counts twice; what goes beyond the
/// grid is dropped.
pub fn moved(
    view: &[CellObservation],
    layout: &Layout,
    motion: &Rigid<Tool, Tool>,
) -> Vec<CellObservation> {
    let shift = |observation: &CellObservation| {
        let foot = Point3::from(observation.point.map(f64::from));
        motion.isometry() * foot - foot
    };
    let rise_mm = view.iter().map(|w| shift(w).z).sum::<f64>() / view.len().max(1) as f64;
    let [low, high] = layout.height_mm;
    let rows = (rise_mm / (high - low) * layout.rows as f64).round() as i64;
    view.iter()
        .filter_map(|observation| {
            let shift = shift(observation);
            let cell = i64::from(observation.cell) + rows * layout.columns as i64;
            let cell = u32::try_from(cell).ok()?;
            let along = Vector3::from(observation.normal.map(f64::from)).dot(&shift);
            let [x, y, z] = observation.point;
            ((cell as usize) < layout.columns * layout.rows).then(|| CellObservation {
                cell,
                deviation_mm: (f64::from(observation.deviation_mm) + along) as f32,
                point: [x, y, (f64::from(z) + shift.z) as f32],
                ..*observation
            })
        })
        .collect()
}

/// Gathers one view by cells: its points laid on the surface, and the standard uncertainty of each, mm.
pub fn cell_observations(
    layout: &Layout,
    closest: &[Closest],
    sigma_mm: &[f32],
) -> Vec<CellObservation> {
    let mut hits: Vec<(usize, f64, &Closest)> = closest
        .iter()
        .zip(sigma_mm)
        .filter(|(hit, _)| hit.is_smooth() && hit.signed_distance_mm.abs() <= REACH_MM)
        .filter_map(|(hit, &sigma)| {
            let weight = f64::from(sigma).powi(-2);
            let cell = layout.cell_of(hit.point)?;
            (weight.is_finite() && weight > 0.0).then_some((cell, weight, hit))
        })
        .collect();
    // Stable: the sums, and with them every bit, depend on the order of the points alone.
    hits.sort_by_key(|(cell, ..)| *cell);
    hits.chunk_by(|a, b| a.0 == b.0)
        .filter_map(|of_cell| {
            let &(cell, ..) = of_cell.first()?;
            let weight: f64 = of_cell.iter().map(|(_, w, _)| w).sum();
            let mean = |value: &dyn Fn(&Closest) -> f64| {
                (of_cell
                    .iter()
                    .map(|(_, w, hit)| w * value(hit))
                    .sum::<f64>()
                    / weight) as f32
            };
            Some(CellObservation {
                cell: cell as u32,
                weight: weight as f32,
                deviation_mm: mean(&|hit| hit.signed_distance_mm),
                point: [0, 1, 2].map(|axis| mean(&|hit| hit.point[axis])),
                normal: [0, 1, 2].map(|axis| mean(&|hit| hit.normal[axis])),
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::Feature;
    use nalgebra::UnitQuaternion;

    const LAYOUT: Layout = Layout {
        columns: 8,
        rows: 2,
        height_mm: [0.0, 10.0],
        around: crate::multiview::cylinder::Around::Angle,
    };

    fn hit(point: [f64; 3], signed_distance_mm: f64) -> Closest {
        Closest {
            point,
            signed_distance_mm,
            normal: [-1.0, 0.0, 0.0],
            triangle: 0,
            feature: Feature::Face,
            smoothness: 1.0,
        }
    }

    #[test]
    fn points_of_a_cell_become_their_weighted_mean_and_others_are_left_out() {
        let hits = [
            hit([40.0, 1.0, 2.0], 0.010),
            hit([40.0, 3.0, 4.0], 0.040),
            hit([40.0, 1.0, 7.0], 0.003),
            hit([40.0, 1.0, 11.0], 0.003), // above the grid
            hit([40.0, 1.0, 1.0], 0.6),    // no part of the surface
            Closest {
                smoothness: 0.7,
                ..hit([40.0, 1.0, 1.0], 0.0)
            },
        ];
        let sigma = [0.001, 0.002, 0.001, 0.001, 0.001, 0.001];
        let found = cell_observations(&LAYOUT, &hits, &sigma);
        assert_eq!(found.len(), 2);
        // Weights 4 to 1.
        assert!((found[0].deviation_mm - 0.016).abs() < 1e-8);
        assert!((found[0].point[1] - 1.4).abs() < 1e-6);
        assert!((found[0].weight - 1.25e6).abs() < 1.0);
        assert_eq!(found[1].cell, found[0].cell + 8);
    }

    #[test]
    fn a_view_that_moves_takes_its_deviations_along() {
        // A cylinder about z: points 5 µm proud of it, the view then turns about another axis and shifts.
        let motion = nalgebra::Isometry3::new(
            Vector3::new(4e-3, -6e-3, 2e-3),
            UnitQuaternion::from_euler_angles(1e-4, -5e-5, 1e-4).scaled_axis(),
        );
        let radius = 40.0;
        for angle in [0.1_f64, 1.2, -2.5] {
            let outward = Vector3::new(-angle.cos(), -angle.sin(), 0.0);
            let foot = Point3::from(outward * -radius) + Vector3::z() * 5.0;
            let proud = foot + outward * 5e-3;
            let view = [CellObservation {
                cell: 8 + 3,
                weight: 1.0,
                deviation_mm: 5e-3,
                point: [foot.x as f32, foot.y as f32, foot.z as f32],
                normal: [outward.x as f32, outward.y as f32, 0.0],
            }];
            let exact = radius - (motion * proud).coords.xy().norm();
            let here = moved(&view, &LAYOUT, &Rigid::from_isometry(motion))[0];
            assert_eq!(here.cell, 8 + 3);
            let moved = f64::from(here.deviation_mm);
            // The stated second order, (8 µm)²/2/40 mm, is below what f32 keeps of 42 mm: 4 nm.
            assert!((moved - exact).abs() < 1e-5, "{moved} against {exact}");
        }
    }

    #[test]
    fn a_view_that_slides_along_the_axis_keeps_one_witness_per_cell() {
        let view: Vec<CellObservation> = (0..16)
            .map(|cell| CellObservation {
                cell,
                weight: 1.0,
                deviation_mm: 1e-3,
                // Means of points: anywhere within the cell's height of 5 mm.
                point: [40.0, 0.0, 5.0 * (cell / 8) as f32 + 0.3 * cell as f32],
                normal: [-1.0, 0.0, 0.0],
            })
            .collect();
        let slid = |mm: f64| {
            let motion = nalgebra::Isometry3::translation(0.0, 0.0, mm);
            moved(&view, &LAYOUT, &Rigid::from_isometry(motion))
        };
        let cells = |of: &[CellObservation]| of.iter().map(|w| w.cell).collect::<Vec<_>>();
        assert_eq!(cells(&slid(2.4)), cells(&view), "less than half a row");
        let up = slid(2.6);
        assert_eq!(
            cells(&up),
            (8..16).collect::<Vec<_>>(),
            "the upper row is gone"
        );
        assert!(up.iter().all(|w| w.deviation_mm == 1e-3));
        assert!((up[0].point[2] - 2.6).abs() < 1e-6);
        assert!(slid(-11.0).is_empty());
    }
}
