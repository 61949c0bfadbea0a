//! Binary little-endian PLY.

use crate::solid::Mesh;
use std::io::{self, Write};

/// Writes `mesh` as binary little-endian PLY with double-precision vertices and triangles as `vertex_indices` lists.
///
/// Wrap a file in a `BufWriter`: each vertex and triangle is one small write.
pub fn write_ply(mesh: &Mesh, mut out: impl Write) -> io::Result<()> {
    write!(
        out,
        "ply\nformat binary_little_endian 1.0\ncomment millimetres, axis z\n\
         element vertex {}\nproperty double x\nproperty double y\nproperty double z\n\
         element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        mesh.vertices.len(),
        mesh.triangles.len()
    )?;
    for vertex in &mesh.vertices {
        let mut record = [0u8; 24];
        for (bytes, value) in record.chunks_exact_mut(8).zip(vertex) {
            bytes.copy_from_slice(&value.to_le_bytes());
        }
        out.write_all(&record)?;
    }
    for triangle in &mesh.triangles {
        let mut record = [3u8; 13];
        for (bytes, index) in record[1..].chunks_exact_mut(4).zip(triangle) {
            bytes.copy_from_slice(&index.to_le_bytes());
        }
        out.write_all(&record)?;
    }
    out.flush()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_triangle_byte_by_byte() {
        let mesh = Mesh {
            vertices: vec![[1.0, 2.0, 3.0], [0.5, 0.0, 0.0], [0.0, -1.0, 0.0]],
            triangles: vec![[0, 2, 1]],
        };
        let mut bytes = Vec::new();
        write_ply(&mesh, &mut bytes).expect("a Vec takes every byte");
        let header_end = b"end_header\n";
        let at = bytes
            .windows(header_end.len())
            .position(|w| w == header_end)
            .expect("header ends")
            + header_end.len();
        let header = std::str::from_utf8(&bytes[..at]).expect("ASCII header");
        assert!(header.contains("element vertex 3\n") && header.contains("element face 1\n"));
        let body = &bytes[at..];
        assert_eq!(body.len(), 3 * 24 + 13);
        assert_eq!(body[..8], 1f64.to_le_bytes());
        assert_eq!(body[56..64], (-1f64).to_le_bytes());
        assert_eq!(body[72..], [3, 0, 0, 0, 0, 2, 0, 0, 0, 1, 0, 0, 0]);
    }
}
