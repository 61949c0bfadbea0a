//! The in-situ check: a few critical teeth, between two strokes, to one verdict.

mod result;

pub use result::{
    Feature, FlankMap, FrameCount, Inspection, Pictures, Timing, ViewRegistration, WeakDirection,
};
