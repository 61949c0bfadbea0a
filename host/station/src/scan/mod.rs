//! The scan of the whole die: many views, laid on the CAD together, merged into one map.
//!
//! ```text
//!  grid ──► captures of up to 16 views ──► view: points, pose, information ──► session folder
//!                                            ▲ joint solve so far                   │
//!                                            └──────────────────────────────────────┤
//!                              scan document ◄── map ◄── joint solve, re-associated ┘
//! ```
//!
//! | file | holds |
//! |---|---|
//! | `grid` | which views, in which order |
//! | `view` | one view's sums to points and a first pose |
//! | `session` | what is kept of a scan that is killed |
//! | `stitch` | all views to one map |
//! | `paper` | all views to one map the article's way |
//! | `comparison` | both ways in the same figures |
//! | `job` | orders and captures from hello to result |
//! | `result` | the JSON document |

mod comparison;
mod grid;
mod job;
mod paper;
mod result;
mod session;
mod stitch;
mod view;

pub use comparison::{LayerDrift, Method, MethodResult, ScanDrift, Spread, Trend};
pub use grid::{Grid, GridError};
pub use job::{Progress, ScanError, Scanner};
pub use paper::PaperSettings;
pub use result::{Form, Joint, OppositeTeeth, Scan, ScanRegistration, StageErrors};
pub use session::SessionError;
