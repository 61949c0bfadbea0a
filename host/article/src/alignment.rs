//! One way to lay the views, in the article's metric and in the exact one (figures 4, 18, 20 and 21).

use std::collections::BTreeMap;

use flankscope_foundation::rigid::{Camera, Rigid, Tool as ToolFrame};
use flankscope_metrology::deviation::{Order, SampleTree, Statistics, statistics};
use flankscope_metrology::multiview::cylinder::Layout;
use flankscope_metrology::surface::Surface;
use nalgebra::Isometry3;
use serde::Serialize;

use crate::comparison::Spread;
use crate::drawn::{Drawn, laid};

/// What laid points are compared with.
pub(crate) struct Yardstick<'a> {
    pub surface: &'a Surface,
    pub reference: &'a SampleTree,
    pub order: Order,
    pub layout: Layout,
}

/// The views as one way of alignment lays them.
#[derive(Clone, Debug, Serialize)]
pub struct Alignment {
    /// `positions`, `serial`, `article` or `surface`.
    pub name: &'static str,
    /// Views that it laid.
    pub views: usize,
    /// Signed distances of the drawn points to the surface.
    pub exact: Option<Spread>,
    /// Their distances to the nearest reference point.
    pub nearest: Option<Spread>,
    /// Root mean square of the latter of every view, µm, in order of capture.
    pub rms_um: Vec<Option<f64>>,
    /// Pose of every view, row by row: tool frame from camera frame, mm.
    pub tool_from_camera: Vec<Option<[[f64; 4]; 4]>>,
    /// Distances to the nearest reference point, µm.
    #[serde(skip)]
    pub nearest_um: Vec<f64>,
    /// Their mean in every cell of the unrolled bore, µm.
    #[serde(skip)]
    pub map_um: Vec<Option<f64>>,
}

impl Alignment {
    /// Lays the drawn points of every view by its pose. Returns them too, mm.
    pub(crate) fn of(
        name: &'static str,
        views: &BTreeMap<usize, Drawn>,
        poses: &BTreeMap<usize, Isometry3<f64>>,
        planned: usize,
        by: &Yardstick<'_>,
    ) -> (Self, Vec<[f64; 3]>) {
        let mut rms_um = vec![None; planned];
        let mut tool_from_camera = vec![None; planned];
        let (mut points, mut exact_mm, mut nearest_mm) = (Vec::new(), Vec::new(), Vec::new());
        for (&view, pose) in poses {
            let Some(drawn) = views.get(&view) else {
                continue;
            };
            let laid = laid(&drawn.xyz, pose);
            let distances_mm = by.reference.distances(&laid, by.order);
            rms_um[view] = statistics(&distances_mm).map(|of: Statistics| of.rms_mm * 1e3);
            tool_from_camera[view] =
                Some(Rigid::<ToolFrame, Camera>::from_isometry(*pose).to_rows());
            let closest = by.surface.closest_many(&laid);
            exact_mm.extend(closest.iter().map(|found| found.signed_distance_mm));
            nearest_mm.extend(distances_mm);
            points.extend(laid);
        }
        let nearest_um: Vec<f64> = nearest_mm.iter().map(|mm| mm * 1e3).collect();
        let alignment = Self {
            name,
            views: rms_um.iter().flatten().count(),
            exact: statistics(&exact_mm).map(Spread::from),
            nearest: statistics(&nearest_mm).map(Spread::from),
            rms_um,
            tool_from_camera,
            map_um: means(&by.layout, &points, &nearest_um),
            nearest_um,
        };
        (alignment, points)
    }
}

/// Mean of the values in every cell of the unrolled bore.
fn means(layout: &Layout, points: &[[f64; 3]], values: &[f64]) -> Vec<Option<f64>> {
    let mut sums = vec![(0.0, 0_u32); layout.columns * layout.rows];
    for (point, value) in points.iter().zip(values) {
        if let Some(cell) = layout.cell_of(*point) {
            sums[cell].0 += value;
            sums[cell].1 += 1;
        }
    }
    let mean = |(sum, count): (f64, u32)| (count > 0).then(|| sum / f64::from(count));
    sums.into_iter().map(mean).collect()
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;
    use std::f64::consts::TAU;

    use flankscope_metrology::multiview::cylinder::Around;

    use super::*;

    /// Points about a bore of 10 mm radius and 4 mm height.
    fn scattered(count: u32, seed: u32) -> Vec<[f64; 3]> {
        let mut state = seed;
        let mut uniform = move || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 8) / f64::from(1 << 24)
        };
        (0..count)
            .map(|_| {
                let (angle, radius) = (TAU * uniform(), 10.0 + 0.2 * uniform());
                [
                    radius * angle.cos(),
                    radius * angle.sin(),
                    4.4 * uniform() - 0.2,
                ]
            })
            .collect()
    }

    #[test]
    fn the_map_is_that_of_a_search_through_all_points() {
        let (points, reference) = (scattered(3000, 1), scattered(500, 2));
        let layout = Layout {
            columns: 36,
            rows: 8,
            height_mm: [0.0, 4.0],
            around: Around::Angle,
        };
        let tree = SampleTree::new(&reference).unwrap();
        let map = means(&layout, &points, &tree.distances(&points, Order::Two));
        let mut expected: HashMap<(i64, i64), Vec<f64>> = HashMap::new();
        for p in &points {
            let distance = |q: &[f64; 3]| {
                ((p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2) + (p[2] - q[2]).powi(2)).sqrt()
            };
            let nearest = reference.iter().map(distance).fold(f64::INFINITY, f64::min);
            let column = ((p[1].atan2(p[0]).to_degrees() + 180.0) / 10.0).floor() as i64;
            let row = (p[2] / 0.5).floor() as i64;
            expected.entry((row, column)).or_default().push(nearest);
        }
        let mut seen = 0;
        for (cell, mean) in map.iter().enumerate() {
            let place = ((cell / 36) as i64, (cell % 36) as i64);
            match (mean, expected.get(&place)) {
                (Some(mean), Some(all)) => {
                    let brute = all.iter().sum::<f64>() / all.len() as f64;
                    assert!((mean - brute).abs() < 1e-12, "{place:?}");
                    seen += all.len();
                }
                (mean, all) => assert!(mean.is_none() && all.is_none(), "{place:?}"),
            }
        }
        let inside = points.iter().filter(|p| (0.0..4.0).contains(&p[2])).count();
        assert_eq!(seen, inside);
    }
}
