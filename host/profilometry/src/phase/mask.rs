//! The article's mask: where the fringes oscillate, there is an object in focus.
//!
//! The standard deviation over the phase steps of the finest frequency is smoothed by a Gaussian and thresholded.
//! It is taken from the phasor: a sinusoid of amplitude B has B / sqrt(2), and the difference (harmonics, noise) is
//! what a mask should not react to; for three steps it is the very standard deviation.

use crate::accumulate::{Accumulator, Band};
use crate::cells::CoreGrid;
use crate::cells::{CellGrid, Grid};
use crate::phase::smoothing::{Blur, dense};

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
    let deviation = |band: &Band, cell: usize| {
        let phasor = band.phasor(set, cell);
        match phasor.exposures {
            0 => 0.0,
            exposures => scale * phasor.re.hypot(phasor.im) / f32::from(exposures),
        }
    };
    match &layout.grid {
        Grid::Blocks(grid) => blocks(accumulator, grid, smoothing_px, deviation),
        Grid::Cores(grid) => {
            let deviation = &deviation;
            let raw = accumulator
                .bands
                .iter()
                .flat_map(|band| (0..band.cells).map(move |cell| deviation(band, cell)));
            cores(raw.collect(), grid, smoothing_px)
        }
    }
}

fn blocks(
    accumulator: &Accumulator,
    grid: &CellGrid,
    smoothing_px: f64,
    deviation: impl Fn(&Band, usize) -> f32,
) -> Vec<f32> {
    let mut plane = dense(accumulator, grid, deviation);
    if let Some(blur) = Blur::new(smoothing_px / grid.binning as f64) {
        let mut inside = dense(accumulator, grid, |_, _| 1.0);
        normalised(&blur, &mut plane, &mut inside, grid.columns);
    }
    let mut smoothed = Vec::with_capacity(grid.len());
    for row in 0..grid.rows {
        let span = grid.span(row);
        smoothed.extend_from_slice(&plane[row * grid.columns..][span.begin..span.end]);
    }
    smoothed
}

/// Cores are laid into squares of a core's pitch, which hold one each, more or less, and smoothed there.
fn cores(raw: Vec<f32>, grid: &CoreGrid, smoothing_px: f64) -> Vec<f32> {
    let side_px = grid.pitch_px().max(1.0);
    let Some(blur) = Blur::new(smoothing_px / side_px) else {
        return raw;
    };
    let square = |&[x, y]: &[f64; 2]| [x, y].map(|px| (px.max(0.0) / side_px) as usize);
    let squares: Vec<[usize; 2]> = grid.seen_px().iter().map(square).collect();
    let size = |axis: usize| squares.iter().map(|at| at[axis] + 1).max().unwrap_or(0);
    let (columns, rows) = (size(0), size(1));
    let mut plane = vec![0.0; columns * rows];
    let mut inside = plane.clone();
    for ([column, row], value) in squares.iter().zip(&raw) {
        plane[row * columns + column] += value;
        inside[row * columns + column] += 1.0;
    }
    normalised(&blur, &mut plane, &mut inside, columns);
    squares
        .iter()
        .map(|[column, row]| plane[row * columns + column])
        .collect()
}

/// Smooths, with what lies outside weighing nothing.
fn normalised(blur: &Blur, plane: &mut [f32], inside: &mut [f32], columns: usize) {
    blur.apply(plane, columns);
    blur.apply(inside, columns);
    for (value, weight) in plane.iter_mut().zip(inside) {
        *value /= weight.max(f32::MIN_POSITIVE);
    }
}
