//! Orientation of a mesh: which side of its triangles is outside.
//!
//! The formats say that corners run counter-clockwise seen from outside; many files do not keep to it. Triangles that share an
//! edge must run along it in opposite directions, which orients every connected part up to one choice. Of a closed part the
//! choice follows from its volume, and from how many other closed parts hold it (a cavity's shell points inwards). Of an open
//! part it cannot be known: the file's own order stands, that of most of the part's area where it is mixed.

mod repeated;
mod rim;
#[cfg(test)]
mod tests;
mod winding;

use std::sync::OnceLock;

use nalgebra::Vector3;

use crate::io::mesh::{TriMesh, weld};
use crate::space::Aabb;
use crate::surface::Surface;
use repeated::drop_repeated;
pub use rim::Rim;
use winding::{Parities, edges};

/// A part of an open mesh whose smaller half is more than this share of its area has no order that could stand.
const MOST_MIXED: f64 = 0.1;
/// A closed part of less volume than this share of that of a sphere of its area is a sheet folded on itself: it has no inside.
const LEAST_VOLUME: f64 = 1e-6;
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
