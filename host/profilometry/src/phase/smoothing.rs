//! Optional smoothing of the phasors before they become phases.

use rayon::prelude::*;

use crate::accumulate::{Accumulator, Band};
use crate::cells::CellGrid;

/// Separable Gaussian on a dense row-major plane; outside counts as zero.
pub(crate) struct Blur {
    /// Kernel from its centre outwards.
    weights: Vec<f32>,
}

impl Blur {
    /// `None` for a sigma that is too small to matter.
    pub fn new(sigma_cells: f64) -> Option<Self> {
        if !(sigma_cells > 0.05) {
            return None;
        }
        // 3.5 sigma leave 5e-4 of the weight out.
        let radius = (3.5 * sigma_cells).ceil().min(512.0) as usize;
        let mut weights: Vec<f64> = (0..=radius)
            .map(|i| (-0.5 * (i as f64 / sigma_cells).powi(2)).exp())
            .collect();
        let total = 2.0 * weights.iter().sum::<f64>() - weights[0];
        weights.iter_mut().for_each(|weight| *weight /= total);
        Some(Self {
            weights: weights.into_iter().map(|weight| weight as f32).collect(),
        })
    }

    /// The factor on the variance of independent cells.
    pub fn variance_ratio(&self) -> f64 {
        let squares = |weight: &f32| f64::from(*weight) * f64::from(*weight);
        let line = 2.0 * self.weights.iter().map(squares).sum::<f64>() - squares(&self.weights[0]);
        line * line
    }

    pub fn apply(&self, plane: &mut [f32], columns: usize) {
        if columns == 0 {
            return;
        }
        let radius = self.weights.len() - 1;
        plane.par_chunks_mut(columns).for_each(|row| {
            let mut padded = vec![0.0; columns + 2 * radius];
            padded[radius..radius + columns].copy_from_slice(row);
            for (column, value) in row.iter_mut().enumerate() {
                let centre = column + radius;
                let mut sum = self.weights[0] * padded[centre];
                for (distance, weight) in self.weights.iter().enumerate().skip(1) {
                    sum += weight * (padded[centre - distance] + padded[centre + distance]);
                }
                *value = sum;
            }
        });
        let source = plane.to_vec();
        let rows = source.len() / columns;
        plane
            .par_chunks_mut(columns)
            .enumerate()
            .for_each(|(row, out)| {
                out.fill(0.0);
                let first = row.saturating_sub(radius);
                let last = (row + radius).min(rows - 1);
                for other in first..=last {
                    let weight = self.weights[row.abs_diff(other)];
                    for (value, from) in out.iter_mut().zip(&source[other * columns..][..columns]) {
                        *value += weight * from;
                    }
                }
            });
    }
}

/// A plane over the whole grid, zero outside the image circle.
pub(crate) fn dense(
    accumulator: &Accumulator,
    grid: &CellGrid,
    value: impl Fn(&Band, usize) -> f32,
) -> Vec<f32> {
    let mut plane = vec![0.0; grid.columns * grid.rows];
    for band in &accumulator.bands {
        for row in band.rows.clone() {
            let span = grid.span(row);
            for column in span.begin..span.end {
                plane[row * grid.columns + column] = value(
                    band,
                    span.first_cell - band.first_cell + column - span.begin,
                );
            }
        }
    }
    plane
}

/// Smooths the phasors of all frequencies; returns the factor on the variance of the phase.
///
/// Phasors, not phases: they have no jumps, and dim or dropped cells weigh little by themselves.
pub(crate) fn smooth(
    accumulator: &mut Accumulator,
    grid: &CellGrid,
    sigma_cells: &[f64],
) -> Vec<f64> {
    let mut ratios = Vec::with_capacity(sigma_cells.len());
    for (set, &sigma) in sigma_cells.iter().enumerate() {
        let Some(blur) = Blur::new(sigma) else {
            ratios.push(1.0);
            continue;
        };
        ratios.push(blur.variance_ratio());
        let mut re = dense(accumulator, grid, |band, cell| {
            band.merged[set].planes.re[cell]
        });
        let mut im = dense(accumulator, grid, |band, cell| {
            band.merged[set].planes.im[cell]
        });
        blur.apply(&mut re, grid.columns);
        blur.apply(&mut im, grid.columns);
        for band in &mut accumulator.bands {
            for row in band.rows.clone() {
                let span = grid.span(row);
                let cells = span.first_cell - band.first_cell
                    ..span.first_cell - band.first_cell + span.len();
                let from = row * grid.columns + span.begin..row * grid.columns + span.end;
                band.merged[set].planes.re[cells.clone()].copy_from_slice(&re[from.clone()]);
                band.merged[set].planes.im[cells].copy_from_slice(&im[from]);
            }
        }
    }
    ratios
}
