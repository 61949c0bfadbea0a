//! Why there is no such world, view or frame.

use flankscope_gear_cad::Flank;

use super::WearError;

/// Why there is no such world, view or frame.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum WorldError {
    /// A parameter lies outside the range that the model describes.
    #[error("{name} is {got}; it must be a number from {min} to {max}")]
    Parameter {
        /// Its name.
        name: &'static str,
        /// Its value.
        got: f64,
        /// Smallest.
        min: f64,
        /// Largest.
        max: f64,
    },
    /// Too few or too many cores.
    #[error("a bundle of {got} cores; {min} to {max} are possible")]
    Cores {
        /// Number asked for.
        got: usize,
        /// Fewest.
        min: usize,
        /// Most.
        max: usize,
    },
    /// The CAD mesh has no triangle.
    #[error("the CAD mesh has no triangle; a closed surface is needed")]
    EmptyMesh,
    /// A vertex is not a place near the machine.
    #[error(
        "vertex {vertex} has the coordinate {got_mm} mm; finite values within ±{limit_mm} mm are needed"
    )]
    Vertex {
        /// Index of the vertex.
        vertex: usize,
        /// The coordinate, mm.
        got_mm: f64,
        /// Largest magnitude, mm.
        limit_mm: f64,
    },
    /// More triangles than a die may have.
    #[error("the mesh of the die has {got} triangles; at most {max} are possible")]
    Triangles {
        /// Triangles there are.
        got: usize,
        /// Most.
        max: usize,
    },
    /// All triangles are points or segments.
    #[error(
        "all {triangles} triangles of the die's mesh are degenerate; at least one with area is needed"
    )]
    NoArea {
        /// Triangles there are.
        triangles: usize,
    },
    /// Damage for a die that is given as a mesh.
    #[error(
        "{got} damages are given beside the mesh of a die; a mesh is the die as it is: cut the damage into it, or leave one out"
    )]
    WearOnMesh {
        /// Damages asked for.
        got: usize,
    },
    /// A triangle names a vertex that does not exist.
    #[error("triangle {triangle} names vertex {got}, but there are only {vertices}")]
    Index {
        /// Index of the triangle.
        triangle: usize,
        /// The vertex it names.
        got: u32,
        /// Vertices there are.
        vertices: usize,
    },
    /// The mesh has no triangle where the gear data put a flank.
    #[error(
        "no triangle lies within {limit_mm} mm of the {flank:?} flank of tooth {tooth}: CAD and gear data do not belong together"
    )]
    FlankNotFound {
        /// Tooth.
        tooth: u32,
        /// Flank.
        flank: Flank,
        /// Largest distance, mm.
        limit_mm: f64,
    },
    /// Damage that this die cannot have.
    #[error(transparent)]
    Wear(#[from] WearError),
    /// More frequencies than one set may have.
    #[error("a pattern set of {got} different frequencies; at most {max} are possible")]
    Frequencies {
        /// Frequencies asked for.
        got: usize,
        /// Most.
        max: usize,
    },
    /// The view has no such pattern.
    #[error("pattern {got} was asked for; this view has 0 (black) to {last}")]
    Pattern {
        /// Index asked for.
        got: u16,
        /// Largest index.
        last: usize,
    },
    /// The buffer does not fit the sensor.
    #[error("a buffer of {got} pixels; the sensor has {need}")]
    Buffer {
        /// Length given.
        got: usize,
        /// Length needed.
        need: usize,
    },
}

impl WorldError {
    /// Refuses NaN and whatever lies outside the range.
    pub(crate) fn check(name: &'static str, got: f64, min: f64, max: f64) -> Result<(), Self> {
        if got >= min && got <= max {
            Ok(())
        } else {
            Err(Self::Parameter {
                name,
                got,
                min,
                max,
            })
        }
    }
}
