//! Relative pose of two views from the surface that both saw.
//!
//! In a cell that both saw, the form of the piece is in both deviations and cancels in their difference; what remains is how
//! far the views lie apart. So overlaps tie views to each other and not to the CAD.
//!
//! Pairs of a kind (the same layers, the same turn between them) look at each other with the same parts of the field, so
//! what the calibration leaves there is the same in all of them. It must not pass for a motion that all views share:
//! [`take_off_common`] lets the pairs speak only of what distinguishes them.

use std::collections::BTreeMap;

use nalgebra::{Matrix6, Rotation3, SMatrix, SVector, Vector3, Vector6};

use super::CameraPose;
use super::view::ViewInformation;
use crate::multiview::cylinder::CellObservation;

/// Deviations that differ by more are not of the same surface, mm: an edge in one of the views.
const MOST_DIFFERENCE_MM: f64 = 0.03;
/// Neighbouring cells share what calibration and fibre cores leave: so many of them, about 1 mm², count as one.
const CELLS_PER_PATCH: f64 = 25.0;
/// Least number of common cells of an overlap.
const LEAST_CELLS: usize = 25;

/// Information about the relative pose of two views, linearised at both: the cost of small motions d of the first and e of the
/// second (rotation about the view's centre in rad, then translation in mm) is xᵀHx/2 + gᵀx with x = (d, e).
#[derive(Debug, Clone)]
pub struct Overlap {
    /// The views, by their place in the list that is solved.
    pub views: [usize; 2],
    /// Cells that both saw.
    pub cells: usize,
    pub(super) information: SMatrix<f64, 12, 12>,
    pub(super) gradient: SVector<f64, 12>,
    /// Mean difference of the deviations, mm, and how it changes with the motions.
    step_mm: f64,
    step_slope: SVector<f64, 12>,
}

impl Overlap {
    /// Compares two views (cell_observations in order of their cells, where each was laid) with these centres, mm; `None` when
    /// they hardly overlap.
    pub fn between(
        views: [usize; 2],
        [first, second]: [&[CellObservation]; 2],
        [centre, other_centre]: [[f64; 3]; 2],
    ) -> Option<Self> {
        let mut overlap = Self {
            views,
            cells: 0,
            information: SMatrix::zeros(),
            gradient: SVector::zeros(),
            step_mm: 0.0,
            step_slope: SVector::zeros(),
        };
        let mut weights = 0.0;
        let mut seen = second.iter().peekable();
        for here in first {
            while seen.next_if(|there| there.cell < here.cell).is_some() {}
            let Some(there) = seen.next_if(|there| there.cell == here.cell) else {
                continue;
            };
            let off_mm = f64::from(here.deviation_mm) - f64::from(there.deviation_mm);
            if off_mm.abs() > MOST_DIFFERENCE_MM {
                continue;
            }
            let weight = 1.0 / (here.variance_mm2() + there.variance_mm2());
            let mut row = SVector::<f64, 12>::zeros();
            row.fixed_rows_mut::<6>(0).copy_from(&slope(here, centre));
            row.fixed_rows_mut::<6>(6)
                .copy_from(&-slope(there, other_centre));
            overlap.information += row * row.transpose() * weight;
            overlap.gradient += row * (weight * off_mm);
            overlap.step_mm += weight * off_mm;
            overlap.step_slope += row * weight;
            overlap.cells += 1;
            weights += weight;
        }
        if overlap.cells < LEAST_CELLS {
            return None;
        }
        overlap.information /= CELLS_PER_PATCH;
        overlap.gradient /= CELLS_PER_PATCH;
        overlap.step_mm /= weights;
        overlap.step_slope /= weights;
        Some(overlap)
    }

    /// By how much the first view's surface stands proud of the second's once both have moved, mm, in the mean over the
    /// common cells.
    pub fn step_mm(&self, [first, second]: [&Vector6<f64>; 2]) -> f64 {
        self.step_mm
            + self.step_slope.fixed_rows::<6>(0).dot(first)
            + self.step_slope.fixed_rows::<6>(6).dot(second)
    }

    /// Block of the information between one view's motion (0 or 1) and another's.
    pub(super) fn block(&self, row: usize, column: usize) -> Matrix6<f64> {
        self.information
            .fixed_view::<6, 6>(6 * row, 6 * column)
            .into_owned()
    }
}

/// Takes off what all overlaps of a kind say in common of views at `poses`: there they are content in the mean, and pull
/// views only as they differ from each other. The first view of each pair must be the one that the second is turned on from,
/// or the lower one.
pub fn take_off_common(overlaps: &mut [Overlap], views: &[ViewInformation], poses: &[CameraPose]) {
    // Turned so that the first view of every pair looks along the same direction.
    let turns = |overlap: &Overlap| {
        let [x, y, _] = views[overlap.views[0]].centre_mm;
        Rotation3::from_axis_angle(&Vector3::z_axis(), -y.atan2(x))
    };
    let pulls: Vec<SVector<f64, 12>> = overlaps
        .iter()
        .map(|overlap| {
            let mut motions = SVector::<f64, 12>::zeros();
            for (side, &view) in overlap.views.iter().enumerate() {
                let motion = views[view].motion_to(&poses[view]);
                motions.fixed_rows_mut::<6>(6 * side).copy_from(&motion);
            }
            let pull = overlap.gradient + overlap.information * motions;
            turned(&turns(overlap), &pull)
        })
        .collect();
    let mut kinds: BTreeMap<[u64; 3], (f64, SVector<f64, 12>)> = BTreeMap::new();
    for (overlap, pull) in overlaps.iter().zip(&pulls) {
        let of_kind = kinds
            .entry(kind(overlap, views))
            .or_insert((0.0, SVector::zeros()));
        of_kind.0 += overlap.cells as f64;
        of_kind.1 += pull;
    }
    for overlap in overlaps.iter_mut() {
        if let Some((cells, sum)) = kinds.get(&kind(overlap, views)) {
            let back = turns(overlap).inverse();
            overlap.gradient -= turned(&back, sum) * (overlap.cells as f64 / cells);
        }
    }
}

/// Both views' heights, and how far the second is turned on from the first, by 0.1 mrad.
fn kind(overlap: &Overlap, views: &[ViewInformation]) -> [u64; 3] {
    let [first, second] = overlap.views.map(|view| views[view].at);
    let turn_rad = (second.rotation_rad - first.rotation_rad).rem_euclid(std::f64::consts::TAU);
    [
        first.vertical_mm.to_bits(),
        second.vertical_mm.to_bits(),
        (turn_rad * 1e4).round() as u64,
    ]
}

fn turned(turn: &Rotation3<f64>, of: &SVector<f64, 12>) -> SVector<f64, 12> {
    let mut all = *of;
    for part in 0..4 {
        let vector: Vector3<f64> = of.fixed_rows::<3>(3 * part).into_owned();
        all.fixed_rows_mut::<3>(3 * part)
            .copy_from(&(turn * vector));
    }
    all
}

/// Derivatives of a deviation by a motion of its view.
fn slope(observation: &CellObservation, centre: [f64; 3]) -> Vector6<f64> {
    let normal = Vector3::from(observation.normal.map(f64::from));
    let arm = Vector3::from(observation.point.map(f64::from)) - Vector3::from(centre);
    let turn = arm.cross(&normal);
    Vector6::new(turn.x, turn.y, turn.z, normal.x, normal.y, normal.z)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A piece of a cylinder wall around +x, toothed enough to tell sideways: normals tilt by turns.
    fn wall(
        cells: std::ops::Range<u32>,
        deviation_mm: impl Fn([f64; 3], [f64; 3]) -> f64,
    ) -> Vec<CellObservation> {
        cells
            .map(|cell| {
                let (column, row) = (f64::from(cell % 20), f64::from(cell / 20));
                let point = [41.0, 0.13 * (column - 10.0), 0.25 * row];
                let tilt = [-0.8_f64, 0.0, 0.8][cell as usize % 3];
                let normal = [-tilt.cos(), tilt.sin(), 0.0];
                CellObservation {
                    cell,
                    weight: 2.5e5,
                    deviation_mm: deviation_mm(point, normal) as f32,
                    point: point.map(|c| c as f32),
                    normal: normal.map(|c| c as f32),
                }
            })
            .collect()
    }

    fn form_mm([_, y, z]: [f64; 3]) -> f64 {
        8e-3 * (0.9 * y).sin() + 5e-3 * (1.3 * z).cos()
    }

    #[test]
    fn form_cancels_and_a_shift_of_one_view_is_a_step() {
        let centres = [[41.0, 0.0, 2.0], [41.0, 0.3, 3.0]];
        // The second view was laid 3 µm too far outwards (+x) and 1 µm too high.
        let shift = [3e-3, 0.0, 1e-3];
        let first = wall(0..400, |p, _| form_mm(p));
        let second = wall(100..500, |p, n| {
            form_mm(p) + (0..3).map(|k| shift[k] * n[k]).sum::<f64>()
        });
        let overlap = Overlap::between([0, 1], [&first, &second], centres).unwrap();
        assert_eq!(overlap.cells, 300);
        let still = Vector6::zeros();
        let back = Vector6::new(0.0, 0.0, 0.0, -3e-3, 0.0, -1e-3);
        // Normals point to the axis, some askew: cos 0.8 of two thirds of the cells.
        let expected_mm = 3e-3 * (1.0 + 2.0 * 0.8_f64.cos()) / 3.0;
        let step_mm = overlap.step_mm([&still, &still]);
        assert!((step_mm - expected_mm).abs() < 1e-8, "{step_mm}");
        assert!(overlap.step_mm([&still, &back]).abs() < 1e-8);
        // No direction leads down from there: the gradient is gone.
        let mut x = SVector::<f64, 12>::zeros();
        x.fixed_rows_mut::<6>(6).copy_from(&back);
        let left = overlap.information * x + overlap.gradient;
        assert!(left.amax() < 1e-4 * overlap.gradient.amax(), "{left}");
        // One patch of 25 cells at 2 µm and 1 µm of each view: along x, for 300 cells.
        let along_x = (0..400)
            .skip(100)
            .map(|cell| [0.8_f64.cos(), 1.0][usize::from(cell % 3 == 1)].powi(2));
        let expected = along_x.sum::<f64>() / 25.0 / (2.0 * 5e-6);
        let got = overlap.information[(3, 3)];
        assert!((got / expected - 1.0).abs() < 1e-5, "{got}, {expected}");
        assert!((overlap.information[(3, 9)] + got).abs() < 1e-5 * got);
    }

    #[test]
    fn views_that_hardly_meet_or_see_different_surfaces_say_nothing() {
        let centres = [[41.0, 0.0, 2.0]; 2];
        let view = |cells| wall(cells, |p, _| form_mm(p));
        let between = |first: &[CellObservation], second: &[CellObservation]| {
            Overlap::between([0, 1], [first, second], centres).map(|overlap| overlap.cells)
        };
        assert_eq!(between(&view(0..400), &view(380..700)), None);
        assert_eq!(between(&view(0..400), &view(370..700)), Some(30));
        let far = wall(0..400, |p, _| form_mm(p) + 0.05);
        assert_eq!(between(&view(0..400), &far), None);
    }
}
