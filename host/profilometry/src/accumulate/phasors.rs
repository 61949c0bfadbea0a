//! The sums of a view as bytes and back: what its points were computed from, to compute them again.
//!
//! ```text
//!  "PHASORS3"  cells u32  frequencies u32      planes, one value per cell in the grid's order:
//!  dark f32                                    counts of the dark frame, where one was captured
//!  re f32, im f32, sum f32, [chi-square f32,] exposures u8
//!                                              for each frequency, low to high; the last padded to 4 bytes
//!  disagreement f32                            of the exposures, where several are compared
//!  difference f32, amplitude f32               for each bit of a code, most significant first
//! ```
//!
//! For a head with two projectors those of the second follow in the same way. All little endian. The phasor of a cell is
//! `re + i im` over `sum`, each summed over steps and over the exposures that did not saturate.

use crate::accumulate::{Accumulator, Band};

const MAGIC: &[u8; 8] = b"PHASORS3";
/// Magic, cells, frequencies.
const HEAD_BYTES: usize = 16;

/// Why bytes are not the sums of a view of this decoder.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum PhasorsError {
    /// Not this format, or another release's.
    #[error(
        "these are no phasors of this layout: they begin with \"{}\", right would be \"{}\" (another release computes them again)",
        got.escape_ascii(), MAGIC.escape_ascii()
    )]
    Magic {
        /// First bytes.
        got: Vec<u8>,
    },
    /// Another grid or another pattern set.
    #[error(
        "phasors of {cells} cells and {sets} frequencies, this head and its patterns have {expected_cells} and {expected_sets}"
    )]
    Layout {
        /// Cells stated.
        cells: u32,
        /// Frequencies stated.
        sets: u32,
        /// Cells of the grid.
        expected_cells: usize,
        /// Frequencies of the pattern set.
        expected_sets: usize,
    },
    /// Cut short, or too long.
    #[error("{got} bytes of phasors, right would be {expected}")]
    Length {
        /// Bytes given.
        got: usize,
        /// Bytes of this layout.
        expected: usize,
    },
}

impl Accumulator {
    /// Bytes that [`Self::to_bytes`] gives, whatever was summed.
    #[must_use]
    pub fn byte_count(&self) -> usize {
        self.own_byte_count() + self.second.as_ref().map_or(0, |second| second.byte_count())
    }

    fn own_byte_count(&self) -> usize {
        let cells = self.layout.grid.len();
        let dark = if self.layout.dark_frame { 4 * cells } else { 0 };
        let tested = if self.layout.noise.is_some() { 4 } else { 0 };
        HEAD_BYTES
            + dark
            + self.layout.steps.len() * ((12 + tested) * cells + cells.next_multiple_of(4))
            + self.layout.agreement.as_ref().map_or(0, |_| 4 * cells)
            + self.layout.bits * 8 * cells
    }

    /// Everything that the points of this view depend on, beside head and options.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(self.byte_count());
        bytes.extend_from_slice(MAGIC);
        for count in [self.layout.grid.len(), self.layout.steps.len()] {
            bytes.extend_from_slice(&u32::try_from(count).unwrap_or(u32::MAX).to_le_bytes());
        }
        let plane = |bytes: &mut Vec<u8>, of: &dyn Fn(&Band) -> &[f32]| {
            for band in &self.bands {
                bytes.extend(of(band).iter().flat_map(|value| value.to_le_bytes()));
            }
        };
        plane(&mut bytes, &|band| &band.dark);
        for set in 0..self.layout.steps.len() {
            plane(&mut bytes, &|band| &band.merged[set].planes.re);
            plane(&mut bytes, &|band| &band.merged[set].planes.im);
            plane(&mut bytes, &|band| &band.merged[set].planes.sum);
            plane(&mut bytes, &|band| &band.merged[set].chi_square);
            for band in &self.bands {
                bytes.extend_from_slice(&band.merged[set].exposures);
            }
            bytes.resize(bytes.len().next_multiple_of(4), 0);
        }
        plane(&mut bytes, &|band| &band.disagreement);
        for bit in 0..self.layout.bits {
            plane(&mut bytes, &|band| &band.code[bit].difference);
            plane(&mut bytes, &|band| &band.code[bit].amplitude);
        }
        if let Some(second) = &self.second {
            bytes.extend(second.to_bytes());
        }
        bytes
    }

    /// Becomes the complete view that gave these bytes.
    ///
    /// # Errors
    /// [`PhasorsError`]: not the bytes of a view with this grid and these patterns. The sums are unchanged then.
    pub fn restore(&mut self, bytes: &[u8]) -> Result<(), PhasorsError> {
        let (head, mut rest) = bytes.split_at_checked(HEAD_BYTES).unwrap_or((bytes, &[]));
        if !head.starts_with(MAGIC) {
            return Err(PhasorsError::Magic {
                got: head[..head.len().min(MAGIC.len())].to_vec(),
            });
        }
        let number = |at: usize| {
            let bytes = head.get(at..at + 4)?;
            Some(u32::from_le_bytes(bytes.try_into().ok()?))
        };
        let (expected_cells, expected_sets) = (self.layout.grid.len(), self.layout.steps.len());
        let (cells, sets) = (number(8).unwrap_or(0), number(12).unwrap_or(0));
        if (cells as usize, sets as usize) != (expected_cells, expected_sets) {
            return Err(PhasorsError::Layout {
                cells,
                sets,
                expected_cells,
                expected_sets,
            });
        }
        let expected = self.byte_count();
        if bytes.len() != expected {
            return Err(PhasorsError::Length {
                got: bytes.len(),
                expected,
            });
        }
        let own = self.own_byte_count();
        if let Some(second) = &mut self.second {
            second.restore(&bytes[own..])?;
        }
        for band in &mut self.bands {
            fill(&mut band.dark, &mut rest);
        }
        for set in 0..expected_sets {
            for band in &mut self.bands {
                fill(&mut band.merged[set].planes.re, &mut rest);
            }
            for band in &mut self.bands {
                fill(&mut band.merged[set].planes.im, &mut rest);
            }
            for band in &mut self.bands {
                fill(&mut band.merged[set].planes.sum, &mut rest);
            }
            for band in &mut self.bands {
                fill(&mut band.merged[set].chi_square, &mut rest);
            }
            for band in &mut self.bands {
                let exposures = &mut band.merged[set].exposures;
                let (now, later) = rest.split_at(exposures.len());
                exposures.copy_from_slice(now);
                rest = later;
            }
            rest = &rest[expected_cells.next_multiple_of(4) - expected_cells..];
        }
        for band in &mut self.bands {
            fill(&mut band.disagreement, &mut rest);
        }
        for bit in 0..self.layout.bits {
            for band in &mut self.bands {
                fill(&mut band.code[bit].difference, &mut rest);
            }
            for band in &mut self.bands {
                fill(&mut band.code[bit].amplitude, &mut rest);
            }
        }
        self.complete();
        Ok(())
    }
}

/// Takes as many values off the front of `bytes` as `values` holds; the length was checked before.
fn fill(values: &mut [f32], bytes: &mut &[u8]) {
    let (now, later) = bytes.split_at(4 * values.len());
    for (value, four) in values.iter_mut().zip(now.as_chunks().0) {
        *value = f32::from_le_bytes(*four);
    }
    *bytes = later;
}
