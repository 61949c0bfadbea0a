//! STL, binary and text. STL has no shared vertices: corners with equal coordinates are joined.

use std::io::{self, Write};

use rayon::prelude::*;

use super::{MeshError, TriMesh, weld};

const HEADER_BYTES: usize = 84;
const RECORD_BYTES: usize = 50;

fn declared(bytes: &[u8]) -> Option<u32> {
    let count = bytes.get(80..HEADER_BYTES)?;
    Some(u32::from_le_bytes([count[0], count[1], count[2], count[3]]))
}

fn size_of(triangles: u32) -> u64 {
    HEADER_BYTES as u64 + RECORD_BYTES as u64 * u64::from(triangles)
}

/// A binary STL is known by its size alone: many start with `solid` too.
pub(super) fn is_binary(bytes: &[u8]) -> bool {
    declared(bytes).is_some_and(|count| size_of(count) == bytes.len() as u64)
}

/// Reads a file for which [`is_binary`] holds.
pub(super) fn parse_binary(bytes: &[u8]) -> Result<TriMesh, MeshError> {
    let corners: Vec<[[f64; 3]; 3]> = bytes[HEADER_BYTES..]
        .par_chunks_exact(RECORD_BYTES)
        .with_min_len(1 << 13)
        .map(|record| {
            // Twelve bytes of facet normal come first; the corners' order decides, not the stored normal.
            let number = |i: usize| {
                let o = 12 + 4 * i;
                f64::from(f32::from_le_bytes([
                    record[o],
                    record[o + 1],
                    record[o + 2],
                    record[o + 3],
                ]))
            };
            std::array::from_fn(|c| std::array::from_fn(|k| number(3 * c + k)))
        })
        .collect();
    join(corners)
}

fn join(corners: Vec<[[f64; 3]; 3]>) -> Result<TriMesh, MeshError> {
    let (vertices, indices) = weld(corners.as_flattened());
    let triangles = indices.as_chunks::<3>().0.to_vec();
    Ok(TriMesh {
        vertices,
        triangles,
    })
}

/// Text STL starts with `solid`, in letters of any size.
pub(super) fn is_text(bytes: &[u8]) -> bool {
    let start = bytes.trim_ascii_start();
    start.len() >= 5 && start[..5].eq_ignore_ascii_case(b"solid")
}

/// Reads text STL.
pub(super) fn parse_ascii(bytes: &[u8]) -> Result<TriMesh, MeshError> {
    let mut corners = Vec::new();
    let mut loop_corners: Vec<[f64; 3]> = Vec::new();
    let mut closed = false;
    let mut line = 0;
    for raw in bytes.split(|&b| b == b'\n') {
        line += 1;
        let text = String::from_utf8_lossy(raw);
        let refuse = |expected| MeshError::Line {
            line,
            text: text.trim().chars().take(40).collect(),
            expected,
        };
        let mut words = text.split_ascii_whitespace();
        match words.next().map(str::to_ascii_lowercase).as_deref() {
            None | Some("solid" | "facet" | "outer" | "endfacet") => {}
            Some("vertex") => {
                let mut corner = [0.0f64; 3];
                for value in &mut corner {
                    *value = words
                        .next()
                        .and_then(|word| word.parse().ok())
                        .ok_or_else(|| refuse("`vertex x y z` with three numbers"))?;
                }
                if corner.iter().any(|value| !value.is_finite()) {
                    return Err(refuse("`vertex x y z` with three finite numbers"));
                }
                loop_corners.push(corner);
            }
            Some("endloop") => {
                let [a, b, c] = loop_corners[..] else {
                    return Err(refuse("exactly three `vertex` lines before `endloop`"));
                };
                corners.push([a, b, c]);
                loop_corners.clear();
            }
            Some("endsolid") => closed = true,
            Some(_) => {
                return Err(refuse(
                    "a line of text STL (facet, outer loop, vertex, ...)",
                ));
            }
        }
    }
    if !closed {
        return Err(MeshError::StlOpen { line });
    }
    join(corners)
}

/// The size that a file would have that starts like a binary STL; none of one that does not. A truncated one still has a
/// printable or zero header; an image or an archive does not.
pub(super) fn declared_size(bytes: &[u8]) -> Option<(u32, u64)> {
    let is_plain = |b: &u8| *b == 0 || b.is_ascii_graphic() || b.is_ascii_whitespace();
    let count = declared(bytes)?;
    bytes[..80]
        .iter()
        .all(is_plain)
        .then(|| (count, size_of(count)))
}

/// Writes binary STL. Coordinates become f32: at 100 mm that rounds to 4 nm.
///
/// # Errors
/// Those of `out`; `InvalidInput` for more than 2^32 - 1 triangles.
pub fn write_stl(out: &mut dyn Write, mesh: &TriMesh) -> io::Result<()> {
    let count = u32::try_from(mesh.triangles.len())
        .map_err(|_| io::Error::new(io::ErrorKind::InvalidInput, "too many triangles for STL"))?;
    let mut header = [0u8; 80];
    let title = b"flankscope, millimetres";
    header[..title.len()].copy_from_slice(title);
    out.write_all(&header)?;
    out.write_all(&count.to_le_bytes())?;
    for index in 0..mesh.triangles.len() {
        let corners = mesh.corners(index);
        let normal = crate::space::unit_normal(corners).unwrap_or([0.0; 3]);
        let mut record = [0u8; RECORD_BYTES];
        for (i, value) in normal.iter().chain(corners.as_flattened()).enumerate() {
            record[4 * i..4 * i + 4].copy_from_slice(&(*value as f32).to_le_bytes());
        }
        out.write_all(&record)?;
    }
    Ok(())
}
