//! Live view for setting up the head at the die: one tooth, captured again and again by the acquisition of a check.
//!
//! | file | holds |
//! |---|---|
//! | `job` | captures in a loop, each with its figures |
//! | `cells` | modulation, contrast and points of one view's cells |
//! | `exposures` | exposures that suit the light of a capture |
//! | `head_file` | writes them into the head file |

mod cells;
mod exposures;
mod head_file;
mod job;

pub use head_file::{HeadFileError, write_exposures};
pub use job::{LiveView, LiveViewError};
