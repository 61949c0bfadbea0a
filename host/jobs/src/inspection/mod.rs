//! The in-situ check: a few critical teeth, measured between two strokes, with one verdict.
//!
//! | file | holds |
//! |---|---|
//! | `job` | one check, from connecting to the verdict |
//! | `recorded` | the same check with recorded frames |
//! | `recipe` | the part of a plan that tool and head file do not state, for a replay |
//! | `repeat` | repeats views whose wear is too near to a limit |
//! | `views` | from one view's sums to points, pose and wear |
//! | `exposures` | tests whether the exposures of a view show the same scene |
//! | `outcome` | outcome of one view, captured once or more often |
//! | `fit` | registration of a view to the CAD |
//! | `mount` | pose by the lands, in the mounting of the baseline |
//! | `datum` | points inside a patch's datum, or on bands that the workpiece never touches |
//! | `die_size` | tests whether the die in view has the drawing's size |
//! | `maps` | deviation maps for a report |
//! | `head_error` | uncertainty of a flank due to the head's calibration |
//! | `flank_decision` | a view's flanks, measured once or more often, against limits and baseline |
//! | `in_view` | flanks in a view other than the requested ones, and missing teeth |
//! | `findings` | from outcomes of all views to the findings of a check |
//! | `verdict` | from flanks to one verdict |
//! | `foreign_cloud` | the same figures and rules for a cloud of another scanner |

mod datum;
mod die_size;
mod exposures;
mod findings;
mod fit;
mod flank_decision;
mod foreign_cloud;
mod head_error;
mod in_view;
mod job;
mod maps;
mod mount;
mod outcome;
mod place;
mod recipe;
mod recorded;
mod repeat;
mod verdict;
mod views;

pub(crate) use exposures::exposures_disagree;
pub(crate) use findings::Findings;
pub use foreign_cloud::{CloudPose, CloudVerdict, ForeignCloud, judge_cloud};
pub(crate) use head_error::calibration_um;
pub use in_view::InView;
pub use job::InspectError;
pub use outcome::ViewOutcome;
pub(crate) use recipe::recipe;
pub(crate) use recorded::tooth_in_middle;
pub use verdict::Judged;
pub(crate) use verdict::unmeasured_flank;
pub use views::{Evaluator, EvaluatorError};
pub(crate) use views::{OUTLIER_NEIGHBOURS, OUTLIER_RATIO, hand_eye, rays_without_point};
