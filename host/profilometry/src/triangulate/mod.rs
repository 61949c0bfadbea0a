//! A camera ray meets the sheet of light of one projector column.

// Lanes are counted: an iterator over several arrays at once hides from the compiler what a vector holds.
#![allow(clippy::needless_range_loop)]

mod head;

use flankscope_foundation::simd::with_widest;

use crate::head::{Distorted, HeadModel, ImageCircle, Pinhole};
use crate::pattern::Axis;

pub(crate) use head::HeadTriangulator;

/// Intersection of a camera ray with a sheet of light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Depth z in the camera frame; the point is `z (x, y, 1)`.
    pub depth_mm: f64,
    /// Change of the projector column when the point moves 1 mm in depth along the ray, px/mm.
    pub column_by_depth_px_per_mm: f64,
    /// The projector's pixel that lights the point.
    pub projector_px: [f64; 2],
}

/// Camera and projector, ready to intersect.
#[derive(Clone, Debug)]
pub struct Triangulator {
    /// Projector coordinate that the fringes encode: 0 columns, 1 rows. "Column" stands for either in this file.
    axis: usize,
    projector: Pinhole,
    rotation: [[f64; 3]; 3],
    translation_mm: [f64; 3],
    /// Part of the projector whose fringes are used.
    circle: Option<ImageCircle>,
}

/// The column must be met to this; a millionth of it is far below any calibration.
const COLUMN_TOLERANCE_PX: f64 = 1e-9;
const MAX_ITERATIONS: usize = 12;
/// Rays that are followed together.
const LANES: usize = 8;

impl Triangulator {
    /// For one head and one way of the fringes.
    pub fn new(head: &HeadModel, axis: Axis) -> Self {
        Self {
            axis: axis.index(),
            projector: head.projector.clone(),
            rotation: head.projector_from_camera.rotation,
            translation_mm: head.projector_from_camera.translation_mm,
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

    /// Whether a point lies inside the projector's lit circle: at the rim of a fibre bundle light comes from one side only, and its phase
    /// is that of the rim.
    pub fn is_lit(&self, hit: &Hit) -> bool {
        let circle = self.circle.as_ref();
        circle.is_none_or(|circle| circle.contains(hit.projector_px))
    }

    fn column_along(&self, a: [f64; 3], depth_mm: f64) -> Option<(f64, f64)> {
        let lens = |at| self.projector.distort(at);
        let seen = self.seen(a, depth_mm, lens);
        let column = seen.projector_px[self.axis];
        (!column.is_nan()).then_some((column, seen.column_by_depth_px_per_mm))
    }

    /// The point at this depth as the projector sees it through its lens; NaN behind the projector.
    #[inline(always)]
    fn seen(&self, a: [f64; 3], depth_mm: f64, lens: impl Fn([f64; 2]) -> Distorted) -> Hit {
        let t = self.translation_mm;
        let [x, y, z] = [
            a[0] * depth_mm + t[0],
            a[1] * depth_mm + t[1],
            a[2] * depth_mm + t[2],
        ];
        let z = if z > 0.0 { z } else { f64::NAN };
        let [u, v] = [x / z, y / z];
        let [du, dv] = [(a[0] - u * a[2]) / z, (a[1] - v * a[2]) / z];
        let (focal, principal) = (self.projector.focal_px, self.projector.principal_px);
        let Distorted {
            value,
            gradient_x,
            gradient_y,
        } = lens([u, v]);
        let gradient = if self.axis == 0 {
            gradient_x
        } else {
            gradient_y
        };
        Hit {
            depth_mm,
            column_by_depth_px_per_mm: focal[self.axis] * (gradient[0] * du + gradient[1] * dv),
            projector_px: [
                focal[0] * value[0] + principal[0],
                focal[1] * value[1] + principal[1],
            ],
        }
    }

    /// The depth at which the ray `(x, y, 1)` (undistorted image plane) lies in the sheet of `column_px`.
    ///
    /// Starts from the undistorted sheet, which is a plane, and follows the ray by Newton's method on the distorted
    /// column. `None` when ray and sheet do not meet in front of both camera and projector.
    pub fn intersect(&self, ray: [f64; 2], column_px: f64) -> Option<Hit> {
        let lens = |at| self.projector.distort(at);
        let [hit] = self.follow([(ray, column_px)], lens);
        hit
    }

    /// The same of many rays and their columns.
    pub fn intersect_all(&self, rays: &[([f64; 2], f64)]) -> Vec<Option<Hit>> {
        // The residual's table is no arithmetic for vectors.
        if self.projector.residual.is_some() {
            let hit = |&(ray, column_px): &([f64; 2], f64)| self.intersect(ray, column_px);
            return rays.iter().map(hit).collect();
        }
        with_widest(
            #[inline(always)]
            || {
                let mut hits = Vec::with_capacity(rays.len() + LANES);
                for rays in rays.chunks(LANES) {
                    // The last ones are followed more than once.
                    let lane = |lane: usize| rays[lane.min(rays.len() - 1)];
                    let lens = |at| self.projector.brown(at);
                    hits.extend(self.follow::<LANES>(std::array::from_fn(lane), lens));
                }
                hits.truncate(rays.len());
                hits
            },
        )
    }

    /// Follows some rays at once, without a branch, so that the compiler takes several in a vector.
    #[inline(always)]
    fn follow<const N: usize>(
        &self,
        rays: [([f64; 2], f64); N],
        lens: impl Fn([f64; 2]) -> Distorted,
    ) -> [Option<Hit>; N] {
        let t = self.translation_mm;
        let (axis, r) = (self.axis, &self.rotation);
        let direction =
            |axis: usize, [x, y]: [f64; 2]| r[axis][0] * x + r[axis][1] * y + r[axis][2];
        let a: [[f64; N]; 3] =
            std::array::from_fn(|axis| std::array::from_fn(|i| direction(axis, rays[i].0)));
        let along = if axis == 0 { &a[0] } else { &a[1] };
        let mut depth_mm: [f64; N] = std::array::from_fn(|i| {
            let u = (rays[i].1 - self.projector.principal_px[axis]) / self.projector.focal_px[axis];
            (t[axis] - u * t[2]) / (u * a[2][i] - along[i])
        });
        let (mut slope, mut px) = ([f64::NAN; N], [[f64::NAN; N]; 2]);
        let mut met = [false; N];
        for _ in 0..MAX_ITERATIONS {
            for i in 0..N {
                let seen = self.seen([a[0][i], a[1][i], a[2][i]], depth_mm[i], &lens);
                let [column, row] = seen.projector_px;
                let error_px = if axis == 0 { column } else { row } - rays[i].1;
                slope[i] = seen.column_by_depth_px_per_mm;
                [px[0][i], px[1][i]] = [column, row];
                met[i] = error_px.abs() <= COLUMN_TOLERANCE_PX;
                // What was met stays where it is, and is met again.
                let next_mm = depth_mm[i] - error_px / slope[i];
                depth_mm[i] = if met[i] { depth_mm[i] } else { next_mm };
            }
            if (0..N).all(|i| met[i] | depth_mm[i].is_nan()) {
                break;
            }
        }
        std::array::from_fn(|i| {
            let usable = met[i]
                && depth_mm[i] > 0.0
                && depth_mm[i].is_finite()
                && slope[i].abs() > f64::MIN_POSITIVE;
            usable.then_some(Hit {
                depth_mm: depth_mm[i],
                column_by_depth_px_per_mm: slope[i],
                projector_px: [px[0][i], px[1][i]],
            })
        })
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
                let by = |axis| {
                    let of = Triangulator::new(&head, axis);
                    of.is_lit(&of.intersect(ray, at(&of)).unwrap())
                };
                assert_eq!(by(Axis::Rows), by(Axis::Columns));
                by(Axis::Rows)
            };
            assert!(lit_within(away_px + 1e-6) && !lit_within(away_px - 1e-6));
            assert!(columns.is_lit(&columns.intersect(ray, at(&columns)).unwrap()));
        }
    }
}
