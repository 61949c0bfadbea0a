//! A die given as a mesh of its own, from any source.

use super::WorldError;
use super::die::check_mesh;
use flankscope_gear_cad::Mesh;
use nalgebra::Vector3;
use rayon::prelude::*;

/// Largest number of triangles of a die.
pub const MAX_DIE_TRIANGLES: usize = 5_000_000;
/// Smallest height of a triangle over its longest side, mm: below it, its normal is undefined, and no ray hits it.
const LEAST_HEIGHT_MM: f64 = 1e-9;

/// A mesh used instead of the worn CAD: any triangulation, open or closed, in either orientation.
#[derive(Clone, Debug, PartialEq)]
pub struct DieMesh {
    mesh: Mesh,
    closed: bool,
    degenerate: usize,
}

impl DieMesh {
    /// Checks a mesh in millimetres in the tool frame, and removes its degenerate triangles.
    ///
    /// # Errors
    /// No triangle has area, there are too many triangles, a vertex is not finite or too far away, or an index is out of range.
    pub fn new(mut mesh: Mesh) -> Result<Self, WorldError> {
        let triangles = mesh.triangles.len();
        if triangles > MAX_DIE_TRIANGLES {
            return Err(WorldError::Triangles {
                got: triangles,
                max: MAX_DIE_TRIANGLES,
            });
        }
        check_mesh(&mesh)?;
        let Mesh {
            vertices,
            triangles: all,
        } = &mut mesh;
        all.retain(|t| has_area(t.map(|v| vertices[v as usize])));
        if mesh.triangles.is_empty() {
            return Err(WorldError::NoArea { triangles });
        }
        Ok(Self {
            closed: is_closed(&mesh),
            degenerate: triangles - mesh.triangles.len(),
            mesh,
        })
    }

    /// The surface, mm.
    pub fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// Whether it has a defined inside: every edge belongs to an even number of triangles.
    pub fn is_closed(&self) -> bool {
        self.closed
    }

    /// Number of removed triangles without area.
    pub fn degenerate(&self) -> usize {
        self.degenerate
    }
}

fn has_area([a, b, c]: [[f64; 3]; 3]) -> bool {
    let [a, b, c] = [a, b, c].map(Vector3::from);
    let longest_mm = (b - a).norm().max((c - b).norm()).max((a - c).norm());
    (b - a).cross(&(c - a)).norm() > LEAST_HEIGHT_MM * longest_mm
}

fn is_closed(mesh: &Mesh) -> bool {
    let edge = |a: u32, b: u32| (u64::from(a.min(b)) << 32) | u64::from(a.max(b));
    let mut edges: Vec<u64> = mesh
        .triangles
        .par_iter()
        .flat_map_iter(|&[a, b, c]| [edge(a, b), edge(b, c), edge(c, a)])
        .collect();
    edges.par_sort_unstable();
    edges
        .chunk_by(|p, q| p == q)
        .all(|same| same.len().is_multiple_of(2))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tetrahedron() -> Mesh {
        Mesh {
            vertices: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            triangles: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]],
        }
    }

    #[test]
    fn open_and_closed_are_told_apart_whatever_the_winding() {
        let closed = |mesh: Mesh| DieMesh::new(mesh).map(|die| die.is_closed());
        assert_eq!(closed(tetrahedron()), Ok(true));
        let mut twisted = tetrahedron();
        twisted.triangles[2].swap(0, 1);
        assert_eq!(closed(twisted), Ok(true));
        let mut open = tetrahedron();
        open.triangles.pop();
        assert_eq!(closed(open), Ok(false));
    }

    #[test]
    fn triangles_without_area_are_left_out_and_counted() {
        let mut mesh = tetrahedron();
        // A point, a segment, and a sliver a tenth of LEAST_HEIGHT_MM high.
        mesh.vertices.extend([[0.5, 1e-10, 0.0]; 1]);
        mesh.triangles.extend([[1, 1, 1], [0, 1, 0], [0, 1, 4]]);
        let die = DieMesh::new(mesh).expect("four triangles have area");
        assert_eq!((die.degenerate(), die.mesh().triangles.len()), (3, 4));
        let mut flat = tetrahedron();
        flat.vertices = vec![[1.0, 2.0, 3.0]; 4];
        assert_eq!(DieMesh::new(flat), Err(WorldError::NoArea { triangles: 4 }));
    }

    #[test]
    fn what_no_mesh_may_be_is_named() {
        let mut mesh = tetrahedron();
        mesh.vertices[2][1] = f64::NAN;
        assert!(matches!(
            DieMesh::new(mesh),
            Err(WorldError::Vertex { vertex: 2, .. })
        ));
        let mut mesh = tetrahedron();
        mesh.triangles[1][2] = 4;
        assert!(matches!(
            DieMesh::new(mesh),
            Err(WorldError::Index {
                triangle: 1,
                got: 4,
                vertices: 4
            })
        ));
        let many = Mesh {
            triangles: vec![[0, 1, 2]; MAX_DIE_TRIANGLES + 1],
            ..tetrahedron()
        };
        assert_eq!(
            DieMesh::new(many),
            Err(WorldError::Triangles {
                got: MAX_DIE_TRIANGLES + 1,
                max: MAX_DIE_TRIANGLES
            })
        );
    }
}
