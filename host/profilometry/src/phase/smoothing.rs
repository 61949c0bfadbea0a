//! Optional smoothing of phasors before phases are computed, and of other figures of cells.

use rayon::prelude::*;

use crate::accumulate::{Accumulator, Band};
use crate::cells::{CellGrid, Grid};

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

    /// Correlation of two cells so far apart along a row, for independent cells before.
    pub fn correlation(&self, cells: usize) -> f64 {
        let radius = self.weights.len() as isize - 1;
        let weight = |at: isize| {
            let weight = self.weights.get(at.unsigned_abs());
            weight.map_or(0.0, |weight| f64::from(*weight))
        };
        let product = |shift: isize| -> f64 {
            (-radius..=radius)
                .map(|at| weight(at) * weight(at + shift))
                .sum()
        };
        product(cells as isize) / product(0)
    }

    pub fn apply(&self, plane: &mut [f32], columns: usize) {
        if columns == 0 {
            return;
        }
        let radius = self.weights.len() - 1;
        plane.par_chunks_mut(columns).for_each(|row| {
            let mut padded = vec![0.0; columns + 2 * radius];
            padded[radius..radius + columns].copy_from_slice(row);
            // Distance by distance over the whole row, which the compiler vectorises; every cell's terms keep their order.
            for (value, own) in row.iter_mut().zip(&padded[radius..]) {
                *value = self.weights[0] * own;
            }
            for (distance, weight) in self.weights.iter().enumerate().skip(1) {
                let (before, after) = (&padded[radius - distance..], &padded[radius + distance..]);
                for ((value, before), after) in row.iter_mut().zip(before).zip(after) {
                    *value += weight * (before + after);
                }
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

/// Phasors of one frequency less the phase of another, smoothed, in cell order.
///
/// Fine fringes would be washed out over the cells that smoothing of a coarse frequency takes; the difference of two high
/// frequencies has the few periods of their beat.
#[derive(Clone, Debug)]
pub(crate) struct Difference {
    pub re: Vec<f32>,
    pub im: Vec<f32>,
    /// The factor on the variance of the phase.
    pub variance_ratio: f64,
}

impl Difference {
    /// `weight`: how much the phase of a cell counts in those of its neighbours.
    pub fn new(
        accumulator: &Accumulator,
        grid: &CellGrid,
        [set, reference]: [usize; 2],
        blur: &Blur,
        weight: impl Fn(&Band, usize) -> f32,
    ) -> Self {
        let turned = |band: &Band, cell: usize| {
            let (own, other) = (band.phasor(set, cell), band.phasor(reference, cell));
            let length = own.re.hypot(own.im) * other.re.hypot(other.im);
            let share = weight(band, cell) / length.max(f32::MIN_POSITIVE);
            [
                (own.re * other.re + own.im * other.im) * share,
                (own.im * other.re - own.re * other.im) * share,
            ]
        };
        let [re, im] = [0, 1].map(|part| {
            let mut plane = dense(accumulator, grid, |band, cell| turned(band, cell)[part]);
            blur.apply(&mut plane, grid.columns);
            sparse(grid, &plane)
        });
        Self {
            re,
            im,
            variance_ratio: blur.variance_ratio(),
        }
    }
}

/// The cells of a plane over the whole grid.
fn sparse(grid: &CellGrid, plane: &[f32]) -> Vec<f32> {
    let mut cells = Vec::with_capacity(grid.len());
    for row in 0..grid.rows {
        let span = grid.span(row);
        cells.extend_from_slice(&plane[row * grid.columns..][span.begin..span.end]);
    }
    cells
}

/// Cells laid into a plane, for means over those about each: blocks as they lie, cores into squares of a core's pitch, which
/// hold one each, more or less.
pub(crate) struct CellPlane<'a> {
    grid: &'a Grid,
    columns: usize,
    rows: usize,
    /// Position of each core, for a fibre bundle.
    squares: Vec<u32>,
}

impl<'a> CellPlane<'a> {
    pub fn new(grid: &'a Grid) -> Self {
        let cores = match grid {
            Grid::Blocks(blocks) => {
                return Self {
                    grid,
                    columns: blocks.columns,
                    rows: blocks.rows,
                    squares: Vec::new(),
                };
            }
            Grid::Cores(cores) => cores,
        };
        let side_px = cores.pitch_px().max(1.0);
        let square = |&[x, y]: &[f64; 2]| [x, y].map(|px| (px.max(0.0) / side_px) as usize);
        let squares: Vec<[usize; 2]> = cores.seen_px().iter().map(square).collect();
        let size = |axis: usize| squares.iter().map(|at| at[axis] + 1).max().unwrap_or(0);
        let (columns, rows) = (size(0), size(1));
        let place = |[column, row]: &[usize; 2]| (row * columns + column) as u32;
        Self {
            grid,
            columns,
            rows,
            squares: squares.iter().map(place).collect(),
        }
    }

    /// Gaussian mean about each cell over the cells that have a value, sigma in cells; 0 where none has.
    pub fn mean(&self, values: &[Option<f32>], sigma_cells: f64) -> Vec<f32> {
        let Some(blur) = Blur::new(sigma_cells) else {
            return values.iter().map(|value| value.unwrap_or(0.0)).collect();
        };
        let mut sums = self.lay(values, |value| value.unwrap_or(0.0));
        let mut weights = self.lay(values, |value| f32::from(u8::from(value.is_some())));
        blur.apply(&mut sums, self.columns);
        blur.apply(&mut weights, self.columns);
        for (sum, weight) in sums.iter_mut().zip(weights) {
            *sum /= weight.max(f32::MIN_POSITIVE);
        }
        match self.grid {
            Grid::Blocks(grid) => sparse(grid, &sums),
            Grid::Cores(_) => {
                let squares = self.squares.iter();
                squares.map(|&square| sums[square as usize]).collect()
            }
        }
    }

    fn lay(&self, values: &[Option<f32>], of: impl Fn(&Option<f32>) -> f32) -> Vec<f32> {
        let mut plane = vec![0.0; self.columns * self.rows];
        match self.grid {
            Grid::Blocks(grid) => {
                for row in 0..grid.rows {
                    let span = grid.span(row);
                    let cells = &values[span.first_cell..][..span.len()];
                    let places = &mut plane[row * grid.columns..][span.begin..span.end];
                    for (place, value) in places.iter_mut().zip(cells) {
                        *place = of(value);
                    }
                }
            }
            Grid::Cores(_) => {
                for (&square, value) in self.squares.iter().zip(values) {
                    plane[square as usize] += of(value);
                }
            }
        }
        plane
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

/// Centroids of the light of smoothed phasors: the mean position of the cells that contribute, weighted by the Gaussian and by
/// their amplitudes, in cells (columns, rows) from the cell itself. In cell order.
///
/// Where the phase grows linearly, a sum of phasors has the phase at this position. In the dark beside bright cells it lies on those.
pub(crate) fn centroids(
    accumulator: &Accumulator,
    grid: &CellGrid,
    set: usize,
    sigma_cells: f64,
) -> Option<Vec<[f32; 2]>> {
    let blur = Blur::new(sigma_cells)?;
    let amplitude = dense(accumulator, grid, |band, cell| {
        let planes = &band.merged[set].planes;
        planes.re[cell].hypot(planes.im[cell])
    });
    let mut sum = amplitude.clone();
    blur.apply(&mut sum, grid.columns);
    let places = [0, 1].map(|axis| {
        let mut moment = amplitude.clone();
        for (at, value) in moment.iter_mut().enumerate() {
            *value *= [at % grid.columns, at / grid.columns][axis] as f32;
        }
        blur.apply(&mut moment, grid.columns);
        for (at, (moment, sum)) in moment.iter_mut().zip(&sum).enumerate() {
            let own = [at % grid.columns, at / grid.columns][axis] as f32;
            // Nothing came from anywhere.
            *moment = if *sum > 0.0 { *moment / sum - own } else { 0.0 };
        }
        sparse(grid, &moment)
    });
    let [columns, rows] = places;
    Some(columns.into_iter().zip(rows).map(|(x, y)| [x, y]).collect())
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
