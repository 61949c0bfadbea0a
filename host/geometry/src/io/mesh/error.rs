//! Errors of meshes.

use crate::io::Unit;
use crate::io::ply::PlyError;

/// Reasons for which a mesh is refused.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MeshError {
    /// The file cannot be read.
    #[error(transparent)]
    Read(std::io::Error),
    /// Zero bytes.
    #[error("the file is empty; a mesh is PLY, STL or OBJ")]
    EmptyFile,
    /// None of the formats.
    #[error(
        "not a mesh: neither PLY (starts with `ply`), STL (starts with `solid`, or 84 + 50 n bytes) nor OBJ (`v` and `f` lines)"
    )]
    Foreign,
    /// A format that is known, but not read.
    #[error("the file is {format}, not PLY, STL or OBJ; {advice}")]
    OtherFormat {
        /// Its name.
        format: &'static str,
        /// Remedy.
        advice: &'static str,
    },
    /// A PLY file that is wrong inside.
    #[error(transparent)]
    Ply(#[from] PlyError),
    /// A binary STL whose length contradicts its triangle count.
    #[error(
        "binary STL declares {declared} triangles, which are {need_bytes} bytes, but the file has {have_bytes}; it is truncated, padded or not STL"
    )]
    StlSize {
        /// Declared triangles.
        declared: u32,
        /// 84 + 50 n.
        need_bytes: u64,
        /// File size.
        have_bytes: u64,
    },
    /// A binary STL whose triangles are certain, where nothing may be ignored.
    #[error(
        "the file does not keep to its format ({irregularity}), which only meshes of --cad may do: export the mesh again"
    )]
    StlIrregular {
        /// Deviation from the format.
        irregularity: super::StlIrregularity,
    },
    /// A line of a text format that is wrong.
    #[error("line {line}: {text:?} not understood; right would be {expected}")]
    Line {
        /// Line number, from 1.
        line: usize,
        /// The line, shortened.
        text: String,
        /// Valid contents.
        expected: &'static str,
    },
    /// A text STL that stops before `endsolid`.
    #[error("the STL text ends at line {line} before `endsolid`; the file is truncated")]
    StlOpen {
        /// Last line.
        line: usize,
    },
    /// A vertex with NaN or infinity.
    #[error("vertex {vertex}: coordinate {axis} is {value}; every coordinate must be finite")]
    NonFinite {
        /// Vertex, from 0.
        vertex: usize,
        /// `x`, `y` or `z`.
        axis: char,
        /// The value.
        value: f64,
    },
    /// A triangle that names a vertex which does not exist.
    #[error("triangle {triangle} names vertex {index}, but there are vertices 0..{vertices}")]
    IndexOutOfRange {
        /// Triangle, from 0.
        triangle: usize,
        /// The index.
        index: i64,
        /// Number of vertices.
        vertices: usize,
    },
    /// A face with more than three corners that no triangles cover.
    #[error(
        "face {face} has {corners} corners and crosses itself (or is far from flat); right would be a simple polygon, or triangles"
    )]
    Polygon {
        /// Face, from 0.
        face: usize,
        /// Its corners.
        corners: usize,
    },
    /// A face that is not convex, with more corners than are cut into triangles.
    #[error(
        "face {face} has {corners} corners and is not convex; at most {most} are cut into triangles: right would be triangles"
    )]
    Corners {
        /// Face, from 0.
        face: usize,
        /// Its corners.
        corners: usize,
        /// The limit.
        most: usize,
    },
    /// No triangles.
    #[error(
        "the mesh has {vertices} vertices but no triangles; a surface needs at least one triangle"
    )]
    Empty {
        /// Number of vertices.
        vertices: usize,
    },
    /// All triangles are points or segments.
    #[error(
        "all {triangles} triangles are degenerate (no area); a surface needs at least one with area"
    )]
    NoArea {
        /// Number of triangles.
        triangles: usize,
    },
    /// Too small for a die.
    #[error(
        "bounding box diagonal is {diagonal_mm:.6} mm when read in {unit}, below {least_mm} mm: {}",
        if_too_small(.unit)
    )]
    TooSmall {
        /// Diagonal.
        diagonal_mm: f64,
        /// Limit.
        least_mm: f64,
        /// Unit assumed.
        unit: Unit,
    },
    /// Too large for a die.
    #[error(
        "bounding box diagonal is {diagonal_mm} mm when read in {unit}, above {most_mm} mm: {}",
        if_too_large(.unit)
    )]
    TooLarge {
        /// Diagonal.
        diagonal_mm: f64,
        /// Limit.
        most_mm: f64,
        /// Unit assumed.
        unit: Unit,
    },
}

/// Advice for a mesh that is too small for a die in this unit.
fn if_too_small(read_in: &Unit) -> &'static str {
    match read_in {
        Unit::M => "the file is damaged, or shows no die",
        Unit::Um => PROBABLY_MM,
        Unit::Mm | Unit::Inch => {
            "the file is probably in metres; say so with --cad-unit m (tool file: unit = \"m\")"
        }
    }
}

/// Advice for a mesh that is too large for a die in this unit.
fn if_too_large(read_in: &Unit) -> &'static str {
    match read_in {
        Unit::M | Unit::Inch => PROBABLY_MM,
        Unit::Mm => {
            "the file is probably in micrometres; say so with --cad-unit um (tool file: unit = \"um\")"
        }
        Unit::Um => "the file is damaged, or shows no die",
    }
}

const PROBABLY_MM: &str =
    "the file is probably in millimetres; say so with --cad-unit mm (tool file: unit = \"mm\")";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mesh_of_impossible_size_is_told_the_unit_that_fits() {
        for (read_in, small, large) in [
            (Unit::Mm, "--cad-unit m ", "--cad-unit um "),
            (Unit::M, "damaged", "--cad-unit mm "),
            (Unit::Um, "--cad-unit mm ", "damaged"),
            (Unit::Inch, "--cad-unit m ", "--cad-unit mm "),
        ] {
            let small_error = MeshError::TooSmall {
                diagonal_mm: 1e-3,
                least_mm: 1.0,
                unit: read_in,
            };
            assert!(small_error.to_string().contains(small), "{small_error}");
            let large_error = MeshError::TooLarge {
                diagonal_mm: 1e5,
                most_mm: 1e4,
                unit: read_in,
            };
            assert!(large_error.to_string().contains(large), "{large_error}");
        }
    }
}
