//! Exact signed distance to a triangle surface.
//!
//! The distance is the Euclidean one to the nearest point of any triangle, in f64. Its sign comes from angle-weighted
//! pseudo-normals at faces, edges and corners (Baerentzen and Aanaes, IEEE TVCG 11, 243, 2005), so it is right at
//! ridges too, where the normal of one face alone misleads. Positive is outside the material.
//!
//! Of several closed bodies in one mesh ([`Surface::oriented`]) a point is inside if the winding numbers of all bodies about it sum to
//! more than nought (Barill et al., ACM Trans. Graph. 37, 43, 2018): a face inside another body does not bound the material. The distance
//! is that to the nearest face of any body, buried or not.

mod bodies;
pub(crate) mod bvh;
pub mod orientation;
mod ray;
pub mod sampling;
pub(crate) mod triangle;
mod triangle_packet;

use std::collections::HashMap;
use std::sync::Arc;

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::io::mesh::{MeshError, TriMesh, weld};
use crate::space::Aabb;
use crate::space::morton::map_along_curve;
use crate::space::unit_normal;
use bodies::Bodies;
use bvh::{Bvh, Found, PacketScratch, QUERIES};
use flankscope_foundation::simd;
use orientation::Orientation;
pub use triangle::Feature;

/// Points per parallel task. Fixed, so that hints and sums, and with them every bit, do not depend on the thread count.
pub const CHUNK: usize = 1024;

/// Cosine of 10 degrees, half the angle between the faces of the bluntest edge that counts as sharp.
const LEAST_SMOOTHNESS: f64 = 0.985;

/// A surface ready for closest-point queries.
#[derive(Debug, Clone)]
pub struct Surface {
    facets: Arc<Vec<Facet>>,
    bvh: Bvh,
    bounds: Aabb,
    /// The closed parts of a mesh that has several.
    bodies: Option<Arc<Bodies>>,
}

/// Data of one triangle beside its corners. Order of corners: as in the mesh, turned for triangles without area.
#[derive(Debug, Clone)]
struct Facet {
    corners: [[f64; 3]; 3],
    /// Number of the triangle in the mesh.
    triangle: u32,
    normal: [f64; 3],
    edge_normals: [[f64; 3]; 3],
    corner_normals: [[f64; 3]; 3],
}

/// The closest point of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Closest {
    /// The point on the surface, mm.
    pub point: [f64; 3],
    /// Distance, mm; positive outside the material, negative inside.
    pub signed_distance_mm: f64,
    /// Unit outward normal at the point; at edges and corners the pseudo-normal.
    pub normal: [f64; 3],
    /// Number of the triangle in the mesh.
    pub triangle: u32,
    /// Part of the triangle that holds the point.
    pub feature: Feature,
    /// Cosine of the angle between `normal` and the triangle's own normal: 1 on faces and smooth edges, clearly less on sharp
    /// edges.
    pub smoothness: f64,
}

impl Closest {
    /// Whether the normal belongs to the face: not at sharp edges (more than 20 degrees between the faces), where it is of
    /// neither.
    #[inline(always)]
    pub fn is_smooth(&self) -> bool {
        self.smoothness >= LEAST_SMOOTHNESS
    }
}

impl Surface {
    /// Prepares a mesh. Corners that are equal bit by bit are joined first; triangles without area stay as segments.
    ///
    /// # Errors
    /// [`MeshError`] when the mesh breaks its invariants or has no area.
    pub fn new(mesh: &TriMesh) -> Result<Self, MeshError> {
        mesh.check()?;
        let (_, joined) = weld(&mesh.vertices);
        let facets = facets(mesh, &joined);
        let no_area = MeshError::NoArea {
            triangles: mesh.triangles.len(),
        };
        if facets.iter().all(|facet| facet.normal == [0.0; 3]) {
            return Err(no_area);
        }
        Self::over(Arc::new(facets), |_| true).ok_or(no_area)
    }

    /// Prepares a mesh as [`orientation::orient`] left it: with the bodies that it found there.
    ///
    /// # Errors
    /// As [`Surface::new`].
    pub fn oriented(mesh: &TriMesh, orientation: &Orientation) -> Result<Self, MeshError> {
        let mut surface = Self::new(mesh)?;
        if !orientation.bodies.is_empty() && orientation.unsigned.is_none() {
            surface.bodies = Some(Arc::new(Bodies::new(mesh, &orientation.bodies)?));
        }
        Ok(surface)
    }

    fn over(facets: Arc<Vec<Facet>>, keep: impl Fn(&Aabb) -> bool) -> Option<Self> {
        let mut bounds: Option<Aabb> = None;
        let mut items = Vec::with_capacity(facets.len());
        for (index, facet) in facets.iter().enumerate() {
            let aabb = Aabb::around(&facet.corners);
            if keep(&aabb) {
                items.push((facet.corners, index as u32));
                let all = bounds.get_or_insert(aabb);
                *all = Aabb::around(&[all.low, all.high, aabb.low, aabb.high]);
            }
        }
        let bounds = bounds?;
        let bvh = Bvh::new(&items);
        Some(Self {
            facets,
            bvh,
            bounds,
            bodies: None,
        })
    }

    /// The part of the surface whose triangles' boxes pass `keep`, or none when nothing passes. Signs near the cut stay
    /// those of the whole surface. The caller keeps a margin: a point nearer to a dropped triangle is measured to a kept one.
    pub fn restrict(&self, keep: impl Fn(&Aabb) -> bool) -> Option<Self> {
        let bodies = self.bodies.clone();
        Self::over(Arc::clone(&self.facets), keep).map(|part| Self { bodies, ..part })
    }

    /// Box around all triangles, mm.
    pub fn bounds(&self) -> Aabb {
        self.bounds
    }

    /// The closest point to a finite `p`, mm.
    pub fn closest(&self, p: [f64; 3]) -> Closest {
        self.describe(p, &self.bvh.closest(p))
    }

    /// Unit outward normal at a closest point; at edges and corners the pseudo-normal.
    #[inline(always)]
    fn normal(&self, found: &Found) -> [f64; 3] {
        let facet = &self.facets[self.bvh.id(found.place) as usize];
        match found.nearest.feature {
            Feature::Face => facet.normal,
            Feature::Edge(k) => facet.edge_normals[usize::from(k)],
            Feature::Corner(k) => facet.corner_normals[usize::from(k)],
        }
    }

    #[inline(always)]
    fn describe(&self, p: [f64; 3], found: &Found) -> Closest {
        let Found { place, nearest } = *found;
        let facet = &self.facets[self.bvh.id(place) as usize];
        let normal = self.normal(found);
        let normal_vector = Vector3::from(normal);
        let outside = normal_vector.dot(&(Vector3::from(p) - nearest.point));
        let distance = nearest.distance2_mm2.sqrt();
        Closest {
            point: nearest.point.into(),
            signed_distance_mm: if self.is_inside(p, outside) {
                -distance
            } else {
                distance
            },
            normal,
            triangle: facet.triangle,
            feature: nearest.feature,
            smoothness: normal_vector.dot(&Vector3::from(facet.normal)),
        }
    }

    /// Closest points of many finite points, in order, on all threads; the same bytes for any thread count.
    ///
    /// Scattered points are asked in an order of their own, so that each finds the surface where its
    /// predecessor left it; the results come in the order of `points`.
    pub fn closest_many(&self, points: &[[f64; 3]]) -> Vec<Closest> {
        let empty = Closest {
            point: [0.0; 3],
            signed_distance_mm: 0.0,
            normal: [0.0; 3],
            triangle: 0,
            feature: Feature::Face,
            smoothness: 0.0,
        };
        let mut closest = vec![empty; points.len()];
        self.map(points, &mut closest, empty, |p, found| {
            self.describe(p, found)
        });
        closest
    }

    /// Signed distances of many finite points, mm, in order, as [`Surface::closest_many`] finds them. `results_mm` is as
    /// long as `points`.
    pub fn signed_distances(&self, points: &[[f64; 3]], results_mm: &mut [f64]) {
        self.map(points, results_mm, 0.0, |p, found| {
            let Found { place, nearest } = *found;
            // On a face the triangle's own normal decides, and nothing else need be looked up.
            let normal = match nearest.feature {
                Feature::Face => self.bvh.normal(place),
                _ => self.normal(found).into(),
            };
            let outside = normal.dot(&(Vector3::from(p) - nearest.point));
            let distance = nearest.distance2_mm2.sqrt();
            if self.is_inside(p, outside) {
                -distance
            } else {
                distance
            }
        });
    }

    /// Whether a point is inside the material, by its component along the normal at the closest point, or by all bodies.
    #[inline(always)]
    fn is_inside(&self, p: [f64; 3], outside_mm: f64) -> bool {
        match &self.bodies {
            None => outside_mm < 0.0,
            Some(bodies) => bodies.hold(p),
        }
    }

    /// As [`Surface::closest_many`], keeping only what `pick` takes.
    fn map<T: Copy + Send + Sync>(
        &self,
        points: &[[f64; 3]],
        results: &mut [T],
        empty: T,
        pick: impl Fn([f64; 3], &Found) -> T + Sync,
    ) {
        let map = |points: &[[f64; 3]], results: &mut [T]| {
            self.each_found(points, results, |p, found, result| *result = pick(p, found));
        };
        if !map_along_curve(points, results, empty, map) {
            results
                .par_chunks_mut(CHUNK)
                .zip(points.par_chunks(CHUNK))
                .for_each(|(results, points)| map(points, results));
        }
    }

    /// Shows `visit` each point's closest point, with what belongs to the point, on this thread.
    pub fn each_closest<T>(
        &self,
        points: &[[f64; 3]],
        with: &mut [T],
        visit: impl Fn(&Closest, &mut T),
    ) {
        self.each_found(points, with, |p, found, own| {
            visit(&self.describe(p, found), own)
        });
    }

    fn each_found<T>(
        &self,
        points: &[[f64; 3]],
        with: &mut [T],
        visit: impl Fn([f64; 3], &Found, &mut T),
    ) {
        simd::with_widest(
            #[inline(always)]
            || {
                let mut scratch = PacketScratch::new();
                let mut found = [Found::NONE; QUERIES];
                for (points, with) in points.chunks(QUERIES).zip(with.chunks_mut(QUERIES)) {
                    self.bvh.closest_packet(points, &mut scratch, &mut found);
                    for ((&point, found), own) in points.iter().zip(&found).zip(with) {
                        visit(point, found, own);
                    }
                }
            },
        );
    }
}

/// Sums and their normals per edge and corner of the joined mesh.
fn facets(mesh: &TriMesh, joined: &[u32]) -> Vec<Facet> {
    // Triangles that name one position twice are segments which their neighbours already have.
    let mut kept: Vec<Kept> = Vec::with_capacity(mesh.triangles.len());
    for (number, triangle) in mesh.triangles.iter().enumerate() {
        let ids = triangle.map(|i| joined[i as usize]);
        let corners = mesh.corners(number);
        if ids[0] != ids[1] && ids[1] != ids[2] && ids[2] != ids[0] {
            kept.push((number as u32, ids, corners));
        }
    }
    let mut normals: Vec<[f64; 3]> = Vec::with_capacity(kept.len());
    let mut flat = Vec::new();
    for (index, (_, ids, corners)) in kept.iter_mut().enumerate() {
        let normal = unit_normal(*corners);
        if normal.is_none() {
            let turn = longest_edge(corners);
            corners.rotate_left(turn);
            ids.rotate_left(turn);
            flat.push(index);
        }
        normals.push(normal.unwrap_or([0.0; 3]));
    }

    let positions = joined.iter().max().map_or(0, |&m| m as usize + 1);
    let (edges, edge_count) = edge_numbers(&kept, positions);
    let mut edge_sums = vec![Vector3::zeros(); edge_count];
    for (edges, normal) in edges.iter().zip(&normals) {
        for &edge in edges {
            edge_sums[edge as usize] += Vector3::from(*normal);
        }
    }
    // A triangle flat to a segment (a T-junction closed by a sliver) passes on what lies across its longest edge, so that
    // its two short edges and the corner between them see both sides.
    let mut stands_for: HashMap<usize, Vector3<f64>> = HashMap::new();
    for &index in &flat {
        let own = edges[index].map(|edge| edge as usize);
        stands_for.insert(index, edge_sums[own[0]]);
        let all = edge_sums[own[0]] + edge_sums[own[1]] + edge_sums[own[2]];
        for edge in own {
            edge_sums[edge] = all;
        }
    }

    let mut corner_sums = vec![Vector3::zeros(); positions];
    for (index, (_, ids, corners)) in kept.iter().enumerate() {
        let normal = stands_for
            .get(&index)
            .map_or_else(|| Vector3::from(normals[index]), |across| unit(*across));
        for k in 0..3 {
            let at = Vector3::from(corners[k]);
            let to = Vector3::from(corners[(k + 1) % 3]) - at;
            let from = Vector3::from(corners[(k + 2) % 3]) - at;
            // atan2 keeps its digits for very small and very blunt angles, where acos does not.
            let angle = to.cross(&from).norm().atan2(to.dot(&from));
            corner_sums[ids[k] as usize] += normal * angle;
        }
    }

    kept.par_iter()
        .zip(normals)
        .zip(&edges)
        .map(|(((triangle, ids, corners), normal), edges)| {
            let own = Vector3::from(normal);
            let or_own = |sum: Vector3<f64>| -> [f64; 3] {
                // Opposite faces (a sheet without thickness) cancel; the face's own side is then as good as any.
                if sum.norm() > 1e-9 { unit(sum) } else { own }.into()
            };
            Facet {
                corners: *corners,
                triangle: *triangle,
                normal,
                edge_normals: edges.map(|edge| or_own(edge_sums[edge as usize])),
                corner_normals: ids.map(|id| or_own(corner_sums[id as usize])),
            }
        })
        .collect()
}

/// A triangle's number in the mesh, its joined corners, and where they are.
type Kept = (u32, [u32; 3], [[f64; 3]; 3]);

/// Numbers the edges: those of each triangle, side k from corner k to the next, and how many there are in all.
///
/// The sides are gathered by their lower corner, of which each has few, so that no table of all edges has to be searched.
fn edge_numbers(kept: &[Kept], positions: usize) -> (Vec<[u32; 3]>, usize) {
    let ends = |ids: &[u32; 3], k: usize| {
        let (a, b) = (ids[k], ids[(k + 1) % 3]);
        (a.min(b) as usize, a.max(b))
    };
    let mut starts = vec![0u32; positions + 1];
    for (_, ids, _) in kept {
        for k in 0..3 {
            starts[ends(ids, k).0 + 1] += 1;
        }
    }
    for at in 0..positions {
        starts[at + 1] += starts[at];
    }
    // Upper corner above, side below: sorted, the sides of one edge lie together.
    let mut sides = vec![0u64; 3 * kept.len()];
    let mut next = starts.clone();
    for (side, (ids, k)) in kept
        .iter()
        .flat_map(|(_, ids, _)| (0..3).map(move |k| (ids, k)))
        .enumerate()
    {
        let (low, high) = ends(ids, k);
        sides[next[low] as usize] = u64::from(high) << 32 | side as u64;
        next[low] += 1;
    }
    let mut edges = vec![[0u32; 3]; kept.len()];
    let mut count = 0;
    for at in 0..positions {
        let own = &mut sides[starts[at] as usize..starts[at + 1] as usize];
        own.sort_unstable();
        for edge in own.chunk_by(|a, b| a >> 32 == b >> 32) {
            for side in edge.iter().map(|side| *side as u32 as usize) {
                edges[side / 3][side % 3] = count;
            }
            count += 1;
        }
    }
    (edges, count as usize)
}

fn unit(v: Vector3<f64>) -> Vector3<f64> {
    let norm = v.norm();
    if norm > 0.0 { v / norm } else { v }
}

fn longest_edge(corners: &[[f64; 3]; 3]) -> usize {
    let length2 =
        |k: usize| (Vector3::from(corners[(k + 1) % 3]) - Vector3::from(corners[k])).norm_squared();
    let mut longest = 0;
    for k in 1..3 {
        if length2(k) > length2(longest) {
            longest = k;
        }
    }
    longest
}
