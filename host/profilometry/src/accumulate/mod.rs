//! Frames in, one phasor per cell and frequency out: streaming, without keeping a frame.
//!
//! Exposures are merged in raw counts (electrons but for a constant): in the shot-noise limit the plain sum is the
//! best estimate. An exposure whose frames saturate anywhere in a cell is dropped for that cell, so the sums of one
//! exposure and frequency wait in `pending` and join `merged` with its last step.
//!
//! The sums of squares are kept as well, to test whether a cell's frames follow one fringe ([`consistency`]), and whether its exposures
//! show the same scene (`agreement`), where configured.
//!
//! A cell's sums run over the frames in their order whatever the number of threads: same input, same bytes.

pub(crate) mod agreement;
mod band;
mod cell_row;
pub(crate) mod code;
pub mod consistency;
mod layout;
mod phasors;

use std::f64::consts::TAU;
use std::sync::Arc;

use rayon::prelude::*;

use crate::frame::{FrameError, FrameKind, FrameLevel, FrameView};

use band::Work;
pub(crate) use band::{Band, Merged};
use code::BitPart;
pub(crate) use layout::Layout;
pub use phasors::PhasorsError;

/// Sums over all used frames of one cell and one frequency, in counts.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Phasor {
    /// Real part of C.
    pub re: f32,
    /// Imaginary part of C.
    pub im: f32,
    /// Sum of all frames, offset included.
    pub sum: f32,
    /// Number of exposures used; 0 when all were saturated.
    pub exposures: u8,
}

/// The running sums of one view. Made by [`crate::Decoder::begin`]; [`Accumulator::reset`] makes it ready for the next.
#[derive(Clone, Debug)]
pub struct Accumulator {
    pub(crate) layout: Arc<Layout>,
    pub(crate) bands: Vec<Band>,
    next: usize,
    /// Those of the same view by the head's second projector.
    pub(crate) second: Option<Box<Self>>,
}

impl Accumulator {
    pub(crate) fn new(layout: Arc<Layout>) -> Self {
        let grid = &layout.grid;
        let bands = (0..grid.rows())
            .step_by(grid.rows_per_band())
            .map(|first_row| {
                let rows = first_row..(first_row + grid.rows_per_band()).min(grid.rows());
                Band::new(&layout, rows)
            })
            .collect();
        Self {
            layout,
            bands,
            next: 0,
            second: None,
        }
    }

    /// The sums of the same view by the head's second projector, whose frames they take as any other's; none of a head with one.
    pub fn take_second(&mut self) -> Option<Self> {
        self.second.take().map(|second| *second)
    }

    /// Puts them back.
    pub fn put_second(&mut self, second: Self) {
        self.second = Some(Box::new(second));
    }

    /// Forgets the view; allocates nothing.
    pub fn reset(&mut self) {
        self.next = 0;
        if let Some(second) = &mut self.second {
            second.reset();
        }
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
                    exposure,
                }
            }
            FrameKind::Code {
                exposure,
                bit,
                complement,
            } => Work::Code {
                bit: bit as usize,
                part: match (layout.has_complements(), complement) {
                    (false, _) => BitPart::Alone,
                    (true, false) => BitPart::Lit,
                    (true, true) => BitPart::Complement,
                },
                first_exposure: exposure == 0,
            },
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

#[cfg(test)]
mod tests {
    use super::agreement::Agreement;
    use super::consistency::FrameNoise;
    use super::*;
    use crate::cells::{CellGrid, Grid};
    use crate::gray::GrayCode;
    use crate::pattern::{FringeSet, PatternSet};

    /// The vectorised code against the portable code.
    #[test]
    fn wide_registers_give_the_same_bytes() {
        let sets = vec![FringeSet::new(4.0, 3), FringeSet::new(48.0, 8)];
        let code = GrayCode {
            bits: 2,
            stripes: 4.0,
            origin_px: -0.5,
            complement: true,
        };
        let patterns = PatternSet::new("", sets).unwrap();
        let patterns = patterns.with_code(Some(code)).unwrap();
        for binning in [1, 2, 3, 4, 5] {
            let layout = Layout {
                width: 203,
                height: 41,
                grid: Grid::Blocks(CellGrid::new(203, 41, binning, None)),
                pictures: patterns.pictures().collect(),
                steps: vec![3, 8],
                bits: 2,
                exposures: 2,
                dark_frame: true,
                saturation_limit_dn: 3891,
                noise: Some(FrameNoise {
                    offset_dn: 100.0,
                    dark_variance_dn2: 1.0,
                    variance_per_dn: 0.1,
                    response_ratio: 1e-3,
                }),
                agreement: Agreement::new(&[10_000, 20_000], &[4.0, 48.0]),
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
                assert_eq!(wide.disagreement, plain.disagreement);
                for (wide, plain) in wide.merged.iter().zip(&plain.merged) {
                    assert_eq!(wide.planes.re, plain.planes.re);
                    assert_eq!(wide.planes.im, plain.planes.im);
                    assert_eq!(wide.planes.sum, plain.planes.sum);
                    assert_eq!(wide.exposures, plain.exposures);
                    assert_eq!(wide.chi_square, plain.chi_square);
                }
                assert_eq!(wide.code, plain.code);
            }
            // Round trip through bytes, the Gray code included.
            let mut again = Accumulator::new(Arc::clone(&layout));
            let bytes = wide.to_bytes();
            assert_eq!(bytes.len(), wide.byte_count());
            again.restore(&bytes).unwrap();
            assert_eq!(again.to_bytes(), bytes);
            let lit = |of: &Accumulator| {
                of.bands
                    .iter()
                    .map(|band| band.code.clone())
                    .collect::<Vec<_>>()
            };
            assert_eq!(lit(&again), lit(&wide));
            let told = lit(&wide).concat();
            // In larger cells of this noise some pixel is always saturated.
            let differs = told.iter().flat_map(|bit| &bit.difference);
            assert!(binning > 1 || differs.into_iter().any(|&dn| dn != 0.0));
        }
    }
}
