//! Orientation of a mesh: which side of its triangles is outside.
//!
//! The formats say that corners run counter-clockwise seen from outside; many files do not keep to it. Triangles that share an
//! edge must run along it in opposite directions, which orients every connected part up to one choice. Of a closed part the
//! choice follows from its volume, and from how many other closed parts hold all of it: a cavity's shell points inwards, a body
//! that sticks out of another one or touches its surface is a body. Where bodies of the mesh cross one another it is an assembly,
//! and what lies wholly in one of them may be a body or a cavity: its order in the file decides. Of an open part it cannot be known: the file's own order
//! stands, that of most of the part's area where it is mixed.

mod repeated;
mod rim;
#[cfg(test)]
mod tests;
mod winding;

use std::collections::HashMap;
use std::sync::OnceLock;

use nalgebra::Vector3;

use crate::io::mesh::{TriMesh, weld};
use crate::space::Aabb;
use crate::surface::Surface;
use repeated::drop_repeated;
pub use rim::Rim;
use winding::{Parities, edges, mates};

/// A part of an open mesh whose smaller half is more than this share of its area has no order that could stand.
const MOST_MIXED: f64 = 0.1;
/// A closed part of less volume than this share of that of a sphere of its area is a sheet folded on itself: it has no inside.
const LEAST_VOLUME: f64 = 1e-6;
/// A part is wholly inside another if none of its triangles comes nearer to the other's surface than this share of its own size.
const LEAST_WALL: f64 = 1e-4;
/// Places at which a part is compared with another one before it counts as touching it.
const MOST_PLACES: usize = 200_000;
/// Which of the closed parts lie within which is asked for each two of them, so there is a limit to their number.
const MOST_PARTS: usize = 2000;

/// Result of [`orient`].
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Orientation {
    /// Triangles in all, without those that repeat another one.
    pub triangles: usize,
    /// Triangles of the same three corners as another one, which are dropped.
    pub repeated: usize,
    /// Triangles whose corners were put in the other order.
    pub turned: usize,
    /// Edges that do not lie between two triangles: where the mesh is open, or more than two meet. None of a solid.
    pub open_edges: usize,
    /// The edges of one triangle only.
    #[serde(skip)]
    pub rim: Rim,
    /// Reason for which distances to the mesh have no sign; none when they have one.
    #[serde(skip)]
    pub unsigned: Option<Unsigned>,
    /// Triangles of each closed part, where there is nothing else and some may overlap, touch or hold one another: then the nearest
    /// triangle alone does not tell inside from outside.
    #[serde(skip)]
    pub bodies: Vec<Vec<u32>>,
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
    let (places, joined) = weld(&mesh.vertices);
    let repeated = drop_repeated(mesh, &joined);
    let ids: Vec<[u32; 3]> = mesh
        .triangles
        .iter()
        .map(|corners| corners.map(|i| joined[i as usize]))
        .collect();
    let mut parities = Parities::new(ids.len());
    let (mut open, mut open_edges, mut rim) = (Vec::new(), 0, Rim::default());
    let mut one_sided = Vec::new();
    for edge in edges(&ids).chunk_by(|a, b| a.ends == b.ends) {
        if let Some(mates) = mates(edge, &ids, &places) {
            for [a, b] in mates {
                // Wound alike, by the order in which they were paired.
                let _always_agrees = parities.join(a as usize, b as usize, false);
            }
            continue;
        }
        let [a, b] = edge else {
            open.extend(edge.iter().map(|side| side.triangle as usize));
            open_edges += 1;
            if let [only] = edge {
                let (a, b) = only.ends;
                rim.edges_mm
                    .push([a, b].map(|corner| places[corner as usize]));
            }
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
        rim,
        unsigned: None,
        bodies: Vec::new(),
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
        match choice(&solids, root, part) {
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
    found.bodies = bodies(&solids, &of, &parts);
    found
}

/// Triangles of each solid, if boxes of two of them meet and there is nothing but solids.
fn bodies(solids: &[Solid], of: &[(usize, bool)], parts: &[Option<MeshPart>]) -> Vec<Vec<u32>> {
    let meets = |a: &Aabb, b: &Aabb| (0..3).all(|k| a.low[k] <= b.high[k] && b.low[k] <= a.high[k]);
    let is_beside = |(number, solid): (usize, &Solid)| {
        let mut others = solids[number + 1..].iter();
        others.any(|other| meets(&solid.bounds, &other.bounds))
    };
    if !solids.iter().enumerate().any(is_beside) {
        return Vec::new();
    }
    let places = solids.iter().map(|solid| solid.root).zip(0..);
    let places: HashMap<usize, usize> = places.collect();
    let mut bodies = vec![Vec::new(); solids.len()];
    for (triangle, (root, _)) in (0..).zip(of) {
        match places.get(root) {
            Some(&body) => bodies[body].push(triangle),
            // A triangle without area belongs to no solid.
            None if parts[*root]
                .as_ref()
                .is_some_and(|part| part.area_mm2 == [0.0; 2]) => {}
            None => return Vec::new(),
        }
    }
    bodies
}

/// Whether the part must be turned against how its root's triangle is wound.
fn choice(solids: &[Solid], root: usize, part: &MeshPart) -> Result<bool, Unsigned> {
    if let Some(triangle) = part.one_sided {
        return Err(Unsigned::OneSided { triangle });
    }
    let [with, against] = part.area_mm2;
    if part.is_solid() {
        let own = solids.iter().find(|solid| solid.root == root);
        let holders = solids.iter().filter(|solid| solid.root != root);
        let holders = holders.filter(|solid| own.is_some_and(|own| solid.holds(own)));
        let holders: Vec<&Solid> = holders.collect();
        let is_assembly = || solids.iter().any(|solid| solid.is_crossed(solids));
        let is_cavity = if !holders.is_empty() && is_assembly() {
            (part.volume6_mm3 < 0.0) != (against > with)
        } else {
            holders.len() % 2 == 1
        };
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
    is_crossed: OnceLock<bool>,
}

impl Solid {
    /// Depth of a place below its surface, mm; negative outside.
    fn depth_mm(&self, at: [f64; 3]) -> f64 {
        let surface = self
            .surface
            .get_or_init(|| Surface::new(&self.triangles).ok());
        let signed_mm = surface.as_ref().map_or(f64::INFINITY, |surface| {
            surface.closest(at).signed_distance_mm
        });
        if self.inside_out {
            signed_mm
        } else {
            -signed_mm
        }
    }

    /// Whether corners of another part lie on both sides of its surface, or its own on both sides of another part's.
    fn is_crossed(&self, solids: &[Self]) -> bool {
        let reaches_into = |part: &Self, other: &Self| {
            let corners = || part.triangles.vertices.iter();
            let Aabb { low, high } = other.bounds;
            let may_be_in = |at: &&[f64; 3]| (0..3).all(|k| low[k] < at[k] && at[k] < high[k]);
            let mut inside = corners().filter(may_be_in);
            inside.any(|&at| other.depth_mm(at) > 0.0)
                && corners().any(|&at| other.depth_mm(at) < 0.0)
        };
        *self.is_crossed.get_or_init(|| {
            let mut others = solids.iter().filter(|other| other.root != self.root);
            others.any(|other| reaches_into(other, self) || reaches_into(self, other))
        })
    }

    /// Whether all of another part is inside this one, and does not touch its surface.
    fn holds(&self, part: &Self) -> bool {
        let (own, other) = (self.bounds, part.bounds);
        if !(0..3).all(|k| own.low[k] <= other.low[k] && other.high[k] <= own.high[k]) {
            return false;
        }
        let depth_mm = |at: [f64; 3]| self.depth_mm(at);
        if part
            .triangles
            .vertices
            .iter()
            .any(|&corner| depth_mm(corner) <= 0.0)
        {
            return false;
        }
        let size_mm = (Vector3::from(other.high) - Vector3::from(other.low)).norm();
        let triangles = 0..part.triangles.triangles.len();
        let mut left: Vec<[Vector3<f64>; 3]> = triangles
            .map(|index| part.triangles.corners(index).map(Vector3::from))
            .collect();
        let mut places = 0;
        // A place so deep that the whole triangle about it is inside; else the triangle's four quarters are asked.
        while let Some(corners) = left.pop() {
            let [a, b, c] = corners;
            let middle = (a + b + c) / 3.0;
            let radius_mm = corners
                .map(|corner| (corner - middle).norm())
                .into_iter()
                .fold(0.0, f64::max);
            let depth_mm = depth_mm(middle.into());
            if depth_mm > radius_mm {
                continue;
            }
            places += 1;
            if depth_mm <= 0.0 || radius_mm < LEAST_WALL * size_mm || places > MOST_PLACES {
                return false;
            }
            let [ab, bc, ca] = [(a + b) / 2.0, (b + c) / 2.0, (c + a) / 2.0];
            left.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
        }
        true
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
                is_crossed: OnceLock::new(),
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
