//! Meshes from PLY, STL and OBJ files; the format is detected from the content. No memory is allocated for counts that exceed the file.

mod ply;
mod text;

use std::collections::HashMap;
use std::path::Path;

use flankscope_gear_cad::Mesh;

use super::regular;

/// Bytes before the first triangle of a binary STL, and bytes per triangle.
const STL_HEADER: usize = 84;
const STL_RECORD: usize = 50;

/// Why a file is not a mesh.
#[derive(Debug, thiserror::Error)]
pub enum MeshFileError {
    /// The file cannot be read.
    #[error(transparent)]
    Read(std::io::Error),
    #[error("the file is empty; a mesh is PLY, STL or OBJ")]
    Empty,
    /// The file has none of the formats.
    #[error(
        "not a mesh: neither PLY (starts with `ply`), STL (starts with `solid`, or 84 + 50 n bytes) nor OBJ (`v` and `f` lines)"
    )]
    Foreign,
    /// A line does not follow its format.
    #[error("line {line}: {text:?} not understood; right would be {expected}")]
    Line {
        /// Number, from 1.
        line: usize,
        /// The line, shortened.
        text: String,
        /// Expected content.
        expected: &'static str,
    },
    /// A PLY header lacks an element that a mesh needs.
    #[error("the PLY header has no {missing}")]
    Lacks {
        /// What is missing.
        missing: &'static str,
    },
    /// A PLY body is shorter than its header states.
    #[error(
        "the PLY header promises {count} of element {element}, at least {need_bytes} bytes, but {have_bytes} bytes are left for it"
    )]
    Short {
        element: String,
        count: u64,
        /// Smallest size for this count.
        need_bytes: u64,
        /// Actual size.
        have_bytes: u64,
    },
    /// The body ends within an element, or has a word that is not a number.
    #[error(
        "element {element} number {index} of the PLY body is no row of numbers, or the file ends there"
    )]
    Row {
        element: String,
        /// Index, from 0.
        index: u64,
    },
    /// A face has fewer than three corners.
    #[error("face {face} has {corners} corners; at least 3 are needed")]
    Corners {
        /// Face, from 0.
        face: u64,
        /// Number of corners.
        corners: f64,
    },
    /// A face refers to a vertex that does not exist.
    #[error("face {face} names vertex {index}, but there are vertices 0..{vertices}")]
    Index {
        /// Face or triangle, from 0.
        face: u64,
        index: f64,
        /// Number of vertices.
        vertices: usize,
    },
    /// A vertex is NaN or infinite.
    #[error("vertex {vertex}: coordinate {axis} is {value}; every coordinate must be finite")]
    NotFinite {
        /// Vertex, from 0.
        vertex: usize,
        /// `x`, `y` or `z`.
        axis: char,
        value: f64,
    },
    /// The length of a binary STL does not fit its count.
    #[error(
        "binary STL declares {declared} triangles, which are {need_bytes} bytes, but the file has {have_bytes}; it is truncated, padded or not STL"
    )]
    StlSize {
        declared: u32,
        /// Size for this count.
        need_bytes: u64,
        /// Actual size.
        have_bytes: u64,
    },
    /// A text STL ends without `endsolid`.
    #[error("the STL text ends at line {line} before `endsolid`; the file is truncated")]
    StlOpen {
        /// Number of the last line.
        line: usize,
    },
    #[error("the mesh has {vertices} vertices but no triangles")]
    NoTriangles { vertices: usize },
}

/// Reads a mesh whose unit is `unit_mm` millimetres.
pub fn load(path: &Path, unit_mm: f64) -> Result<Mesh, MeshFileError> {
    let bytes = regular(path)
        .and_then(std::fs::read)
        .map_err(MeshFileError::Read)?;
    let mut mesh = parse(&bytes)?;
    if unit_mm != 1.0 {
        for vertex in &mut mesh.vertices {
            *vertex = vertex.map(|x| x * unit_mm);
        }
    }
    Ok(mesh)
}

fn parse(bytes: &[u8]) -> Result<Mesh, MeshFileError> {
    if bytes.is_empty() {
        return Err(MeshFileError::Empty);
    }
    let declared = bytes
        .get(80..STL_HEADER)
        .map(|n| u32::from_le_bytes([n[0], n[1], n[2], n[3]]));
    let stl_bytes = |count: u32| STL_HEADER as u64 + STL_RECORD as u64 * u64::from(count);
    let mesh = if bytes.starts_with(b"ply") {
        ply::parse(bytes)?
    } else if declared.is_some_and(|count| stl_bytes(count) == bytes.len() as u64) {
        // By the size alone, because many binary files start with `solid` too.
        binary_stl(bytes)
    } else if bytes.trim_ascii_start().starts_with(b"solid") {
        text::stl(bytes)?
    } else if text::looks_like_obj(bytes) {
        text::obj(bytes)?
    } else {
        // A truncated binary STL still has a readable or empty title; a picture or an archive does not.
        let readable = |b: &u8| *b == 0 || b.is_ascii_graphic() || b.is_ascii_whitespace();
        return Err(match declared {
            Some(declared) if bytes[..80].iter().all(readable) => MeshFileError::StlSize {
                declared,
                need_bytes: stl_bytes(declared),
                have_bytes: bytes.len() as u64,
            },
            _ => MeshFileError::Foreign,
        });
    };
    check(mesh)
}

/// Checks that vertices are finite, triangles exist, and all vertex indices are valid.
fn check(mesh: Mesh) -> Result<Mesh, MeshFileError> {
    let vertices = mesh.vertices.len();
    if mesh.triangles.is_empty() {
        return Err(MeshFileError::NoTriangles { vertices });
    }
    for (vertex, position) in mesh.vertices.iter().enumerate() {
        for (axis, &value) in ['x', 'y', 'z'].into_iter().zip(position) {
            if !value.is_finite() {
                return Err(MeshFileError::NotFinite {
                    vertex,
                    axis,
                    value,
                });
            }
        }
    }
    for (face, corners) in (0..).zip(&mesh.triangles) {
        if let Some(&index) = corners.iter().find(|&&index| index as usize >= vertices) {
            return Err(MeshFileError::Index {
                face,
                index: f64::from(index),
                vertices,
            });
        }
    }
    Ok(mesh)
}

/// Reads a file whose length fits its count exactly.
fn binary_stl(bytes: &[u8]) -> Mesh {
    let records = bytes[STL_HEADER..].chunks_exact(STL_RECORD);
    joined(records.map(|record| {
        // The facet's normal is skipped, because the order of the corners defines it.
        let mut numbers = record[12..48]
            .as_chunks::<4>()
            .0
            .iter()
            .map(|&number| f64::from(f32::from_le_bytes(number)));
        std::array::from_fn(|_| std::array::from_fn(|_| numbers.next().unwrap_or_default()))
    }))
}

/// Triangles from the positions of their corners; equal positions become one vertex, numbered by first use, with −0 equal to 0.
fn joined(facets: impl Iterator<Item = [[f64; 3]; 3]>) -> Mesh {
    let mut numbers: HashMap<[u64; 3], u32> = HashMap::new();
    let mut mesh = Mesh {
        vertices: Vec::new(),
        triangles: Vec::with_capacity(facets.size_hint().0),
    };
    for facet in facets {
        mesh.triangles.push(facet.map(|corner| {
            let corner = corner.map(|x| x + 0.0);
            *numbers.entry(corner.map(f64::to_bits)).or_insert_with(|| {
                mesh.vertices.push(corner);
                mesh.vertices.len() as u32 - 1
            })
        }));
    }
    mesh
}

/// Splits a face into a fan about its first corner.
fn fan(polygon: &[u32], triangles: &mut Vec<[u32; 3]>) {
    if let Some((&first, rest)) = polygon.split_first() {
        triangles.extend(rest.windows(2).map(|pair| [first, pair[0], pair[1]]));
    }
}
