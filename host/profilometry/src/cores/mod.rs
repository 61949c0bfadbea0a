//! The fibre bundle in the camera's image: where its cores lie, how bright they are, and one cell per core.
//!
//! A pixel inside a core sees that core's one phase, wherever in the core it lies: triangulated along the pixel's own
//! ray it makes a staircase. So a flat-field capture is searched for the cores ([`find`]), the result is kept beside
//! the head's file ([`CoreMap`]), and views are summed core by core and triangulated along the cores' rays
//! ([`CoreGrid`]).

pub(crate) mod buckets;
mod find;
mod grid;
mod map;

pub use find::{FindError, FlatField, find};
pub(crate) use grid::BOX_PX;
pub use grid::CoreGrid;
pub use map::{CoreMap, CoreMapError, CoreMapFile};
