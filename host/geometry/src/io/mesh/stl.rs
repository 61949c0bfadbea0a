//! STL, binary and text. STL has no shared vertices: corners with equal coordinates are joined.

use std::io::{self, Write};

use rayon::prelude::*;

use super::{MeshError, TriMesh, weld};

pub(super) const HEADER_BYTES: usize = 84;
pub(super) const RECORD_BYTES: usize = 50;

pub(super) fn declared(bytes: &[u8]) -> Option<u32> {
    let count = bytes.get(80..HEADER_BYTES)?;
    Some(u32::from_le_bytes([count[0], count[1], count[2], count[3]]))
}

fn size_of(triangles: u32) -> u64 {
    HEADER_BYTES as u64 + RECORD_BYTES as u64 * u64::from(triangles)
}

/// A binary STL is known by its size alone: many start with `solid` too.
pub(in crate::io) fn is_binary(bytes: &[u8]) -> bool {
    declared(bytes).is_some_and(|count| size_of(count) == bytes.len() as u64)
}

/// Reads a file for which [`is_binary`] holds.
pub(super) fn parse_binary(bytes: &[u8]) -> Result<TriMesh, MeshError> {
    let records = bytes[HEADER_BYTES..].par_chunks_exact(RECORD_BYTES);
    join(records.with_min_len(1 << 13).map(facet).collect())
}

/// Joins the facets of some records.
pub(super) fn parse_records(records: &[&[u8]]) -> Result<TriMesh, MeshError> {
    join(records.iter().map(|record| facet(record)).collect())
}

/// Corners of a record.
fn facet(record: &[u8]) -> [[f64; 3]; 3] {
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
}

fn join(corners: Vec<[[f64; 3]; 3]>) -> Result<TriMesh, MeshError> {
    let (vertices, indices) = weld(corners.as_flattened());
    let triangles = indices.as_chunks::<3>().0.to_vec();
    Ok(TriMesh {
        vertices,
        triangles,
    })
}

/// Bytes in which a text STL shows its first facet or its end.
const TEXT_START_BYTES: usize = 1 << 10;

/// Text STL starts with `solid`, in letters of any size, and holds no zero bytes at its start. Many binary files start with
/// `solid` too.
pub(super) fn is_text(bytes: &[u8]) -> bool {
    let start = bytes.trim_ascii_start();
    let start = &start[..start.len().min(TEXT_START_BYTES)];
    start.len() >= 5 && start[..5].eq_ignore_ascii_case(b"solid") && !start.contains(&0)
}

/// Words of a text with their line. Lines end in LF, CR LF or CR.
struct Words<'a> {
    rest: &'a [u8],
    line: usize,
}

impl<'a> Words<'a> {
    fn next(&mut self) -> Option<&'a [u8]> {
        let mut start = 0;
        while let Some(byte) = self
            .rest
            .get(start)
            .filter(|byte| byte.is_ascii_whitespace())
        {
            let ends_line = match byte {
                b'\n' => true,
                b'\r' => self.rest.get(start + 1) != Some(&b'\n'),
                _ => false,
            };
            self.line += usize::from(ends_line);
            start += 1;
        }
        let rest = &self.rest[start..];
        let is_blank = u8::is_ascii_whitespace;
        let length = rest.iter().position(is_blank).unwrap_or(rest.len());
        self.rest = &rest[length..];
        (length > 0).then_some(&rest[..length])
    }

    fn peek(&self) -> Option<&'a [u8]> {
        Words { ..*self }.next()
    }

    /// Takes the next word if it is `keyword`, in letters of any size.
    fn take(&mut self, keyword: &str) -> bool {
        let is_next = self.peek().is_some_and(|word| is(word, keyword));
        is_next && self.next().is_some()
    }

    fn number(&mut self) -> Option<f64> {
        crate::io::word::number(std::str::from_utf8(self.next()?).ok()?)
    }

    fn refuse(&self, word: &[u8], expected: &'static str) -> MeshError {
        MeshError::Line {
            line: self.line,
            text: String::from_utf8_lossy(&word[..word.len().min(40)]).into_owned(),
            expected,
        }
    }
}

fn is(word: &[u8], keyword: &str) -> bool {
    word.eq_ignore_ascii_case(keyword.as_bytes())
}

/// Reads text STL by its words, whatever the lines. Keywords may be parted (`end loop`).
pub(super) fn parse_ascii(bytes: &[u8]) -> Result<TriMesh, MeshError> {
    const KEYWORD: &str = "a keyword of text STL (facet, outer loop, vertex, ...)";
    let mut words = Words {
        rest: bytes,
        line: 1,
    };
    let mut corners = Vec::new();
    let mut loop_corners: Vec<[f64; 3]> = Vec::new();
    let mut closed = false;
    // Names after `solid` and `endsolid` hold any words, in one line with the first facet in some files.
    let mut in_name = false;
    while let Some(word) = words.next() {
        if is(word, "facet") && (!in_name || words.peek().is_some_and(|next| is(next, "normal"))) {
            in_name = false;
            closed = false;
            if words.take("normal") {
                for _ in 0..3 {
                    // Unused. Some files leave it out.
                    if words.peek().is_some_and(|next| is(next, "outer")) {
                        break;
                    }
                    words.next();
                }
            }
        } else if is(word, "endsolid") || (is(word, "end") && words.take("solid")) {
            in_name = true;
            closed = true;
        } else if in_name {
        } else if is(word, "solid") {
            in_name = true;
        } else if is(word, "outer") {
            words.take("loop");
        } else if is(word, "vertex") {
            let mut corner = [0.0f64; 3];
            for value in &mut corner {
                let number = words.number().filter(|number| number.is_finite());
                *value = number.ok_or_else(|| {
                    words.refuse(word, "`vertex x y z` with three finite numbers")
                })?;
            }
            loop_corners.push(corner);
        } else if is(word, "endloop") || (is(word, "end") && words.take("loop")) {
            let [a, b, c] = loop_corners[..] else {
                return Err(words.refuse(word, "exactly three `vertex` before `endloop`"));
            };
            corners.push([a, b, c]);
            loop_corners.clear();
        } else if !(is(word, "endfacet") || (is(word, "end") && words.take("facet"))) {
            return Err(words.refuse(word, KEYWORD));
        }
    }
    if !closed {
        return Err(MeshError::StlOpen { line: words.line });
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

#[cfg(test)]
mod tests {
    use super::*;

    const SOLID: &str = "solid a box\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 10 0 0\nvertex 0 1.0D+01 0\nendloop\n\
        endfacet\nendsolid a box\n";

    /// Line ends, parted keywords, one line, a byte-order mark.
    #[test]
    fn text_is_read_by_words() {
        let expected = super::super::parse(SOLID.as_bytes(), crate::io::Unit::Mm).unwrap();
        for text in [
            SOLID.replace('\n', "\r"),
            SOLID.replace('\n', "\r\n"),
            SOLID.replace('\n', " "),
            SOLID.replace("endloop", "end loop"),
            SOLID.replace("endfacet", "end facet"),
            SOLID.replace("endsolid", "END SOLID"),
            format!("\u{feff}{SOLID}"),
        ] {
            let mesh = super::super::parse(text.as_bytes(), crate::io::Unit::Mm);
            assert_eq!(mesh.unwrap(), expected, "{text:?}");
        }
        let open = SOLID.replace("endsolid a box", "");
        assert!(matches!(
            parse_ascii(open.as_bytes()),
            Err(MeshError::StlOpen { .. })
        ));
    }
}
