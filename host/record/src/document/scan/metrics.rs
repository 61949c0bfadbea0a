//! The article's distance metrics beside the exact distance, on the same points.

use flankscope_metrology::deviation::Statistics;
use serde::Serialize;

/// Both metrics on the same points.
#[derive(Clone, Debug, Serialize)]
pub struct TwoMetrics {
    /// Signed distance to the surface.
    pub exact: Option<Statistics>,
    /// Distance to the nearest reference point.
    pub nearest: Option<Statistics>,
    /// Signed distances, µm.
    #[serde(skip)]
    pub exact_um: Vec<f64>,
    /// Distances to the nearest reference point, µm.
    #[serde(skip)]
    pub nearest_um: Vec<f64>,
}

/// The article's metrics, with the exact distance for comparison.
#[derive(Clone, Debug, Serialize)]
pub struct Metrics {
    /// Number of the view in `one_view`.
    pub view: usize,
    /// All points of one view in its final pose.
    pub one_view: TwoMetrics,
    /// One point per cell of the map.
    pub merged: TwoMetrics,
}
