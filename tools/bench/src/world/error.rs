//! Errors of a world, a view or a frame.

use flankscope_gear_cad::Flank;

use super::WearError;

/// Why a world, view or frame cannot be computed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum WorldError {
    /// A parameter lies outside the range that the model describes.
    #[error("{name} is {got}; it must be a number from {min} to {max}")]
    Parameter {
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
    #[error("the CAD mesh has no triangle; a closed surface is needed")]
    EmptyMesh,
    /// A vertex coordinate is not finite, or too far away.
    #[error(
        "vertex {vertex} has the coordinate {got_mm} mm; finite values within ±{limit_mm} mm are needed"
    )]
    Vertex {
        /// Index of the vertex.
        vertex: usize,
        got_mm: f64,
        /// Largest magnitude, mm.
        limit_mm: f64,
    },
    /// The mesh has too many triangles.
    #[error("the mesh of the die has {got} triangles; at most {max} are possible")]
    Triangles {
        /// Number of triangles.
        got: usize,
        max: usize,
    },
    /// All triangles are points or segments.
    #[error(
        "all {triangles} triangles of the die's mesh are degenerate; at least one with area is needed"
    )]
    NoArea {
        /// Number of triangles.
        triangles: usize,
    },
    #[error(
        "{got} damages are given beside the mesh of a die; a mesh is the die as it is: cut the damage into it, or leave one out"
    )]
    WearOnMesh {
        /// Number of damages.
        got: usize,
    },
    /// A triangle refers to a vertex that does not exist.
    #[error("triangle {triangle} names vertex {got}, but there are only {vertices}")]
    Index {
        triangle: usize,
        got: u32,
        /// Number of vertices.
        vertices: usize,
    },
    /// The mesh has no triangle at the flank position of the gear data.
    #[error(
        "no triangle lies within {limit_mm} mm of the {flank:?} flank of tooth {tooth}: CAD and gear data do not belong together"
    )]
    FlankNotFound {
        tooth: u32,
        flank: Flank,
        /// Largest distance, mm.
        limit_mm: f64,
    },
    /// The damage is not possible for this die.
    #[error(transparent)]
    Wear(#[from] WearError),
    /// A set has too many frequencies.
    #[error("a pattern set of {got} different frequencies; at most {max} are possible")]
    Frequencies {
        /// Number of frequencies.
        got: usize,
        max: usize,
    },
    /// The view does not have this pattern.
    #[error("pattern {got} was asked for; this view has 0 (black) to {last}")]
    Pattern {
        /// Requested index.
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
    /// Refuses values outside the range, and NaN.
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
