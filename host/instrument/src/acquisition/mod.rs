//! Turns a list of stage positions into the summed frames of each view, captured through controller and camera or read from a folder.
//! Evaluation of the sums belongs to the caller.
//!
//! ```text
//!  I/O runtime           capture thread            compute thread
//!  ───────────           ──────────────            ──────────────
//!  hello, home, plan ──► armed
//!  start ──────────────► frame, frame, … summed
//!  triggers collected    view ───────────► pair ─► what `evaluate` makes of the sums
//!  retracting                                      └► outcome
//! ```
//!
//! | file | holds |
//! |---|---|
//! | `program` | converts positions, patterns and exposures to a capture plan |
//! | `route` | in which order the positions are visited |
//! | `sums` | running sums of a view's frames, pass by pass |
//! | `session` | the threads that frames and sums pass through |
//! | `levels` | histograms of the pixel levels of a view, where a job asks for them |
//! | `capture` | one capture, from its plan to its last view |
//! | `recapture` | which views are captured a second time |
//! | `run` | results that all captures of a run have gathered |
//! | `recorder` | the capture thread: sums frames in shared memory, without a copy |
//! | `pairing` | compares triggers with frames |
//! | `recording` | recorded frames in place of a camera |
//! | `timeline` | activity of the devices over time |
//! | `error` | errors, and the progress of a run |

mod capture;
mod error;
mod levels;
mod pairing;
mod program;
mod recapture;
mod recorder;
mod recording;
mod route;
mod run;
mod session;
mod sums;
mod timeline;

pub use error::{AcquisitionError, Progress, Stop, ViewError};
pub use levels::{LevelHistogram, ViewLevels};
pub use pairing::{PairingError, pair};
pub use program::{Program, ProgramError, StagePosition};
pub use recapture::AfterStop;
pub use recording::{FrameIndex, ImageProblem, IndexedView, Recording, RecordingError};
pub use recording::{RecordedIndex, RecordedView, SavedView, stays_inside};
pub use route::{Route, RouteTime};
pub use run::{Counts, Run};
pub use session::Acquisition;
