//! Plates with printed dots, seen from many sides, to a head: `flankscope calibrate`.
//!
//! ```text
//!  target: plates on the seat of the die      sums of one view, per core
//!              │                                        │
//!              │                    dots: centres, fringe column there
//!              │                                        │
//!              │                    label: which dot of the plate each is
//!              ▼                                        ▼
//!            adjust: camera, projector, hand-eye, plates and stage errors together ──► head
//!                                                       │
//!  views kept aside ───────────────────────► hold_out: form and scale by points that took no part
//! ```
//!
//! | file | holds |
//! |---|---|
//! | `target` | the artefact: plates, dots, sphere (`target.toml`) |
//! | `captures` | images of it from other instruments (`captures.toml`) |
//! | `dots` | dots of one view, to hundredths of a pixel |
//! | `label` | their places on the plate |
//! | `sighting` | one view: stages, plate, marks |
//! | `least_squares` | Levenberg and Marquardt |
//! | `rig` | camera and projector: where a dot appears in their images |
//! | `bundle` | bundle adjustment with robust weights, over an observation model |
//! | `model` | the observation model of plates on the stages |
//! | `adjust` | from views of plates to a head |
//! | `uncertainty` | standard uncertainty of a point by the calibration |
//! | `form` | planes and spheres through points |
//! | `hold_out` | plates measured with the result |
//! | `self_test` | a plane and a sphere, measured |
//! | `sharpest` | the setting of a lens at which the camera is sharp, by the contrast of fringes |
//! | `focus` | a head between the settings of its lens at which it was calibrated (`focus.toml`) |
//! | `record` | what it writes into the head's file |
//! | `board` | the same from an ordinary board: no certified pose, no blank plate |

mod adjust;
mod artwork;
pub mod board;
mod bundle;
mod captures;
pub mod cores;
mod dots;
mod focus;
mod form;
mod hold_out;
mod label;
mod least_squares;
mod model;
mod record;
mod rig;
mod self_test;
mod sharpest;
mod sighting;
mod target;
mod uncertainty;

pub use adjust::{Adjusted, adjust};
pub use artwork::{Artwork, PrintedMark};
pub use captures::{CapturedView, Captures};
pub use focus::{Focus, FocusError, FocusSeries, FocusedHeads};
pub use hold_out::hold_out;
pub use self_test::SelfTestError;
pub use sharpest::{
    AxialDistance, Components, MostContrast, NotSharp, Sharpest, Sharpness, coarse, fine,
    most_contrast, sharpest,
};
pub use sighting::{Mark, Sighting, StagePose};
pub use target::{Dots, KEYS, Partner, Plate, Sphere, SphereAt, StageOffset, Target, TestPlace};

/// Why there is no calibration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CalibrateError {
    /// The head file lacks something that the adjustment starts from.
    #[error("the starting head has no {what}; give the drawing's values")]
    HeadLacks {
        /// What.
        what: &'static str,
    },
    /// A head value beyond its limits.
    #[error("{key} = {got}: {expected}")]
    Head {
        /// Which.
        key: String,
        /// Its value.
        got: String,
        /// Allowed values.
        expected: std::borrow::Cow<'static, str>,
    },
    /// Too little light, or too few dots.
    #[error(
        "view {view} shows {got} dots, at least {limit} are needed: is the plate there, in focus and evenly lit?"
    )]
    FewDots {
        /// The view.
        view: usize,
        /// Dots found.
        got: usize,
        /// Least.
        limit: usize,
    },
    /// The large dots that mark the plate's middle.
    #[error(
        "view {view} shows {got} large dots, exactly 3 mark the plate's middle: is all of it in the field?"
    )]
    Keys {
        /// The view.
        view: usize,
        /// Large dots found.
        got: usize,
    },
    /// Three large dots that are not those of the plate.
    #[error(
        "the three large dots of view {view} stand as 1 : {got:.2}, right is 1 : {expected:.2}: is this plate the target's?"
    )]
    KeyShape {
        /// The view.
        view: usize,
        /// Ratio of their distances from the corner.
        got: f64,
        /// The plate's.
        expected: f64,
    },
    /// A plate that the target does not have.
    #[error("view {view} is said to show plate {got}, but the target has {plates}")]
    NoSuchPlate {
        /// The view.
        view: usize,
        /// Plate named.
        got: usize,
        /// Plates of the target.
        plates: usize,
    },
    /// Too few views.
    #[error("{got} views of printed plates, at least {limit} are needed")]
    FewViews {
        /// Views.
        got: usize,
        /// Least.
        limit: usize,
    },
    /// The views do not determine an unknown.
    #[error(
        "the views leave {unknown} uncertain by {sigma:.3}, at most {limit} is allowed: add views of plates that are tilted and turned against the others"
    )]
    Degenerate {
        /// Which.
        unknown: &'static str,
        /// Its standard uncertainty.
        sigma: f64,
        /// Largest.
        limit: f64,
    },
    /// The equations have no solution at all.
    #[error(
        "the views do not determine the head (the normal equations are singular): add views of plates that are tilted and turned against the others"
    )]
    Singular,
    /// The search did not come to an end.
    #[error(
        "the adjustment still moves after {limit} steps: are start and target those of this head?"
    )]
    NotSettled {
        /// Steps done.
        limit: usize,
    },
    /// Residuals larger than noise explains.
    #[error(
        "after the adjustment {what} are off by {got_px:.3} px rms, at most {limit_px} px are allowed: is the target this one, and was it at rest?"
    )]
    Residual {
        /// Dots, or fringes.
        what: &'static str,
        /// Root mean square.
        got_px: f64,
        /// Limit.
        limit_px: f64,
    },
    /// Many marks do not fit.
    #[error(
        "{got} of {of} dots do not fit the others, at most {limit_percent} % may: is the plate clean?"
    )]
    Outliers {
        /// Dots left out.
        got: usize,
        /// All.
        of: usize,
        /// Limit.
        limit_percent: u32,
    },
}

impl From<flankscope_foundation::textfile::BadValue> for CalibrateError {
    fn from(bad: flankscope_foundation::textfile::BadValue) -> Self {
        Self::Head {
            key: bad.key,
            got: bad.got,
            expected: bad.expected,
        }
    }
}

impl From<least_squares::NoMinimum> for CalibrateError {
    fn from(why: least_squares::NoMinimum) -> Self {
        match why {
            least_squares::NoMinimum::Singular => Self::Singular,
            least_squares::NoMinimum::NotSettled(limit) => Self::NotSettled { limit },
        }
    }
}
