//! Points against CAD: meshes, registration, exact deviation, wear, verdict.
//!
//! Millimetres and radians throughout, f64. Numbers from outside are checked where they enter ([`mesh`], [`cloud`],
//! [`tool`]) and are finite from there on.

pub mod alpha;
mod bvh;
pub mod cloud;
pub mod deviation;
pub mod frames;
pub mod gear;
pub mod mesh;
pub mod outlier;
pub mod ply;
mod random;
pub mod registration;
pub mod surface;
pub mod tool;
mod triangle;
pub mod verdict;
pub mod wear;
