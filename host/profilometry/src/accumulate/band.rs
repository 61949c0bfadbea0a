//! Some cell rows with their sums: what one thread adds a frame to.

use super::Phasor;
use super::agreement::MergedExposures;
use super::cell_row::CellRow;
use super::code::{BitPart, BitSums, Finest, add_difference};
use super::consistency::{Sums, add_chi_square, deviate};
use super::layout::Layout;
use crate::frame::FrameView;

/// Sums per cell of one band.
#[derive(Clone, Debug, Default)]
pub(crate) struct Planes {
    pub re: Vec<f32>,
    pub im: Vec<f32>,
    pub sum: Vec<f32>,
}

impl Planes {
    fn new(cells: usize) -> Self {
        Self {
            re: vec![0.0; cells],
            im: vec![0.0; cells],
            sum: vec![0.0; cells],
        }
    }
}

/// All exposures of one frequency.
#[derive(Clone, Debug)]
pub(crate) struct Merged {
    pub planes: Planes,
    /// Exposures that went in, per cell.
    pub exposures: Vec<u8>,
    /// Chi-square of the exposures that went in, per cell; empty where it is not tested.
    pub chi_square: Vec<f32>,
}

/// Some cell rows with all their sums: the unit of parallel work.
#[derive(Clone, Debug)]
pub(crate) struct Band {
    pub rows: std::ops::Range<usize>,
    pub first_cell: usize,
    pub cells: usize,
    /// Counts of the dark frame per cell.
    pub dark: Vec<f32>,
    pending: Planes,
    /// First frame of the frequency, and squares about it; empty where nothing is tested.
    first: Vec<f32>,
    squares: Vec<f32>,
    pub merged: Vec<Merged>,
    /// Disagreement of the exposures over all frequencies, per cell; empty where nothing is compared.
    pub disagreement: Vec<f32>,
    /// Every bit of the code.
    pub code: Vec<BitSums>,
    /// The frame whose complement comes next; empty without complements.
    lit: Vec<f32>,
    row: CellRow,
}

/// Operation of one frame on a band.
#[derive(Clone, Copy)]
pub(super) enum Work {
    Dark,
    Fringe {
        set: usize,
        cos: f32,
        minus_sin: f32,
        first_step: bool,
        last_step: bool,
        exposure: usize,
    },
    Code {
        bit: usize,
        part: BitPart,
        first_exposure: bool,
    },
}

impl Band {
    /// Empty sums of some cell rows.
    pub(super) fn new(layout: &Layout, rows: std::ops::Range<usize>) -> Self {
        let grid = &layout.grid;
        let first_cell = grid.cells(rows.start).start;
        let cells = grid.cells(rows.end - 1).end - first_cell;
        let tested = if layout.noise.is_some() { cells } else { 0 };
        Self {
            rows,
            first_cell,
            cells,
            dark: vec![0.0; if layout.dark_frame { cells } else { 0 }],
            pending: Planes::new(cells),
            first: vec![0.0; tested],
            squares: vec![0.0; tested],
            merged: vec![
                Merged {
                    planes: Planes::new(cells),
                    exposures: vec![0; cells],
                    chi_square: vec![0.0; tested],
                };
                layout.steps.len()
            ],
            disagreement: vec![0.0; layout.agreement.as_ref().map_or(0, |_| cells)],
            code: vec![BitSums::new(cells); layout.bits],
            lit: vec![0.0; if layout.has_complements() { cells } else { 0 }],
            row: CellRow::new(grid),
        }
    }

    /// The phasor of the band's `index`-th cell.
    pub fn phasor(&self, set: usize, index: usize) -> Phasor {
        let Merged {
            planes, exposures, ..
        } = &self.merged[set];
        Phasor {
            re: planes.re[index],
            im: planes.im[index],
            sum: planes.sum[index],
            exposures: exposures[index],
        }
    }

    /// Takes all sums of its `index`-th cell from another band of the same cells.
    pub fn take(&mut self, index: usize, from: &Self) {
        for (own, from) in self.merged.iter_mut().zip(&from.merged) {
            own.planes.re[index] = from.planes.re[index];
            own.planes.im[index] = from.planes.im[index];
            own.planes.sum[index] = from.planes.sum[index];
            own.exposures[index] = from.exposures[index];
            if let (Some(own), Some(from)) =
                (own.chi_square.get_mut(index), from.chi_square.get(index))
            {
                *own = *from;
            }
        }
        let disagreement = self.disagreement.get_mut(index);
        if let (Some(own), Some(from)) = (disagreement, from.disagreement.get(index)) {
            *own = *from;
        }
        for (own, from) in self.code.iter_mut().zip(&from.code) {
            own.difference[index] = from.difference[index];
            own.amplitude[index] = from.amplitude[index];
        }
    }

    /// Adds the band's part of a frame and returns the sum of the pixels read.
    pub(super) fn add(&mut self, layout: &Layout, frame: FrameView<'_>, work: Work) -> u64 {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the only requirement of `add_avx2` is the instruction set just detected.
            return unsafe { self.add_avx2(layout, frame, work) };
        }
        self.add_rows(layout, frame, work)
    }

    /// The same code, compiled for wider registers. No fused multiply-add: the bytes stay those of every other machine.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn add_avx2(&mut self, layout: &Layout, frame: FrameView<'_>, work: Work) -> u64 {
        self.add_rows(layout, frame, work)
    }

    #[inline(always)]
    pub(super) fn add_rows(&mut self, layout: &Layout, frame: FrameView<'_>, work: Work) -> u64 {
        let mut total = 0;
        for index in self.rows.clone() {
            let cells = layout.grid.cells(index);
            if cells.is_empty() {
                continue;
            }
            let cells = cells.start - self.first_cell..cells.end - self.first_cell;
            total += self.row.read(layout, frame, index);
            let values = &self.row.values[..cells.len()];
            match work {
                // A saturated dark frame is caught by its level; here it only must not spread infinities.
                Work::Dark => {
                    for (dark, &value) in self.dark[cells].iter_mut().zip(values) {
                        *dark = value.min(f32::MAX);
                    }
                }
                Work::Fringe {
                    set,
                    cos,
                    minus_sin,
                    first_step,
                    last_step,
                    exposure,
                } => {
                    let first_exposure = exposure == 0;
                    let re = &mut self.pending.re[cells.clone()];
                    let im = &mut self.pending.im[cells.clone()];
                    let sum = &mut self.pending.sum[cells.clone()];
                    if first_step {
                        start(values, re, im, sum, cos, minus_sin);
                    } else {
                        accumulate(values, re, im, sum, cos, minus_sin);
                    }
                    if let Some(noise) = &layout.noise {
                        let first = &mut self.first[cells.clone()];
                        let squares = &mut self.squares[cells.clone()];
                        if first_step {
                            first.copy_from_slice(values);
                            squares.fill(0.0);
                        } else {
                            deviate(values, first, squares);
                        }
                        if last_step {
                            let sums = Sums {
                                re,
                                im,
                                sum,
                                first,
                                squares,
                            };
                            let into = &mut self.merged[set].chi_square[cells.clone()];
                            add_chi_square(sums, layout.steps[set], noise, first_exposure, into);
                            if let Some(agreement) = &layout.agreement {
                                let Merged {
                                    planes, exposures, ..
                                } = &self.merged[set];
                                agreement.add(
                                    sums,
                                    MergedExposures::new(planes, exposures, cells.clone()),
                                    (exposure, set),
                                    layout.steps[set],
                                    noise,
                                    &mut self.disagreement[cells.clone()],
                                );
                            }
                        }
                    }
                    if last_step {
                        merge(re, im, sum, &mut self.merged[set], cells, first_exposure);
                    }
                }
                Work::Code {
                    part: BitPart::Lit, ..
                } => self.lit[cells].copy_from_slice(values),
                Work::Code {
                    bit,
                    part,
                    first_exposure,
                } => {
                    let finest = Finest {
                        re: &self.pending.re[cells.clone()],
                        im: &self.pending.im[cells.clone()],
                        sum: &self.pending.sum[cells.clone()],
                        steps: *layout.steps.last().unwrap_or(&1),
                    };
                    let sums = &mut self.code[bit];
                    let difference = &mut sums.difference[cells.clone()];
                    let amplitude = &mut sums.amplitude[cells.clone()];
                    if first_exposure {
                        difference.fill(0.0);
                        amplitude.fill(0.0);
                    }
                    // A saturated pixel is at least as bright as the limit: that tells a bit as well as its count would. Of
                    // several pixels that share a cell it says too little.
                    let saturated = match layout.grid.pixels_per_cell() {
                        1 => f32::from(layout.saturation_limit_dn),
                        _ => f32::NAN,
                    };
                    let least = |value: f32| match value == f32::INFINITY {
                        true => saturated,
                        false => value,
                    };
                    if part == BitPart::Alone {
                        let off = |i: usize, mean: f32| least(values[i]) - mean;
                        add_difference(finest, off, difference, amplitude);
                    } else {
                        let lit = &self.lit[cells];
                        let off = |i: usize, _: f32| 0.5 * (least(lit[i]) - least(values[i]));
                        add_difference(finest, off, difference, amplitude);
                    }
                }
            }
        }
        total
    }
}

#[inline(always)]
fn start(
    values: &[f32],
    re: &mut [f32],
    im: &mut [f32],
    sum: &mut [f32],
    cos: f32,
    minus_sin: f32,
) {
    for (((&value, re), im), sum) in values.iter().zip(re).zip(im).zip(sum) {
        *re = value * cos;
        *im = value * minus_sin;
        *sum = value;
    }
}

#[inline(always)]
fn accumulate(
    values: &[f32],
    re: &mut [f32],
    im: &mut [f32],
    sum: &mut [f32],
    cos: f32,
    minus_sin: f32,
) {
    for (((&value, re), im), sum) in values.iter().zip(re).zip(im).zip(sum) {
        *re += value * cos;
        *im += value * minus_sin;
        *sum += value;
    }
}

/// Adds one exposure to the others, cell by cell, unless it was saturated (its sum is then infinite).
#[inline(always)]
fn merge(
    re: &[f32],
    im: &[f32],
    sum: &[f32],
    merged: &mut Merged,
    cells: std::ops::Range<usize>,
    first_exposure: bool,
) {
    let into_re = &mut merged.planes.re[cells.clone()];
    let into_im = &mut merged.planes.im[cells.clone()];
    let into_sum = &mut merged.planes.sum[cells.clone()];
    let exposures = &mut merged.exposures[cells];
    if first_exposure {
        into_re.fill(0.0);
        into_im.fill(0.0);
        into_sum.fill(0.0);
        exposures.fill(0);
    }
    for i in 0..sum.len() {
        let good = sum[i].is_finite();
        into_re[i] += if good { re[i] } else { 0.0 };
        into_im[i] += if good { im[i] } else { 0.0 };
        into_sum[i] += if good { sum[i] } else { 0.0 };
        exposures[i] += u8::from(good);
    }
}
