//! The scan of the whole die: many views, laid on the CAD together, merged into one map.
//!
//! ```text
//!  grid ──► captures of up to 16 views ──► view: points, pose, information, cells ──► session folder, patches
//!                                            ▲ adjustment so far                          │
//!                                            └────────────────────────────────────────────┤
//!                scan document ◄── map ◄── patches, moved ◄── adjustment, re-associated ◄─┘
//! ```
//!
//! | file | holds |
//! |---|---|
//! | `grid` | which views, in which order |
//! | `view` | one view's sums to points and a first pose |
//! | `cell_observations` | a view's points on the CAD, gathered by cells of the unrolled bore |
//! | `patches` | those cells of every view, kept on the disk until all poses are known |
//! | `session` | the session folder: points of the views that are done, from which a killed scan goes on |
//! | `stitch` | all views to one map |
//! | `overlaps` | steps between views that overlap |
//! | `reference` | whether the die sits as in an earlier scan |
//! | `bore_size` | how well the mean size of the bore is known |
//! | `die_identity` | whether it is the CAD's die at all |
//! | `coverage` | planned flank fields that were not seen |
//! | `metrics` | distances of the same points by the article's metrics |
//! | `view_pipeline` | summed frames of a view to points that are kept |
//! | `recorded` | the same scan of frames that were recorded |
//! | `clouds` | the same of clouds, without their frames |
//! | `finished` | a scan's session folder, opened again for the article's figures |
//! | `job` | orders and captures from hello to result |
//! | `describe` | the stitched views to the document |
//! | `full_cloud` | every point of every view, streamed |
//! | `fine_map` | the map in cells of a chosen size |
//! | `gear` | profile, helix and pitch of every tooth from them |
//! | `flanks` | the wear of every flank, judged as in a check |
//! | `result` | the JSON document |

mod bore_size;
mod cell_observations;
mod clouds;
mod coverage;
mod describe;
mod die_identity;
mod fine_map;
mod finished;
mod flanks;
mod full_cloud;
mod gear;
mod grid;
mod job;
mod metrics;
mod overlaps;
mod patches;
mod recorded;
mod reference;
mod result;
mod session;
mod stitch;
mod view;
mod view_pipeline;

pub use clouds::{
    CloudIndex, CloudRecording, CloudScan, CloudsError, IndexedCloud, SaveCloudsError,
};
pub use coverage::{Coverage, Hole, percent};
pub use fine_map::FineMapError;
pub use finished::{FinishedScan, FinishedScanError, SectionsError};
pub use full_cloud::CloudError;
pub use gear::{ScanGear, ScanGearError};
pub use grid::{Grid, GridError};
pub use job::{Method, Progress, ScanError, Scanner};
pub use metrics::{Metrics, MetricsError, TwoMetrics};
pub use overlaps::{Step, Steps};
pub use reference::{Placement, ReferenceError};
pub use result::{
    Adjustment, FlankSeen, OppositeTeeth, Scan, ScanRegistration, StageErrors, StageU95, Stitching,
};
pub use session::SessionError;
pub use view_pipeline::{Kept, Processing, ProcessingError};
