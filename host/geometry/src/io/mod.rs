//! Other people's files: meshes and clouds, checked where they enter. Everything past this floor is finite.

pub mod cloud;
mod faces;
pub mod mesh;
pub mod ply;
pub mod points;
mod unit;
mod word;

pub use unit::Unit;
