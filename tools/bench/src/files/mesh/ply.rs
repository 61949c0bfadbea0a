//! PLY: text, and binary of both byte orders.

use flankscope_gear_cad::Mesh;

use super::{MeshFileError, fan};

/// Largest header, bytes.
const MAX_HEADER_BYTES: usize = 1 << 16;

/// A number type, by size and kind.
#[derive(Clone, Copy)]
enum Number {
    Signed(usize),
    Unsigned(usize),
    Float(usize),
}

impl Number {
    fn named(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::Signed(1),
            "uchar" | "uint8" => Self::Unsigned(1),
            "short" | "int16" => Self::Signed(2),
            "ushort" | "uint16" => Self::Unsigned(2),
            "int" | "int32" => Self::Signed(4),
            "uint" | "uint32" => Self::Unsigned(4),
            "float" | "float32" => Self::Float(4),
            "double" | "float64" => Self::Float(8),
            _ => return None,
        })
    }

    fn bytes(self) -> usize {
        let (Self::Signed(bytes) | Self::Unsigned(bytes) | Self::Float(bytes)) = self;
        bytes
    }

    /// Value of little-endian bytes; every type fits into f64 without loss.
    fn value(self, bytes: [u8; 8]) -> f64 {
        let word = u64::from_le_bytes(bytes);
        match self {
            Self::Float(4) => f64::from(f32::from_bits(word as u32)),
            Self::Float(_) => f64::from_bits(word),
            Self::Unsigned(_) => word as f64,
            Self::Signed(size) => {
                let unused = 64 - 8 * size as u32;
                ((word << unused) as i64 >> unused) as f64
            }
        }
    }
}

struct Property {
    name: String,
    number: Number,
    /// Type of a list's length field.
    length: Option<Number>,
}

struct Element {
    name: String,
    count: u64,
    properties: Vec<Property>,
}

/// Reads the numbers of the body in sequence.
enum Body<'a> {
    Text(std::slice::Split<'a, u8, fn(&u8) -> bool>),
    Binary { rest: &'a [u8], big_endian: bool },
}

impl Body<'_> {
    fn next(&mut self, number: Number) -> Option<f64> {
        match self {
            Self::Text(words) => {
                let word = words.find(|word| !word.is_empty())?;
                std::str::from_utf8(word).ok()?.parse().ok()
            }
            Self::Binary { rest, big_endian } => {
                let (taken, others) = rest.split_at_checked(number.bytes())?;
                *rest = others;
                let mut bytes = [0; 8];
                bytes[..taken.len()].copy_from_slice(taken);
                if *big_endian {
                    bytes[..taken.len()].reverse();
                }
                Some(number.value(bytes))
            }
        }
    }
}

pub(super) fn parse(bytes: &[u8]) -> Result<Mesh, MeshFileError> {
    let (elements, mut body, body_bytes) = header(bytes)?;
    check_length(&elements, &body, body_bytes as u64)?;
    let mut mesh = Mesh {
        vertices: Vec::new(),
        triangles: Vec::new(),
    };
    let mut polygon = Vec::new();
    for element in &elements {
        let axes = ["x", "y", "z"].map(|axis| {
            element
                .properties
                .iter()
                .position(|p| p.name == axis && p.length.is_none())
        });
        let is_vertex = element.name == "vertex";
        if is_vertex && axes.contains(&None) {
            return Err(MeshFileError::Lacks {
                missing: "x, y and z of its vertices",
            });
        }
        let corners = element
            .properties
            .iter()
            .position(|property| is_corners(element, property));
        for index in 0..element.count {
            let mut vertex = [0.0; 3];
            for (place, property) in element.properties.iter().enumerate() {
                let row = || MeshFileError::Row {
                    element: element.name.clone(),
                    index,
                };
                let Some(length) = property.length else {
                    let value = body.next(property.number).ok_or_else(row)?;
                    if let Some(axis) = axes.iter().position(|&axis| axis == Some(place)) {
                        vertex[axis] = value;
                    }
                    continue;
                };
                let length = body.next(length).ok_or_else(row)?;
                let is_face = corners == Some(place);
                if is_face && (length < 3.0 || length.is_nan()) {
                    return Err(MeshFileError::Corners {
                        face: index,
                        corners: length,
                    });
                }
                polygon.clear();
                let mut left = length;
                while left >= 1.0 {
                    left -= 1.0;
                    let value = body.next(property.number).ok_or_else(row)?;
                    if !is_face {
                        continue;
                    }
                    if !(0.0..f64::from(u32::MAX)).contains(&value) || value.fract() != 0.0 {
                        return Err(MeshFileError::Index {
                            face: index,
                            index: value,
                            vertices: mesh.vertices.len(),
                        });
                    }
                    polygon.push(value as u32);
                }
                if is_face {
                    fan(&polygon, &mut mesh.triangles);
                }
            }
            if is_vertex {
                mesh.vertices.push(vertex);
            }
        }
    }
    Ok(mesh)
}

/// Whether this list contains the vertex indices of a face.
fn is_corners(element: &Element, property: &Property) -> bool {
    let named = matches!(property.name.as_str(), "vertex_indices" | "vertex_index");
    element.name == "face" && named && property.length.is_some()
}

/// The elements, the body, and its length.
fn header(bytes: &[u8]) -> Result<(Vec<Element>, Body<'_>, usize), MeshFileError> {
    let mut elements: Vec<Element> = Vec::new();
    let mut encoding = None;
    let (mut line, mut at) = (0, 0);
    let head = &bytes[..bytes.len().min(MAX_HEADER_BYTES)];
    while let Some(length) = head[at..].iter().position(|&byte| byte == b'\n') {
        let text = String::from_utf8_lossy(&head[at..at + length]).into_owned();
        (line, at) = (line + 1, at + length + 1);
        let refused = |expected| MeshFileError::Line {
            line,
            text: text.trim().chars().take(40).collect(),
            expected,
        };
        let words: Vec<&str> = text.split_ascii_whitespace().collect();
        match words.as_slice() {
            ["ply"] if line == 1 => {}
            ["format", name, "1.0"] => encoding = Some((*name).to_owned()),
            [] | ["comment" | "obj_info", ..] => {}
            ["element", name, count] => elements.push(Element {
                name: (*name).into(),
                count: count.parse().map_err(|_| refused("`element NAME COUNT`"))?,
                properties: Vec::new(),
            }),
            ["property", types @ .., name] => {
                let named = |name: &str| Number::named(name);
                let property = match types {
                    [number] => named(number).map(|number| (number, None)),
                    ["list", length, number] => named(number).zip(named(length).map(Some)),
                    _ => None,
                };
                let (Some((number, length)), Some(element)) = (property, elements.last_mut())
                else {
                    return Err(refused(
                        "`property TYPE NAME` or `property list TYPE TYPE NAME` after an element",
                    ));
                };
                element.properties.push(Property {
                    name: (*name).into(),
                    number,
                    length,
                });
            }
            ["end_header"] => {
                let rest = &bytes[at..];
                let body = match encoding.as_deref() {
                    Some("ascii") => {
                        Body::Text(rest.split(u8::is_ascii_whitespace as fn(&u8) -> bool))
                    }
                    Some("binary_little_endian") => Body::Binary {
                        rest,
                        big_endian: false,
                    },
                    Some("binary_big_endian") => Body::Binary {
                        rest,
                        big_endian: true,
                    },
                    _ => {
                        return Err(MeshFileError::Lacks {
                            missing: "format (ascii, binary_little_endian or binary_big_endian 1.0)",
                        });
                    }
                };
                return Ok((elements, body, rest.len()));
            }
            _ => return Err(refused("a line of a PLY header")),
        }
    }
    Err(MeshFileError::Lacks {
        missing: "end_header",
    })
}

/// Checks that this many elements fit into the remaining bytes.
fn check_length(
    elements: &[Element],
    body: &Body<'_>,
    mut have_bytes: u64,
) -> Result<(), MeshFileError> {
    for element in elements {
        let least = |number: Number| match body {
            Body::Text(_) => 2, // a digit and what separates it
            Body::Binary { .. } => number.bytes() as u64,
        };
        let of_property = |property: &Property| match property.length {
            None => least(property.number),
            Some(length) if is_corners(element, property) => {
                least(length) + 3 * least(property.number)
            }
            Some(length) => least(length),
        };
        let row: u64 = element.properties.iter().map(of_property).sum();
        // The last number of a text file needs no separator after it.
        let need_bytes = row
            .saturating_mul(element.count)
            .saturating_sub(match body {
                Body::Text(_) => 1,
                Body::Binary { .. } => 0,
            });
        // An element without properties takes no space, so any count would be possible.
        if need_bytes > have_bytes || (row == 0 && element.count > 0) {
            return Err(MeshFileError::Short {
                element: element.name.clone(),
                count: element.count,
                need_bytes,
                have_bytes,
            });
        }
        have_bytes -= need_bytes;
    }
    Ok(())
}
