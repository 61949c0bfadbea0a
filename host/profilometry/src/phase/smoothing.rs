//! Optional smoothing of phasors before phases are computed, and of other figures of cells.

// Lanes are counted: an iterator over several arrays at once hides from the compiler what a vector holds.
#![allow(clippy::needless_range_loop)]

use flankscope_foundation::simd::with_widest;
use rayon::prelude::*;

use crate::accumulate::{Accumulator, Band};
use crate::cells::{CellGrid, Grid, Span};

/// Cells of a row whose sums are found together: four of the widest vectors.
const LANES: usize = 32;
/// Rows of a unit of parallel work.
const BAND_ROWS: usize = 16;

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

    /// Smooths along the rows, then across them. Every cell's terms keep their order, whatever the processor and the threads.
    pub fn apply(&self, plane: &mut [f32], columns: usize) {
        if plane.is_empty() || columns == 0 {
            return;
        }
        let radius = self.weights.len() - 1;
        let stride = columns.next_multiple_of(LANES);
        let mut along = vec![0.0; plane.len() / columns * stride];
        let rows = along.par_chunks_mut(stride).zip(plane.par_chunks(columns));
        let padded = || vec![0.0; stride + 2 * radius];
        rows.for_each_init(padded, |padded, (out, row)| {
            padded[radius..radius + columns].copy_from_slice(row);
            with_widest(
                #[inline(always)]
                || self.along_row(padded, out),
            );
        });
        let bands = plane.par_chunks_mut(BAND_ROWS * columns).enumerate();
        bands.for_each(|(band, out)| {
            with_widest(
                #[inline(always)]
                || self.across_rows(&along, stride, band * BAND_ROWS, out, columns),
            );
        });
    }

    /// One row, which lies in `padded` with zeros about it.
    #[inline(always)]
    fn along_row(&self, padded: &[f32], out: &mut [f32]) {
        let radius = self.weights.len() - 1;
        for (block, out) in out.as_chunks_mut::<LANES>().0.iter_mut().enumerate() {
            // What the block's sums reach.
            let reached = &padded[block * LANES..][..LANES + 2 * radius];
            let own = &reached[radius..][..LANES];
            let mut sums = [0.0; LANES];
            for lane in 0..LANES {
                sums[lane] = self.weights[0] * own[lane];
            }
            let before = reached[..radius + LANES - 1].array_windows::<LANES>().rev();
            let after = reached[radius + 1..].array_windows::<LANES>();
            for ((before, after), weight) in before.zip(after).zip(&self.weights[1..]) {
                for lane in 0..LANES {
                    sums[lane] += weight * (before[lane] + after[lane]);
                }
            }
            *out = sums;
        }
    }

    /// Some rows of the plane from all rows, so many columns at a time that their sums stay in registers.
    #[inline(always)]
    fn across_rows(
        &self,
        along: &[f32],
        stride: usize,
        first_row: usize,
        out: &mut [f32],
        columns: usize,
    ) {
        let radius = self.weights.len() - 1;
        let above = self.weights[1..].iter().rev();
        let kernel: Vec<f32> = above.chain(&self.weights).copied().collect();
        for left in (0..columns).step_by(LANES) {
            for (row, out) in out.chunks_mut(columns).enumerate() {
                let row = first_row + row;
                let first = row.saturating_sub(radius);
                let rows = along[first * stride..].chunks_exact(stride);
                let mut sums = [0.0; LANES];
                for (from, weight) in rows.zip(&kernel[first + radius - row..]) {
                    let Some(from) = from[left..].first_chunk::<LANES>() else {
                        continue;
                    };
                    for lane in 0..LANES {
                        sums[lane] += weight * from[lane];
                    }
                }
                let out = &mut out[left..];
                let count = out.len().min(LANES);
                out[..count].copy_from_slice(&sums[..count]);
            }
        }
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
        weight: impl Fn(&Band, usize) -> f32 + Sync,
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
        let part = |part: usize| {
            let mut plane = dense(accumulator, grid, |band, cell| turned(band, cell)[part]);
            blur.apply(&mut plane, grid.columns);
            sparse(grid, &plane)
        };
        let (re, im) = rayon::join(|| part(0), || part(1));
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
/// hold one each, more or less. The plane ends where the cells do.
#[derive(Clone, Debug)]
pub(crate) struct CellPlane {
    columns: usize,
    rows: usize,
    /// First column of blocks that has any.
    left: usize,
    /// Position of each core, for a fibre bundle.
    squares: Vec<u32>,
}

impl CellPlane {
    pub fn new(grid: &Grid) -> Self {
        let cores = match grid {
            Grid::Blocks(blocks) => {
                let spans = (0..blocks.rows).map(|row| blocks.span(row));
                let spans: Vec<Span> = spans.filter(|span| !span.is_empty()).collect();
                let left = spans.iter().map(|span| span.begin).min().unwrap_or(0);
                let right = spans.iter().map(|span| span.end).max().unwrap_or(0);
                return Self {
                    columns: right - left,
                    rows: blocks.rows,
                    left,
                    squares: Vec::new(),
                };
            }
            Grid::Cores(cores) => cores,
        };
        let side_px = cores.pitch_px().max(1.0);
        let square = |&[x, y]: &[f64; 2]| [x, y].map(|px| (px.max(0.0) / side_px) as usize);
        let squares: Vec<[usize; 2]> = cores.seen_px().iter().map(square).collect();
        let size = |axis: usize| {
            let along = squares.iter().map(|at| at[axis]);
            let first = along.clone().min().unwrap_or(0);
            (first, along.max().map_or(0, |last| last + 1 - first))
        };
        let ((left, columns), (top, rows)) = (size(0), size(1));
        let place = |[column, row]: &[usize; 2]| ((row - top) * columns + column - left) as u32;
        Self {
            columns,
            rows,
            left: 0,
            squares: squares.iter().map(place).collect(),
        }
    }

    /// Gaussian mean about each cell over the cells that have a value, sigma in cells; 0 where none has.
    pub fn mean(
        &self,
        grid: &Grid,
        value: impl Fn(usize) -> Option<f32> + Sync,
        sigma_cells: f64,
    ) -> Vec<f32> {
        let [mean] = self.means(grid, |cell| value(cell).map(|value| [value]), sigma_cells);
        mean
    }

    /// The same of several figures that the same cells have.
    pub fn means<const N: usize>(
        &self,
        grid: &Grid,
        values: impl Fn(usize) -> Option<[f32; N]> + Sync,
        sigma_cells: f64,
    ) -> [Vec<f32>; N] {
        let Some(blur) = Blur::new(sigma_cells) else {
            let own = |at: usize| {
                let value = |cell| values(cell).map_or(0.0, |values| values[at]);
                (0..grid.len()).map(value).collect()
            };
            return std::array::from_fn(own);
        };
        // The last plane holds the weights.
        let plane = |at: usize| {
            let of = |values: [f32; N]| values.get(at).copied().unwrap_or(1.0);
            let mut plane = self.lay(grid, |cell| values(cell).map_or(0.0, of));
            blur.apply(&mut plane, self.columns);
            plane
        };
        let planes: Vec<Vec<f32>> = (0..=N).into_par_iter().map(plane).collect();
        let mean = |at: usize| {
            let (sums, weights) = (&planes[at], &planes[N]);
            self.take(grid, |place| {
                sums[place] / weights[place].max(f32::MIN_POSITIVE)
            })
        };
        std::array::from_fn(mean)
    }

    fn lay(&self, grid: &Grid, value: impl Fn(usize) -> f32 + Sync) -> Vec<f32> {
        let mut plane = vec![0.0; self.columns * self.rows];
        match grid {
            Grid::Blocks(grid) => {
                let rows = plane.par_chunks_mut(self.columns.max(1)).enumerate();
                rows.for_each(|(row, places)| {
                    let span = grid.span(row);
                    for at in 0..span.len() {
                        places[span.begin - self.left + at] = value(span.first_cell + at);
                    }
                });
            }
            Grid::Cores(_) => {
                for (cell, &square) in self.squares.iter().enumerate() {
                    plane[square as usize] += value(cell);
                }
            }
        }
        plane
    }

    /// A figure of every cell by its place in the plane.
    fn take(&self, grid: &Grid, of: impl Fn(usize) -> f32 + Sync) -> Vec<f32> {
        match grid {
            Grid::Blocks(grid) => {
                let mut cells = Vec::with_capacity(grid.len());
                for row in 0..grid.rows {
                    let span = grid.span(row);
                    let first = row * self.columns + span.begin.saturating_sub(self.left);
                    cells.extend((first..first + span.len()).map(&of));
                }
                cells
            }
            Grid::Cores(_) => {
                let squares = self.squares.par_iter();
                squares.map(|&square| of(square as usize)).collect()
            }
        }
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
