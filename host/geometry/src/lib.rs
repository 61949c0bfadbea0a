//! Triangle meshes and point clouds, without gears, views or wear.
//!
//! ```text
//!  space    boxes, normals, order in space
//!  io       other people's meshes and clouds, checked where they enter
//!  surface  triangles: exact signed distance, random points
//!  cloud    points by themselves: neighbours, outliers, merging
//! ```
//!
//! A floor uses those above it in this list, never one below.
//!
//! ```
//! use flankscope_geometry::io::mesh::TriMesh;
//! use flankscope_geometry::surface::Surface;
//!
//! let square = TriMesh {
//!     vertices: vec![[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [10.0, 10.0, 0.0], [0.0, 10.0, 0.0]],
//!     triangles: vec![[0, 1, 2], [0, 2, 3]],
//! };
//! let surface = Surface::new(&square)?;
//! assert_eq!(surface.closest([4.0, 5.0, 0.25]).signed_distance_mm, 0.25);
//! assert_eq!(surface.closest([4.0, 5.0, -0.25]).signed_distance_mm, -0.25);
//! # Ok::<(), flankscope_geometry::io::mesh::MeshError>(())
//! ```
//!
//! Millimetres throughout, f64. Numbers from outside are checked where they enter ([`io`]) and are finite from there on.
#![warn(missing_docs)]

pub mod cloud;
pub mod io;
pub mod space;
pub mod surface;
