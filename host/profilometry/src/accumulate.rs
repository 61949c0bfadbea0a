//! Frames in, one phasor per cell and frequency out: streaming, without keeping a frame.
//!
//! Exposures are merged in raw counts (electrons but for a constant): in the shot-noise limit the plain sum is the
//! best estimate. An exposure whose frames saturate anywhere in a cell is dropped for that cell, so the sums of one
//! exposure and frequency wait in `pending` and join `merged` with its last step.
//!
//! Beside them run the squares that tell whether a cell's frames follow one fringe ([`crate::consistency`]), if wanted.
//!
//! A cell's sums run over the frames in their order whatever the number of threads: same input, same bytes.

use std::f64::consts::TAU;
use std::sync::Arc;

use rayon::prelude::*;

use crate::cell_row::CellRow;
use crate::consistency::{FrameNoise, Sums, add_chi_square, deviate};
use crate::frame::{FrameError, FrameKind, FrameLevel, FrameView};
use crate::grid::Grid;
use crate::phase::Phasor;

/// What an accumulator is laid out for.
#[derive(Debug)]
pub(crate) struct Layout {
    pub width: usize,
    pub height: usize,
    pub grid: Grid,
    /// Phase steps of each frequency.
    pub steps: Vec<u32>,
    pub exposures: usize,
    pub dark_frame: bool,
    /// Counts above this are saturated.
    pub saturation_limit_dn: u16,
    /// What frames scatter by, where that is to be tested.
    pub noise: Option<FrameNoise>,
}

impl Layout {
    /// Frames of a view.
    pub fn planned(&self) -> usize {
        usize::from(self.dark_frame) + self.exposures * self.steps_per_exposure()
    }

    fn steps_per_exposure(&self) -> usize {
        self.steps.iter().map(|&steps| steps as usize).sum()
    }

    /// The place of a frame in the capture order.
    fn index(&self, kind: FrameKind) -> Option<usize> {
        match kind {
            FrameKind::Dark => self.dark_frame.then_some(0),
            FrameKind::Fringe {
                exposure,
                set,
                step,
            } => {
                if exposure >= self.exposures || step >= *self.steps.get(set)? {
                    return None;
                }
                let before: usize = self.steps[..set].iter().map(|&steps| steps as usize).sum();
                Some(
                    usize::from(self.dark_frame)
                        + exposure * self.steps_per_exposure()
                        + before
                        + step as usize,
                )
            }
        }
    }

    /// The frame at a place in the capture order.
    pub fn kind(&self, index: usize) -> Option<FrameKind> {
        if index >= self.planned() {
            return None;
        }
        if self.dark_frame && index == 0 {
            return Some(FrameKind::Dark);
        }
        let index = index - usize::from(self.dark_frame);
        let exposure = index / self.steps_per_exposure();
        let mut step = (index % self.steps_per_exposure()) as u32;
        for (set, &steps) in self.steps.iter().enumerate() {
            if step < steps {
                return Some(FrameKind::Fringe {
                    exposure,
                    set,
                    step,
                });
            }
            step -= steps;
        }
        None
    }
}

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
    row: CellRow,
}

/// What one frame does to a band.
#[derive(Clone, Copy)]
enum Work {
    Dark,
    Fringe {
        set: usize,
        cos: f32,
        minus_sin: f32,
        first_step: bool,
        last_step: bool,
        first_exposure: bool,
    },
}

/// The running sums of one view. Made by [`crate::Decoder::begin`]; [`Accumulator::reset`] makes it ready for the next.
#[derive(Clone, Debug)]
pub struct Accumulator {
    pub(crate) layout: Arc<Layout>,
    pub(crate) bands: Vec<Band>,
    next: usize,
}

impl Accumulator {
    pub(crate) fn new(layout: Arc<Layout>) -> Self {
        let grid = &layout.grid;
        let bands = (0..grid.rows())
            .step_by(grid.rows_per_band())
            .map(|first_row| {
                let rows = first_row..(first_row + grid.rows_per_band()).min(grid.rows());
                let first_cell = grid.cells(first_row).start;
                let cells = grid.cells(rows.end - 1).end - first_cell;
                let tested = if layout.noise.is_some() { cells } else { 0 };
                Band {
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
                    row: CellRow::new(grid),
                }
            })
            .collect();
        Self {
            layout,
            bands,
            next: 0,
        }
    }

    /// Forgets the view; allocates nothing.
    pub fn reset(&mut self) {
        self.next = 0;
    }

    /// The frame that must come next; `None` when the view is complete.
    pub fn expected(&self) -> Option<FrameKind> {
        self.layout.kind(self.next)
    }

    /// Frames added since the last reset.
    pub fn received(&self) -> usize {
        self.next
    }

    /// Frames of a complete view.
    pub fn planned(&self) -> usize {
        self.layout.planned()
    }

    /// Adds a frame, reading it once and in place. Frames come in capture order: the dark frame, then exposure by
    /// exposure, frequency by frequency (low to high), step by step.
    ///
    /// Returns the frame's brightness, for [`FrameLevel::check_content`].
    ///
    /// # Errors
    /// [`FrameError`] for a wrong size or order; the sums are unchanged then.
    pub fn add(&mut self, frame: FrameView<'_>, kind: FrameKind) -> Result<FrameLevel, FrameError> {
        frame.check(self.layout.width, self.layout.height)?;
        let work = self.admit(kind)?;
        let layout = &*self.layout;
        // Integer sums: their order does not matter.
        let total: u64 = self
            .bands
            .par_iter_mut()
            .map(|band| band.add(layout, frame, work))
            .sum();
        self.next += 1;
        let pixels = (layout.grid.len() * layout.grid.pixels_per_cell()) as u64;
        Ok(FrameLevel {
            mean_dn: total as f64 / pixels.max(1) as f64,
            pixels,
        })
    }

    fn admit(&self, kind: FrameKind) -> Result<Work, FrameError> {
        let layout = &*self.layout;
        let Some(expected) = self.expected() else {
            return Err(FrameError::Extra {
                got: kind,
                planned: layout.planned(),
            });
        };
        match layout.index(kind) {
            None => {
                return Err(FrameError::NotPlanned {
                    got: kind,
                    expected,
                    exposures: layout.exposures,
                    sets: layout.steps.len(),
                });
            }
            Some(index) if index < self.next => {
                return Err(FrameError::Repeated {
                    got: kind,
                    expected,
                });
            }
            Some(index) if index > self.next => {
                return Err(FrameError::Missing {
                    got: kind,
                    expected,
                    missing: index - self.next,
                });
            }
            Some(_) => {}
        }
        Ok(match kind {
            FrameKind::Dark => Work::Dark,
            FrameKind::Fringe {
                exposure,
                set,
                step,
            } => {
                let shift_rad = TAU * f64::from(step) / f64::from(layout.steps[set]);
                Work::Fringe {
                    set,
                    cos: shift_rad.cos() as f32,
                    minus_sin: -shift_rad.sin() as f32,
                    first_step: step == 0,
                    last_step: step + 1 == layout.steps[set],
                    first_exposure: exposure == 0,
                }
            }
        })
    }

    /// Counts as a whole view from here on: its sums were put there.
    pub(crate) fn complete(&mut self) {
        self.next = self.planned();
    }

    /// The phasor of a cell, as merged so far.
    pub fn phasor(&self, set: usize, cell: usize) -> Option<Phasor> {
        let band = self
            .bands
            .iter()
            .find(|band| (band.first_cell..band.first_cell + band.cells).contains(&cell))?;
        (set < band.merged.len()).then(|| band.phasor(set, cell - band.first_cell))
    }
}

impl Band {
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

    /// Adds the band's part of a frame and returns the sum of the pixels read.
    fn add(&mut self, layout: &Layout, frame: FrameView<'_>, work: Work) -> u64 {
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
    fn add_rows(&mut self, layout: &Layout, frame: FrameView<'_>, work: Work) -> u64 {
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
                    first_exposure,
                } => {
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
                        }
                    }
                    if last_step {
                        merge(re, im, sum, &mut self.merged[set], cells, first_exposure);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::CellGrid;

    /// What the wide registers compute, against the code for every machine.
    #[test]
    fn wide_registers_give_the_same_bytes() {
        for binning in [1, 2, 3, 4, 5] {
            let layout = Layout {
                width: 203,
                height: 41,
                grid: Grid::Blocks(CellGrid::new(203, 41, binning, None)),
                steps: vec![3, 8],
                exposures: 2,
                dark_frame: true,
                saturation_limit_dn: 3891,
                noise: None,
            };
            let wide = Accumulator::new(Arc::new(layout));
            let mut plain = wide.clone();
            let mut wide = wide;
            let layout = Arc::clone(&wide.layout);
            let mut state = 1u32;
            while let Some(kind) = wide.expected() {
                let pixels: Vec<u16> = (0..203 * 41)
                    .map(|_| {
                        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                        (state >> 20) as u16
                    })
                    .collect();
                let frame = FrameView::packed(&pixels, 203, 41);
                let work = plain.admit(kind).unwrap();
                let total: u64 = plain
                    .bands
                    .iter_mut()
                    .map(|band| band.add_rows(&layout, frame, work))
                    .sum();
                plain.next += 1;
                let level = wide.add(frame, kind).unwrap();
                assert_eq!(level.mean_dn, total as f64 / level.pixels as f64);
            }
            for (wide, plain) in wide.bands.iter().zip(&plain.bands) {
                assert_eq!(wide.dark, plain.dark);
                for (wide, plain) in wide.merged.iter().zip(&plain.merged) {
                    assert_eq!(wide.planes.re, plain.planes.re);
                    assert_eq!(wide.planes.im, plain.planes.im);
                    assert_eq!(wide.planes.sum, plain.planes.sum);
                    assert_eq!(wide.exposures, plain.exposures);
                }
            }
        }
    }
}
