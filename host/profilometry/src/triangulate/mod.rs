//! A camera ray meets the sheet of light of one projector column.

mod head;

use crate::head::{HeadModel, ImageCircle, Pinhole};
use crate::pattern::Axis;

pub(crate) use head::HeadTriangulator;

/// Intersection of a camera ray with a sheet of light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Depth z in the camera frame; the point is `z (x, y, 1)`.
    pub depth_mm: f64,
    /// Change of the projector column when the point moves 1 mm in depth along the ray, px/mm.
    pub column_by_depth_px_per_mm: f64,
}

/// Camera and projector, ready to intersect.
#[derive(Clone, Debug)]
pub struct Triangulator {
    /// Projector coordinate that the fringes encode: 0 columns, 1 rows. "Column" stands for either in this file.
    axis: usize,
    projector: Pinhole,
    rotation: [[f64; 3]; 3],
    translation_mm: [f64; 3],
    distorted: bool,
    /// Part of the projector whose fringes are used.
    circle: Option<ImageCircle>,
}

/// The column must be met to this; a millionth of it is far below any calibration.
const COLUMN_TOLERANCE_PX: f64 = 1e-9;
const MAX_ITERATIONS: usize = 12;

impl Triangulator {
    /// For one head and one way of the fringes.
    pub fn new(head: &HeadModel, axis: Axis) -> Self {
        Self {
            axis: axis.index(),
            projector: head.projector.clone(),
            rotation: head.projector_from_camera.rotation,
            translation_mm: head.projector_from_camera.translation_mm,
            distorted: !head.projector.is_ideal(),
            circle: head.projector_circle,
        }
    }

    /// The projector column of the point `depth_mm (x, y, 1)` and its derivative by depth; `None` behind the projector.
    pub fn column(&self, ray: [f64; 2], depth_mm: f64) -> Option<(f64, f64)> {
        self.column_along(self.direction(ray), depth_mm)
    }

    /// The ray's direction in the projector frame.
    fn direction(&self, [x, y]: [f64; 2]) -> [f64; 3] {
        self.rotation.map(|row| row[0] * x + row[1] * y + row[2])
    }

    /// Whether the point `depth_mm (x, y, 1)` lies inside the projector's lit circle: at the rim of a fibre bundle light comes from one
    /// side only, and its phase is that of the rim.
    pub fn is_lit(&self, ray: [f64; 2], depth_mm: f64) -> bool {
        let Some(circle) = &self.circle else {
            return true;
        };
        let a = self.direction(ray);
        let [x, y, z] = [0, 1, 2].map(|axis| a[axis] * depth_mm + self.translation_mm[axis]);
        z > 0.0 && circle.contains(self.projector.pixel([x / z, y / z]))
    }

    fn column_along(&self, a: [f64; 3], depth_mm: f64) -> Option<(f64, f64)> {
        let t = self.translation_mm;
        let [x, y, z] = [
            a[0] * depth_mm + t[0],
            a[1] * depth_mm + t[1],
            a[2] * depth_mm + t[2],
        ];
        if !(z > 0.0) {
            return None;
        }
        let [u, v] = [x / z, y / z];
        let [du, dv] = [(a[0] - u * a[2]) / z, (a[1] - v * a[2]) / z];
        let (focal, principal) = (self.projector.focal_px, self.projector.principal_px);
        let axis = self.axis;
        let (value, slope) = match self.distorted {
            false => ([u, v][axis], [du, dv][axis]),
            true => {
                let distorted = self.projector.distort([u, v]);
                let gradient = [distorted.gradient_x, distorted.gradient_y][axis];
                (distorted.value[axis], gradient[0] * du + gradient[1] * dv)
            }
        };
        Some((focal[axis] * value + principal[axis], focal[axis] * slope))
    }

    /// The depth at which the ray `(x, y, 1)` (undistorted image plane) lies in the sheet of `column_px`.
    ///
    /// Starts from the undistorted sheet, which is a plane, and follows the ray by Newton's method on the distorted
    /// column. `None` when ray and sheet do not meet in front of both camera and projector.
    pub fn intersect(&self, ray: [f64; 2], column_px: f64) -> Option<Hit> {
        let a = self.direction(ray);
        let t = self.translation_mm;
        let u = (column_px - self.projector.principal_px[self.axis])
            / self.projector.focal_px[self.axis];
        let mut depth_mm = (t[self.axis] - u * t[2]) / (u * a[2] - a[self.axis]);
        for _ in 0..MAX_ITERATIONS {
            let (column, slope) = self.column_along(a, depth_mm)?;
            let error_px = column - column_px;
            if error_px.abs() <= COLUMN_TOLERANCE_PX {
                let usable =
                    depth_mm > 0.0 && depth_mm.is_finite() && slope.abs() > f64::MIN_POSITIVE;
                return usable.then_some(Hit {
                    depth_mm,
                    column_by_depth_px_per_mm: slope,
                });
            }
            depth_mm -= error_px / slope;
        }
        None
    }
}

/// Standard uncertainty of the depth for a phase of `periods` over `width_px` columns:
/// `sigma_phase width / (TAU periods |d column / d depth|)`.
pub fn depth_sigma_mm(phase_sigma_rad: f64, periods: f64, width_px: f64, hit: &Hit) -> f64 {
    phase_sigma_rad * width_px
        / (std::f64::consts::TAU * periods * hit.column_by_depth_px_per_mm.abs())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A made-up head with a lens of every kind of distortion.
    fn head() -> HeadModel {
        toml::from_str(
            "name = 'test'\nworking_distance_mm = 20.0\n\
             [camera]\nwidth_px = 960\nheight_px = 600\nfocal_px = [1265.0, 1265.0]\nprincipal_px = [480.0, 300.0]\n\
             [projector]\nwidth_px = 1024\nheight_px = 768\nfocal_px = [2300.0, 2310.0]\nprincipal_px = [510.0, 380.0]\n\
             distortion = [0.08, -0.02, 0.001, -0.002, 0.0]\n\
             [projector_from_camera]\nrotation = [[0.96, 0.02, -0.279284801], [0.0, 0.997446, 0.071425], [0.28, -0.068568, 0.957548]]\n\
             translation_mm = [6.0, 5.0, 0.8]\n",
        )
        .unwrap()
    }

    /// The columns and rows of a point, each by a triangulator of its own, say how far it is from the circle's centre.
    #[test]
    fn what_lies_outside_the_projectors_circle_is_not_lit() {
        let bare = head();
        let of_axis = |axis| Triangulator::new(&bare, axis);
        let [columns, rows] = [Axis::Columns, Axis::Rows].map(of_axis);
        let centre_px = [500.0, 390.0];
        for ray in [[0.0, 0.0], [0.1, -0.05], [-0.15, 0.1], [0.02, 0.17]] {
            let at = |of: &Triangulator| of.column(ray, 20.7).unwrap().0;
            let away_px = (at(&columns) - centre_px[0]).hypot(at(&rows) - centre_px[1]);
            let lit_within = |radius_px: f64| {
                let circle = ImageCircle {
                    centre_px,
                    radius_px,
                };
                let head = HeadModel {
                    projector_circle: Some(circle),
                    ..bare.clone()
                };
                let by_rows = Triangulator::new(&head, Axis::Rows).is_lit(ray, 20.7);
                assert_eq!(
                    by_rows,
                    Triangulator::new(&head, Axis::Columns).is_lit(ray, 20.7)
                );
                by_rows
            };
            assert!(lit_within(away_px + 1e-6) && !lit_within(away_px - 1e-6));
            assert!(columns.is_lit(ray, 20.7));
        }
    }
}
