//! Residual field of a lens: a smooth, irregular image shift beyond Brown's distortion.
//!
//! A gradient-index objective behind a fibre bundle bends light by a micrometre or two where no polynomial of its radius
//! follows. The shift is a tensor product of uniform cubic B-splines (de Boor 1978): continuous in its second derivative, and
//! local, so that a dot tells of its own neighbourhood only.

use serde::{Deserialize, Serialize};

use flankscope_foundation::textfile::{self, BadValue};

/// Coefficients along a side.
pub const SIDE: usize = 10;
/// Pieces of the spline along a side.
const PIECES: usize = SIDE - 3;
/// A coefficient of more is no remainder of a lens; less cannot fold the image.
const MAX_SHIFT_PX: f64 = 10.0;

/// Coefficients of one direction, row by row.
pub type Coefficients = [[f64; SIDE]; SIDE];

/// ImageShift of the image beyond the distortion, over a square of the undistorted image plane `z = 1`. Outside, it is what it is
/// at the border.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ResidualField {
    /// Middle of the square: x, y.
    pub centre: [f64; 2],
    /// Half its side.
    pub half_side: f64,
    /// ImageShift along the columns: 10 by 10 coefficients, those of the least y first.
    pub columns_px: Coefficients,
    /// ImageShift along the rows; absent where nothing sees it, as in a projector of upright fringes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rows_px: Option<Coefficients>,
}

/// The four splines that are not zero at a place along one axis, with their derivatives.
struct SplineWeights {
    first: usize,
    weights: [f64; 4],
    slopes: [f64; 4],
}

/// A value and its derivatives by x and y.
pub(crate) struct ImageShift {
    pub value_px: f64,
    pub gradient_px: [f64; 2],
}

impl ResidualField {
    /// No shift, over a square.
    pub(crate) fn zero(centre: [f64; 2], half_side: f64, rows: bool) -> Self {
        Self {
            centre,
            half_side,
            columns_px: [[0.0; SIDE]; SIDE],
            rows_px: rows.then_some([[0.0; SIDE]; SIDE]),
        }
    }

    /// ImageShift of a point of the undistorted image plane: along columns and rows, px.
    pub fn shift_px(&self, at: [f64; 2]) -> [f64; 2] {
        self.shifts(at).map(|shift| shift.value_px)
    }

    /// The same with derivatives.
    pub(crate) fn shifts(&self, at: [f64; 2]) -> [ImageShift; 2] {
        let [x, y] = [0, 1].map(|axis| self.span(at[axis] - self.centre[axis]));
        let along = |coefficients: &Coefficients| {
            let mut shift = ImageShift {
                value_px: 0.0,
                gradient_px: [0.0; 2],
            };
            for (j, row) in coefficients[y.first..][..4].iter().enumerate() {
                let row = &row[x.first..][..4];
                let dot = |by: &[f64; 4]| row.iter().zip(by).map(|(c, w)| c * w).sum::<f64>();
                let across = dot(&x.weights);
                shift.value_px += y.weights[j] * across;
                shift.gradient_px[0] += y.weights[j] * dot(&x.slopes);
                shift.gradient_px[1] += y.slopes[j] * across;
            }
            shift
        };
        let none = || ImageShift {
            value_px: 0.0,
            gradient_px: [0.0; 2],
        };
        [
            along(&self.columns_px),
            self.rows_px.as_ref().map_or_else(none, along),
        ]
    }

    /// The coefficients, by row and column, that the shift at a place follows, and how much.
    pub(crate) fn weights(&self, at: [f64; 2]) -> [([usize; 2], f64); 16] {
        let [x, y] = [0, 1].map(|axis| self.span(at[axis] - self.centre[axis]));
        std::array::from_fn(|k| {
            let (j, i) = (k / 4, k % 4);
            ([y.first + j, x.first + i], y.weights[j] * x.weights[i])
        })
    }

    fn span(&self, from_centre: f64) -> SplineWeights {
        let per_unit = PIECES as f64 / (2.0 * self.half_side);
        let at = (from_centre + self.half_side) * per_unit;
        let inside = at.clamp(0.0, PIECES as f64);
        let first = (inside as usize).min(PIECES - 1);
        let t = inside - first as f64;
        let s = 1.0 - t;
        let weights = [
            s * s * s,
            3.0 * t * t * t - 6.0 * t * t + 4.0,
            3.0 * s * s * s - 6.0 * s * s + 4.0,
            t * t * t,
        ]
        .map(|w| w / 6.0);
        // Outside, nothing changes any more.
        let per_unit = if inside == at { per_unit } else { 0.0 };
        let slopes = [-s * s, 3.0 * t * t - 4.0 * t, 4.0 * s - 3.0 * s * s, t * t]
            .map(|slope| 0.5 * slope * per_unit);
        SplineWeights {
            first,
            weights,
            slopes,
        }
    }

    /// Limits on what a file may say; `table` is the name in messages.
    #[rustfmt::skip]
    pub(crate) fn check(&self, table: &str) -> Result<(), BadValue> {
        let Self { centre, half_side, columns_px, rows_px } = self;
        let is_in_plane = centre.iter().all(|x| x.abs() < 10.0);
        textfile::require(&[
            (is_in_plane, &format!("{table}.centre"), centre, "must be a point of the image plane z = 1"),
            (*half_side > 1e-3 && *half_side < 10.0, &format!("{table}.half_side"), half_side, "must be 0.001 to 10, in the image plane z = 1"),
        ])?;
        for (key, coefficients) in [("columns_px", Some(columns_px)), ("rows_px", rows_px.as_ref())] {
            let mut all = coefficients.into_iter().flatten().flatten();
            if let Some(bad) = all.find(|c| !(c.abs() <= MAX_SHIFT_PX)) {
                return Err(BadValue::new(format!("{table}.{key}"), bad, "must be pixels, at most 10 either way"));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Coefficients that are a polynomial of their place give it back exactly: cubic B-splines reproduce a linear one as it
    /// is, and a square plus a third (Marsden's identity).
    #[test]
    fn polynomials_come_back() {
        let at = |i: usize| i as f64 - 1.0;
        let mut field = ResidualField::zero([0.1, -0.2], 0.5, true);
        let coefficients = |of: fn(f64, f64) -> f64| -> Coefficients {
            std::array::from_fn(|j| std::array::from_fn(|i| of(at(i), at(j))))
        };
        field.columns_px = coefficients(|u, v| 0.3 * u - 0.2 * v);
        field.rows_px = Some(coefficients(|u, v| 0.01 * (u * u - 1.0 / 3.0) * v));
        for [x, y] in [[0.1, -0.2], [-0.39, 0.29], [0.55, -0.65], [0.123, 0.045]] {
            let [u, v] = [(x + 0.4) * PIECES as f64, (y + 0.7) * PIECES as f64];
            let [column, row] = field.shifts([x, y]);
            assert!((column.value_px - (0.3 * u - 0.2 * v)).abs() < 1e-12);
            assert!((column.gradient_px[0] - 0.3 * PIECES as f64).abs() < 1e-12);
            assert!((column.gradient_px[1] + 0.2 * PIECES as f64).abs() < 1e-12);
            assert!((row.value_px - 0.01 * u * u * v).abs() < 1e-12, "{x} {y}");
            assert!((row.gradient_px[0] - 0.02 * PIECES as f64 * u * v).abs() < 1e-12);
            assert!((row.gradient_px[1] - 0.01 * PIECES as f64 * u * u).abs() < 1e-12);
        }
        let at = [0.123, 0.045];
        let summed: f64 = field
            .weights(at)
            .iter()
            .map(|([j, i], w)| w * field.columns_px[*j][*i])
            .sum();
        assert!((summed - field.shift_px(at)[0]).abs() < 1e-12);
        assert_eq!(
            field.shift_px([9.0, 0.0]),
            field.shift_px([0.6, 0.0]),
            "beyond the square"
        );
    }
}
