//! The documents of checks: what is stored, shown and believed later.
//!
//! | file | holds |
//! |---|---|
//! | `check` | the JSON document of a check, and what only a report draws |
//! | `evidence` | recipe, phasors and problems: enough to compute the verdict again |
//! | `feature_id` | the flank or patch that a figure is of |
//! | `flank_in_view` | a flank that was in view and not asked for |
//! | `identity` | which tooth is which, by the operator's word or by the baseline |

mod check;
mod evidence;
mod feature_id;
mod flank_in_view;
mod identity;

pub use check::{
    Expanded, Feature, FlankDetail, FlankMap, FrameCount, Handover, Inspection, Light, Pictures,
    Timing, Toothing, ViewRegistration, ViewStatus, WeakDirection,
};
pub use evidence::{Evidence, Phasors, Problem, Recipe, RecordedRecipe};
pub use feature_id::FeatureId;
pub use flank_in_view::FlankInView;
pub use identity::{IdentifiedBy, ToothIdentity};
