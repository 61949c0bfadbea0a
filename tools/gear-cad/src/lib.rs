//! Involute gear CAD as a watertight triangle mesh.
//!
//! ```text
//! GearSpec ──spec.rs──► flank angle by radius ──profile.rs──► one pitch of the outline, chords within a stated error
//!                                              ──solid.rs───► Mesh: flanks, lands, roots, wall, end caps
//!                                              ──ply.rs, stl.rs──► bytes
//! ```
//!
//! The axis is z and a tooth *space* is centred on +x. Tooth `k` (1-based) is centred at `(k - 0.5)` pitches. Its `left`
//! flank is the one on the side of increasing angle, its `right` flank the one on the side of decreasing angle.
//! Lengths are millimetres, angles radians.
//!
//! ```
//! use flankscope_gear_cad::{GearKind, GearSpec, Meshing, write_stl};
//!
//! let gear = GearSpec {
//!     kind: GearKind::Internal,
//!     teeth: 84,
//!     module_mm: 1.0,
//!     pressure_angle_rad: 20f64.to_radians(),
//!     tip_radius_mm: 41.0,
//!     root_radius_mm: 43.25,
//!     root_fillet_radius_mm: 0.0,
//!     turned_rad: 0.0,
//!     body_radius_mm: 51.25,
//!     height_mm: [0.0, 66.0],
//! };
//! let solid = gear.mesh(&Meshing::default())?;
//! let mut bytes = Vec::new();
//! write_stl(&solid, "ring gear", &mut bytes)?;
//! assert_eq!(bytes.len(), 84 + 50 * solid.triangles.len());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod ply;
mod profile;
mod solid;
mod spec;
mod stl;
mod triangulate;

pub use ply::write_ply;
pub use solid::{Mesh, MeshError, Meshing};
pub use spec::{Flank, GearKind, GearSpec, SpecError, involute};
pub use stl::write_stl;
