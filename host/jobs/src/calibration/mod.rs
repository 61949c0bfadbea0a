//! Calibration of a head by the instrument: from captures of a target's plates to a head file.
//!
//! ```text
//!  blank plate, pixel by pixel ──► cores ──► plates, core by core ──► dots ──► adjustment ──► head
//!                                                └── some kept aside ──────────► hold-out ──► record
//! ```
//!
//! | file | holds |
//! |---|---|
//! | `survey` | captures at a list of stage positions, each passed on when complete |
//! | `views` | stage positions for a target |
//! | `job` | from captures to the head |
//! | `folder` | calibration from images of a target captured elsewhere |
//! | `board` | calibration from images of an ordinary board captured elsewhere |
//! | `artwork` | what is to be printed on a target's plates |
//! | `autofocus` | captures of the blank plate, or of a tooth, at several settings of a driven lens |
//! | `fitness` | regular test of a calibrated head with plane and sphere |

mod artwork;
mod autofocus;
mod board;
mod fitness;
mod folder;
mod job;
mod survey;
mod views;

pub use artwork::target_artwork;
pub(crate) use autofocus::lit_cells;
pub use autofocus::{Autofocus, DieFocus, Focused};
pub use board::{BoardFolder, BoardFolderError, board_artwork};
pub use fitness::{FitnessSurvey, save_self_test};
pub use folder::CaptureFolder;
pub use job::{
    Calibrated, CalibrationError, CoreSearch, PlateSurvey, SaveError, ViewReport, save_head,
};
pub use survey::{SurveyError, Surveyor};
