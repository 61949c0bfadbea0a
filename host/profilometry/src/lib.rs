//! Fringe images to points with a standard uncertainty each.
//!
//! ```text
//!  frames (borrowed)            accumulate            phase         unwrap          triangulate        decode
//!  dark, then exposure by  ->  one phasor per  ->  phase and  ->  absolute    ->  camera ray x    ->  Cloud: mm, camera frame,
//!  exposure, set by set,       cell and set        sigma_phi      phase           sheet of light      sigma_z per point
//!  step by step
//! ```
//!
//! No frame is ever copied or kept: each is read once, while it is added. What a *cell* is (a pixel, a block of pixels,
//! or a core of the fibre bundle) is decided by [`grid::Grid`]; the instrument's geometry comes from [`calibration::HeadModel`], the
//! projected patterns from [`pattern::PatternSet`]. [`decode::Decoder`] joins them and is made once per head.
//!
//! Depends on nothing of the instrument: `station` and `cli` use it, it uses neither, and it does not know `metrology`.
//!
//! ```
//! use flankscope_profilometry::{decode::{DecodeOptions, Decoder}, calibration::HeadModel, frame::{FrameKind, FrameView}, pattern::PatternSet};
//! # fn frames() -> Vec<(Vec<u16>, FrameKind)> { Vec::new() }
//! # fn run(head: &HeadModel) -> Result<(), Box<dyn std::error::Error>> {
//! let patterns = PatternSet::named("insitu12")?;
//! let decoder = Decoder::new(head, &patterns, &[10_000, 20_000], DecodeOptions::for_head(head))?;
//! let mut accumulator = decoder.begin();
//! for (pixels, kind) in frames() {
//!     accumulator.add(FrameView::packed(&pixels, 1920, 1200), kind)?;
//! }
//! let decoded = decoder.finish(&accumulator)?;
//! println!("{} points", decoded.cloud.len());
//! # Ok(()) }
//! ```

// `!(value > limit)` is meant: a NaN must fail every check.
#![allow(clippy::neg_cmp_op_on_partial_ord)]

pub mod accumulate;
pub mod calibrate;
pub mod calibration;
pub mod camera;
mod cell_row;
pub mod cloud;
pub mod consistency;
pub mod cores;
pub mod date;
pub mod decode;
pub mod frame;
pub mod grid;
pub mod images;
pub mod mask;
mod neighbours;
mod opencv;
pub mod options;
pub mod pattern;
pub mod phase;
pub mod phasors;
pub mod plan;
mod rays;
pub mod residual;
pub mod smoothing;
pub mod textfile;
pub mod triangulate;
pub mod unwrap;

pub use accumulate::Accumulator;
pub use calibration::HeadModel;
pub use decode::{Cloud, DecodeError, DecodeOptions, Decoded, Decoder};
pub use frame::{FrameError, FrameKind, FrameLevel, FrameView};
pub use pattern::{FringeSet, PatternSet};
pub use phasors::PhasorsError;
