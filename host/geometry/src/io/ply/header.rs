//! The PLY header.

use super::error::{PlyError, shorten};

/// Longest header that is searched for `end_header`.
const MAX_HEADER_BYTES: usize = 1 << 20;

/// Encoding of the body.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// Text.
    Ascii,
    /// Binary, least significant byte first.
    LittleEndian,
    /// Binary, most significant byte first.
    BigEndian,
}

/// A PLY number type.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scalar {
    /// `char`, `int8`
    I8,
    /// `uchar`, `uint8`
    U8,
    /// `short`, `int16`
    I16,
    /// `ushort`, `uint16`
    U16,
    /// `int`, `int32`
    I32,
    /// `uint`, `uint32`
    U32,
    /// `float`, `float32`
    F32,
    /// `double`, `float64`
    F64,
}

impl Scalar {
    fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    /// Bytes of one number.
    pub fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The type's name in a header.
    pub fn name(self) -> &'static str {
        match self {
            Self::I8 => "char",
            Self::U8 => "uchar",
            Self::I16 => "short",
            Self::U16 => "ushort",
            Self::I32 => "int",
            Self::U32 => "uint",
            Self::F32 => "float",
            Self::F64 => "double",
        }
    }

    /// Reads one number from exactly [`Scalar::size`] bytes; every PLY type fits a f64 without loss.
    pub(in crate::io) fn decode(self, bytes: &[u8], big_endian: bool) -> f64 {
        let mut raw = [0u8; 8];
        let size = self.size();
        raw[..size].copy_from_slice(&bytes[..size]);
        if big_endian {
            raw[..size].reverse();
        }
        let [a, b, c, d, ..] = raw;
        match self {
            Self::I8 => f64::from(a as i8),
            Self::U8 => f64::from(a),
            Self::I16 => f64::from(i16::from_le_bytes([a, b])),
            Self::U16 => f64::from(u16::from_le_bytes([a, b])),
            Self::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
            Self::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
            Self::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Self::F64 => f64::from_le_bytes(raw),
        }
    }

    /// Appends `value` in little-endian order, rounded to the type.
    pub(super) fn encode(self, value: f64, out: &mut Vec<u8>) {
        match self {
            Self::I8 => out.extend((value as i8).to_le_bytes()),
            Self::U8 => out.extend((value as u8).to_le_bytes()),
            Self::I16 => out.extend((value as i16).to_le_bytes()),
            Self::U16 => out.extend((value as u16).to_le_bytes()),
            Self::I32 => out.extend((value as i32).to_le_bytes()),
            Self::U32 => out.extend((value as u32).to_le_bytes()),
            Self::F32 => out.extend((value as f32).to_le_bytes()),
            Self::F64 => out.extend(value.to_le_bytes()),
        }
    }
}

impl std::fmt::Display for Scalar {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// One property of an element.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Property {
    pub name: String,
    pub kind: PropertyKind,
}

/// A number or a counted list of numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum PropertyKind {
    Scalar(Scalar),
    List { length: Scalar, item: Scalar },
}

/// One element (a table) of the file.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Element {
    pub name: String,
    pub count: u64,
    pub properties: Vec<Property>,
}

impl Element {
    /// Bytes of one binary record when it holds no list, else the least it can have.
    pub fn least_record_bytes(&self) -> usize {
        self.properties
            .iter()
            .map(|p| match p.kind {
                PropertyKind::Scalar(kind) => kind.size(),
                PropertyKind::List { length, .. } => length.size(),
            })
            .sum()
    }

    pub fn has_list(&self) -> bool {
        self.properties
            .iter()
            .any(|p| matches!(p.kind, PropertyKind::List { .. }))
    }

    /// Refuses a declared count that the remaining bytes cannot hold.
    pub fn check_count(&self, encoding: Encoding, have_bytes: usize) -> Result<(), PlyError> {
        if self.count == 0 {
            return Ok(());
        }
        if self.properties.is_empty() {
            return Err(PlyError::NoProperties {
                element: self.name.clone(),
                count: self.count,
            });
        }
        let need_bytes = match encoding {
            // One character and one separator each; the very last separator may be missing.
            Encoding::Ascii => u128::from(self.count) * 2 * self.properties.len() as u128 - 1,
            _ => u128::from(self.count) * self.least_record_bytes() as u128,
        };
        if need_bytes > have_bytes as u128 {
            return Err(PlyError::CountBeyondFile {
                element: self.name.clone(),
                count: self.count,
                need_bytes,
                have_bytes,
            });
        }
        Ok(())
    }
}

/// The parsed header.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Header {
    pub encoding: Encoding,
    pub elements: Vec<Element>,
    /// Offset of the body, bytes.
    pub body_offset: usize,
    /// Line number of the first body line.
    pub body_line: usize,
}

/// Reads the header alone.
pub(super) fn parse(bytes: &[u8]) -> Result<Header, PlyError> {
    if !(bytes.starts_with(b"ply\n") || bytes.starts_with(b"ply\r")) {
        return Err(PlyError::Foreign);
    }
    let searched = &bytes[..bytes.len().min(MAX_HEADER_BYTES)];
    let mut encoding = None;
    let mut elements: Vec<Element> = Vec::new();
    let mut offset = 0;
    let mut line_number = 0;
    loop {
        let rest = &searched[offset..];
        let Some(length) = rest.iter().position(|&b| b == b'\n') else {
            return Err(PlyError::HeaderOpen {
                searched: searched.len(),
            });
        };
        let line = rest[..length].trim_ascii();
        offset += length + 1;
        line_number += 1;
        let refuse = |expected| {
            Err(PlyError::HeaderLine {
                line: line_number,
                text: shorten(line),
                expected,
            })
        };
        let Ok(text) = std::str::from_utf8(line) else {
            // Comments are free text in any encoding.
            if line.starts_with(b"comment") || line.starts_with(b"obj_info") {
                continue;
            }
            return refuse("plain text");
        };
        let words: Vec<&str> = text.split_ascii_whitespace().collect();
        match words.as_slice() {
            ["ply"] if line_number == 1 => {}
            [] | ["comment" | "obj_info", ..] => {}
            ["format", name, "1.0"] => {
                encoding = Some(match *name {
                    "ascii" => Encoding::Ascii,
                    "binary_little_endian" => Encoding::LittleEndian,
                    "binary_big_endian" => Encoding::BigEndian,
                    _ => {
                        return refuse("`ascii`, `binary_little_endian` or `binary_big_endian`");
                    }
                });
            }
            ["element", name, count] => {
                let Ok(count) = count.parse() else {
                    return refuse("`element NAME COUNT` with a whole, non-negative COUNT");
                };
                elements.push(Element {
                    name: (*name).to_owned(),
                    count,
                    properties: Vec::new(),
                });
            }
            ["property", rest @ ..] => {
                let Some(element) = elements.last_mut() else {
                    return refuse("an `element` line before its properties");
                };
                let property = match rest {
                    ["list", length, item, name] => Scalar::parse(length)
                        .zip(Scalar::parse(item))
                        .map(|(length, item)| (name, PropertyKind::List { length, item })),
                    [kind, name] => {
                        Scalar::parse(kind).map(|kind| (name, PropertyKind::Scalar(kind)))
                    }
                    _ => None,
                };
                let Some((name, kind)) = property else {
                    return refuse("`property TYPE NAME` or `property list TYPE TYPE NAME`");
                };
                element.properties.push(Property {
                    name: (*name).to_owned(),
                    kind,
                });
            }
            ["end_header"] => break,
            _ => {
                return refuse("a `format`, `comment`, `element`, `property` or `end_header` line");
            }
        }
    }
    let Some(encoding) = encoding else {
        return Err(PlyError::HeaderLine {
            line: line_number,
            text: "end_header".into(),
            expected: "a `format` line before it",
        });
    };
    Ok(Header {
        encoding,
        elements,
        body_offset: offset,
        body_line: line_number + 1,
    })
}
