//! Deviations of a cloud from CAD, and their statistics.

use rayon::prelude::*;

use crate::surface::Surface;

/// Signed distances of `points` (finite, mm) to the surface, mm, in order: positive where material stands proud.
pub fn deviations(surface: &Surface, points: &[[f64; 3]]) -> Vec<f64> {
    surface.map_closest(points, |closest| closest.signed_distance_mm)
}

/// Summary of a set of deviations, mm.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Statistics {
    /// Number of values.
    pub count: usize,
    /// Arithmetic mean.
    pub mean_mm: f64,
    /// Standard deviation about the mean, divisor n - 1; 0 for a single value.
    pub std_mm: f64,
    /// Root of the mean square.
    pub rms_mm: f64,
    /// 95th percentile of the absolute values (the smallest value that at least 95 % do not exceed).
    pub p95_abs_mm: f64,
    /// Largest absolute value.
    pub max_abs_mm: f64,
}

/// Summarises deviations; none for an empty set.
pub fn statistics(values_mm: &[f64]) -> Option<Statistics> {
    if values_mm.is_empty() {
        return None;
    }
    let n = values_mm.len() as f64;
    // Sums over fixed chunks, added in order: the same bytes on any thread count.
    let sum_of = |f: &(dyn Fn(f64) -> f64 + Sync)| -> f64 {
        let parts: Vec<f64> = values_mm
            .par_chunks(1 << 14)
            .map(|chunk| chunk.iter().map(|&v| f(v)).sum())
            .collect();
        parts.iter().sum()
    };
    let mean_mm = sum_of(&|v| v) / n;
    let rms_mm = (sum_of(&|v| v * v) / n).sqrt();
    let std_mm = if values_mm.len() > 1 {
        (sum_of(&|v| (v - mean_mm).powi(2)) / (n - 1.0)).sqrt()
    } else {
        0.0
    };
    let mut sizes: Vec<f64> = values_mm.iter().map(|v| v.abs()).collect();
    let max_abs_mm = sizes.iter().copied().fold(0.0, f64::max);
    let rank = ((0.95 * n).ceil() as usize).clamp(1, sizes.len()) - 1;
    let (_, p95_abs_mm, _) = sizes.select_nth_unstable_by(rank, f64::total_cmp);
    Some(Statistics {
        count: values_mm.len(),
        mean_mm,
        std_mm,
        rms_mm,
        p95_abs_mm: *p95_abs_mm,
        max_abs_mm,
    })
}
