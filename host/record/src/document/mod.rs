//! The documents of checks and scans, which are stored, displayed and used by later ones.
//!
//! | file | holds |
//! |---|---|
//! | `check` | the JSON document of a check, and the data of its report's pictures |
//! | `comparison` | what changed between two checks |
//! | `evidence` | recipe, phasors and problems: enough to compute the verdict again |
//! | `feature_id` | the flank or patch that a figure is of |
//! | `flank_in_view` | a flank that was in view but not requested |
//! | `identity` | how the teeth were numbered: by the operator or by the baseline |
//! | `live` | what a watch says while it runs |
//! | `scan` | the JSON document of a scan, and the data of its report's pictures |
//! | `setup` | the live view for setting up the head |

mod check;
mod comparison;
mod evidence;
mod feature_id;
mod flank_in_view;
mod identity;
mod live;
pub mod scan;
mod setup;

pub use check::{
    Expanded, Feature, FlankDetail, FlankMap, FrameCount, Handover, Inspection, LastExposure,
    Light, Pictures, Timing, Toothing, ViewRegistration, ViewStatus, WeakDirection,
};
pub use comparison::{ComparedCheck, ComparedFlank, Comparison};
pub use evidence::{Evidence, FurtherEvidence, Phasors, Problem, Recipe, RecordedRecipe};
pub use feature_id::FeatureId;
pub use flank_in_view::FlankInView;
pub use flankscope_profilometry::head::HeadDates;
pub use identity::{IdentifiedBy, ToothIdentity};
pub use live::{
    LiveCounts, LiveLine, LivePicture, LiveState, LiveStep, MOST_LIVE_BYTES, live_socket,
};
pub use setup::{
    ExpectedByHead, ExposureLevels, LostCapture, ProposedExposures, SetupCapture, SetupView,
};
