//! Robust straight line through wear against cycles, insensitive to a few outliers.
//!
//! The slope is the median of the slopes of all pairs, its interval follows from the distribution of Kendall's tau (Theil 1950;
//! Sen, J. Am. Stat. Assoc. 63, 1968). Breakdown point: 29 % of the values.

use flankscope_foundation::{normal::COVERAGE_95, order::midpoint_median};

use super::series::Point;

/// Smallest number of points for a trend.
pub const LEAST_POINTS: usize = 5;
/// Only this many of the last points are used, because the number of pairs grows with the square.
const MOST_POINTS: usize = 1000;

/// A line.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Trend {
    /// Wear per cycle, µm.
    pub rate_um: f64,
    /// Its 95 % interval.
    pub rate_um_95: [f64; 2],
    /// Wear on the line at the last value, µm.
    pub now_um: f64,
    /// Cycles at the last value.
    pub now_cycles: f64,
    /// Number of points used.
    pub points: usize,
}

impl Trend {
    /// The trend of the last points; `None` for fewer than [`LEAST_POINTS`], or if all are at the same cycle.
    #[must_use]
    pub fn of(points: &[Point]) -> Option<Self> {
        let points = &points[points.len().saturating_sub(MOST_POINTS)..];
        let last = points.last().filter(|_| points.len() >= LEAST_POINTS)?;
        let mut slopes = Vec::with_capacity(points.len() * (points.len() - 1) / 2);
        for (i, a) in points.iter().enumerate() {
            for b in &points[i + 1..] {
                let cycles = b.cycles - a.cycles;
                if cycles > 0.0 {
                    slopes.push((b.wear_um - a.wear_um) / cycles);
                }
            }
        }
        slopes.sort_unstable_by(f64::total_cmp);
        let rate_um = midpoint_median(&mut slopes)?;
        let half_width = COVERAGE_95 * kendall_variance(points).sqrt();
        // Ranks count from one, indices from zero; an interval beyond all slopes ends at the outermost slope.
        let outermost = slopes.len() - 1;
        let pairs = slopes.len() as f64;
        let low = (((pairs - half_width) / 2.0).floor() - 1.0).max(0.0) as usize;
        let high = (((pairs + half_width) / 2.0).ceil() as usize).min(outermost);
        let mut at_last: Vec<f64> = points
            .iter()
            .map(|p| p.wear_um + rate_um * (last.cycles - p.cycles))
            .collect();
        at_last.sort_unstable_by(f64::total_cmp);
        Some(Self {
            rate_um,
            rate_um_95: [slopes[low], slopes[high]],
            now_um: midpoint_median(&mut at_last)?,
            now_cycles: last.cycles,
            points: points.len(),
        })
    }

    /// Standard uncertainty of the rate, µm per cycle.
    pub fn u_rate_um(&self) -> f64 {
        (self.rate_um_95[1] - self.rate_um_95[0]) / (2.0 * COVERAGE_95)
    }
}

/// Variance of the number of rising minus falling pairs without a trend; values at the same cycle form no pair.
fn kendall_variance(points: &[Point]) -> f64 {
    let term = |n: f64| n * (n - 1.0) * (2.0 * n + 5.0);
    let ties: f64 = points
        .chunk_by(|a, b| a.cycles == b.cycles)
        .map(|tied| term(tied.len() as f64))
        .sum();
    (term(points.len() as f64) - ties) / 18.0
}
