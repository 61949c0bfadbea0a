//! The article's mask: where the fringes oscillate, there is an object in focus.
//!
//! The standard deviation over the phase steps of the finest frequency is smoothed by a Gaussian and thresholded.
//! It is taken from the phasor: a sinusoid of amplitude B has B / sqrt(2), and the difference (harmonics, noise) is
//! what a mask should not react to; for three steps it is the very standard deviation.

use crate::accumulate::Accumulator;
use crate::grid::CellGrid;
use crate::smoothing::{Blur, dense};

/// Mask parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MaskOptions {
    /// Standard deviation over the phase steps per pixel and exposure, after smoothing; cells below are dropped.
    pub threshold_dn: f64,
    /// Sigma of the Gaussian, in camera pixels; 0 for none.
    pub smoothing_px: f64,
}

/// True for every cell to keep, in cell order.
pub(crate) fn keep(accumulator: &Accumulator, grid: &CellGrid, options: &MaskOptions) -> Vec<bool> {
    let layout = &*accumulator.layout;
    let set = layout.steps.len() - 1;
    let pixels = (grid.binning * grid.binning) as f32;
    let scale = std::f32::consts::SQRT_2 / layout.steps[set] as f32 / pixels;
    let mut deviation = dense(accumulator, grid, |band, cell| {
        let phasor = band.phasor(set, cell);
        match phasor.exposures {
            0 => 0.0,
            exposures => scale * phasor.re.hypot(phasor.im) / f32::from(exposures),
        }
    });
    if let Some(blur) = Blur::new(options.smoothing_px / grid.binning as f64) {
        let mut inside = dense(accumulator, grid, |_, _| 1.0);
        blur.apply(&mut deviation, grid.columns);
        blur.apply(&mut inside, grid.columns);
        for (value, weight) in deviation.iter_mut().zip(&inside) {
            *value /= weight.max(f32::MIN_POSITIVE);
        }
    }
    let mut kept = Vec::with_capacity(grid.len());
    for row in 0..grid.rows {
        let span = grid.span(row);
        let values = &deviation[row * grid.columns..][span.begin..span.end];
        kept.extend(
            values
                .iter()
                .map(|&value| f64::from(value) >= options.threshold_dn),
        );
    }
    kept
}
