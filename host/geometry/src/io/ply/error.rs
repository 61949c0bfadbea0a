//! Errors of PLY files.

use super::header::Scalar;

/// Reasons for which a PLY file is refused.
#[derive(Debug, thiserror::Error, PartialEq)]
#[non_exhaustive]
pub enum PlyError {
    /// The first line is not `ply`.
    #[error("not a PLY file: the first line is not `ply`")]
    Foreign,
    /// The header has no `end_header` within its largest allowed size.
    #[error(
        "the PLY header does not end: no `end_header` in the first {searched} bytes; the file is truncated or not PLY"
    )]
    HeaderOpen {
        /// Bytes searched.
        searched: usize,
    },
    /// A header line that the format does not know.
    #[error("line {line}: PLY header line {text:?} not understood; right would be {expected}")]
    HeaderLine {
        /// Line number, from 1.
        line: usize,
        /// The line, shortened.
        text: String,
        /// Valid contents.
        expected: &'static str,
    },
    /// An element without properties claims records.
    #[error(
        "PLY element `{element}` declares {count} records without any property; an element needs at least one `property` line"
    )]
    NoProperties {
        /// Element name.
        element: String,
        /// Declared records.
        count: u64,
    },
    /// The header promises more than the file holds.
    #[error(
        "PLY element `{element}` declares {count} records, which need at least {need_bytes} bytes, but {have_bytes} are left; the file is truncated or its header lies"
    )]
    CountBeyondFile {
        /// Element name.
        element: String,
        /// Declared records.
        count: u64,
        /// Smallest number of bytes that these records can have.
        need_bytes: u128,
        /// Bytes that are left.
        have_bytes: usize,
    },
    /// The body ended inside a record.
    #[error("the PLY file ends inside record {index} of element `{element}`; it is truncated")]
    Truncated {
        /// Element name.
        element: String,
        /// Record, from 0.
        index: u64,
    },
    /// An element that the caller needs is absent.
    #[error("the PLY file has no element `{element}`")]
    MissingElement {
        /// Element name.
        element: &'static str,
    },
    /// A property that the caller needs is absent or of the wrong kind.
    #[error("PLY element `{element}` has no {expected} property `{property}`")]
    MissingProperty {
        /// Element name.
        element: &'static str,
        /// Property name.
        property: &'static str,
        /// Kind of property that would be right.
        expected: &'static str,
    },
    /// Text where a number belongs.
    #[error("line {line}: {text:?} is not a number of PLY type {kind}")]
    Number {
        /// Line number, from 1.
        line: usize,
        /// The token, shortened.
        text: String,
        /// Expected type.
        kind: Scalar,
    },
    /// A vertex with NaN or infinity.
    #[error("vertex {index}{place}: coordinate {axis} is {value}; every coordinate must be finite")]
    NonFinite {
        /// Vertex, from 0.
        index: u64,
        /// ` (line N)` in a text file, else empty.
        place: Place,
        /// `x`, `y` or `z`.
        axis: char,
        /// The value.
        value: f64,
    },
    /// A face with fewer than three corners or a negative length.
    #[error("face {face} has {corners} corners; a face needs at least 3")]
    FaceCorners {
        /// Face, from 0.
        face: u64,
        /// Declared corners.
        corners: i64,
    },
    /// A face that names a vertex which does not exist.
    #[error("face {face} names vertex {index}, but the file has vertices 0..{vertices}")]
    IndexOutOfRange {
        /// Face, from 0.
        face: u64,
        /// The index.
        index: i64,
        /// Number of vertices.
        vertices: u64,
    },
}

/// Position in a text file; prints as nothing for a binary one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Place(pub Option<usize>);

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.0 {
            Some(line) => write!(f, " (line {line})"),
            None => Ok(()),
        }
    }
}

/// A short printable form of foreign text for an error line.
pub(super) fn shorten(text: &[u8]) -> String {
    String::from_utf8_lossy(&text[..text.len().min(40)]).into_owned()
}
