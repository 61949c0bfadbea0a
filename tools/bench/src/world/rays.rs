//! Intersection of rays with a triangle mesh: a bounding volume hierarchy finds candidates, double precision decides.

use flankscope_gear_cad::Mesh;
use nalgebra::{Point3, Vector3};
use obvhs::BvhBuildParams;
use obvhs::aabb::Aabb;
use obvhs::bvh2::{Bvh2, builder::build_bvh2};
use obvhs::ray::{Ray, RayHit};
use std::time::Duration;

/// The hierarchy stores single precision: half a unit in the last place at 100 mm is 4e-6 mm, so boxes grow by ten times
/// that and never lose a triangle.
const BOX_MARGIN_MM: f32 = 5e-5;

/// Intersection of a ray with the mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Index of the triangle in the mesh.
    pub triangle: usize,
    /// Distance along the ray in units of its direction.
    pub distance: f64,
    /// Unit normal of the triangle, out of the material.
    pub normal: Vector3<f64>,
}

/// A mesh prepared for ray casting.
pub struct RayCaster {
    bvh: Bvh2,
    /// Corner and two edges per triangle, in the order of the hierarchy's leaves.
    corners: Vec<[Vector3<f64>; 3]>,
}

impl RayCaster {
    /// Prepares `mesh`. Its coordinates must be finite and below 1000 mm.
    pub fn new(mesh: &Mesh) -> Self {
        let corners = |t: &[u32; 3]| t.map(|i| Vector3::from(mesh.vertices[i as usize]));
        let boxes: Vec<Aabb> = mesh
            .triangles
            .iter()
            .map(|t| {
                let [a, b, c] = corners(t);
                let low = a.inf(&b).inf(&c).map(|x| x as f32 - BOX_MARGIN_MM);
                let high = a.sup(&b).sup(&c).map(|x| x as f32 + BOX_MARGIN_MM);
                Aabb {
                    min: <[f32; 3]>::from(low).into(),
                    max: <[f32; 3]>::from(high).into(),
                }
            })
            .collect();
        let bvh = build_bvh2(
            &boxes,
            BvhBuildParams::fast_build(),
            &mut Duration::default(),
        );
        let corners = bvh
            .primitive_indices
            .iter()
            .map(|&i| {
                let [a, b, c] = corners(&mesh.triangles[i as usize]);
                [a, b - a, c - a]
            })
            .collect();
        Self { bvh, corners }
    }

    /// First triangle that the ray meets from `origin` along `direction`, from either side.
    pub fn nearest(&self, origin: Point3<f64>, direction: Vector3<f64>) -> Option<Hit> {
        self.nearest_within(origin, direction, f64::INFINITY)
    }

    /// As [`Self::nearest`], no farther than `reach` in units of the direction.
    pub fn nearest_within(
        &self,
        origin: Point3<f64>,
        direction: Vector3<f64>,
        reach: f64,
    ) -> Option<Hit> {
        let mut best: Option<(usize, f64)> = None;
        let mut ignored = RayHit::none();
        self.bvh.ray_traverse(
            single_precision(origin, direction, reach as f32 * (1.0 + 1e-6)),
            &mut ignored,
            |_, leaf| {
                match self.distance(leaf, origin, direction) {
                    Some(t) if t <= reach && best.is_none_or(|(_, nearest)| t < nearest) => {
                        best = Some((leaf, t));
                        // Rounded up, so that boxes at the same distance are still opened.
                        (t as f32) * (1.0 + 1e-6)
                    }
                    _ => f32::INFINITY,
                }
            },
        );
        best.map(|(leaf, distance)| {
            let [_, u, v] = self.corners[leaf];
            Hit {
                triangle: self.bvh.primitive_indices[leaf] as usize,
                distance,
                normal: u.cross(&v).normalize(),
            }
        })
    }

    /// Whether a point lies inside a closed mesh, independent of the orientation of its triangles: by the parity of crossings,
    /// the majority of three rays, because a ray through an edge may count it twice.
    pub fn encloses(&self, point: Point3<f64>) -> bool {
        const DIRECTIONS: [[f64; 3]; 3] = [
            [0.356, 0.271, 0.894],
            [-0.617, 0.513, 0.597],
            [0.159, -0.841, -0.517],
        ];
        let inside = |direction: [f64; 3]| {
            let direction = Vector3::from(direction);
            let mut crossed = 0;
            let mut ignored = RayHit::none();
            self.bvh.ray_traverse(
                single_precision(point, direction, f32::INFINITY),
                &mut ignored,
                |_, leaf| {
                    crossed += usize::from(self.distance(leaf, point, direction).is_some());
                    f32::INFINITY
                },
            );
            crossed % 2 == 1
        };
        DIRECTIONS.into_iter().filter(|d| inside(*d)).count() >= 2
    }

    /// Whether the line between two points is blocked. Offset the ends from the surface: an end on a triangle counts as blocked.
    pub fn blocked(&self, from: Point3<f64>, to: Point3<f64>) -> bool {
        let way = to - from;
        !self
            .bvh
            .ray_traverse_miss(single_precision(from, way, 1.0), |_, leaf| {
                match self.distance(leaf, from, way) {
                    Some(t) if t < 1.0 => 0.0,
                    _ => f32::INFINITY,
                }
            })
    }

    /// Ray parameter of the intersection with triangle `leaf` in front of the origin (Möller and Trumbore 1997).
    fn distance(&self, leaf: usize, origin: Point3<f64>, direction: Vector3<f64>) -> Option<f64> {
        // Slight overlap, so that a ray through a shared edge hits at least one of its triangles.
        const OVERLAP: f64 = 1e-12;
        let [a, u, v] = self.corners[leaf];
        let p = direction.cross(&v);
        let determinant = u.dot(&p);
        if determinant == 0.0 {
            return None;
        }
        let s = origin.coords - a;
        let along_u = s.dot(&p) / determinant;
        if !(-OVERLAP..=1.0 + OVERLAP).contains(&along_u) {
            return None;
        }
        let q = s.cross(&u);
        let along_v = direction.dot(&q) / determinant;
        if along_v < -OVERLAP || along_u + along_v > 1.0 + OVERLAP {
            return None;
        }
        let t = v.dot(&q) / determinant;
        (t > 0.0).then_some(t)
    }
}

fn single_precision(origin: Point3<f64>, direction: Vector3<f64>, reach: f32) -> Ray {
    let origin = <[f32; 3]>::from(origin.coords.map(|x| x as f32));
    let direction = <[f32; 3]>::from(direction.map(|x| x as f32));
    Ray::new(origin.into(), direction.into(), 0.0, reach)
}
