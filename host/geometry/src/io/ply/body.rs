//! The PLY body: the vertex table and the faces.

use rayon::prelude::*;

use super::error::{Place, PlyError, shorten};
use super::header::{self, Element, Encoding, PropertyKind, Scalar};
use crate::io::faces::Faces;

/// Properties that the caller wants besides the vertices' coordinates; the rest is skipped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Want {
    /// Faces.
    Faces,
    /// All further number properties of the vertices.
    Extras,
    /// Number properties as of [`Want::Extras`], and vertices whose coordinates are not finite, which are refused otherwise.
    ExtrasAndNonFinite,
}

impl Want {
    fn has_extras(self) -> bool {
        self != Self::Faces
    }
}

/// A further number property of the vertices.
#[derive(Debug, Clone, PartialEq)]
pub struct Extra {
    /// Property name.
    pub name: String,
    /// Its type.
    pub kind: Scalar,
    /// Values, little-endian, [`Scalar::size`] bytes per vertex.
    pub bytes: Vec<u8>,
}

impl Extra {
    /// All values, in the order of the vertices.
    pub fn values(&self) -> impl Iterator<Item = f64> {
        let each = self.bytes.chunks_exact(self.kind.size());
        each.map(|bytes| self.kind.decode(bytes, false))
    }

    /// The values of some vertices alone.
    pub(crate) fn keep(&mut self, kept: &[bool]) {
        let each = self.bytes.chunks_exact(self.kind.size()).zip(kept);
        let kept = each.filter(|(_, kept)| **kept);
        self.bytes = kept.flat_map(|(bytes, _)| bytes).copied().collect();
    }
}

/// The content of a PLY file.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    /// Vertex coordinates, in file order; finite unless [`Want::ExtrasAndNonFinite`].
    pub points: Vec<[f64; 3]>,
    /// Type in which the file holds x.
    pub coordinate: Scalar,
    /// Faces, triangles with indices in range; empty unless [`Want::Faces`].
    pub(crate) faces: Faces,
    /// Further vertex properties; empty if [`Want::Faces`].
    pub extras: Vec<Extra>,
}

/// Reads a PLY file from memory.
///
/// # Errors
/// [`PlyError`] names the first thing that is wrong; counts are checked before anything is allocated for them.
pub fn read(bytes: &[u8], want: Want) -> Result<Table, PlyError> {
    let header = header::parse(bytes)?;
    let mut table = Table {
        points: Vec::new(),
        coordinate: Scalar::F32,
        faces: Faces::default(),
        extras: Vec::new(),
    };
    let mut seen_vertices = false;
    let is_face = |element: &Element| element.name == "face" && element.count > 0;
    let has_faces = header.elements.iter().any(is_face);
    let has_strips = header.elements.iter().any(|e| e.name == "tristrips");
    let mut seen_faces = false;
    let mut body = Body {
        rest: &bytes[header.body_offset..],
        line: header.body_line,
        encoding: header.encoding,
    };
    // Faces before vertices are legal but their indices can only be checked at the end.
    for element in &header.elements {
        element.check_count(header.encoding, body.rest.len())?;
        match element.name.as_str() {
            "vertex" if !seen_vertices => {
                seen_vertices = true;
                body.vertices(element, want, &mut table)?;
            }
            "face" if !seen_faces && want == Want::Faces && (has_faces || !has_strips) => {
                seen_faces = true;
                body.faces(element, &mut table.faces)?;
            }
            "tristrips" if !seen_faces && want == Want::Faces && !has_faces => {
                seen_faces = true;
                body.strips(element, &mut table.faces.triangles)?;
            }
            _ => body.skip(element)?,
        }
        if seen_vertices && (want.has_extras() || seen_faces) {
            break;
        }
    }
    if !seen_vertices {
        return Err(PlyError::MissingElement { element: "vertex" });
    }
    if want == Want::Faces && !seen_faces {
        return Err(PlyError::MissingElement { element: "face" });
    }
    check_indices(&table.faces.triangles, table.points.len())?;
    Ok(table)
}

fn check_indices(triangles: &[[u32; 3]], vertices: usize) -> Result<(), PlyError> {
    for (face, triangle) in triangles.iter().enumerate() {
        if let Some(&index) = triangle.iter().find(|&&i| i as usize >= vertices) {
            return Err(PlyError::IndexOutOfRange {
                face: face as u64,
                index: i64::from(index),
                vertices: vertices as u64,
            });
        }
    }
    Ok(())
}

/// Reading position in the body.
struct Body<'a> {
    rest: &'a [u8],
    line: usize,
    encoding: Encoding,
}

impl<'a> Body<'a> {
    fn take(&mut self, bytes: usize, element: &Element, index: u64) -> Result<&'a [u8], PlyError> {
        if bytes > self.rest.len() {
            return Err(PlyError::Truncated {
                element: element.name.clone(),
                index,
            });
        }
        let (head, tail) = self.rest.split_at(bytes);
        self.rest = tail;
        Ok(head)
    }

    /// The next whitespace-separated word of a text body.
    fn word(&mut self, element: &Element, index: u64) -> Result<&'a [u8], PlyError> {
        let mut start = 0;
        while let Some(&byte) = self.rest.get(start) {
            if !byte.is_ascii_whitespace() {
                break;
            }
            self.line += usize::from(byte == b'\n');
            start += 1;
        }
        let rest = &self.rest[start..];
        let length = rest
            .iter()
            .position(u8::is_ascii_whitespace)
            .unwrap_or(rest.len());
        if length == 0 {
            return Err(PlyError::Truncated {
                element: element.name.clone(),
                index,
            });
        }
        self.rest = &rest[length..];
        Ok(&rest[..length])
    }

    fn number(&mut self, kind: Scalar, element: &Element, index: u64) -> Result<f64, PlyError> {
        if self.encoding == Encoding::Ascii {
            let word = self.word(element, index)?;
            std::str::from_utf8(word)
                .ok()
                .and_then(crate::io::word::number)
                .ok_or_else(|| PlyError::Number {
                    line: self.line,
                    text: shorten(word),
                    kind,
                })
        } else {
            let bytes = self.take(kind.size(), element, index)?;
            Ok(kind.decode(bytes, self.encoding == Encoding::BigEndian))
        }
    }

    /// Length of a list, refused when the bytes for it are not there.
    fn length(
        &mut self,
        length: Scalar,
        item: Scalar,
        element: &Element,
        index: u64,
    ) -> Result<i64, PlyError> {
        let count = self.number(length, element, index)?;
        let least = if self.encoding == Encoding::Ascii {
            1
        } else {
            item.size()
        };
        if count * least as f64 > self.rest.len() as f64 {
            return Err(PlyError::Truncated {
                element: element.name.clone(),
                index,
            });
        }
        Ok(count as i64)
    }

    fn skip(&mut self, element: &Element) -> Result<(), PlyError> {
        if self.encoding != Encoding::Ascii && !element.has_list() {
            // check_count has proved that the product fits.
            let bytes = element.count as usize * element.least_record_bytes();
            self.take(bytes, element, element.count)?;
            return Ok(());
        }
        for index in 0..element.count {
            for property in &element.properties {
                self.skip_property(property.kind, element, index)?;
            }
        }
        Ok(())
    }

    fn skip_property(
        &mut self,
        kind: PropertyKind,
        element: &Element,
        index: u64,
    ) -> Result<(), PlyError> {
        match kind {
            PropertyKind::Scalar(kind) => {
                self.number(kind, element, index)?;
            }
            PropertyKind::List { length, item } => {
                for _ in 0..self.length(length, item, element, index)? {
                    self.number(item, element, index)?;
                }
            }
        }
        Ok(())
    }

    fn vertices(
        &mut self,
        element: &Element,
        want: Want,
        table: &mut Table,
    ) -> Result<(), PlyError> {
        let axis = |property: &'static str| {
            let found = element
                .properties
                .iter()
                .position(|p| p.name == property && matches!(p.kind, PropertyKind::Scalar(_)));
            found.ok_or(PlyError::MissingProperty {
                element: "vertex",
                property,
                expected: "number",
            })
        };
        let axes = [axis("x")?, axis("y")?, axis("z")?];
        if let PropertyKind::Scalar(kind) = element.properties[axes[0]].kind {
            table.coordinate = kind;
        }
        if self.encoding != Encoding::Ascii && !element.has_list() {
            return self.fixed_vertices(element, axes, want, table);
        }

        let mut columns: Vec<Option<Extra>> = element
            .properties
            .iter()
            .enumerate()
            .map(|(i, p)| match p.kind {
                PropertyKind::Scalar(kind) if want.has_extras() && !axes.contains(&i) => {
                    Some(Extra {
                        name: p.name.clone(),
                        kind,
                        bytes: Vec::new(),
                    })
                }
                _ => None,
            })
            .collect();
        table.points.reserve_exact(element.count as usize);
        for index in 0..element.count {
            let mut point = [0.0; 3];
            for (i, property) in element.properties.iter().enumerate() {
                let PropertyKind::Scalar(kind) = property.kind else {
                    self.skip_property(property.kind, element, index)?;
                    continue;
                };
                let value = self.number(kind, element, index)?;
                if let Some(k) = axes.iter().position(|&a| a == i) {
                    point[k] = value;
                    let place = Place((self.encoding == Encoding::Ascii).then_some(self.line));
                    check_finite(want, index, place, k, value)?;
                } else if let Some(extra) = &mut columns[i] {
                    kind.encode(value, &mut extra.bytes);
                }
            }
            table.points.push(point);
        }
        table.extras = columns.into_iter().flatten().collect();
        Ok(())
    }

    /// Binary records of one size: coordinates by known offsets, in parallel.
    fn fixed_vertices(
        &mut self,
        element: &Element,
        axes: [usize; 3],
        want: Want,
        table: &mut Table,
    ) -> Result<(), PlyError> {
        let stride = element.least_record_bytes();
        let count = element.count as usize;
        let big_endian = self.encoding == Encoding::BigEndian;
        let records = self.take(count * stride, element, element.count)?;
        let mut offset = 0;
        let mut fields = Vec::new();
        for property in &element.properties {
            if let PropertyKind::Scalar(kind) = property.kind {
                fields.push((property, kind, offset));
                offset += kind.size();
            }
        }
        let [x, y, z] = axes.map(|i| (fields[i].1, fields[i].2));
        table.points = if !big_endian && [x.0, y.0, z.0] == [Scalar::F32; 3] {
            // The common layout by far: no type dispatch per number.
            let f32_at = |r: &[u8], o: usize| {
                f64::from(f32::from_le_bytes([r[o], r[o + 1], r[o + 2], r[o + 3]]))
            };
            records
                .par_chunks_exact(stride)
                .with_min_len(1 << 14)
                .map(|r| [f32_at(r, x.1), f32_at(r, y.1), f32_at(r, z.1)])
                .collect()
        } else {
            records
                .par_chunks_exact(stride)
                .with_min_len(1 << 14)
                .map(|r| [x, y, z].map(|(kind, o)| kind.decode(&r[o..], big_endian)))
                .collect()
        };
        for (index, point) in table.points.iter().enumerate() {
            for (k, &value) in point.iter().enumerate() {
                check_finite(want, index as u64, Place(None), k, value)?;
            }
        }
        if want.has_extras() {
            for (i, (property, kind, offset)) in fields.into_iter().enumerate() {
                if axes.contains(&i) {
                    continue;
                }
                let size = kind.size();
                let mut bytes = Vec::with_capacity(count * size);
                for record in records.chunks_exact(stride) {
                    let field = &record[offset..offset + size];
                    if big_endian {
                        bytes.extend(field.iter().rev());
                    } else {
                        bytes.extend_from_slice(field);
                    }
                }
                table.extras.push(Extra {
                    name: property.name.clone(),
                    kind,
                    bytes,
                });
            }
        }
        Ok(())
    }

    fn faces(&mut self, element: &Element, faces: &mut Faces) -> Result<(), PlyError> {
        let corners = element.properties.iter().position(|p| {
            matches!(p.kind, PropertyKind::List { .. })
                && (p.name == "vertex_indices" || p.name == "vertex_index")
        });
        let Some(corners) = corners else {
            return Err(PlyError::MissingProperty {
                element: "face",
                property: "vertex_indices",
                expected: "list",
            });
        };
        faces.triangles.reserve_exact(element.count as usize);
        if element.properties.len() == 1
            && self.encoding == Encoding::LittleEndian
            && let PropertyKind::List {
                length: Scalar::U8,
                item: Scalar::I32 | Scalar::U32,
            } = element.properties[0].kind
        {
            self.plain_triangles(element, &mut faces.triangles);
        }
        let mut polygon = Vec::new();
        for face in faces.len() as u64..element.count {
            for (i, property) in element.properties.iter().enumerate() {
                let PropertyKind::List { length, item } = property.kind else {
                    self.skip_property(property.kind, element, face)?;
                    continue;
                };
                if i != corners {
                    self.skip_property(property.kind, element, face)?;
                    continue;
                }
                let count = self.length(length, item, element, face)?;
                if count < 3 {
                    return Err(PlyError::FaceCorners {
                        face,
                        corners: count,
                    });
                }
                polygon.clear();
                for _ in 0..count {
                    let value = self.number(item, element, face)?;
                    if !(0.0..=f64::from(u32::MAX - 1)).contains(&value) {
                        return Err(PlyError::IndexOutOfRange {
                            face,
                            index: value as i64,
                            vertices: u64::from(u32::MAX),
                        });
                    }
                    polygon.push(value as u32);
                }
            }
            faces.push(&polygon);
        }
        Ok(())
    }

    /// Triangle strips: every further corner makes a triangle with the two before it, turned alternately. A negative number ends a
    /// strip. Triangles of two equal corners only join strips and are left out.
    fn strips(&mut self, element: &Element, triangles: &mut Vec<[u32; 3]>) -> Result<(), PlyError> {
        for record in 0..element.count {
            for property in &element.properties {
                let (PropertyKind::List { length, item }, "vertex_indices" | "vertex_index") =
                    (property.kind, property.name.as_str())
                else {
                    self.skip_property(property.kind, element, record)?;
                    continue;
                };
                let mut strip: Vec<u32> = Vec::new();
                for _ in 0..self.length(length, item, element, record)? {
                    let value = self.number(item, element, record)?;
                    if value < 0.0 || value == f64::from(u32::MAX) {
                        strip.clear();
                        continue;
                    }
                    if !(0.0..f64::from(u32::MAX)).contains(&value) {
                        return Err(PlyError::IndexOutOfRange {
                            face: triangles.len() as u64,
                            index: value as i64,
                            vertices: u64::from(u32::MAX),
                        });
                    }
                    strip.push(value as u32);
                    let &[.., a, b, c] = strip.as_slice() else {
                        continue;
                    };
                    if a != b && b != c && c != a {
                        let is_turned = strip.len().is_multiple_of(2);
                        triangles.push(if is_turned { [b, a, c] } else { [a, b, c] });
                    }
                }
            }
        }
        Ok(())
    }

    /// The leading run of faces that are plain triangles in the most common layout: 1 + 3 x 4 bytes.
    fn plain_triangles(&mut self, element: &Element, triangles: &mut Vec<[u32; 3]>) {
        let mut taken = 0;
        for record in self.rest.chunks_exact(13).take(element.count as usize) {
            if record[0] != 3 {
                break;
            }
            let at = |o: usize| {
                u32::from_le_bytes([record[o], record[o + 1], record[o + 2], record[o + 3]])
            };
            triangles.push([at(1), at(5), at(9)]);
            taken += 13;
        }
        self.rest = &self.rest[taken..];
    }
}

fn check_finite(
    want: Want,
    index: u64,
    place: Place,
    axis: usize,
    value: f64,
) -> Result<(), PlyError> {
    if value.is_finite() || want == Want::ExtrasAndNonFinite {
        return Ok(());
    }
    Err(PlyError::NonFinite {
        index,
        place,
        axis: ['x', 'y', 'z'][axis],
        value,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn triangle_strips_are_faces() {
        let text = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
            element tristrips 1\nproperty list int int vertex_indices\nend_header\n\
            0 0 0\n1 0 0\n0 1 0\n1 1 0\n9 0 1 2 3 -1 3 2 1 0\n";
        let table = read(text.as_bytes(), Want::Faces).unwrap();
        let expected = vec![[0, 1, 2], [2, 1, 3], [3, 2, 1], [1, 2, 0]];
        assert_eq!(table.faces.triangles, expected);
        let beyond = text.replace("9 0 1 2 3", "9 0 1 2 4");
        assert!(matches!(
            read(beyond.as_bytes(), Want::Faces),
            Err(PlyError::IndexOutOfRange { index: 4, .. })
        ));
    }
}
