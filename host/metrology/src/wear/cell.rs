//! One cell of a field: its mean wear from the points that fell into it.
//!
//! Points rarely fill a cell evenly, least of all where wear has a slope: the surface turns to or from the view there. So a
//! quadratic is laid through them, whose mean over the cell is exact; with few points a plane. What they leave over is the
//! points' noise; with its slope counted as noise, a pit's own shape would make it uncertain.

use nalgebra::{Matrix3, SMatrix, SVector};

/// Coefficients of the quadratic; the first three are the plane.
const QUADRATIC: usize = 6;
const PLANE: usize = 3;
/// A surface is used where its mean over the cell is at most this much less sure, in variance, than that of as many points
/// spread evenly: beyond, they lie too far to one side.
const MOST_LOPSIDED: f64 = 8.0;

/// Sums over the points of one cell.
#[derive(Debug, Clone, Default)]
pub(super) struct Cell {
    points: usize,
    /// Of the surface's terms with each other and with the wear.
    normal: SMatrix<f64, QUADRATIC, QUADRATIC>,
    right: SVector<f64, QUADRATIC>,
    squares: f64,
    variance_sum: f64,
}

impl Cell {
    /// Takes a point's wear, mm, at `x` along the profile and `y` up from the cell's middle, in cells, with standard
    /// uncertainty `sigma`, mm (NaN where it is not stated).
    pub fn add(&mut self, [x, y]: [f64; 2], wear: f64, sigma: f64) {
        // All terms but the first have no mean over the cell: the first coefficient is the mean.
        let twelfth = 1.0 / 12.0;
        let terms = SVector::from([1.0, x, y, x * x - twelfth, y * y - twelfth, x * y]);
        self.points += 1;
        self.normal += terms * terms.transpose();
        self.right += wear * terms;
        self.squares += wear * wear;
        self.variance_sum += sigma * sigma;
    }

    /// Mean wear over the cell, mm, and its variance by noise, mm2: from the points' own uncertainties, or from their
    /// scatter about the surface when that is larger or alone. None for fewer than `least` points, or when they do not lie
    /// around the middle.
    pub fn mean(&self, least: usize) -> Option<[f64; 2]> {
        if self.points < least {
            return None;
        }
        if self.points >= 2 * QUADRATIC
            && let Some(inverse) = self.normal.try_inverse()
            && let Some(found) = self.first(&inverse, &self.right)
        {
            return Some(found);
        }
        let plane: Matrix3<f64> = self.normal.fixed_view::<PLANE, PLANE>(0, 0).into();
        let right = self.right.fixed_rows::<PLANE>(0).into_owned();
        self.first(&plane.try_inverse()?, &right)
    }

    /// The first coefficient of a surface and its variance.
    fn first<const N: usize>(
        &self,
        inverse: &SMatrix<f64, N, N>,
        right: &SVector<f64, N>,
    ) -> Option<[f64; 2]> {
        let (points, share) = (self.points as f64, inverse[(0, 0)]);
        if self.points <= N || !(0.5..=MOST_LOPSIDED).contains(&(points * share)) {
            return None;
        }
        let surface = inverse * right;
        let left_over = (self.squares - surface.dot(right)).max(0.0);
        let scatter = left_over / (points - N as f64);
        let stated = self.variance_sum / points;
        // f64::max passes over the NaN of unstated uncertainties.
        Some([surface[0], scatter.max(stated) * share])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points that crowd to one side of the cell, by a linear density.
    fn crowded(side: u32) -> impl Iterator<Item = [f64; 2]> {
        (0..side * side).map(move |i| {
            let part = |k: u32| (f64::from(k) + 0.5) / f64::from(side);
            [part(i % side).sqrt() - 0.5, part(i / side) - 0.5]
        })
    }

    #[test]
    fn a_slope_and_a_bowl_are_no_noise_and_crowded_points_no_bias() {
        let shape = |[x, y]: [f64; 2]| 0.03 + 0.02 * x - 0.01 * y + 0.04 * x * x + 0.03 * x * y;
        // Mean over the cell: the odd terms vanish, x2 has 1/12.
        let expected = 0.03 + 0.04 / 12.0;
        let mut cell = Cell::default();
        for at in crowded(6) {
            cell.add(at, shape(at), 1e-6);
        }
        let [mean, variance] = cell.mean(5).unwrap();
        assert!((mean - expected).abs() < 1e-9, "{mean} {expected}");
        // 36 points of 1 nm, less sure by their crowding.
        let even = 1e-12 / 36.0;
        assert!(
            (even..MOST_LOPSIDED * even).contains(&variance),
            "{variance}"
        );
    }

    #[test]
    fn few_points_make_a_plane_and_points_on_one_side_nothing() {
        let mut few = Cell::default();
        for at in crowded(3) {
            few.add(at, 0.01 + 0.02 * at[0], 1e-3);
        }
        let [mean, variance] = few.mean(5).unwrap();
        assert!((mean - 0.01).abs() < 1e-12 && variance >= 1e-6 / 9.0);
        assert!(few.mean(10).is_none());
        let mut aside = Cell::default();
        for at in crowded(5) {
            aside.add([0.4 + 0.1 * at[0], at[1]], 0.01, 1e-3);
        }
        assert!(aside.mean(5).is_none());
    }
}
