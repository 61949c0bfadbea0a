//! Binary STL.

use crate::solid::Mesh;
use std::io::{self, Write};

/// Writes `mesh` as binary STL: single precision and no shared vertices, as the format has it.
///
/// `title` fills the 80-byte header, cut if longer. More than 2^32 - 1 triangles are an [`io::ErrorKind::InvalidInput`].
pub fn write_stl(mesh: &Mesh, title: &str, mut out: impl Write) -> io::Result<()> {
    let count = u32::try_from(mesh.triangles.len()).map_err(|_| {
        io::Error::new(
            io::ErrorKind::InvalidInput,
            format!(
                "{} triangles; STL counts to {}",
                mesh.triangles.len(),
                u32::MAX
            ),
        )
    })?;
    let mut header = [b' '; 80];
    let length = title.len().min(header.len());
    header[..length].copy_from_slice(&title.as_bytes()[..length]);
    if header.starts_with(b"solid") {
        // Readers take a file that starts with "solid" for the text variant.
        header[0] = b'S';
    }
    out.write_all(&header)?;
    out.write_all(&count.to_le_bytes())?;
    for triangle in &mesh.triangles {
        let corners = triangle.map(|i| mesh.vertices[i as usize]);
        let mut record = [0u8; 50];
        let rows = [unit_normal(corners), corners[0], corners[1], corners[2]];
        for (bytes, value) in record.chunks_exact_mut(4).zip(rows.iter().flatten()) {
            bytes.copy_from_slice(&(*value as f32).to_le_bytes());
        }
        out.write_all(&record)?;
    }
    out.flush()
}

/// Unit normal of a triangle; zero for one without area, as STL readers expect.
fn unit_normal([a, b, c]: [[f64; 3]; 3]) -> [f64; 3] {
    let u = [b[0] - a[0], b[1] - a[1], b[2] - a[2]];
    let v = [c[0] - a[0], c[1] - a[1], c[2] - a[2]];
    let n = [
        u[1] * v[2] - u[2] * v[1],
        u[2] * v[0] - u[0] * v[2],
        u[0] * v[1] - u[1] * v[0],
    ];
    let length = n.iter().map(|x| x * x).sum::<f64>().sqrt();
    if length > 0.0 {
        n.map(|x| x / length)
    } else {
        [0.0; 3]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_triangle_byte_by_byte() {
        let mesh = Mesh {
            vertices: vec![[0.0; 3], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]],
            triangles: vec![[0, 1, 2]],
        };
        let mut bytes = Vec::new();
        write_stl(&mesh, "solid", &mut bytes).expect("a Vec takes every byte");
        assert_eq!(bytes.len(), 84 + 50);
        assert_eq!(&bytes[..6], b"Solid ");
        assert_eq!(bytes[80..84], [1, 0, 0, 0]);
        assert_eq!(bytes[92..96], 1f32.to_le_bytes(), "normal is +z");
        assert_eq!(bytes[108..112], 2f32.to_le_bytes(), "second corner, x");
        assert_eq!(bytes[132..], [0, 0]);
    }
}
