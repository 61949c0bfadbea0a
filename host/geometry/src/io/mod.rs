//! Other people's files: meshes and clouds, checked where they enter. Everything past this floor is finite.

pub mod cloud;
mod faces;
pub mod mesh;
mod non_finite;
pub mod ply;
pub mod points;
mod unit;
mod word;

pub use non_finite::NonFinite;
pub use unit::Unit;
