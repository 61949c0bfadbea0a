//! Wavefront OBJ: `v` and `f` lines; everything else (normals, groups, materials) is skipped.

use std::borrow::Cow;

use super::{MeshError, TriMesh, polygon};
use crate::io::faces::Faces;

/// Whether the first lines of a file hold OBJ statements.
pub(super) fn looks_like(bytes: &[u8]) -> bool {
    let head = &bytes[..bytes.len().min(1 << 16)];
    !head.contains(&0)
        && head.split(|&b| b == b'\n').any(|line| {
            let line = line.trim_ascii_start();
            line.starts_with(b"v ") || line.starts_with(b"f ")
        })
}

/// Lines with their number, from 1. A line that ends in a backslash goes on in the next one.
fn statements(bytes: &[u8]) -> impl Iterator<Item = (usize, Cow<'_, str>)> {
    let mut lines = (1..).zip(bytes.split(|&b| b == b'\n'));
    std::iter::from_fn(move || {
        let (number, line) = lines.next()?;
        let mut text = String::from_utf8_lossy(line);
        while let Some(start) = text.trim_ascii_end().strip_suffix('\\') {
            let next = lines.next().map_or(&[][..], |(_, line)| line);
            text = Cow::Owned(format!("{start} {}", String::from_utf8_lossy(next)));
        }
        Some((number, text))
    })
}

pub(super) fn parse(bytes: &[u8]) -> Result<TriMesh, MeshError> {
    let mut vertices: Vec<[f64; 3]> = Vec::new();
    let mut faces = Faces::default();
    let mut corners = Vec::new();
    for (number, text) in statements(bytes) {
        let refuse = |expected| MeshError::Line {
            line: number,
            text: text.trim().chars().take(40).collect(),
            expected,
        };
        let mut words = text.split_ascii_whitespace();
        match words.next() {
            Some("v") => {
                let mut vertex = [0.0; 3];
                for value in &mut vertex {
                    *value = words
                        .next()
                        .and_then(crate::io::word::number)
                        .filter(|value: &f64| value.is_finite())
                        .ok_or_else(|| refuse("`v x y z` with three finite numbers"))?;
                }
                vertices.push(vertex);
            }
            Some("f") => {
                corners.clear();
                for word in words {
                    // `f v/vt/vn`: only the first number matters here; negative ones count back from the last vertex.
                    let index: i64 = word
                        .split('/')
                        .next()
                        .and_then(|first| first.parse().ok())
                        .ok_or_else(|| refuse("`f` with at least three vertex numbers"))?;
                    let have = vertices.len() as i64;
                    let zero_based = if index < 0 { have + index } else { index - 1 };
                    // A face may name a vertex that follows later, so the upper end is checked with the whole mesh.
                    let Some(corner) = u32::try_from(zero_based).ok().filter(|&i| i < u32::MAX)
                    else {
                        return Err(MeshError::IndexOutOfRange {
                            triangle: faces.len(),
                            index,
                            vertices: vertices.len(),
                        });
                    };
                    corners.push(corner);
                }
                if corners.len() < 3 {
                    return Err(refuse("`f` with at least three vertex numbers"));
                }
                faces.push(&corners);
            }
            _ => {}
        }
    }
    Ok(TriMesh {
        triangles: polygon::into_triangles(faces, &vertices)?,
        vertices,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statements_go_on_after_a_backslash() {
        let plain = "v 0 0 0\nv 10 0 0\nv 0 10 0\nv 10 10 0\nf 1 2 4 3\n";
        let continued = "v 0 0 \\\n0\nv 10 \\\r\n 0 \\\r\n0\nv 0 10 0\nv 10 10 0\nf 1 2 \\ \n4 3\n";
        let expected = parse(plain.as_bytes()).unwrap();
        assert_eq!(parse(continued.as_bytes()).unwrap(), expected);
        // An error names the first line of its statement; a backslash at the end of the file ends there.
        let wrong = "v 0 0 0\nv 1 \\\n 2 \\\n";
        assert!(matches!(
            parse(wrong.as_bytes()),
            Err(MeshError::Line { line: 2, .. })
        ));
    }
}
