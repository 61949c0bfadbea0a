//! Other people's files: meshes and clouds, checked where they enter. Everything past this floor is finite.

pub mod cloud;
pub mod mesh;
pub mod ply;
