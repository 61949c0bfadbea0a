//! Orientation of a mesh: which side of its triangles is outside.
//!
//! The formats say that corners run counter-clockwise seen from outside; many files do not keep to it. Triangles that share an
//! edge must run along it in opposite directions, which orients every connected part up to one choice. Of a closed part the
//! choice follows from its volume, and from how many other closed parts hold it (a cavity's shell points inwards). Of an open
//! part it cannot be known: the file's own order stands, that of most of the part's area where it is mixed.

use std::sync::OnceLock;

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::io::mesh::{TriMesh, weld};
use crate::space::Aabb;
use crate::surface::Surface;

/// A part of an open mesh whose smaller half is more than this share of its area has no order that could stand.
const MOST_MIXED: f64 = 0.1;
/// A closed part of less volume than this share of that of a sphere of its area is a sheet folded on itself: it has no inside.
const LEAST_VOLUME: f64 = 1e-6;
/// Which of the closed parts lie within which is asked for each two of them, so there is a limit to their number.
const MOST_PARTS: usize = 2000;

/// Result of [`orient`].
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Orientation {
    /// Triangles in all, without those that repeat another one.
    pub triangles: usize,
    /// Triangles of the same three corners as another one, which are dropped.
    pub repeated: usize,
    /// Triangles whose corners were put in the other order.
    pub turned: usize,
    /// Edges that do not lie between two triangles: where the mesh is open, or more than two meet. None of a solid.
    pub open_edges: usize,
    /// Reason for which distances to the mesh have no sign; none when they have one.
    #[serde(skip)]
    pub unsigned: Option<Unsigned>,
}

/// Reasons for which no side of a mesh is outside.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Unsigned {
    /// A Moebius strip, or triangles joined the wrong way round.
    #[error(
        "the mesh has a part with one side only (at triangle {triangle}), so nothing is outside of it; right would be the surface of a solid"
    )]
    OneSided {
        /// A triangle where the contradiction shows, from 0.
        triangle: usize,
    },
    /// Open, and its triangles do not agree.
    #[error(
        "the mesh is open and {:.0} % of the area of a part (at triangle {triangle}) is wound against the rest, so which side is outside cannot be told; right would be corners counter-clockwise seen from outside, or a closed solid", 100.0 * share
    )]
    Mixed {
        /// A triangle of the part, from 0.
        triangle: usize,
        /// Share of the smaller half.
        share: f64,
    },
    /// More solids and cavities than are told apart.
    #[error(
        "the mesh has {parts} closed parts; which of them are cavities of others is told of at most {MOST_PARTS}: remove those that do not belong to the die"
    )]
    Parts {
        /// How many.
        parts: usize,
    },
}

impl std::fmt::Display for Orientation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        if self.repeated > 0 {
            let and = if self.turned == 0 && self.open_edges == 0 && self.unsigned.is_none() {
                ""
            } else {
                "; "
            };
            write!(
                f,
                "{} triangles repeat others and are dropped{and}",
                self.repeated
            )?;
        }
        if let Some(why) = &self.unsigned {
            return write!(f, "{why}: distances are without sign");
        }
        if self.turned > 0 {
            let (turned, all) = (self.turned, self.triangles);
            write!(
                f,
                "{turned} of {all} triangles were wound the wrong way round and have been turned"
            )?;
        }
        if self.open_edges > 0 {
            let and = if self.turned > 0 { "; " } else { "" };
            write!(
                f,
                "{and}the mesh is not closed ({} edges without exactly two triangles): that its corners run counter-clockwise seen from outside is taken from the file",
                self.open_edges
            )?;
        }
        Ok(())
    }
}

impl Orientation {
    /// Whether the mesh was closed and wound correctly.
    pub fn is_plain(&self) -> bool {
        self.repeated + self.turned + self.open_edges == 0 && self.unsigned.is_none()
    }
}

/// A connected part.
#[derive(Clone)]
struct MeshPart {
    /// A triangle of it.
    first: usize,
    /// Six times its volume when oriented as its first triangle, mm³.
    volume6_mm3: f64,
    /// Area that is wound as its first triangle, and that is wound the other way, mm².
    area_mm2: [f64; 2],
    bounds: Aabb,
    is_closed: bool,
    one_sided: Option<usize>,
}

/// Puts the corners of all triangles counter-clockwise seen from outside the material, after dropping those that repeat others.
/// A mesh that is unsigned stays as it is otherwise.
///
/// The mesh must hold its invariants ([`TriMesh::check`]).
pub fn orient(mesh: &mut TriMesh) -> Orientation {
    let (_, joined) = weld(&mesh.vertices);
    let repeated = drop_repeated(mesh, &joined);
    let ids: Vec<[u32; 3]> = mesh
        .triangles
        .iter()
        .map(|corners| corners.map(|i| joined[i as usize]))
        .collect();
    let mut parities = Parities::new(ids.len());
    let (mut open, mut open_edges) = (Vec::new(), 0);
    let mut one_sided = Vec::new();
    for edge in edges(&ids).chunk_by(|a, b| a.ends == b.ends) {
        let [a, b] = edge else {
            open.extend(edge.iter().map(|side| side.triangle as usize));
            open_edges += 1;
            continue;
        };
        // Along a shared edge neighbours run in opposite directions.
        let turned = a.forward == b.forward;
        if !parities.join(a.triangle as usize, b.triangle as usize, turned) {
            one_sided.push(a.triangle as usize);
        }
    }
    let of: Vec<(usize, bool)> = (0..ids.len()).map(|i| parities.root(i)).collect();
    let mut parts = parts(mesh, &of);
    for &triangle in &open {
        if let Some(part) = &mut parts[of[triangle].0] {
            part.is_closed = false;
        }
    }
    for &triangle in &one_sided {
        if let Some(part) = &mut parts[of[triangle].0] {
            part.one_sided.get_or_insert(triangle);
        }
    }
    let mut found = Orientation {
        triangles: ids.len(),
        repeated,
        turned: 0,
        open_edges,
        unsigned: None,
    };
    let solids = match solids(mesh, &of, &parts) {
        Ok(solids) => solids,
        Err(why) => {
            found.unsigned = Some(why);
            return found;
        }
    };
    let mut turn = vec![false; ids.len()];
    for (root, part) in parts.iter().enumerate() {
        let Some(part) = part else { continue };
        match choice(mesh, &solids, root, part) {
            Ok(turned) => turn[root] = turned,
            Err(why) => {
                found.unsigned.get_or_insert(why);
            }
        }
    }
    if found.unsigned.is_some() {
        return found;
    }
    for (triangle, (root, against)) in mesh.triangles.iter_mut().zip(&of) {
        if turn[*root] != *against {
            triangle.swap(1, 2);
            found.turned += 1;
        }
    }
    found
}

/// Drops triangles between the same three positions as an earlier one, whichever way they are wound; returns how many.
fn drop_repeated(mesh: &mut TriMesh, joined: &[u32]) -> usize {
    let mut keys: Vec<([u32; 3], u32)> = mesh
        .triangles
        .par_iter()
        .zip(0..mesh.triangles.len() as u32)
        .map(|(corners, index)| {
            let mut key = corners.map(|i| joined[i as usize]);
            key.sort_unstable();
            (key, index)
        })
        .collect();
    keys.par_sort_unstable();
    let mut repeats = vec![false; keys.len()];
    for same in keys.chunk_by(|a, b| a.0 == b.0) {
        for (_, index) in &same[1..] {
            repeats[*index as usize] = true;
        }
    }
    let before = mesh.triangles.len();
    let mut repeat = repeats.into_iter();
    mesh.triangles.retain(|_| repeat.next() == Some(false));
    before - mesh.triangles.len()
}

/// Whether the part must be turned against how its root's triangle is wound.
fn choice(
    mesh: &TriMesh,
    solids: &[Solid],
    root: usize,
    part: &MeshPart,
) -> Result<bool, Unsigned> {
    if let Some(triangle) = part.one_sided {
        return Err(Unsigned::OneSided { triangle });
    }
    let [with, against] = part.area_mm2;
    if part.is_solid() {
        let [a, b, c] = mesh.corners(part.first);
        let inside: [f64; 3] = std::array::from_fn(|k| (a[k] + b[k] + c[k]) / 3.0);
        let holders = solids.iter().filter(|solid| solid.root != root);
        let is_cavity = holders.filter(|solid| solid.holds(inside)).count() % 2 == 1;
        return Ok((part.volume6_mm3 < 0.0) != is_cavity);
    }
    let share = with.min(against) / (with + against);
    if share > MOST_MIXED {
        return Err(Unsigned::Mixed {
            triangle: part.first,
            share,
        });
    }
    Ok(against > with)
}

impl MeshPart {
    fn is_solid(&self) -> bool {
        let volume_mm3 = self.volume6_mm3 / 6.0;
        // A sphere of area A holds A^1.5 / (6 sqrt(pi)).
        let area_mm2: f64 = self.area_mm2.iter().sum();
        let sphere_mm3 = area_mm2.powf(1.5) / (6.0 * std::f64::consts::PI.sqrt());
        self.is_closed && volume_mm3.abs() > LEAST_VOLUME * sphere_mm3
    }
}

/// A closed part that may hold others.
struct Solid {
    root: usize,
    bounds: Aabb,
    /// Its own triangles, wound alike; made when somebody asks for the first time.
    surface: OnceLock<Option<Surface>>,
    triangles: TriMesh,
    /// Whether they are wound clockwise seen from outside.
    inside_out: bool,
}

impl Solid {
    fn holds(&self, point: [f64; 3]) -> bool {
        let Aabb { low, high } = self.bounds;
        if !(0..3).all(|k| low[k] <= point[k] && point[k] <= high[k]) {
            return false;
        }
        let surface = self
            .surface
            .get_or_init(|| Surface::new(&self.triangles).ok());
        surface.as_ref().is_some_and(|surface| {
            (surface.closest(point).signed_distance_mm < 0.0) != self.inside_out
        })
    }
}

/// All parts that have an inside, if there are two: one alone holds none.
fn solids(
    mesh: &TriMesh,
    of: &[(usize, bool)],
    parts: &[Option<MeshPart>],
) -> Result<Vec<Solid>, Unsigned> {
    let mut solids = Vec::new();
    let mut place = vec![usize::MAX; parts.len()];
    for (root, part) in parts.iter().enumerate() {
        if let Some(part) = part.as_ref().filter(|part| part.is_solid()) {
            place[root] = solids.len();
            solids.push(Solid {
                root,
                bounds: part.bounds,
                surface: OnceLock::new(),
                triangles: TriMesh {
                    vertices: Vec::new(),
                    triangles: Vec::new(),
                },
                inside_out: part.volume6_mm3 < 0.0,
            });
        }
    }
    if solids.len() < 2 {
        return Ok(Vec::new());
    }
    if solids.len() > MOST_PARTS {
        return Err(Unsigned::Parts {
            parts: solids.len(),
        });
    }
    for (index, &(root, against)) in of.iter().enumerate() {
        if let Some(solid) = solids.get_mut(place[root]) {
            let TriMesh {
                vertices,
                triangles,
            } = &mut solid.triangles;
            let first = vertices.len() as u32;
            vertices.extend(mesh.corners(index));
            let mut own = [first, first + 1, first + 2];
            if against {
                own.swap(1, 2);
            }
            triangles.push(own);
        }
    }
    Ok(solids)
}

/// The parts, each at the number of its root.
fn parts(mesh: &TriMesh, of: &[(usize, bool)]) -> Vec<Option<MeshPart>> {
    let mut parts: Vec<Option<MeshPart>> = vec![None; of.len()];
    // Volumes are summed about a corner of the mesh, so that far from the origin no digits are lost.
    let origin = Vector3::from(mesh.corners(0)[0]);
    for (index, &(root, against)) in of.iter().enumerate() {
        let corners = mesh.corners(index);
        let [a, b, c] = corners.map(|corner| Vector3::from(corner) - origin);
        let area_mm2 = 0.5 * (b - a).cross(&(c - a)).norm();
        let volume6_mm3 = a.dot(&b.cross(&c));
        let own = Aabb::around(&corners);
        let part = parts[root].get_or_insert(MeshPart {
            first: index,
            volume6_mm3: 0.0,
            area_mm2: [0.0; 2],
            bounds: own,
            is_closed: true,
            one_sided: None,
        });
        part.bounds = Aabb::around(&[part.bounds.low, part.bounds.high, own.low, own.high]);
        part.volume6_mm3 += if against { -volume6_mm3 } else { volume6_mm3 };
        part.area_mm2[usize::from(against)] += area_mm2;
    }
    parts
}

/// A side of a triangle: its two corners in the order of their numbers, and whether the triangle runs from first to second.
struct Edge {
    ends: (u32, u32),
    triangle: u32,
    forward: bool,
}

/// The sides of all triangles that do not name a position twice, those of one edge beside each other.
fn edges(ids: &[[u32; 3]]) -> Vec<Edge> {
    let mut edges: Vec<Edge> = Vec::with_capacity(3 * ids.len());
    for (triangle, &[a, b, c]) in ids.iter().enumerate() {
        if a == b || b == c || c == a {
            continue;
        }
        edges.extend([(a, b), (b, c), (c, a)].map(|(from, to)| Edge {
            ends: (from.min(to), from.max(to)),
            triangle: triangle as u32,
            forward: from < to,
        }));
    }
    edges.par_sort_unstable_by_key(|edge| (edge.ends, edge.triangle));
    edges
}

/// Disjoint sets whose members know whether they are wound as their set's root.
struct Parities {
    parent: Vec<u32>,
    against_parent: Vec<bool>,
}

impl Parities {
    fn new(count: usize) -> Self {
        Self {
            parent: (0..count as u32).collect(),
            against_parent: vec![false; count],
        }
    }

    /// Root of a member's set, and whether the member is wound against it.
    fn root(&mut self, member: usize) -> (usize, bool) {
        let (mut root, mut against) = (member, false);
        while self.parent[root] as usize != root {
            against ^= self.against_parent[root];
            root = self.parent[root] as usize;
        }
        // Everything on the way then hangs at the root.
        let (mut at, mut left) = (member, against);
        while self.parent[at] as usize != root && at != root {
            let next = self.parent[at] as usize;
            let own = self.against_parent[at];
            self.parent[at] = root as u32;
            self.against_parent[at] = left;
            left ^= own;
            at = next;
        }
        (root, against)
    }

    /// Joins the sets of two members, of which one is wound against the other or not; false if that contradicts what is known.
    fn join(&mut self, a: usize, b: usize, against: bool) -> bool {
        let ((root_a, a_against), (root_b, b_against)) = (self.root(a), self.root(b));
        let between = a_against ^ b_against ^ against;
        if root_a == root_b {
            return !between;
        }
        // The smaller number stays root: the first triangle of a part.
        let (root, child) = (root_a.min(root_b), root_a.max(root_b));
        self.parent[child] = root as u32;
        self.against_parent[child] = between;
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::Surface;

    /// A cube of side `2 r` about `centre`, corners counter-clockwise seen from outside.
    fn cube(centre: [f64; 3], r: f64) -> TriMesh {
        let corner = |i: usize| -> [f64; 3] {
            std::array::from_fn(|k| centre[k] + if i >> k & 1 == 1 { r } else { -r })
        };
        let quads = [
            [0, 2, 3, 1],
            [4, 5, 7, 6],
            [0, 1, 5, 4],
            [2, 6, 7, 3],
            [0, 4, 6, 2],
            [1, 3, 7, 5],
        ];
        TriMesh {
            vertices: (0..8).map(corner).collect(),
            triangles: quads
                .iter()
                .flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]])
                .collect(),
        }
    }

    fn joined(meshes: &[TriMesh]) -> TriMesh {
        let mut all = TriMesh {
            vertices: Vec::new(),
            triangles: Vec::new(),
        };
        for mesh in meshes {
            let first = all.vertices.len() as u32;
            all.vertices.extend(&mesh.vertices);
            let moved = mesh.triangles.iter().map(|t| t.map(|i| i + first));
            all.triangles.extend(moved);
        }
        all
    }

    fn flip(mesh: &mut TriMesh, which: impl Fn(usize) -> bool) -> usize {
        let mut count = 0;
        for (index, triangle) in mesh.triangles.iter_mut().enumerate() {
            if which(index) {
                triangle.swap(0, 1);
                count += 1;
            }
        }
        count
    }

    fn distance(mesh: &TriMesh, at: [f64; 3]) -> f64 {
        Surface::new(mesh).unwrap().closest(at).signed_distance_mm
    }

    #[test]
    fn a_solid_is_put_right_however_its_triangles_are_wound() {
        // Far from the origin, where volumes about it would cancel.
        let right = cube([5000.0, -3000.0, 100.0], 1.0);
        for pattern in 0..1 << 12 {
            let mut mesh = right.clone();
            let wrong = flip(&mut mesh, |i| pattern >> i & 1 == 1);
            let found = orient(&mut mesh);
            assert_eq!((found.turned, found.unsigned), (wrong, None), "{pattern:b}");
            assert_eq!(found.is_plain(), wrong == 0);
        }
        let mut inverted = right.clone();
        flip(&mut inverted, |_| true);
        let outside = [5000.0, -3000.0, 101.5];
        assert!(
            (distance(&inverted, outside) + 0.5).abs() < 1e-12,
            "as read"
        );
        orient(&mut inverted);
        assert!((distance(&inverted, outside) - 0.5).abs() < 1e-12);
    }

    #[test]
    fn corners_that_are_not_shared_in_the_file_are_neighbours_all_the_same() {
        let mut mesh = cube([0.0; 3], 1.0);
        let soup: Vec<[f64; 3]> = (0..12).flat_map(|i| mesh.corners(i)).collect();
        mesh.triangles = (0..12).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        mesh.vertices = soup;
        flip(&mut mesh, |i| i % 3 == 0);
        let found = orient(&mut mesh);
        assert_eq!((found.turned, found.open_edges), (4, 0));
        assert!(distance(&mesh, [0.0, 0.0, 1.5]) > 0.0);
    }

    #[test]
    fn the_shell_of_a_cavity_points_into_it_and_a_solid_within_out_of_itself() {
        // From outside in: solid, cavity, solid; and a solid beside them.
        let shells = [(0.0, 4.0), (0.0, 2.0), (0.0, 1.0), (20.0, 1.0)];
        for pattern in 0..1 << 4 {
            let meshes: Vec<TriMesh> = shells
                .iter()
                .enumerate()
                .map(|(i, &(x, r))| {
                    let mut mesh = cube([x, 0.0, 0.0], r);
                    flip(&mut mesh, |_| pattern >> i & 1 == 1);
                    mesh
                })
                .collect();
            let mut mesh = joined(&meshes);
            assert_eq!(orient(&mut mesh).unsigned, None);
            for (x, sign) in [
                (4.5, 1.0),
                (3.5, -1.0),
                (1.6, 1.0),
                (0.8, -1.0),
                (20.5, -1.0),
            ] {
                assert!(
                    distance(&mesh, [x, 0.0, 0.0]) * sign > 0.0,
                    "{pattern:b} {x}"
                );
            }
        }
    }

    #[test]
    fn an_open_mesh_keeps_the_order_of_its_file_and_says_so() {
        let tube = || {
            let mut mesh = cube([0.0; 3], 1.0);
            mesh.triangles.drain(..4); // without floor and lid
            mesh
        };
        for inverted in [false, true] {
            let mut mesh = tube();
            flip(&mut mesh, |_| inverted);
            let found = orient(&mut mesh);
            assert_eq!(
                (found.turned, found.unsigned, found.open_edges),
                (0, None, 8)
            );
            // A bore's wall points to its axis: an inverted tube is as good.
            assert_eq!(distance(&mesh, [0.9, 0.0, 0.0]) > 0.0, inverted);
            assert!(found.to_string().contains("not closed (8 edges"), "{found}");
        }
    }

    /// A strip of squares, of which one triangle is wound against the rest.
    #[test]
    fn a_few_wrong_triangles_of_an_open_mesh_are_turned_and_many_refused() {
        let strip = |count: u32| TriMesh {
            vertices: (0..=count)
                .flat_map(|i| [[f64::from(i), 0.0, 0.0], [f64::from(i), 1.0, 0.0]])
                .collect(),
            triangles: (0..count)
                .flat_map(|i| {
                    [
                        [2 * i, 2 * i + 2, 2 * i + 1],
                        [2 * i + 2, 2 * i + 3, 2 * i + 1],
                    ]
                })
                .collect(),
        };
        let mut mesh = strip(10);
        flip(&mut mesh, |i| i == 7);
        assert_eq!(orient(&mut mesh).turned, 1);
        assert!(distance(&mesh, [3.6, 0.5, 0.2]) > 0.0);
        let mut mesh = strip(10);
        flip(&mut mesh, |i| i % 4 == 0);
        let as_read = mesh.clone();
        let found = orient(&mut mesh);
        assert!(
            matches!(found.unsigned, Some(Unsigned::Mixed { share, .. }) if (share - 0.25).abs() < 1e-12),
            "{found:?}"
        );
        assert_eq!(mesh, as_read, "what cannot be told stays as it is");
    }

    #[test]
    fn triangles_that_repeat_are_dropped() {
        let mut again = cube([0.0; 3], 1.0);
        flip(&mut again, |i| i % 2 == 0);
        let mut mesh = joined(&[cube([0.0; 3], 1.0), again]);
        let found = orient(&mut mesh);
        assert_eq!(
            (
                found.triangles,
                found.repeated,
                found.open_edges,
                found.unsigned
            ),
            (12, 12, 0, None)
        );
        assert!(!found.is_plain());
        assert!(
            found.to_string().contains("12 triangles repeat others"),
            "{found}"
        );
        assert!(distance(&mesh, [0.0, 0.0, 1.5]) > 0.0);
    }

    /// Meshes that others send and that once took cubic time. n log n orients them in a second; the square of the number of triangles
    /// would take minutes, and the cube would never end.
    #[test]
    fn no_mesh_takes_more_than_its_share() {
        let repeated = |count: usize| joined(&vec![cube([0.0; 3], 1.0); count / 12]);
        // Triangles about one edge, of which none is closed and all boxes hold the middle.
        let fan = |count: usize| TriMesh {
            vertices: [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]
                .into_iter()
                .chain((0..count).map(|i| {
                    let (s, c) = (i as f64).sin_cos();
                    [s * (1.0 + i as f64), c * (1.0 + i as f64), 0.0]
                }))
                .collect(),
            triangles: (0..count as u32).map(|i| [0, 1, i + 2]).collect(),
        };
        // A casting full of pores.
        let pores = |count: usize| {
            let mut all = vec![cube([0.0; 3], 100.0)];
            let along =
                |i: usize| [(i % 40) as f64, (i / 40) as f64, 0.0].map(|at| 2.0 * at - 50.0);
            all.extend((0..count / 12).map(|i| cube(along(i), 0.5)));
            joined(&all)
        };
        let all = [repeated(480_000), fan(480_000), pores(60_000)];
        for mut mesh in all {
            let given = mesh.triangles.len();
            orient(&mut mesh);
            assert!(!mesh.triangles.is_empty() && mesh.triangles.len() <= given);
        }
        let many = orient(&mut pores(12 * 2500));
        assert_eq!(many.unsigned, Some(Unsigned::Parts { parts: 2501 }));
        assert!(
            !orient(&mut pores(12 * 50)).is_plain(),
            "pores were wound as solids"
        );
    }

    #[test]
    fn a_strip_with_a_half_turn_has_no_outside() {
        const COUNT: u32 = 12;
        let at = |i: u32, side: f64| -> [f64; 3] {
            let turn = f64::from(i) / f64::from(COUNT) * std::f64::consts::TAU;
            let (s, c) = (0.5 * turn).sin_cos();
            let radius = 5.0 + side * c;
            [radius * turn.cos(), radius * turn.sin(), side * s]
        };
        let vertices: Vec<[f64; 3]> = (0..COUNT).flat_map(|i| [at(i, -1.0), at(i, 1.0)]).collect();
        let triangles = (0..COUNT).flat_map(|i| {
            // The last square joins its ends crosswise.
            let [a, b] = [2 * i, 2 * i + 1];
            let [c, d] = if i + 1 < COUNT {
                [a + 2, b + 2]
            } else {
                [1, 0]
            };
            [[a, c, b], [c, d, b]]
        });
        let mut mesh = TriMesh {
            vertices,
            triangles: triangles.collect(),
        };
        let found = orient(&mut mesh);
        assert!(
            matches!(found.unsigned, Some(Unsigned::OneSided { .. })),
            "{found:?}"
        );
    }
}
