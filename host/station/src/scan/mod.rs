//! The scan of the whole die: many views, laid on the CAD together, merged into one map.
//!
//! ```text
//!  grid ──► captures of up to 16 views ──► view: points, pose, information, cells ──► session folder, patches
//!                                            ▲ joint solve so far                         │
//!                                            └────────────────────────────────────────────┤
//!                scan document ◄── map ◄── patches, moved ◄── joint solve, re-associated ◄┘
//! ```
//!
//! | file | holds |
//! |---|---|
//! | `grid` | which views, in which order |
//! | `view` | one view's sums to points and a first pose |
//! | `lay` | a view's points on the CAD, gathered by cells of the unrolled bore |
//! | `patches` | those cells of every view, kept on the disk until all poses are known |
//! | `session` | what is kept of a scan that is killed |
//! | `stitch` | all views to one map |
//! | `overlaps` | what neighbours say of each other |
//! | `reference` | whether the die sits as in an earlier scan |
//! | `stranger` | whether it is the CAD's die at all |
//! | `paper` | all views to one map the article's way |
//! | `comparison` | both ways in the same figures |
//! | `coverage` | what should have been seen and was not |
//! | `metrics` | what the article's ways of measuring a distance would have said |
//! | `workshop` | what is done with a view once its frames are there |
//! | `job` | orders and captures from hello to result |
//! | `describe` | what was stitched, to the document |
//! | `flanks` | the wear of every flank, judged as in a check |
//! | `result` | the JSON document |

mod comparison;
mod coverage;
mod describe;
mod flanks;
mod grid;
mod job;
mod lay;
mod metrics;
mod overlaps;
mod paper;
mod patches;
mod reference;
mod result;
mod session;
mod stitch;
mod stranger;
mod view;
mod workshop;

pub use comparison::{Creep, LayerDrift, Method, MethodResult, ScanDrift, Spread, Trend};
pub use coverage::{Coverage, Hole, percent};
pub use grid::{Grid, GridError};
pub use job::{Progress, ScanError, Scanner};
pub use metrics::{Metrics, MetricsError, TwoMetrics};
pub use overlaps::{Step, Steps};
pub use paper::PaperSettings;
pub use reference::{Placement, ReferenceError};
pub use result::{
    FlankSeen, Form, Joint, OppositeTeeth, Scan, ScanRegistration, StageErrors, Stitching,
};
pub use session::SessionError;
pub use workshop::{Kept, Processing, ProcessingError};
