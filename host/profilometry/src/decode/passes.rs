//! Joins the sums of several passes, each of which lights another part of the field, to those of one view.

use std::sync::Arc;

use rayon::prelude::*;

use super::{DecodeError, Decoder};
use crate::accumulate::{Accumulator, Band};

impl Decoder {
    /// Puts into `first`, for every cell, the sums of the pass whose finest fringes are strongest there: the one that lights the
    /// surface which the cell sees; in the others it is reached over other surfaces at most.
    ///
    /// Strength is amplitude by exposure time, so that a pass of which long exposures saturate loses nothing. A cell that
    /// saturates in all exposures of a pass is assigned to that pass, since the light that reaches it
    /// in the other passes may be indirect. All sums of a cell come from one pass; the dark frame is that of `first`.
    ///
    /// # Errors
    /// As [`Self::finish`], for each pass.
    pub fn join_passes(
        &self,
        first: &mut Accumulator,
        others: &[Accumulator],
    ) -> Result<(), DecodeError> {
        self.admit(first)?;
        for other in others {
            self.admit(other)?;
        }
        let layout = Arc::clone(&self.layout);
        let finest = layout.steps.len() - 1;
        let strength = |band: &Band, index: usize| {
            let phasor = band.phasor(finest, index);
            match phasor.exposures {
                0 => f32::INFINITY,
                used => phasor.re.hypot(phasor.im) / self.exposed_us(used) as f32,
            }
        };
        let joined = |(at, band): (usize, &mut Band)| {
            for index in 0..band.cells {
                let mut best = strength(band, index);
                for other in others {
                    let other = &other.bands[at];
                    let rival = strength(other, index);
                    if rival > best {
                        best = rival;
                        band.take(index, other);
                    }
                }
            }
        };
        first.bands.par_iter_mut().enumerate().for_each(joined);
        Ok(())
    }
}
