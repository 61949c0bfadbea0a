//! Forecast for one flank or patch from its history.

use serde::Serialize;

use super::change::changes;
use super::remaining::Passage;
use super::series::{Point, Series};
use super::trend::Trend;
use crate::document::FeatureId;

/// Trend, changes and remaining cycles of one flank.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Forecast {
    /// Which flank or patch.
    #[serde(flatten)]
    pub id: FeatureId,
    /// Warn limit, µm.
    pub warn_um: f64,
    /// Stop limit, µm.
    pub limit_um: f64,
    /// Numbers of the checks at which the wear left its line: a chip, another tool, another rate.
    pub changes: Vec<i64>,
    /// The line since the last change; absent while there are too few values.
    pub trend: Option<Trend>,
    /// Cycles until the stop limit, counted from the last value.
    pub remaining_cycles: Remaining,
    /// The values.
    pub points: Vec<Point>,
}

/// Quantiles of the remaining cycles; absent without a trend, or if the limit is not reached within the horizon.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Remaining {
    /// 5 % quantile.
    pub q05: Option<f64>,
    /// Median.
    pub q50: Option<f64>,
}

impl Forecast {
    /// Computes the forecast from a flank's values.
    #[must_use]
    pub fn of(series: Series) -> Self {
        let changed = changes(&series.points, series.warn_um);
        let since = &series.points[changed.last().copied().unwrap_or(0)..];
        let trend = Trend::of(since);
        let remaining_cycles = match (trend, series.points.last()) {
            (Some(trend), Some(last)) => {
                let way = Passage::new(&trend, since, last.u_um, series.limit_um);
                Remaining {
                    q05: way.quantile(0.05),
                    q50: way.quantile(0.5),
                }
            }
            _ => Remaining::default(),
        };
        Self {
            id: series.id,
            warn_um: series.warn_um,
            limit_um: series.limit_um,
            changes: changed.iter().map(|&at| series.points[at].check).collect(),
            trend,
            remaining_cycles,
            points: series.points,
        }
    }
}
