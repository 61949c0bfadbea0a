//! Text STL and OBJ.

use flankscope_gear_cad::Mesh;

use super::{MeshFileError, fan, joined};

/// An error that quotes a line.
fn refused(line: usize, text: &str, expected: &'static str) -> MeshFileError {
    MeshFileError::Line {
        line,
        text: text.trim().chars().take(40).collect(),
        expected,
    }
}

fn lines(bytes: &[u8]) -> impl Iterator<Item = (usize, std::borrow::Cow<'_, str>)> {
    let lines = bytes.split(|&byte| byte == b'\n');
    (1..).zip(lines.map(String::from_utf8_lossy))
}

/// Three numbers, or `None`.
fn point<'a>(words: &mut impl Iterator<Item = &'a str>) -> Option<[f64; 3]> {
    let mut point = [0.0; 3];
    for value in &mut point {
        *value = words.next()?.parse().ok()?;
    }
    Some(point)
}

pub(super) fn stl(bytes: &[u8]) -> Result<Mesh, MeshFileError> {
    let (mut facets, mut corners, mut closed, mut last) = (Vec::new(), Vec::new(), false, 0);
    for (line, text) in lines(bytes) {
        last = line;
        let mut words = text.split_ascii_whitespace();
        match words.next() {
            None | Some("solid" | "facet" | "outer" | "endfacet") => {}
            Some("vertex") => {
                let corner = point(&mut words);
                corners
                    .push(corner.ok_or_else(|| {
                        refused(line, &text, "`vertex x y z` with three numbers")
                    })?);
            }
            Some("endloop") => {
                let Ok(facet) = corners.as_slice().try_into() else {
                    return Err(refused(
                        line,
                        &text,
                        "exactly three `vertex` lines before `endloop`",
                    ));
                };
                facets.push(facet);
                corners.clear();
            }
            Some("endsolid") => closed = true,
            Some(_) => return Err(refused(line, &text, "a line of text STL")),
        }
    }
    if !closed {
        return Err(MeshFileError::StlOpen { line: last });
    }
    Ok(joined(facets.into_iter()))
}

/// Whether the first lines are OBJ statements.
pub(super) fn looks_like_obj(bytes: &[u8]) -> bool {
    let head = &bytes[..bytes.len().min(1 << 16)];
    !head.contains(&0)
        && head.split(|&byte| byte == b'\n').any(|line| {
            let line = line.trim_ascii_start();
            line.starts_with(b"v ") || line.starts_with(b"f ")
        })
}

/// Reads `v` and `f` lines; all others (normals, groups, materials) do not affect the surface.
pub(super) fn obj(bytes: &[u8]) -> Result<Mesh, MeshFileError> {
    const FACE: &str = "`f` with at least three vertex numbers";
    let mut mesh = Mesh {
        vertices: Vec::new(),
        triangles: Vec::new(),
    };
    let (mut polygon, mut faces) = (Vec::new(), 0);
    for (line, text) in lines(bytes) {
        let mut words = text.split_ascii_whitespace();
        match words.next() {
            Some("v") => mesh.vertices.push(
                point(&mut words)
                    .ok_or_else(|| refused(line, &text, "`v x y z` with three numbers"))?,
            ),
            Some("f") => {
                polygon.clear();
                for word in words {
                    // `f v/vt/vn` counts from 1, or with negative numbers back from the last vertex.
                    let number = word.split('/').next().and_then(|n| n.parse::<i64>().ok());
                    let number = number.ok_or_else(|| refused(line, &text, FACE))?;
                    let have = mesh.vertices.len();
                    let from_zero = match number {
                        ..0 => (have as i64).checked_add(number),
                        _ => number.checked_sub(1),
                    };
                    let index = from_zero.and_then(|n| u32::try_from(n).ok());
                    polygon.push(index.ok_or(MeshFileError::Index {
                        face: faces,
                        index: number as f64,
                        vertices: have,
                    })?);
                }
                if polygon.len() < 3 {
                    return Err(refused(line, &text, FACE));
                }
                fan(&polygon, &mut mesh.triangles);
                faces += 1;
            }
            _ => {}
        }
    }
    Ok(mesh)
}
