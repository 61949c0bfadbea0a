//! Four triangles side by side, to tell cheaply which of them may be nearest.
//!
//! In a triangle's own frame (u along its first edge, v across it in its plane, h along its normal) the squared distance is
//! h^2 plus the plane distance to the outline, and each edge needs one product along and one across. All is f32 and four
//! triangles wide, which every processor does at once. The result only decides which triangles are measured exactly, in
//! f64: an error of rounding costs a needless measurement, never an answer, as long as it stays below the caller's slack.

use nalgebra::Vector3;
use wide::f32x4;

use crate::space::unit_normal;
use crate::surface::bvh::{Each, QUERIES, larger, smaller};

/// Triangles per leaf.
pub(crate) const LANES: usize = 4;

type Lanes = [f32; LANES];

/// Frames of up to four triangles; unused lanes repeat the first.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub(crate) struct TrianglePacket {
    origin: [Lanes; 3],
    along: [Lanes; 3],
    across: [Lanes; 3],
    normal: [Lanes; 3],
    /// Length of the first edge, from the origin along u.
    first: Lanes,
    /// Directions in (u, v) and length of the edge from the second corner to the third.
    second: [Lanes; 3],
    /// The same from the first corner to the third.
    third: [Lanes; 3],
}

impl TrianglePacket {
    /// `triangles` holds 1 to [`LANES`] triangles, turned so that one without area is the segment from its first to its
    /// second corner.
    pub fn new(triangles: &[[[f64; 3]; 3]]) -> Self {
        let mut leaf = Self {
            origin: [[0.0; LANES]; 3],
            along: [[0.0; LANES]; 3],
            across: [[0.0; LANES]; 3],
            normal: [[0.0; LANES]; 3],
            first: [0.0; LANES],
            second: [[0.0; LANES]; 3],
            third: [[0.0; LANES]; 3],
        };
        for lane in 0..LANES {
            leaf.set(
                lane,
                triangles[if lane < triangles.len() { lane } else { 0 }],
            );
        }
        leaf
    }

    fn set(&mut self, lane: usize, corners: [[f64; 3]; 3]) {
        let [a, b, c] = corners.map(Vector3::from);
        let (ab, length) = ((b - a), (b - a).norm());
        let u = ab / length;
        // Without area any frame about the edge will do, and the third corner counts as the first.
        let (n, c) = match unit_normal(corners) {
            Some(n) => (Vector3::from(n), c),
            None => (perpendicular(u), a),
        };
        let v = n.cross(&u);
        let ac = (u.dot(&(c - a)), v.dot(&(c - a)));
        let third = ac.0.hypot(ac.1);
        let bc = (ac.0 - length, ac.1);
        let second = bc.0.hypot(bc.1);
        let unit = |(x, y): (f64, f64), norm: f64| {
            if norm > 0.0 {
                (x / norm, y / norm)
            } else {
                (1.0, 0.0)
            }
        };
        let (s, t) = (unit(bc, second), unit(ac, third));
        for k in 0..3 {
            self.origin[k][lane] = a[k] as f32;
            self.along[k][lane] = u[k] as f32;
            self.across[k][lane] = v[k] as f32;
            self.normal[k][lane] = n[k] as f32;
        }
        self.first[lane] = length as f32;
        for (k, (second, third)) in [(s.0, t.0), (s.1, t.1), (second, third)]
            .into_iter()
            .enumerate()
        {
            self.second[k][lane] = second as f32;
            self.third[k][lane] = third as f32;
        }
    }

    /// Squared distances from `q`. With S the sum of the sizes of `q`'s and of the corners' coordinates, the distances
    /// are off by less than [`ERROR_RATIO`] S.
    #[inline(always)]
    pub fn distances2(&self, q: &[f32x4; 3]) -> f32x4 {
        let zero = f32x4::ZERO;
        let [dx, dy, dz]: [f32x4; 3] = [0, 1, 2].map(|k: usize| q[k] - f32x4::from(self.origin[k]));
        let dot = |axis: &[Lanes; 3]| {
            f32x4::from(axis[0]) * dx + f32x4::from(axis[1]) * dy + f32x4::from(axis[2]) * dz
        };
        let (u, v, h) = (dot(&self.along), dot(&self.across), dot(&self.normal));
        let beyond = |s: f32x4, length: f32x4| s - s.fast_max(zero).fast_min(length);
        let first = f32x4::from(self.first);
        let [second_u, second_v, second] = self.second.map(f32x4::from);
        let [third_u, third_v, third] = self.third.map(f32x4::from);
        // Across each edge, positive on the triangle's side; along it, what lies beyond its ends.
        let ub = u - first;
        let across = [v, second_u * v - second_v * ub, third_v * u - third_u * v];
        let beyond = [
            beyond(u, first),
            beyond(second_u * ub + second_v * v, second),
            beyond(third_u * u + third_v * v, third),
        ];
        let edge = |k: usize| across[k] * across[k] + beyond[k] * beyond[k];
        let outline = edge(0).fast_min(edge(1)).fast_min(edge(2));
        let inside = across[0]
            .fast_min(across[1])
            .fast_min(across[2])
            .simd_ge(zero);
        h * h + inside.bitselect(zero, outline)
    }
}

impl TrianglePacket {
    /// As [`TrianglePacket::distances2`], of one triangle from several queries; and bit i set when the i-th query's foot on the
    /// triangle's plane lies inside by more than its slack, so that this foot is the closest point for certain.
    #[inline(always)]
    pub fn distances2_of(&self, lane: usize, q: &[Each; 3], slack: &Each) -> (Each, u8) {
        let at = |lanes: &[Lanes; 3]| [lanes[0][lane], lanes[1][lane], lanes[2][lane]];
        let (origin, along, across, normal) = (
            at(&self.origin),
            at(&self.along),
            at(&self.across),
            at(&self.normal),
        );
        let first = self.first[lane];
        let [second_u, second_v, second] = at(&self.second);
        let [third_u, third_v, third] = at(&self.third);
        let beyond = |s: f32, length: f32| s - smaller(larger(s, 0.0), length);
        let mut distances2 = [0.0; QUERIES];
        let mut margin = [0.0; QUERIES];
        for i in 0..QUERIES {
            let (dx, dy, dz) = (
                q[0][i] - origin[0],
                q[1][i] - origin[1],
                q[2][i] - origin[2],
            );
            let dot = |axis: [f32; 3]| axis[0] * dx + axis[1] * dy + axis[2] * dz;
            let (u, v, h) = (dot(along), dot(across), dot(normal));
            let ub = u - first;
            let (across_2, across_3) = (second_u * v - second_v * ub, third_v * u - third_u * v);
            let edge = |across: f32, beyond: f32| across * across + beyond * beyond;
            let outline = smaller(
                smaller(
                    edge(v, beyond(u, first)),
                    edge(across_2, beyond(second_u * ub + second_v * v, second)),
                ),
                edge(across_3, beyond(third_u * u + third_v * v, third)),
            );
            margin[i] = smaller(smaller(v, across_2), across_3);
            distances2[i] = h * h + if margin[i] >= 0.0 { 0.0 } else { outline };
        }
        let mut inside = 0;
        for i in 0..QUERIES {
            inside |= u8::from(margin[i] > slack[i]) << i;
        }
        (distances2, inside)
    }
}

/// Bound on the error of [`TrianglePacket::distances2`] (as a distance) over the sizes of the numbers that go in: f32 rounds to 2^-24
/// = 6e-8, and at most some twelve such roundings of numbers of that size add up in each of u, v, h and the products.
pub(crate) const ERROR_RATIO: f32 = 2e-6;

fn perpendicular(u: Vector3<f64>) -> Vector3<f64> {
    let axis = if u.x.abs() < 0.6 {
        Vector3::x()
    } else {
        Vector3::y()
    };
    u.cross(&axis).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::triangle::Prepared;
    use flankscope_foundation::random::uniform;

    #[test]
    fn the_estimate_stays_within_its_bound() {
        for round in 0..20_000u64 {
            let value = |i: u64| 2.0 * uniform(8, 16 * round + i) - 1.0;
            let size = [60.0, 1.0, 0.01, 1e-5][(round % 4) as usize];
            let a = [50.0 * value(0), 50.0 * value(1), 50.0 * value(2)];
            let near =
                |from: [f64; 3], i: u64| [0, 1, 2].map(|k| from[k as usize] + size * value(i + k));
            let b = near(a, 3);
            let c = match (round / 4) % 3 {
                0 => near(a, 6),
                1 => [0, 1, 2].map(|k| a[k] + 0.3 * (b[k] - a[k])),
                _ => [0, 1, 2]
                    .map(|k| a[k] + 0.3 * (b[k] - a[k]) + 1e-4 * size * value(6 + k as u64)),
            };
            let p = near(a, 9);
            let exact = Prepared::new([a, b, c]).nearest(p.into());
            let exact = exact.distance2_mm2.sqrt();
            let estimate =
                TrianglePacket::new(&[[a, b, c]]).distances2(&p.map(|c| f32x4::splat(c as f32)));
            let sizes: f64 = [a, b, c, p].iter().flatten().map(|c| c.abs()).sum();
            for lane in estimate.to_array() {
                let off = f64::from(lane).sqrt() - exact;
                assert!(
                    off.abs() < f64::from(ERROR_RATIO) * sizes / 2.0,
                    "{off} of {exact}, round {round}"
                );
            }
        }
    }
}
