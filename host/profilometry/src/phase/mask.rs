//! The article's mask: where the fringes oscillate, there is an object in focus.
//!
//! The standard deviation over the phase steps of the finest frequency is smoothed by a Gaussian and thresholded.
//! It is taken from the phasor: a sinusoid of amplitude B has B / sqrt(2), and the difference (harmonics, noise) is
//! what a mask should not react to; for three steps it is the very standard deviation.

use crate::accumulate::{Accumulator, Band};
use crate::phase::smoothing::CellPlane;

/// Mask parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MaskOptions {
    /// Standard deviation over the phase steps per pixel and exposure, after smoothing; cells below are dropped.
    pub threshold_dn: f64,
    /// Sigma of the Gaussian, in camera pixels; 0 for none.
    pub smoothing_px: f64,
}

/// Smoothed standard deviation over the phase steps, counts per pixel and exposure, in cell order.
pub(crate) fn fringe_deviations_dn(accumulator: &Accumulator, smoothing_px: f64) -> Vec<f32> {
    let layout = &*accumulator.layout;
    let set = layout.steps.len() - 1;
    let pixels = layout.grid.pixels_per_cell() as f32;
    let scale = std::f32::consts::SQRT_2 / layout.steps[set] as f32 / pixels;
    let deviation = &|band: &Band, cell: usize| {
        let phasor = band.phasor(set, cell);
        match phasor.exposures {
            0 => 0.0,
            exposures => scale * phasor.re.hypot(phasor.im) / f32::from(exposures),
        }
    };
    let bands = accumulator.bands.iter();
    let raw = bands.flat_map(|band| (0..band.cells).map(move |cell| deviation(band, cell)));
    let raw: Vec<f32> = raw.collect();
    let pitch_px = layout.grid.pitch_px().max(1.0);
    CellPlane::new(&layout.grid).mean(
        &layout.grid,
        |cell| Some(raw[cell]),
        smoothing_px / pitch_px,
    )
}
