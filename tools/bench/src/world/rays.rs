//! Intersection of rays with a triangle mesh: a bounding volume hierarchy finds candidates, double precision decides.

use flankscope_gear_cad::Mesh;
use nalgebra::{Point3, Vector3};
use obvhs::BvhBuildParams;
use obvhs::aabb::Aabb;
use obvhs::bvh2::{Bvh2, builder::build_bvh2};
use obvhs::ray::{Ray, RayHit};
use std::cmp::Ordering;
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

    /// Point of the mesh nearest to `point`; `None` for a mesh without triangles. The first of several at the same distance.
    pub fn nearest_point(&self, point: Point3<f64>) -> Option<Point3<f64>> {
        let mut best: Option<(f64, Vector3<f64>)> = None;
        // Nodes to be opened, with the squared distance of their boxes.
        let mut open = Vec::with_capacity(64);
        let squared_mm2 = |node: usize| {
            let aabb = self.bvh.nodes.get(node)?.aabb();
            let [low, high] = [aabb.min, aabb.max].map(|corner| {
                let corner: [f32; 3] = corner.into();
                Vector3::from(corner.map(f64::from))
            });
            let outside = (low - point.coords).sup(&(point.coords - high));
            Some((outside.map(|mm| mm.max(0.0)).norm_squared(), node))
        };
        open.extend(squared_mm2(0));
        while let Some((box_mm2, node)) = open.pop() {
            if best.is_some_and(|(nearest_mm2, _)| nearest_mm2 <= box_mm2) {
                continue;
            }
            let node = &self.bvh.nodes[node];
            let first = node.first_index as usize;
            if node.is_leaf() {
                for triangle in &self.corners[first..first + node.prim_count as usize] {
                    let candidate = nearest_on_triangle(*triangle, point.coords);
                    let mm2 = (candidate - point.coords).norm_squared();
                    if best.is_none_or(|(nearest_mm2, _)| mm2 < nearest_mm2) {
                        best = Some((mm2, candidate));
                    }
                }
            } else {
                let mut children = [first, first + 1].map(squared_mm2);
                // The nearer one is opened first.
                children.sort_by(|a, b| b.partial_cmp(a).unwrap_or(Ordering::Equal));
                open.extend(children.into_iter().flatten());
            }
        }
        best.map(|(_, nearest)| nearest.into())
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

/// Point of a triangle, given by a corner and two edges from it, nearest to `point`: its foot on the plane, or else the nearest
/// of the three edges. A triangle without area is its edges.
fn nearest_on_triangle([a, u, v]: [Vector3<f64>; 3], point: Vector3<f64>) -> Vector3<f64> {
    let from_corner = point - a;
    // By cross products: sums of squares lose nine digits on facets 66 mm long.
    let normal = u.cross(&v);
    let normal2 = normal.norm_squared();
    let s = from_corner.cross(&v).dot(&normal) / normal2;
    let t = u.cross(&from_corner).dot(&normal) / normal2;
    if s >= 0.0 && t >= 0.0 && s + t <= 1.0 {
        return point - from_corner.dot(&normal) / normal2 * normal;
    }
    let on_edge = |from: Vector3<f64>, edge: Vector3<f64>| {
        let length2 = edge.norm_squared();
        let along = if length2 > 0.0 {
            (point - from).dot(&edge) / length2
        } else {
            0.0
        };
        from + along.clamp(0.0, 1.0) * edge
    };
    let edges = [on_edge(a, u), on_edge(a, v), on_edge(a + u, v - u)];
    let nearer = |p: Vector3<f64>, q: Vector3<f64>| match (p - point).norm_squared()
        <= (q - point).norm_squared()
    {
        true => p,
        false => q,
    };
    nearer(nearer(edges[0], edges[1]), edges[2])
}

fn single_precision(origin: Point3<f64>, direction: Vector3<f64>, reach: f32) -> Ray {
    let origin = <[f32; 3]>::from(origin.coords.map(|x| x as f32));
    let direction = <[f32; 3]>::from(direction.map(|x| x as f32));
    Ray::new(origin.into(), direction.into(), 0.0, reach)
}

#[cfg(test)]
mod tests {
    use nalgebra::Rotation3;
    use rand::RngExt;
    use rand::SeedableRng;
    use rand_pcg::Pcg64;

    use super::*;

    /// The faces of a box between two corners, each of two triangles, as slivers where it is flat.
    fn of_box(low: [f64; 3], high: [f64; 3]) -> Mesh {
        let corner = |i: u32| [0, 1, 2].map(|k| if i >> k & 1 == 1 { high[k] } else { low[k] });
        let face = |[a, b, c, d]: [u32; 4]| [[a, b, c], [a, c, d]];
        let faces = [
            [0, 2, 3, 1],
            [4, 5, 7, 6],
            [0, 1, 5, 4],
            [2, 6, 7, 3],
            [0, 4, 6, 2],
            [1, 3, 7, 5],
        ];
        Mesh {
            vertices: (0..8).map(corner).collect(),
            triangles: faces.into_iter().flat_map(face).collect(),
        }
    }

    /// The distance of a point from the surface of a box, in closed form.
    fn from_box_mm(low: [f64; 3], high: [f64; 3], point: [f64; 3]) -> f64 {
        let outside = [0, 1, 2].map(|k| (low[k] - point[k]).max(point[k] - high[k]));
        match outside.iter().all(|mm| *mm < 0.0) {
            true => outside.into_iter().fold(f64::INFINITY, |d, mm| d.min(-mm)),
            false => Vector3::from(outside.map(|mm| mm.max(0.0))).norm(),
        }
    }

    #[test]
    fn the_nearest_point_of_a_box_is_as_far_as_its_closed_form_says() {
        let mut rng = Pcg64::seed_from_u64(7);
        // As it lies, and turned so that no coordinate of a facet 66 mm long is zero.
        for (high, turned_rad) in [
            ([3.0, 2.0, 1.0], 0.0),
            ([66.0, 0.02, 5.0], 0.0),
            ([66.0, 0.3, 1.0], 0.7),
        ] {
            let low = [-1.0, 0.0, 0.5];
            let turn = Rotation3::from_euler_angles(0.3 * turned_rad, turned_rad, 2.0 * turned_rad);
            let mut mesh = of_box(low, high);
            for vertex in &mut mesh.vertices {
                *vertex = (turn * Point3::from(*vertex)).into();
            }
            let caster = RayCaster::new(&mesh);
            for _ in 0..2000 {
                let point = [0, 1, 2].map(|k| rng.random_range(low[k] - 4.0..high[k] + 4.0));
                let turned = turn * Point3::from(point);
                let nearest = caster.nearest_point(turned).unwrap();
                let expected_mm = from_box_mm(low, high, point);
                // A thousand roundings of 66 mm.
                let tolerance_mm = 1e-11;
                assert!(((nearest - turned).norm() - expected_mm).abs() < tolerance_mm);
                // It lies on the surface.
                let back = turn.inverse() * nearest;
                assert!(from_box_mm(low, high, back.into()) < tolerance_mm);
            }
        }
    }

    #[test]
    fn a_triangle_without_area_is_its_edges_and_no_mesh_has_no_nearest_point() {
        let line = Mesh {
            vertices: vec![[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [1.0, 0.0, 0.0]],
            triangles: vec![[0, 1, 2], [1, 1, 1]],
        };
        let nearest =
            |mesh: &Mesh, point: [f64; 3]| RayCaster::new(mesh).nearest_point(point.into());
        assert_eq!(
            nearest(&line, [1.5, 1.0, 0.0]),
            Some([1.5, 0.0, 0.0].into())
        );
        assert_eq!(
            nearest(&line, [5.0, 0.0, 1.0]),
            Some([2.0, 0.0, 0.0].into())
        );
        let none = Mesh {
            vertices: Vec::new(),
            triangles: Vec::new(),
        };
        assert_eq!(nearest(&none, [0.0; 3]), None);
    }
}
