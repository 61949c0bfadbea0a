//! Points against CAD: registration, deviation, wear, verdict. Meshes, clouds and exact distance come from `flankscope-geometry`, whose
//! modules stand here, too.
//!
//! ```text
//!  kinematics    from commanded stages to the pose of the camera
//!  view          where a view is taken
//!  gear          teeth and flanks, ISO 1328 evaluation
//!  patch         any other parts of the CAD, each with a frame of its own
//!  feature       where on flanks or patches a point lies
//!  registration  one cloud laid on CAD
//!  deviation     distances of the points laid on it
//!  cloud_surface a cloud as the surface that another one is laid on
//!  multiview     many views laid on CAD together, merged over the bore
//!  wear          what is missing from a flank, with its uncertainty
//!  verdict       figures against limits
//!  tool          the file that names the CAD, the flanks and the limits
//! ```
//!
//! A floor uses those above it in this list, never one below.
//!
//! ```
//! use flankscope_metrology::io::mesh::TriMesh;
//! use flankscope_metrology::surface::Surface;
//!
//! let square = TriMesh {
//!     vertices: vec![[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [10.0, 10.0, 0.0], [0.0, 10.0, 0.0]],
//!     triangles: vec![[0, 1, 2], [0, 2, 3]],
//! };
//! let surface = Surface::new(&square)?;
//! assert_eq!(surface.closest([4.0, 5.0, 0.25]).signed_distance_mm, 0.25);
//! assert_eq!(surface.closest([4.0, 5.0, -0.25]).signed_distance_mm, -0.25);
//! # Ok::<(), flankscope_metrology::io::mesh::MeshError>(())
//! ```
//!
//! Millimetres and radians throughout, f64. Numbers from outside are checked where they enter ([`io`], [`tool`]) and are finite from there on.
#![warn(missing_docs)]

pub mod cloud_surface;
pub mod deviation;
pub mod feature;
pub mod gear;
pub mod kinematics;
pub mod multiview;
pub mod patch;
pub mod registration;
pub mod tool;
pub mod verdict;
pub mod view;
pub mod wear;

pub use flankscope_geometry::{cloud, io, space, surface};
