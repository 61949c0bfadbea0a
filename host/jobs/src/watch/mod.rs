//! The instrument by itself: every N press cycles it asks for the die, checks, gives the press back and shows a verdict.
//!
//! ```text
//!  press cycles ──► every N-th: wait for the press to open ──► check ──► latch ──► verdict at the press
//!                                                               │
//!                                        hold limit reached ────┴──► abort, retract, indeterminate
//! ```

mod job;

pub use job::{Checked, WatchError, WatchEvent, WatchSettings};
