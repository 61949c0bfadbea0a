//! Fringe images to points with a standard uncertainty each.
//!
//! ```text
//!  gray         reflected Gray code: which stripe of the projector lights a cell
//!  pattern      the projected fringes: frequencies and their phase steps, and a code
//!  frame        one camera frame, borrowed where it lies
//!  io           other people's files: grey images, OpenCV calibrations
//!  counts       range of the camera's counts in images of others
//!  head         camera, projector, sensor, core map, calibration record (`head.toml`)
//!  cells        which pixels make a cell: blocks of them, or the cores of a bundle
//!  accumulate   frames to one phasor per cell and frequency, streaming
//!  phase        phasor to wrapped phase, modulation and their standard uncertainty
//!  unwrap       wrapped phases of several frequencies to one absolute phase
//!  triangulate  camera ray and projector column to a depth
//!  cloud        points, and why other cells gave none
//!  decode       the whole way, made once per head: sums of a view to a cloud (mm, camera frame, sigma_z per point)
//!  frame_order  whether frames come in the order that their plan says
//!  plan         external captures: which image shows which frame
//!  calibrate    captures of a target to a head, and the head's self-test
//! ```
//!
//! A module uses those above it in this list, never one below.
//!
//! No frame is ever copied or kept: each is read once, while it is added. [`cells::Grid`] decides whether a *cell* is a pixel, a block
//! of pixels, or a core of the fibre bundle; the instrument's geometry comes from [`head::HeadModel`], the
//! projected patterns from [`pattern::PatternSet`]. [`decode::Decoder`] joins them and is made once per head.
//!
//! It knows neither the instrument nor `metrology`.
//!
//! ```
//! use flankscope_profilometry::{decode::{DecodeOptions, Decoder}, head::HeadModel, frame::{FrameKind, FrameView}, pattern::PatternSet};
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
#![warn(missing_docs)]
// `!(value > limit)` is meant: a NaN must fail every check.
#![allow(clippy::neg_cmp_op_on_partial_ord)]

pub mod accumulate;
pub mod calibrate;
pub mod cells;
pub mod cloud;
pub mod counts;
pub mod decode;
pub mod frame;
pub mod frame_order;
pub mod gray;
pub mod head;
pub mod io;
pub mod pattern;
pub mod phase;
pub mod plan;
pub mod triangulate;
pub mod unwrap;

pub use accumulate::{Accumulator, PhasorsError};
pub use decode::{Cloud, DecodeError, DecodeOptions, Decoded, Decoder};
pub use frame::{FrameError, FrameKind, FrameLevel, FrameView, Picture};
pub use head::HeadModel;
pub use pattern::{FringeSet, PatternSet};
