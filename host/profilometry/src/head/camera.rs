//! Pinhole with Brown distortion, for the camera and for the projector as an inverse camera.

use serde::{Deserialize, Serialize};

use super::residual::ResidualField;
use flankscope_foundation::textfile::{self, BadValue};

/// Pinhole with radial and tangential distortion: Brown's model in OpenCV's order and with OpenCV's conventions.
///
/// `x_d = x (1 + k1 r2 + k2 r4 + k3 r6) + 2 p1 x y + p2 (r2 + 2 x2)`, likewise y with p1 and p2 exchanged;
/// `column = focal_px[0] x_d + principal_px[0]`. Pixel centres lie at integers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pinhole {
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// Focal length along columns and rows.
    pub focal_px: [f64; 2],
    /// Principal point: column, row.
    pub principal_px: [f64; 2],
    /// k1, k2, p1, p2, k3.
    #[serde(default)]
    pub distortion: [f64; 5],
    /// Residual image shift beyond Brown's distortion.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub residual: Option<ResidualField>,
}

/// A distorted coordinate with its derivatives by the undistorted ones.
pub(crate) struct Distorted {
    pub value: [f64; 2],
    /// d value[0] / dx, d value[0] / dy.
    pub gradient_x: [f64; 2],
    /// d value[1] / dx, d value[1] / dy.
    pub gradient_y: [f64; 2],
}

impl Pinhole {
    /// Limits on what a file may say; `table` is the name in messages.
    #[rustfmt::skip]
    pub(crate) fn check(&self, table: &str) -> Result<(), BadValue> {
        let Self { width_px, height_px, focal_px, principal_px, distortion, residual } = self;
        let key = |name: &str| format!("{table}.{name}");
        let within = |values: &[f64], limit: f64| values.iter().all(|value| value.abs() <= limit);
        textfile::require(&[
            ((1..=MAX_SIDE_PX).contains(width_px), &key("width_px"), width_px, "must be 1 to 16384 pixels"),
            ((1..=MAX_SIDE_PX).contains(height_px), &key("height_px"), height_px, "must be 1 to 16384 pixels"),
            (focal_px.iter().all(|focal| (1.0..1e7).contains(focal)), &key("focal_px"), focal_px, "both must be positive, at least a pixel (focal length divided by pixel pitch)"),
            (within(principal_px, 1e6), &key("principal_px"), principal_px, "must be finite pixel coordinates"),
            (within(distortion, 1e3), &key("distortion"), distortion, "must be five finite numbers k1, k2, p1, p2, k3"),
        ])?;
        if let Some(residual) = residual {
            residual.check(&key("residual"))?;
        }
        // A mapping that folds over inside the image is no camera model: its inverse would not be unique.
        let [right, bottom] = [width_px, height_px].map(|side| f64::from(side - 1));
        let corners = [[0.0, 0.0], [right, 0.0], [0.0, bottom], [right, bottom]];
        let inverts = corners.iter().all(|&corner| self.undistort(corner).is_some());
        textfile::require(&[(inverts, &key("distortion"), distortion, "folds over inside the image (its inverse does not exist in a corner): are the coefficients in the order k1, k2, p1, p2, k3?")])
    }

    /// The pixel that a point of the undistorted image plane `z = 1` falls on.
    pub fn pixel(&self, undistorted: [f64; 2]) -> [f64; 2] {
        let [x, y] = self.distort(undistorted).value;
        [
            self.focal_px[0] * x + self.principal_px[0],
            self.focal_px[1] * y + self.principal_px[1],
        ]
    }

    pub(crate) fn distort(&self, at: [f64; 2]) -> Distorted {
        let mut distorted = self.brown(at);
        if let Some(residual) = &self.residual {
            let [column, row] = residual.shifts(at);
            let Distorted {
                value,
                gradient_x,
                gradient_y,
            } = &mut distorted;
            for (axis, (shift, gradient)) in [(column, gradient_x), (row, gradient_y)]
                .into_iter()
                .enumerate()
            {
                value[axis] += shift.value_px / self.focal_px[axis];
                for (sum, slope_px) in gradient.iter_mut().zip(shift.gradient_px) {
                    *sum += slope_px / self.focal_px[axis];
                }
            }
        }
        distorted
    }

    #[inline(always)]
    pub(crate) fn brown(&self, [x, y]: [f64; 2]) -> Distorted {
        let [k1, k2, p1, p2, k3] = self.distortion;
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let radial_by_r2 = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3);
        let cross = 2.0 * x * y * radial_by_r2 + 2.0 * p1 * x + 2.0 * p2 * y;
        Distorted {
            value: [
                x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
            ],
            gradient_x: [
                radial + 2.0 * x * x * radial_by_r2 + 2.0 * p1 * y + 6.0 * p2 * x,
                cross,
            ],
            gradient_y: [
                cross,
                radial + 2.0 * y * y * radial_by_r2 + 6.0 * p1 * y + 2.0 * p2 * x,
            ],
        }
    }

    /// The point of the image plane `z = 1` seen by a pixel, by Newton's method; `None` where the distortion folds over.
    pub fn undistort(&self, pixel: [f64; 2]) -> Option<[f64; 2]> {
        let target = [
            (pixel[0] - self.principal_px[0]) / self.focal_px[0],
            (pixel[1] - self.principal_px[1]) / self.focal_px[1],
        ];
        let mut point = target;
        for _ in 0..20 {
            let distorted = self.distort(point);
            let error = [
                distorted.value[0] - target[0],
                distorted.value[1] - target[1],
            ];
            // 1e-13 of a focal length is far below a millionth of a pixel.
            if error[0].abs().max(error[1].abs()) < 1e-13 {
                return Some(point);
            }
            let [[a, b], [c, d]] = [distorted.gradient_x, distorted.gradient_y];
            let determinant = a * d - b * c;
            // The undistorted mapping has determinant 1; it must not fold over on the way.
            if !(determinant > 1e-3 && determinant.is_finite()) {
                return None;
            }
            point[0] -= (d * error[0] - b * error[1]) / determinant;
            point[1] -= (a * error[1] - c * error[0]) / determinant;
        }
        None
    }
}

/// No camera or projector of this kind has more.
const MAX_SIDE_PX: u32 = 16384;

#[cfg(test)]
mod tests {
    use super::*;

    /// A shift of up to a pixel, different everywhere.
    fn bumps() -> ResidualField {
        let mut field = ResidualField::zero([0.0, 0.0], 0.3, true);
        let bump = |i: usize, j: usize| f64::sin((7 * i + 3 * j * j) as f64);
        let coefficients =
            |shift: usize| std::array::from_fn(|j| std::array::from_fn(|i| bump(i + shift, j)));
        field.columns_px = coefficients(0);
        field.rows_px = Some(coefficients(5));
        field
    }

    fn lens() -> Pinhole {
        Pinhole {
            width_px: 1920,
            height_px: 1200,
            focal_px: [2100.0, 2110.0],
            principal_px: [950.0, 610.0],
            distortion: [-0.21, 0.13, 1.5e-3, -8e-4, -0.02],
            residual: Some(bumps()),
        }
    }

    #[test]
    fn undistort_inverts_pixel() {
        for column in [0.0, 700.5, 1919.0] {
            for row in [0.0, 333.0, 1199.0] {
                let point = lens().undistort([column, row]).unwrap();
                let [u, v] = lens().pixel(point);
                assert!((u - column).abs() < 1e-9 && (v - row).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn gradients_agree_with_differences() {
        let at = [0.21, -0.22];
        let step = 1e-6;
        let lens = lens();
        for axis in 0..2 {
            let (mut plus, mut minus) = (at, at);
            plus[axis] += step;
            minus[axis] -= step;
            let (plus, minus) = (lens.distort(plus).value, lens.distort(minus).value);
            let here = lens.distort(at);
            assert!(((plus[0] - minus[0]) / (2.0 * step) - here.gradient_x[axis]).abs() < 1e-9);
            assert!(((plus[1] - minus[1]) / (2.0 * step) - here.gradient_y[axis]).abs() < 1e-9);
        }
    }

    #[test]
    fn a_folding_lens_is_refused() {
        let lens = Pinhole {
            distortion: [-3.0, 0.0, 0.0, 0.0, 0.0],
            ..lens()
        };
        assert_eq!(lens.check("camera").unwrap_err().key, "camera.distortion");
    }
}
