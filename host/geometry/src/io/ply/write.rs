//! Writing PLY, always binary little-endian.

use std::io::{self, Write};

use super::Extra;
use super::header::Scalar;

/// A vertex column to be written after x, y and z.
#[derive(Debug, Clone, Copy)]
pub enum Column<'a> {
    /// A property carried over from another file.
    Carried(&'a Extra),
    /// A computed quantity, stored as `float`.
    Float(&'a str, &'a [f64]),
    /// The same, computed in single precision.
    Single(&'a str, &'a [f32]),
    /// A share of 255, stored as `uchar`: one channel of a colour.
    Byte(&'a str, &'a [u8]),
}

impl Column<'_> {
    fn len(&self) -> usize {
        match self {
            Self::Carried(extra) => extra.bytes.len() / extra.kind.size(),
            Self::Float(_, values) => values.len(),
            Self::Single(_, values) => values.len(),
            Self::Byte(_, values) => values.len(),
        }
    }
}

/// Checks that every column has a value for each point.
///
/// # Errors
/// `InvalidInput` where one is shorter or longer.
pub(crate) fn check_lengths(points: &[[f64; 3]], columns: &[Column<'_>]) -> io::Result<()> {
    if columns.iter().all(|column| column.len() == points.len()) {
        return Ok(());
    }
    let why = "a column is not as long as the points";
    Err(io::Error::new(io::ErrorKind::InvalidInput, why))
}

/// Writes points in their order with further columns, and triangles between them, if there are any.
///
/// `coordinate` is the type of x, y, z: [`Scalar::F64`] keeps everything, [`Scalar::F32`] suits points that were read as float.
///
/// # Errors
/// Those of `out`; `InvalidInput` when a column is not as long as the points.
pub fn write_mesh(
    out: &mut dyn Write,
    comment: &str,
    (points, coordinate): (&[[f64; 3]], Scalar),
    columns: &[Column<'_>],
    triangles: &[[u32; 3]],
) -> io::Result<()> {
    check_lengths(points, columns)?;
    writeln!(
        out,
        "ply\nformat binary_little_endian 1.0\ncomment {comment}"
    )?;
    writeln!(out, "element vertex {}", points.len())?;
    for axis in ["x", "y", "z"] {
        writeln!(out, "property {coordinate} {axis}")?;
    }
    for column in columns {
        match column {
            Column::Carried(extra) => writeln!(out, "property {} {}", extra.kind, extra.name)?,
            Column::Float(name, _) | Column::Single(name, _) => {
                writeln!(out, "property float {name}")?
            }
            Column::Byte(name, _) => writeln!(out, "property uchar {name}")?,
        }
    }
    if !triangles.is_empty() {
        writeln!(
            out,
            "element face {}\nproperty list uchar uint vertex_indices",
            triangles.len()
        )?;
    }
    writeln!(out, "end_header")?;
    let mut block = Vec::new();
    for (start, chunk) in points.chunks(1 << 12).enumerate() {
        block.clear();
        for (i, point) in chunk.iter().enumerate() {
            let index = (start << 12) + i;
            for &value in point {
                coordinate.encode(value, &mut block);
            }
            for column in columns {
                match column {
                    Column::Carried(extra) => {
                        let size = extra.kind.size();
                        block.extend_from_slice(&extra.bytes[index * size..(index + 1) * size]);
                    }
                    Column::Float(_, values) => {
                        block.extend_from_slice(&(values[index] as f32).to_le_bytes());
                    }
                    Column::Single(_, values) => {
                        block.extend_from_slice(&values[index].to_le_bytes());
                    }
                    Column::Byte(_, values) => block.push(values[index]),
                }
            }
        }
        out.write_all(&block)?;
    }
    write_faces(out, triangles)
}

fn write_faces(out: &mut dyn Write, triangles: &[[u32; 3]]) -> io::Result<()> {
    let mut block = Vec::new();
    for chunk in triangles.chunks(1 << 12) {
        block.clear();
        for triangle in chunk {
            block.push(3);
            block.extend(triangle.iter().flat_map(|i| i.to_le_bytes()));
        }
        out.write_all(&block)?;
    }
    Ok(())
}
