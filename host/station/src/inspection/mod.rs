//! The in-situ check: a few critical teeth, between two strokes, to one verdict.
//!
//! | file | holds |
//! |---|---|
//! | `plan` | which poses, patterns and exposures: from tool and head to a capture plan |
//! | `job` | one check, from hello to verdict |
//! | `station` | the threads that frames and sums pass through |
//! | `capture` | one capture followed from its plan to its last view |
//! | `repeat` | what is too near to a limit is measured again |
//! | `run` | what a running check has gathered |
//! | `recorder` | the capture thread: frames summed where they lie |
//! | `pairing` | triggers against frames |
//! | `views` | one view's sums to points, pose and wear |
//! | `head_error` | what the head's calibration leaves uncertain of a flank |
//! | `judge` | a view's flanks, measured once or more often, against limits and baseline |
//! | `findings` | all views to what is said of the tool |
//! | `evidence` | what a verdict was computed from |
//! | `verdict` | flanks to one verdict |
//! | `timeline` | what the devices did when |
//! | `result` | the JSON document and the report's material |

mod capture;
mod evidence;
mod findings;
mod head_error;
mod influence;
mod job;
mod judge;
mod pairing;
mod plan;
mod recorder;
mod repeat;
mod result;
mod run;
mod station;
mod timeline;
mod verdict;
mod views;

pub use evidence::{Evidence, Phasors, Recipe};
pub(crate) use findings::Findings;
pub(crate) use head_error::calibration_um;
pub(crate) use job::peak_memory_mb;
pub use job::{InspectError, Progress, Subject};
pub use pairing::{PairingError, pair};
pub use plan::{Itinerary, PlannedView, PlanningError};
pub use recorder::ViewError;
pub use result::{
    Expanded, Feature, FlankDetail, FlankMap, FrameCount, Handover, Inspection, Pictures, Timing,
    ViewRegistration, WeakDirection,
};
pub(crate) use run::Run;
pub use station::Station;
pub use verdict::Judged;
pub(crate) use verdict::unmeasured_flank;
pub use views::{Evaluator, EvaluatorError, ViewOutcome};
pub(crate) use views::{
    OUTLIER_NEIGHBOURS, OUTLIER_RATIO, field_slope, hand_eye, rays_without_point, reach_mm,
};
pub(crate) use views::{ROTATION_SIGMA_RAD, VERTICAL_SIGMA_MM};
