//! Frames in, one phasor per cell and frequency out: streaming, without keeping a frame.
//!
//! Exposures are merged in raw counts (electrons but for a constant): in the shot-noise limit the plain sum is the
//! best estimate. An exposure whose frames saturate anywhere in a cell is dropped for that cell, so the sums of one
//! exposure and frequency wait in `pending` and join `merged` with its last step.
//!
//! A cell's sums run over the frames in their order whatever the number of threads: same input, same bytes.
//! (A chi-square gate would need one more plane, the sum of squares, beside `sum`.)

use std::f64::consts::TAU;
use std::sync::Arc;

use rayon::prelude::*;

use crate::frame::{FrameError, FrameKind, FrameLevel, FrameView};
use crate::grid::CellGrid;
use crate::phase::Phasor;

/// Cell rows per unit of parallel work; fixed, so that the split never depends on the machine.
const ROWS_PER_BAND: usize = 16;

/// What an accumulator is laid out for.
#[derive(Debug)]
pub(crate) struct Layout {
    pub width: usize,
    pub height: usize,
    pub grid: CellGrid,
    /// Phase steps of each frequency.
    pub steps: Vec<u32>,
    pub exposures: usize,
    pub dark_frame: bool,
    /// Counts above this are saturated.
    pub saturation_limit_dn: u16,
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
    pub merged: Vec<Merged>,
    scratch: RowScratch,
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
        let bands = (0..grid.rows)
            .step_by(ROWS_PER_BAND)
            .map(|first_row| {
                let rows = first_row..(first_row + ROWS_PER_BAND).min(grid.rows);
                let first_cell = grid.span(first_row).first_cell;
                let last = grid.span(rows.end - 1);
                let cells = last.first_cell + last.len() - first_cell;
                Band {
                    rows,
                    first_cell,
                    cells,
                    dark: vec![0.0; if layout.dark_frame { cells } else { 0 }],
                    pending: Planes::new(cells),
                    merged: vec![
                        Merged {
                            planes: Planes::new(cells),
                            exposures: vec![0; cells]
                        };
                        layout.steps.len()
                    ],
                    scratch: RowScratch::new(grid),
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
        let pixels = (layout.grid.len() * layout.grid.binning * layout.grid.binning) as u64;
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
        let Merged { planes, exposures } = &self.merged[set];
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
        for row in self.rows.clone() {
            let span = layout.grid.span(row);
            if span.is_empty() {
                continue;
            }
            let cells =
                span.first_cell - self.first_cell..span.first_cell - self.first_cell + span.len();
            total += self.scratch.read(layout, frame, row);
            let values = &self.scratch.values[..span.len()];
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

/// One row of cells out of the frame's pixel rows.
#[derive(Clone, Debug)]
struct RowScratch {
    /// Counts per cell; infinite where a pixel is saturated, so that every sum it enters is marked.
    values: Vec<f32>,
    /// Per pixel column of the cell row: sum, and non-zero where a pixel exceeds the limit.
    columns: Vec<u32>,
    excess: Vec<u16>,
}

impl RowScratch {
    fn new(grid: &CellGrid) -> Self {
        let pixels = if grid.binning > 1 {
            grid.columns * grid.binning
        } else {
            0
        };
        Self {
            values: vec![0.0; grid.columns],
            columns: vec![0; pixels],
            excess: vec![0; pixels],
        }
    }

    /// Fills `values` and returns the sum of all pixels read.
    #[inline(always)]
    fn read(&mut self, layout: &Layout, frame: FrameView<'_>, row: usize) -> u64 {
        match layout.grid.binning {
            1 => self.read_pixels(layout, frame, row),
            2 => self.read_blocks::<2>(layout, frame, row),
            3 => self.read_blocks::<3>(layout, frame, row),
            4 => self.read_blocks::<4>(layout, frame, row),
            _ => self.read_large_blocks(layout, frame, row),
        }
    }

    #[inline(always)]
    fn read_pixels(&mut self, layout: &Layout, frame: FrameView<'_>, row: usize) -> u64 {
        let span = layout.grid.span(row);
        let limit = layout.saturation_limit_dn;
        let mut total = 0u32;
        for (&pixel, value) in frame.row(row)[span.begin..span.end]
            .iter()
            .zip(&mut self.values)
        {
            total += u32::from(pixel);
            *value = if pixel > limit {
                f32::INFINITY
            } else {
                f32::from(pixel)
            };
        }
        u64::from(total)
    }

    /// Rows first, since neighbouring columns vectorise; then columns, with the block size known to the compiler.
    #[inline(always)]
    fn read_blocks<const B: usize>(
        &mut self,
        layout: &Layout,
        frame: FrameView<'_>,
        row: usize,
    ) -> u64 {
        let span = layout.grid.span(row);
        let limit = layout.saturation_limit_dn;
        let pixels = span.begin * B..span.end * B;
        let count = pixels.len();
        let rows: [&[u16]; B] =
            std::array::from_fn(|y| &frame.row(row * B + y)[pixels.clone()][..count]);
        let columns = &mut self.columns[..count];
        let excess = &mut self.excess[..count];
        for x in 0..count {
            let (mut sum, mut over) = (0u32, 0u16);
            for row in &rows {
                sum += u32::from(row[x]);
                over |= row[x].saturating_sub(limit);
            }
            columns[x] = sum;
            excess[x] = over;
        }
        let mut total = 0u64;
        let blocks = columns
            .as_chunks::<B>()
            .0
            .iter()
            .zip(excess.as_chunks::<B>().0);
        for ((columns, excess), value) in blocks.zip(&mut self.values) {
            let sum: u32 = columns.iter().sum();
            let over = excess.iter().fold(0, |over, &column| over | column);
            total += u64::from(sum);
            *value = if over > 0 { f32::INFINITY } else { sum as f32 };
        }
        total
    }

    fn read_large_blocks(&mut self, layout: &Layout, frame: FrameView<'_>, row: usize) -> u64 {
        let span = layout.grid.span(row);
        let binning = layout.grid.binning;
        let mut total = 0;
        for (column, value) in (span.begin..span.end).zip(&mut self.values) {
            let (mut sum, mut over) = (0u32, false);
            for y in row * binning..(row + 1) * binning {
                for &pixel in &frame.row(y)[column * binning..][..binning] {
                    sum += u32::from(pixel);
                    over |= pixel > layout.saturation_limit_dn;
                }
            }
            total += u64::from(sum);
            *value = if over { f32::INFINITY } else { sum as f32 };
        }
        total
    }
}
