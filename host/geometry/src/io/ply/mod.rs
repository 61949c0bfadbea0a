//! The PLY container: header, bodies in ascii and both byte orders, and a writer.
//!
//! PLY files are other people's files. The header is read first and every declared count is held against the bytes
//! that are really there before anything is allocated for it.

mod body;
mod error;
mod header;
mod write;

pub use body::{Extra, Table, Want, read};
pub use error::PlyError;
pub use header::{Encoding, Scalar};
pub(crate) use write::check_lengths;
pub use write::{Column, write_mesh};
