//! Unattended operation: every N press cycles the watch waits for the press to open, checks the die, releases the press and shows
//! a verdict.
//!
//! ```text
//!  press cycles ──► every N-th: wait for the press to open ──► check ──► latch ──► verdict at the press
//!                                                               │
//!                                        hold limit reached ────┴──► abort, retract, indeterminate
//! ```

mod job;

pub use job::{Checked, WatchError, WatchEvent, WatchSettings};
