//! A head calibrated by the instrument itself: captures of a target's plates, to a head file.
//!
//! ```text
//!  blank plate, pixel by pixel ──► cores ──► plates, core by core ──► dots ──► adjustment ──► head
//!                                                └── some kept aside ──────────► hold-out ──► record
//! ```
//!
//! | file | holds |
//! |---|---|
//! | `survey` | captures of a list of stage positions, each handed on as it comes |
//! | `views` | which positions a target asks for |
//! | `job` | from the captures to the head |
//! | `folder` | the same from images made elsewhere |
//! | `board` | a head from an ordinary board, of images made elsewhere |
//! | `autofocus` | the blank plate at setting after setting of a driven lens |
//! | `fitness` | plane and sphere measured with it, today and every week |

mod autofocus;
mod board;
mod fitness;
mod folder;
mod job;
mod survey;
mod views;

pub use autofocus::{Autofocus, Focused};
pub use board::{BoardFolder, BoardFolderError};
pub use fitness::{FitnessSurvey, save_self_test};
pub use folder::CaptureFolder;
pub use job::{
    Calibrated, CalibrationError, CoreSearch, PlateSurvey, SaveError, ViewReport, save_head,
};
pub use survey::{SurveyError, Surveyor};
