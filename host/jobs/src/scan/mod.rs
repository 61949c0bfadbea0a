//! The scan of the whole die: many views, registered to the CAD together and merged into one map.
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
//! | `grid` | positions and order of the views |
//! | `view` | from one view's sums to points and a first pose |
//! | `cell_observations` | a view's points on the CAD, collected in cells of the unrolled bore |
//! | `patches` | the cells of every view, on disk until all poses are known |
//! | `session` | the session folder: points of finished views, from which an interrupted scan is continued |
//! | `stitch` | from all views to one map |
//! | `overlaps` | steps between overlapping views |
//! | `reference` | tests whether the die is placed as in an earlier scan |
//! | `bore_size` | uncertainty of the mean bore size |
//! | `die_identity` | tests whether the die is that of the CAD |
//! | `coverage` | planned fields of flanks that were not measured |
//! | `metrics` | the article's distance metrics for the same points |
//! | `view_pipeline` | from summed frames of a view to points in the session folder |
//! | `recorded` | the scan of recorded frames |
//! | `clouds` | the scan of recorded clouds, without frames |
//! | `finished` | opens a session folder again for the article's figures |
//! | `job` | captures and evaluation from connecting to the result |
//! | `describe` | writes the document of the stitched views |
//! | `full_cloud` | every point of every view, streamed |
//! | `fine_map` | the map in cells of a chosen size |
//! | `gear` | profile, helix and pitch of every tooth |
//! | `flanks` | the wear of every flank, judged as in a check |

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
mod session;
mod stitch;
mod view;
mod view_pipeline;

pub use clouds::{
    CloudIndex, CloudRecording, CloudScan, CloudsError, IndexedCloud, SaveCloudsError,
};
pub use fine_map::FineMapError;
pub use finished::{FinishedScan, FinishedScanError, SectionsError};
pub use full_cloud::CloudError;
pub use gear::ScanGearError;
pub use grid::{Grid, GridError};
pub use job::{Method, Progress, ScanError, Scanner};
pub use metrics::MetricsError;
pub use reference::ReferenceError;
pub use session::SessionError;
