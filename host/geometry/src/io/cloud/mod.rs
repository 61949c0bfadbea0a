//! Point clouds at the border: PLY, arrays or XYZ text in, PLY or arrays out.

mod arrays;
mod pcd;
mod text;

use std::io::{self, Write};
use std::path::Path;

use flankscope_foundation::files::{MOST_DATA_BYTES, read_regular};
use flankscope_foundation::npz::NpzError;

use crate::io::mesh::{stl, stl_irregular};
use crate::io::ply::{self, Column, Extra, PlyError, Scalar, Want};
use crate::io::points::{Format, PointFile};
use crate::io::{NonFinite, Unit, word};
use crate::space::Aabb;

/// Points that are known to be finite, mm. Nothing else may feed a tree, a registration or a verdict.
#[derive(Debug, Clone, PartialEq)]
pub struct FinitePoints(Vec<[f64; 3]>);

impl FinitePoints {
    /// Checks every coordinate.
    ///
    /// # Errors
    /// [`CloudError::NonFinite`] with the first offending point.
    pub fn new(points: Vec<[f64; 3]>) -> Result<Self, CloudError> {
        for (index, point) in points.iter().enumerate() {
            if let Some(axis) = point.iter().position(|c| !c.is_finite()) {
                return Err(CloudError::NonFinite {
                    index,
                    axis: ['x', 'y', 'z'][axis],
                    value: point[axis],
                });
            }
        }
        Ok(Self(points))
    }

    /// The points.
    pub fn into_inner(self) -> Vec<[f64; 3]> {
        self.0
    }
}

impl std::ops::Deref for FinitePoints {
    type Target = [[f64; 3]];
    fn deref(&self) -> &Self::Target {
        &self.0
    }
}

/// A cloud with whatever else its file holds per point.
#[derive(Debug, Clone, PartialEq)]
pub struct Cloud {
    /// Finite points in file order, mm.
    pub points: FinitePoints,
    /// Type of the coordinates in the file; text counts as double.
    pub coordinate: Scalar,
    /// Further number properties (colour, normal, ...), carried over when the cloud is written again.
    pub extras: Vec<Extra>,
}

/// Reasons for which a cloud is refused.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CloudError {
    /// The file cannot be read.
    #[error(transparent)]
    Read(#[from] io::Error),
    /// Zero bytes.
    #[error("the file is empty; a cloud is PLY, arrays (.npz) or text with `x y z` per line")]
    EmptyFile,
    /// Text in UTF-16.
    #[error("the file is text in UTF-16; save it as UTF-8")]
    Utf16,
    /// A first column that counts the lines of a file without a heading.
    #[error(
        "the first of {columns} columns counts the lines, so that it is probably an index; right would be a heading that names the columns, such as `index,x,y,z`, or a file without that column"
    )]
    IndexColumn {
        /// Columns of a line.
        columns: usize,
    },
    /// A heading without the coordinates.
    #[error(
        "line {line}: the heading {text:?} does not name each of the columns x, y and z once; right would be `x,y,z`"
    )]
    Heading {
        /// Line number, from 1.
        line: usize,
        /// The heading, shortened.
        text: String,
    },
    /// Fewer points than the file states.
    #[error("the file states {stated} points and holds {found}; it is truncated")]
    Count {
        /// Number in the file.
        stated: usize,
        /// Number of points.
        found: usize,
    },
    /// A mesh in the place of a cloud.
    #[error("the file is a mesh (STL); `flankscope sample` makes points of it")]
    Mesh,
    /// A PCD whose header lacks a line, or has one that does not fit the others.
    #[error(
        "the line {key} of the PCD header is missing or does not fit the others; right would be FIELDS with x, y and z, and one number per field in SIZE, TYPE (F, I, U) and COUNT"
    )]
    PcdHeader {
        /// First word of the line.
        key: &'static str,
    },
    /// A PCD with compressed points.
    #[error(
        "the PCD is compressed (DATA binary_compressed); write it again with DATA binary or DATA ascii (for example `pcl_convert_pcd_ascii_binary in.pcd out.pcd 1`)"
    )]
    PcdCompressed,
    /// No points.
    #[error("the cloud has no points; at least one is needed")]
    NoPoints,
    /// A PLY file that is wrong inside.
    #[error(transparent)]
    Ply(#[from] PlyError),
    /// An archive of arrays that is wrong inside.
    #[error(transparent)]
    Npz(#[from] NpzError),
    /// An archive without points.
    #[error("there is no array points_mm; one of (n, 3) would be right")]
    NoPointsArray,
    /// An array that is neither points nor a property of theirs.
    #[error("array {name} is {shape:?} of {descr}: {why}")]
    Array {
        /// Its name.
        name: String,
        /// Its shape.
        shape: Vec<usize>,
        /// NumPy's name of its numbers' type.
        descr: String,
        /// Valid contents.
        why: String,
    },
    /// Arrays that say their unit, and somebody who says another.
    #[error("points_mm is in mm, not in {unit:?}: leave the unit out")]
    ArrayUnit {
        /// Unit said.
        unit: Unit,
    },
    /// A text line that is no point.
    #[error(
        "line {line}: {text:?} is not a point; right would be three finite numbers `x y z` in mm"
    )]
    Line {
        /// Line number, from 1.
        line: usize,
        /// The line, shortened.
        text: String,
    },
    /// A comma that may be a decimal sign or a separator.
    #[error(
        "line {line}: {text:?}: whether commas are decimal signs or separators cannot be told; right would be points as decimal signs, or blanks, tabs or semicolons between columns"
    )]
    Comma {
        /// Line number, from 1.
        line: usize,
        /// The line, shortened.
        text: String,
    },
    /// No part has that size.
    #[error(
        "the cloud spans {diagonal_mm} mm when read in {unit}, right would be {least_mm} to {most_mm} mm: it is probably in another unit; say so with --cloud-unit um, mm, m or inch (read in m a cloud may span 1 km)"
    )]
    Size {
        /// Diagonal of the bounding box.
        diagonal_mm: f64,
        /// Limit.
        least_mm: f64,
        /// Limit.
        most_mm: f64,
        /// Unit assumed.
        unit: Unit,
    },
    /// Neither PLY nor text.
    #[error(
        "not a cloud: neither PLY nor text (byte {byte:#04x} at offset {offset}); right would be PLY or `x y z` lines"
    )]
    Foreign {
        /// First byte that is not text.
        byte: u8,
        /// Position in the file.
        offset: usize,
    },
    /// Where nothing that is measured can lie.
    #[error(
        "point {index}: coordinate {axis} is {value} mm; every coordinate must lie within {most_mm} mm of the origin; of coordinates of a map (UTM), subtract the same offset from all points, here {} mm from {axis}", offset_mm(*value)
    )]
    Far {
        /// Point, from 0.
        index: usize,
        /// `x`, `y` or `z`.
        axis: char,
        /// The value.
        value: f64,
        /// Limit.
        most_mm: f64,
    },
    /// An uncertainty that is none.
    #[error(
        "point {index}: {property} is {sigma_mm} mm; a standard uncertainty is finite and above 0 mm"
    )]
    Sigma {
        /// Point, from 0.
        index: usize,
        /// The property that states it.
        property: String,
        /// The value.
        sigma_mm: f32,
    },
    /// No point of the file is finite.
    #[error(
        "none of the {points} points has finite coordinates; look whether its first columns are x, y and z"
    )]
    AllNonFinite {
        /// Number of points in the file.
        points: usize,
    },
    /// NaN or infinity.
    #[error("point {index}: coordinate {axis} is {value}; every coordinate must be finite")]
    NonFinite {
        /// Point, from 0.
        index: usize,
        /// `x`, `y` or `z`.
        axis: char,
        /// The value.
        value: f64,
    },
}

/// Round offset that brings a coordinate near to the origin, mm: whole kilometres.
fn offset_mm(value: f64) -> f64 {
    1e6 * (1e-6 * value).round()
}

/// A cloud as its file holds it.
struct UncheckedCloud {
    points: Vec<[f64; 3]>,
    coordinate: Scalar,
    extras: Vec<Extra>,
}

/// Loads a cloud all of whose points are finite. PLY is told by its first line, arrays by theirs, everything else is read as text.
/// Arrays are in mm; no other format says its unit.
///
/// # Errors
/// [`CloudError`] names what is wrong and what would be right.
pub fn load(path: &Path, unit: Unit) -> Result<Cloud, CloudError> {
    parse(&read_regular(path, MOST_DATA_BYTES)?, unit)
}

/// Loads the finite points of a cloud, as [`load`] does. Returns the number of the other points, too.
///
/// # Errors
/// [`CloudError::AllNonFinite`], and those of [`load`].
pub fn load_finite(path: &Path, unit: Unit) -> Result<(Cloud, usize), CloudError> {
    parse_finite(&read_regular(path, MOST_DATA_BYTES)?, unit)
}

/// As [`load`], from memory.
///
/// # Errors
/// As [`load`].
pub fn parse(bytes: &[u8], unit: Unit) -> Result<Cloud, CloudError> {
    let cloud = parse_unchecked(bytes, unit, NonFinite::Refuse)?;
    let cloud = Cloud {
        points: FinitePoints::new(cloud.points)?,
        coordinate: cloud.coordinate,
        extras: cloud.extras,
    };
    cloud.in_unit(unit)
}

/// Parses the finite points of a cloud in memory, as [`load_finite`].
///
/// # Errors
/// As [`load_finite`].
pub fn parse_finite(bytes: &[u8], unit: Unit) -> Result<(Cloud, usize), CloudError> {
    let mut cloud = parse_unchecked(bytes, unit, NonFinite::Drop)?;
    let points = cloud.points.len();
    let is_finite = |point: &[f64; 3]| point.iter().all(|c| c.is_finite());
    let kept: Vec<bool> = cloud.points.iter().map(is_finite).collect();
    let dropped = kept.iter().filter(|kept| !**kept).count();
    if dropped == points {
        return Err(CloudError::AllNonFinite { points });
    }
    if dropped > 0 {
        cloud.points.retain(is_finite);
        cloud.extras.iter_mut().for_each(|extra| extra.keep(&kept));
    }
    let cloud = Cloud {
        points: FinitePoints::new(cloud.points)?,
        coordinate: cloud.coordinate,
        extras: cloud.extras,
    };
    Ok((cloud.in_unit(unit)?, dropped))
}

fn parse_unchecked(
    bytes: &[u8],
    unit: Unit,
    non_finite: NonFinite,
) -> Result<UncheckedCloud, CloudError> {
    if bytes.is_empty() {
        return Err(CloudError::EmptyFile);
    }
    if word::is_utf16(bytes) {
        return Err(CloudError::Utf16);
    }
    let bytes = word::without_mark(bytes);
    let cloud = if bytes.starts_with(b"ply") {
        // The PLY reader refuses points that are not finite by index and line.
        let want = match non_finite {
            NonFinite::Refuse => Want::Extras,
            NonFinite::Drop => Want::ExtrasAndNonFinite,
        };
        let table = ply::read(bytes, want)?;
        UncheckedCloud {
            points: table.points,
            coordinate: table.coordinate,
            extras: table.extras,
        }
    } else if bytes.starts_with(arrays::MAGIC) {
        if unit != Unit::Mm {
            return Err(CloudError::ArrayUnit { unit });
        }
        arrays::parse(bytes)?
    } else if let Some(cloud) = pcd::parse(bytes) {
        cloud?
    } else if stl::is_binary(bytes) || stl_irregular::read(bytes).is_some() {
        return Err(CloudError::Mesh);
    } else {
        UncheckedCloud {
            points: text::parse(bytes, non_finite)?,
            coordinate: Scalar::F64,
            extras: Vec::new(),
        }
    };
    if cloud.points.is_empty() {
        return Err(CloudError::NoPoints);
    }
    Ok(cloud)
}

/// Properties that state the standard uncertainty of a point, in the unit of the cloud: `decode` writes the first, `scan --cloud` the
/// second.
pub const SIGMA_PROPERTIES: [&str; 2] = ["sigma_z", "sigma"];

/// Points beyond this many that lie within [`LEAST_DIAGONAL_MM`] are no cloud in mm.
const CHECKED_POINTS: usize = 100;
/// Smallest diagonal of a cloud of that many points, mm: below what any head's field shows, above a whole die in metres.
const LEAST_DIAGONAL_MM: f64 = 0.5;
/// Largest diagonal of a cloud, mm: of a part of a press, or of a hall or a site if it is said to be in metres.
fn most_diagonal_mm(unit: Unit) -> f64 {
    match unit {
        Unit::M => 1e6,
        _ => 10_000.0,
    }
}

/// Largest coordinate, mm: the origin of a machine hall or of a survey is nearer, and squares of it have their digits.
pub const MOST_COORDINATE_MM: f64 = 1e9;

impl Cloud {
    fn in_unit(mut self, unit: Unit) -> Result<Self, CloudError> {
        if unit != Unit::Mm {
            let scale = unit.mm();
            for point in &mut self.points.0 {
                *point = point.map(|c| c * scale);
            }
            // Scaled coordinates are no longer the file's rounded ones.
            self.coordinate = Scalar::F64;
            for extra in &mut self.extras {
                if SIGMA_PROPERTIES.contains(&extra.name.as_str()) {
                    let scaled = extra.values().map(|value| value * scale);
                    extra.bytes = scaled.flat_map(f64::to_le_bytes).collect();
                    extra.kind = Scalar::F64;
                }
            }
        }
        for (index, point) in self.points.iter().enumerate() {
            // What overflows is infinite.
            if let Some(axis) = point.iter().position(|c| c.abs() > MOST_COORDINATE_MM) {
                return Err(CloudError::Far {
                    index,
                    axis: ['x', 'y', 'z'][axis],
                    value: point[axis],
                    most_mm: MOST_COORDINATE_MM,
                });
            }
        }
        let bounds = Aabb::around(&self.points);
        let diagonal_mm = (0..3)
            .map(|k| (bounds.high[k] - bounds.low[k]).powi(2))
            .sum::<f64>()
            .sqrt();
        // A span that overflows is infinite.
        let is_small = self.points.len() >= CHECKED_POINTS && diagonal_mm < LEAST_DIAGONAL_MM;
        let most_mm = most_diagonal_mm(unit);
        if is_small || diagonal_mm > most_mm {
            return Err(CloudError::Size {
                diagonal_mm,
                least_mm: LEAST_DIAGONAL_MM,
                most_mm,
                unit,
            });
        }
        Ok(self)
    }
}

impl Cloud {
    /// The property that states the points' standard uncertainties, mm.
    #[must_use]
    pub fn sigma_property(&self) -> Option<&Extra> {
        let named = |name| self.extras.iter().find(|extra| extra.name == name);
        SIGMA_PROPERTIES.into_iter().find_map(named)
    }

    /// Standard uncertainty of every point, mm, where the file states them.
    ///
    /// # Errors
    /// [`CloudError::Sigma`] with the first that is not finite and above 0.
    pub fn sigma_mm(&self) -> Result<Option<Vec<f32>>, CloudError> {
        let Some(property) = self.sigma_property() else {
            return Ok(None);
        };
        let sigma_mm: Vec<f32> = property.values().map(|mm| mm as f32).collect();
        let is_none = |mm: &f32| !(mm.is_finite() && *mm > 0.0);
        match sigma_mm.iter().position(is_none) {
            Some(index) => Err(CloudError::Sigma {
                index,
                property: property.name.clone(),
                sigma_mm: sigma_mm[index],
            }),
            None => Ok(Some(sigma_mm)),
        }
    }

    /// The marked points alone, with their properties, in the same order.
    #[must_use]
    pub fn keep(mut self, kept: &[bool]) -> Self {
        let points = self.points.iter().zip(kept).filter(|(_, kept)| **kept);
        self.points = FinitePoints(points.map(|(point, _)| *point).collect());
        self.extras.iter_mut().for_each(|extra| extra.keep(kept));
        self
    }

    /// Writes the cloud with the type of its coordinates, its own properties and further computed columns; a column
    /// replaces an own property of the same name.
    ///
    /// # Errors
    /// Those of [`PointFile::write`].
    pub fn write(
        &self,
        format: Format,
        out: &mut dyn Write,
        columns: &[(&str, &[f64])],
    ) -> io::Result<()> {
        let replaced = |extra: &&Extra| !columns.iter().any(|(name, _)| *name == extra.name);
        let mut all: Vec<Column<'_>> = self
            .extras
            .iter()
            .filter(replaced)
            .map(Column::Carried)
            .collect();
        all.extend(
            columns
                .iter()
                .map(|(name, values)| Column::Float(name, values)),
        );
        let coordinate = match self.coordinate {
            Scalar::F32 => Scalar::F32,
            // Integer coordinates (a cloud in whole millimetres) are written as numbers too.
            _ => Scalar::F64,
        };
        let file = PointFile {
            coordinate,
            columns: &all,
            ..PointFile::from_points(&self.points)
        };
        file.write(format, out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Twelve points of which the second, the third and the last have a coordinate that is not finite, with their numbers as a property.
    fn holed_points() -> Vec<[f64; 3]> {
        let mut points: Vec<[f64; 3]> = (0..12).map(|i| [f64::from(i), 0.5, 20.0]).collect();
        points[1] = [f64::NAN; 3];
        points[2][2] = f64::INFINITY;
        points[11][0] = f64::NEG_INFINITY;
        points
    }

    /// The points as PLY in text and binary, as text and as arrays.
    fn files_of(points: &[[f64; 3]]) -> Vec<Vec<u8>> {
        let number: Vec<f64> = (0..points.len()).map(|i| i as f64).collect();
        let columns = [Column::Float("number", &number)];
        let file = PointFile {
            columns: &columns,
            ..PointFile::from_points(points)
        };
        let mut files: Vec<Vec<u8>> = [Format::Ply, Format::Npz, Format::Xyz]
            .into_iter()
            .map(|format| {
                let mut bytes = Vec::new();
                file.write(format, &mut bytes).unwrap();
                bytes
            })
            .collect();
        let mut text = format!(
            "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
             property float number\nend_header\n",
            points.len()
        );
        for (i, [x, y, z]) in points.iter().enumerate() {
            text += &format!("{x} {y} {z} {i}\n");
        }
        files.push(text.into_bytes());
        files
    }

    #[test]
    fn points_that_are_not_finite_are_dropped_with_their_properties_and_counted() {
        let points = holed_points();
        let finite: Vec<[f64; 3]> = points
            .iter()
            .copied()
            .filter(|p| p.iter().all(|c| c.is_finite()))
            .collect();
        for bytes in files_of(&points) {
            let (cloud, dropped) = parse_finite(&bytes, Unit::Mm).unwrap();
            assert_eq!((&cloud.points[..], dropped), (&finite[..], 3));
            if let Some(number) = cloud.extras.first() {
                let number: Vec<f64> = number.values().collect();
                let expected: Vec<f64> = finite.iter().map(|p| p[0]).collect();
                assert_eq!(number, expected);
            }
            assert!(parse(&bytes, Unit::Mm).is_err());
        }
        for bytes in files_of(&finite) {
            let (cloud, dropped) = parse_finite(&bytes, Unit::Mm).unwrap();
            assert_eq!((cloud, dropped), (parse(&bytes, Unit::Mm).unwrap(), 0));
        }
    }

    #[test]
    fn coordinates_of_a_map_are_refused_with_the_offset() {
        // Metres of UTM zone 32.
        let error = parse(b"691603.5 5334784.25 519.0\n", Unit::M).unwrap_err();
        assert!(matches!(error, CloudError::Far { axis: 'y', .. }));
        assert!(
            error.to_string().contains("5335000000 mm from y"),
            "{error}"
        );
    }

    #[test]
    fn a_cloud_without_a_finite_point_is_refused() {
        for bytes in files_of(&[[f64::NAN, 1.0, 2.0]; 5]) {
            assert!(matches!(
                parse_finite(&bytes, Unit::Mm),
                Err(CloudError::AllNonFinite { points: 5 })
            ));
        }
    }
}
