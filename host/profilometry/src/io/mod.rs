//! Other people's files: grey images, OpenCV's FileStorage.

pub mod images;
pub(crate) mod opencv;

pub use opencv::is_file_storage;
