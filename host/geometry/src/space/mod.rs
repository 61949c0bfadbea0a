//! Boxes, the normal of a triangle, and an order in which neighbours in space follow each other.

mod bounds;
pub mod morton;
mod normal;

pub use bounds::Aabb;
pub use normal::unit_normal;
