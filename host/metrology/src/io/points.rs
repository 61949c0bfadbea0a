//! Points with further columns and triangles, as a file of the kind that its name asks for.

use std::io::{self, Write};
use std::path::Path;

use flankscope_foundation::npz::NpzWriter;

use super::ply::{self, Column, Extra, Scalar};

/// Header comment of every PLY in mm of whose frame nothing more is known.
const UNIT_COMMENT: &str = "unit mm";

/// File formats of points.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Binary little-endian PLY.
    Ply,
    /// Arrays for NumPy: `points_mm` (n, 3), one of (n) per column under its name, `triangles` (m, 3) if there are any.
    Npz,
}

impl Format {
    /// Arrays where the name ends in `.npz`, PLY for every other.
    #[must_use]
    pub fn from_path(path: &Path) -> Self {
        let is_npz = path
            .extension()
            .is_some_and(|ending| ending.eq_ignore_ascii_case("npz"));
        if is_npz { Self::Npz } else { Self::Ply }
    }
}

/// Contents of a file of points.
#[derive(Debug, Clone, Copy)]
pub struct PointFile<'a> {
    /// Unit and frame, in words: PLY's comment.
    pub comment: &'a str,
    /// The points, mm.
    pub points: &'a [[f64; 3]],
    /// The type of x, y, z: [`Scalar::F64`] keeps everything, [`Scalar::F32`] suits points that were read as float.
    pub coordinate: Scalar,
    /// Further columns, each as long as the points.
    pub columns: &'a [Column<'a>],
    /// Triangles between the points.
    pub triangles: &'a [[u32; 3]],
}

impl<'a> PointFile<'a> {
    /// Points in mm, in double precision, and nothing else.
    #[must_use]
    pub fn from_points(points: &'a [[f64; 3]]) -> Self {
        Self {
            comment: UNIT_COMMENT,
            points,
            coordinate: Scalar::F64,
            columns: &[],
            triangles: &[],
        }
    }

    /// Writes it. Computed columns are `float` in a PLY, which viewers ask for, and keep every digit as an array.
    ///
    /// # Errors
    /// Those of `out`; `InvalidInput` when a column is not as long as the points, or two arrays have one name.
    pub fn write(&self, format: Format, out: &mut dyn Write) -> io::Result<()> {
        match format {
            Format::Ply => ply::write_mesh(
                out,
                self.comment,
                (self.points, self.coordinate),
                self.columns,
                self.triangles,
            ),
            Format::Npz => self.write_arrays(out),
        }
    }

    fn write_arrays(&self, out: &mut dyn Write) -> io::Result<()> {
        let count = self.points.len();
        let mut npz = NpzWriter::new(out);
        let shape = [count, 3];
        match self.coordinate {
            Scalar::F32 => {
                let points = self.points.iter();
                npz.stream("points_mm", &shape, points.map(|p| Ok(p.map(|c| c as f32))))?;
            }
            _ => npz.array("points_mm", &shape, self.points)?,
        }
        for column in self.columns {
            match column {
                Column::Carried(extra) => carried(&mut npz, count, extra)?,
                Column::Float(name, values) => npz.array(name, &[count], values)?,
                Column::Single(name, values) => npz.array(name, &[count], values)?,
                Column::Byte(name, values) => npz.array(name, &[count], values)?,
            }
        }
        if !self.triangles.is_empty() {
            let shape = [self.triangles.len(), 3];
            npz.array("triangles", &shape, self.triangles)?;
        }
        npz.finish().map(drop)
    }
}

/// A property of another file in its own type, which a f64 holds without loss.
fn carried<W: Write>(npz: &mut NpzWriter<W>, count: usize, extra: &Extra) -> io::Result<()> {
    let values = extra.values();
    let (name, shape) = (&extra.name, &[count]);
    match extra.kind {
        Scalar::I8 => npz.stream(name, shape, values.map(|v| Ok(v as i8))),
        Scalar::U8 => npz.stream(name, shape, values.map(|v| Ok(v as u8))),
        Scalar::I16 => npz.stream(name, shape, values.map(|v| Ok(v as i16))),
        Scalar::U16 => npz.stream(name, shape, values.map(|v| Ok(v as u16))),
        Scalar::I32 => npz.stream(name, shape, values.map(|v| Ok(v as i32))),
        Scalar::U32 => npz.stream(name, shape, values.map(|v| Ok(v as u32))),
        Scalar::F32 => npz.stream(name, shape, values.map(|v| Ok(v as f32))),
        Scalar::F64 => npz.stream(name, shape, values.map(Ok)),
    }
}
