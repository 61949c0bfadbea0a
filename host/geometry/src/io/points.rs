//! Points with further columns and triangles, as a file of the kind that its name asks for.

use std::io::{self, Write};
use std::path::Path;

use flankscope_foundation::npz::NpzWriter;

use super::mesh::{TriMesh, write_stl};
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
    /// Text: per line x y z, then one number per column.
    Xyz,
    /// Binary STL, of triangles alone: no columns, single precision.
    Stl,
}

/// A file of a kind that is not written.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error("{name}: {written}; another ending is not written")]
pub struct FormatError {
    name: String,
    written: &'static str,
}

impl Format {
    /// Of a cloud: arrays where the name ends in `.npz`, text where in `.xyz`, PLY where in `.ply` or nothing.
    ///
    /// # Errors
    /// Another ending.
    pub fn of_cloud(path: &Path) -> Result<Self, FormatError> {
        let ending = path.extension();
        if ending.is_some_and(|ending| ending.eq_ignore_ascii_case("xyz")) {
            return Ok(Self::Xyz);
        }
        match Self::of_mesh(path) {
            Ok(Self::Stl) | Err(_) => Err(FormatError {
                name: path.display().to_string(),
                written: "points are written as PLY (name.ply), as text (name.xyz) or as arrays for NumPy (name.npz)",
            }),
            of_points => of_points,
        }
    }

    /// Of a mesh: these, or STL where the name ends in `.stl`.
    ///
    /// # Errors
    /// Another ending.
    pub fn of_mesh(path: &Path) -> Result<Self, FormatError> {
        let ending = path.extension().map(|ending| ending.to_ascii_lowercase());
        match ending.as_deref().map(|ending| ending.to_str()) {
            None | Some(Some("ply")) => Ok(Self::Ply),
            Some(Some("npz")) => Ok(Self::Npz),
            Some(Some("stl")) => Ok(Self::Stl),
            Some(_) => Err(FormatError {
                name: path.display().to_string(),
                written: "a mesh is written as PLY (name.ply), STL (name.stl) or arrays for NumPy (name.npz)",
            }),
        }
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
            Format::Xyz => self.write_text(out),
            Format::Stl => write_stl(
                out,
                &TriMesh {
                    vertices: self.points.to_vec(),
                    triangles: self.triangles.to_vec(),
                },
            ),
        }
    }

    /// Numbers with as many digits as they need to be read back the same.
    fn write_text(&self, out: &mut dyn Write) -> io::Result<()> {
        ply::check_lengths(self.points, self.columns)?;
        let mut columns: Vec<Box<dyn Iterator<Item = f64> + '_>> = Vec::new();
        for column in self.columns {
            columns.push(match column {
                Column::Carried(extra) => Box::new(extra.values()),
                Column::Float(_, values) => Box::new(values.iter().copied()),
                Column::Single(_, values) => Box::new(values.iter().map(|&v| f64::from(v))),
                Column::Byte(_, values) => Box::new(values.iter().map(|&v| f64::from(v))),
            });
        }
        for [x, y, z] in self.points {
            match self.coordinate {
                Scalar::F32 => write!(out, "{} {} {}", *x as f32, *y as f32, *z as f32)?,
                _ => write!(out, "{x} {y} {z}")?,
            }
            for value in columns.iter_mut().filter_map(Iterator::next) {
                write!(out, " {value}")?;
            }
            writeln!(out)?;
        }
        Ok(())
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::{Unit, mesh};

    #[test]
    fn a_mesh_named_stl_is_one() {
        let points = [
            [0.0, 0.0, 0.0],
            [10.0, 0.0, 0.0],
            [0.0, 10.0, 0.0],
            [0.0, 0.0, 10.0],
        ];
        let triangles = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
        let file = PointFile {
            triangles: &triangles,
            ..PointFile::from_points(&points)
        };
        let mut bytes = Vec::new();
        file.write(Format::of_mesh(Path::new("a/d.STL")).unwrap(), &mut bytes)
            .unwrap();
        assert_eq!(bytes.len(), 84 + 50 * triangles.len());
        let read = mesh::parse(&bytes, Unit::Mm).unwrap();
        assert_eq!(read.triangles.len(), triangles.len());
        let corners = |mesh: &TriMesh, at: usize| mesh.corners(at);
        let own = TriMesh {
            vertices: points.to_vec(),
            triangles: triangles.to_vec(),
        };
        for at in 0..triangles.len() {
            assert_eq!(corners(&read, at), corners(&own, at));
        }
        assert!(Format::of_cloud(Path::new("d.stl")).is_err());
    }
}
