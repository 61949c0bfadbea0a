//! Triangle meshes from CAD: the type, its border checks and the loaders for PLY, STL and OBJ.

mod error;
mod foreign;
mod obj;
mod polygon;
pub(in crate::io) mod stl;
pub(in crate::io) mod stl_irregular;
mod weld;

use std::path::Path;

use flankscope_foundation::files::{MOST_DATA_BYTES, read_regular};

pub use error::MeshError;
pub use stl::write_stl;
pub use stl_irregular::StlIrregularity;
pub use weld::weld;

use crate::io::{Unit, ply, word};
use crate::space::unit_normal;

/// Smallest bounding box diagonal that a die or a feature of one can have, mm.
const LEAST_DIAGONAL_MM: f64 = 1.0;
/// Largest bounding box diagonal, mm.
const MOST_DIAGONAL_MM: f64 = 10_000.0;

/// A triangle mesh in millimetres: finite vertices, indices in range, counter-clockwise seen from outside the material.
#[derive(Debug, Clone, PartialEq)]
pub struct TriMesh {
    /// Corner positions, mm.
    pub vertices: Vec<[f64; 3]>,
    /// Corner indices.
    pub triangles: Vec<[u32; 3]>,
}

impl TriMesh {
    /// Checks the invariants that a file or a caller may break.
    ///
    /// # Errors
    /// [`MeshError`] for no triangles, a non-finite vertex or an index out of range.
    pub fn check(&self) -> Result<(), MeshError> {
        if self.triangles.is_empty() {
            return Err(MeshError::Empty {
                vertices: self.vertices.len(),
            });
        }
        for (vertex, position) in self.vertices.iter().enumerate() {
            if let Some(axis) = position.iter().position(|c| !c.is_finite()) {
                return Err(MeshError::NonFinite {
                    vertex,
                    axis: ['x', 'y', 'z'][axis],
                    value: position[axis],
                });
            }
        }
        let vertices = self.vertices.len();
        for (triangle, corners) in self.triangles.iter().enumerate() {
            if let Some(&index) = corners.iter().find(|&&i| i as usize >= vertices) {
                return Err(MeshError::IndexOutOfRange {
                    triangle,
                    index: i64::from(index),
                    vertices,
                });
            }
        }
        Ok(())
    }

    /// Winds all triangles the other way round.
    pub fn turn_inside_out(&mut self) {
        for triangle in &mut self.triangles {
            triangle.swap(1, 2);
        }
    }

    /// Smallest and largest coordinates over the vertices, mm.
    pub fn bounds(&self) -> ([f64; 3], [f64; 3]) {
        let mut low = [f64::INFINITY; 3];
        let mut high = [f64::NEG_INFINITY; 3];
        for vertex in &self.vertices {
            for k in 0..3 {
                low[k] = low[k].min(vertex[k]);
                high[k] = high[k].max(vertex[k]);
            }
        }
        (low, high)
    }

    /// Positions of the corners of triangle `index`.
    #[inline]
    pub fn corners(&self, index: usize) -> [[f64; 3]; 3] {
        // Spelled out: `map` would be called, not inlined.
        let [a, b, c] = self.triangles[index];
        [
            self.vertices[a as usize],
            self.vertices[b as usize],
            self.vertices[c as usize],
        ]
    }

    fn in_unit(mut self, unit: Unit) -> Result<Self, MeshError> {
        if unit != Unit::Mm {
            let scale = unit.mm();
            for vertex in &mut self.vertices {
                *vertex = vertex.map(|c| c * scale);
            }
        }
        self.check()?;
        let (low, high) = self.bounds();
        let diagonal_mm = (0..3)
            .map(|k| (high[k] - low[k]).powi(2))
            .sum::<f64>()
            .sqrt();
        if diagonal_mm < LEAST_DIAGONAL_MM {
            return Err(MeshError::TooSmall {
                diagonal_mm,
                least_mm: LEAST_DIAGONAL_MM,
                unit,
            });
        }
        // An overflowed diagonal is infinite, so it is refused here too.
        if diagonal_mm > MOST_DIAGONAL_MM {
            return Err(MeshError::TooLarge {
                diagonal_mm,
                most_mm: MOST_DIAGONAL_MM,
                unit,
            });
        }
        let triangles = self.triangles.len();
        if (0..triangles).all(|index| unit_normal(self.corners(index)).is_none()) {
            return Err(MeshError::NoArea { triangles });
        }
        Ok(self)
    }
}

/// Loads a mesh file; the format is told by content, not by name.
///
/// # Errors
/// [`MeshError`] names what is wrong and what would be right. Nothing is allocated for a count that the file cannot hold.
pub fn load(path: &Path, unit: Unit) -> Result<TriMesh, MeshError> {
    let bytes = read_regular(path, MOST_DATA_BYTES).map_err(MeshError::Read)?;
    parse(&bytes, unit)
}

/// Loads a mesh file as [`load`] does, and a binary STL with spare bytes or a wrong count, too, which is told.
///
/// # Errors
/// As [`load`].
pub fn load_tolerant(
    path: &Path,
    unit: Unit,
) -> Result<(TriMesh, Option<StlIrregularity>), MeshError> {
    let bytes = read_regular(path, MOST_DATA_BYTES).map_err(MeshError::Read)?;
    parse_tolerant(&bytes, unit)
}

/// As [`load`], from memory.
///
/// # Errors
/// As [`load`].
pub fn parse(bytes: &[u8], unit: Unit) -> Result<TriMesh, MeshError> {
    match parse_tolerant(bytes, unit)? {
        (mesh, None) => Ok(mesh),
        (_, Some(irregularity)) => Err(MeshError::StlIrregular { irregularity }),
    }
}

/// Parses a mesh in memory, as [`load_tolerant`].
///
/// # Errors
/// As [`load`].
pub fn parse_tolerant(
    bytes: &[u8],
    unit: Unit,
) -> Result<(TriMesh, Option<StlIrregularity>), MeshError> {
    if bytes.is_empty() {
        return Err(MeshError::EmptyFile);
    }
    let bytes = word::without_mark(bytes);
    let mut irregularity = None;
    let mesh = if bytes.starts_with(b"ply") {
        let table = ply::read(bytes, ply::Want::Faces)?;
        TriMesh {
            triangles: polygon::into_triangles(table.faces, &table.points)?,
            vertices: table.points,
        }
    } else if stl::is_binary(bytes) {
        stl::parse_binary(bytes)?
    } else if stl::is_text(bytes) {
        stl::parse_ascii(bytes)?
    } else if let Some(stl) = stl_irregular::read(bytes) {
        irregularity = Some(stl.irregularity);
        stl::parse_records(&stl.records)?
    } else if obj::looks_like(bytes) {
        obj::parse(bytes)?
    } else {
        return Err(foreign::explain(bytes));
    };
    Ok((mesh.in_unit(unit)?, irregularity))
}
