//! Points against CAD: meshes, registration, exact deviation, wear, verdict.
//!
//! ```text
//!  files by others            the tool, once                      per view
//!  mesh  cloud ──ply          tool::Tool ── gear                  outlier ─ registration ─ deviation ─ wear ─ verdict
//!        └─ FinitePoints      └─ surface::Surface ◄──────────────────────────┴──────────────┘
//! ```
//!
//! ```
//! use flankscope_metrology::mesh::TriMesh;
//! use flankscope_metrology::surface::Surface;
//!
//! let square = TriMesh {
//!     vertices: vec![[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [10.0, 10.0, 0.0], [0.0, 10.0, 0.0]],
//!     triangles: vec![[0, 1, 2], [0, 2, 3]],
//! };
//! let surface = Surface::new(&square)?;
//! assert_eq!(surface.closest([4.0, 5.0, 0.25]).signed_distance_mm, 0.25);
//! assert_eq!(surface.closest([4.0, 5.0, -0.25]).signed_distance_mm, -0.25);
//! # Ok::<(), flankscope_metrology::mesh::MeshError>(())
//! ```
//!
//! Millimetres and radians throughout, f64. Numbers from outside are checked where they enter ([`mesh`], [`cloud`],
//! [`tool`]) and are finite from there on.

pub mod alpha;
mod bvh;
pub mod cloud;
pub mod cylinder;
pub mod decision;
pub mod deviation;
pub mod drift;
pub mod fingerprint;
pub mod frames;
pub mod gear;
pub mod gear_evaluation;
pub mod joint;
mod leaf;
pub mod leakage;
pub mod merge;
pub mod mesh;
mod neighbours;
mod order;
pub mod outlier;
pub mod ply;
mod random;
pub mod raster;
pub mod registration;
mod simd;
pub mod spacing;
pub mod stretch;
pub mod surface;
pub mod tool;
mod triangle;
pub mod verdict;
pub mod wear;
