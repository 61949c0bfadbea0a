//! Frames of reference, boxes, and an order in which neighbours in space follow each other.

mod bounds;
pub mod frames;
pub(crate) mod morton;

pub use bounds::Aabb;
