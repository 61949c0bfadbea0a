//! From a list of stage positions to the summed frames of each, through controller and camera or from a folder; what is made
//! of the sums, and what for, is somebody else's.
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
//! | `program` | positions, patterns and exposures: to a capture plan |
//! | `route` | in which order the positions are visited |
//! | `sums` | of the frames of a view, pass by pass |
//! | `session` | the threads that frames and sums pass through |
//! | `capture` | one capture followed from its plan to its last view |
//! | `recapture` | what is captured once more |
//! | `run` | what all captures of a run have gathered |
//! | `recorder` | the capture thread: frames summed where they lie |
//! | `pairing` | triggers against frames |
//! | `recording` | frames that were recorded before, in the place of a camera |
//! | `timeline` | what the devices did when |
//! | `error` | what can go wrong |

mod capture;
mod error;
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

pub use capture::RETRACT_RESERVE;
pub use error::{AcquisitionError, Progress, Stop, ViewError};
pub use pairing::{PairingError, pair};
pub use program::{Program, ProgramError, StagePosition};
pub use recapture::AfterStop;
pub use recording::{FrameIndex, ImageProblem, IndexedView, Recording, RecordingError};
pub use recording::{RecordedIndex, RecordedView, SavedView, stays_inside};
pub use route::{Route, RouteTime};
pub use run::{Counts, Run};
pub use session::Acquisition;
