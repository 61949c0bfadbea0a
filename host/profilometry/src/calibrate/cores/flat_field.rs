//! Captures of an evenly lit white target, averaged.

use super::FindError;
use crate::accumulate::Accumulator;
use crate::cells::Grid;
use crate::frame::{FrameError, FrameView};

/// Frames of an evenly lit white target, averaged; several take the photon noise out.
#[derive(Clone, Debug)]
pub struct FlatField {
    pub(super) width: usize,
    pub(super) height: usize,
    sums: Vec<f32>,
    frames: u32,
    saturated: usize,
    offset_dn: f64,
    saturation_limit_dn: u16,
}

impl FlatField {
    /// For frames of `width` x `height` pixels with `offset_dn` counts in the dark.
    pub fn new(width: usize, height: usize, offset_dn: f64, saturation_limit_dn: u16) -> Self {
        Self {
            width,
            height,
            sums: vec![0.0; width * height],
            frames: 0,
            saturated: 0,
            offset_dn,
            saturation_limit_dn,
        }
    }

    /// The sums of a whole view of an evenly white target: over the steps of a frequency its fringes cancel. The view must
    /// have been summed pixel by pixel.
    ///
    /// # Errors
    /// [`FindError::Cells`] for a view summed otherwise.
    pub fn from_view(view: &Accumulator, offset_dn: f64) -> Result<Self, FindError> {
        let layout = &*view.layout;
        let Grid::Blocks(grid) = &layout.grid else {
            return Err(FindError::Cells);
        };
        if grid.binning != 1 {
            return Err(FindError::Cells);
        }
        let per_exposure: u32 = layout.steps.iter().sum();
        let frames = per_exposure * layout.exposures as u32;
        // Where nothing was summed it counts as dark.
        let dark = (f64::from(frames) * offset_dn) as f32;
        let mut flat = Self {
            sums: vec![dark; layout.width * layout.height],
            frames,
            ..Self::new(
                layout.width,
                layout.height,
                offset_dn,
                layout.saturation_limit_dn,
            )
        };
        for band in &view.bands {
            for row in band.rows.clone() {
                let span = grid.span(row);
                for column in span.begin..span.end {
                    let cell = span.first_cell + column - span.begin - band.first_cell;
                    let sets = (0..layout.steps.len()).map(|set| band.phasor(set, cell));
                    let (mut sum, mut whole) = (0.0, true);
                    for phasor in sets {
                        sum += phasor.sum;
                        whole &= usize::from(phasor.exposures) == layout.exposures;
                    }
                    flat.sums[row * layout.width + column] = sum;
                    flat.saturated += usize::from(!whole);
                }
            }
        }
        Ok(flat)
    }

    /// Adds a frame.
    ///
    /// # Errors
    /// A frame of another size.
    pub fn add(&mut self, frame: FrameView<'_>) -> Result<(), FrameError> {
        frame.check(self.width, self.height)?;
        for (row, sums) in self.sums.chunks_exact_mut(self.width.max(1)).enumerate() {
            for (sum, &pixel) in sums.iter_mut().zip(frame.row(row)) {
                *sum += f32::from(pixel);
                self.saturated += usize::from(pixel > self.saturation_limit_dn);
            }
        }
        self.frames += 1;
        Ok(())
    }

    /// Counts above the dark level of an average frame, row by row.
    pub(super) fn mean(&self) -> Result<Vec<f32>, FindError> {
        if self.frames == 0 {
            return Err(FindError::NoFrame);
        }
        if self.saturated > 0 {
            return Err(FindError::Saturated {
                got: self.saturated,
                limit_dn: self.saturation_limit_dn,
            });
        }
        let (scale, offset) = (1.0 / self.frames as f32, self.offset_dn as f32);
        Ok(self.sums.iter().map(|sum| sum * scale - offset).collect())
    }
}
