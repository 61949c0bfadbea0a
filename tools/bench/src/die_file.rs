//! Reads a die from a mesh file; invalid files are refused before memory is allocated.

use std::io::Read;
use std::path::{Path, PathBuf};

use crate::files::mesh::{self, MeshFileError};
use crate::world::{DieMesh, MAX_DIE_TRIANGLES, WorldError};

/// Largest file, bytes: text STL takes about 300 bytes per triangle.
const MAX_FILE_BYTES: u64 = 4 << 30;
/// Plausible diagonals of a die or a part of one, mm.
const DIAGONAL_MM: std::ops::RangeInclusive<f64> = 1.0..=10_000.0;
/// Largest PLY header that is searched, bytes.
const HEADER_BYTES: u64 = 1 << 16;

/// Why a file is not a die.
#[derive(Debug, thiserror::Error)]
pub enum DieFileError {
    /// The file cannot be read.
    #[error("cannot read the mesh of the die {}: {cause}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        cause: std::io::Error,
    },
    /// The path is a folder, a device or a pipe.
    #[error("the mesh of the die {} is no ordinary file; a PLY or STL file is needed", path.display())]
    NoFile {
        /// The file.
        path: PathBuf,
    },
    /// The file is larger than any mesh with the allowed number of triangles.
    #[error(
        "the mesh of the die {} has {got_bytes} bytes; at most {max_bytes} are possible", path.display()
    )]
    TooLong {
        /// The file.
        path: PathBuf,
        /// Its length.
        got_bytes: u64,
        /// Largest.
        max_bytes: u64,
    },
    /// The mesh has too many triangles.
    #[error(
        "the mesh of the die {} has {got} triangles; at most {max} are possible", path.display()
    )]
    Triangles {
        /// The file.
        path: PathBuf,
        /// Number of triangles by the header.
        got: u64,
        /// Largest number.
        max: usize,
    },
    /// The mesh is too small or too large for a die, if its unit is millimetres.
    #[error(
        "the mesh of the die {} is {diagonal_mm} mm from corner to corner when read in millimetres, which no die is; write it in millimetres", path.display()
    )]
    Size {
        /// The file.
        path: PathBuf,
        /// Diagonal of its bounding box, mm.
        diagonal_mm: f64,
    },
    /// The file is damaged, or not a mesh.
    #[error("the mesh of the die {}: {cause}", path.display())]
    Mesh {
        /// The file.
        path: PathBuf,
        cause: MeshFileError,
    },
    /// The mesh cannot be used on the bench.
    #[error("the mesh of the die {}: {cause}", path.display())]
    World {
        /// The file.
        path: PathBuf,
        cause: WorldError,
    },
}

/// Reads PLY (text, both byte orders) or STL (text, binary), in millimetres and in the frame of the CAD.
///
/// # Errors
/// [`DieFileError`] names the file, the error and the expected value.
pub fn load(path: &Path) -> Result<DieMesh, DieFileError> {
    let path = path.to_path_buf();
    match promised_triangles(&path)? {
        Some(got) if got > MAX_DIE_TRIANGLES as u64 => Err(DieFileError::Triangles {
            path,
            got,
            max: MAX_DIE_TRIANGLES,
        }),
        _ => {
            let mesh = match mesh::load(&path, 1.0) {
                Ok(mesh) => mesh,
                Err(MeshFileError::Read(cause)) => return Err(DieFileError::Read { path, cause }),
                Err(cause) => return Err(DieFileError::Mesh { path, cause }),
            };
            let diagonal_mm = diagonal_mm(&mesh.vertices);
            // An overflowed diagonal is infinite, so it is refused here too.
            if !DIAGONAL_MM.contains(&diagonal_mm) {
                return Err(DieFileError::Size { path, diagonal_mm });
            }
            DieMesh::new(mesh).map_err(|cause| DieFileError::World { path, cause })
        }
    }
}

/// Diagonal of the bounding box.
fn diagonal_mm(vertices: &[[f64; 3]]) -> f64 {
    let sides = [0, 1, 2].map(|axis| {
        let along = vertices.iter().map(|vertex| vertex[axis]);
        along.clone().fold(f64::NEG_INFINITY, f64::max) - along.fold(f64::INFINITY, f64::min)
    });
    sides.iter().map(|side| side * side).sum::<f64>().sqrt()
}

/// Number of triangles (PLY faces) by the file's header, if it has one; refuses a file that is too large.
fn promised_triangles(path: &Path) -> Result<Option<u64>, DieFileError> {
    let unreadable = |cause| DieFileError::Read {
        path: path.to_path_buf(),
        cause,
    };
    // Tested before opening, because opening a pipe waits for its writer.
    let about = std::fs::metadata(path).map_err(unreadable)?;
    if !about.is_file() {
        return Err(DieFileError::NoFile {
            path: path.to_path_buf(),
        });
    }
    if about.len() > MAX_FILE_BYTES {
        return Err(DieFileError::TooLong {
            path: path.to_path_buf(),
            got_bytes: about.len(),
            max_bytes: MAX_FILE_BYTES,
        });
    }
    let mut head = Vec::new();
    crate::files::regular(path)
        .and_then(std::fs::File::open)
        .and_then(|file| file.take(HEADER_BYTES).read_to_end(&mut head))
        .map_err(unreadable)?;
    if head.starts_with(b"ply") {
        return Ok(faces_of_ply(&head));
    }
    let binary = head
        .get(80..84)
        .map(|count| u64::from(u32::from_le_bytes([count[0], count[1], count[2], count[3]])));
    Ok(binary.filter(|triangles| about.len() == 84 + 50 * triangles))
}

fn faces_of_ply(head: &[u8]) -> Option<u64> {
    head.split(|&byte| byte == b'\n')
        .map(|line| String::from_utf8_lossy(line))
        .take_while(|line| line.trim() != "end_header")
        .find_map(|line| {
            line.trim()
                .strip_prefix("element face ")?
                .trim()
                .parse()
                .ok()
        })
}
