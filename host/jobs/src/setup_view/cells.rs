//! Modulation, contrast and points of one view's cells.

use crate::calibration::lit_cells;
use flankscope_foundation::order::median_of;
use flankscope_profilometry::calibrate::Sharpness;
use flankscope_profilometry::decode::Rejected;
use flankscope_profilometry::{Accumulator, DecodeError, DecodeOptions, Decoder, HeadModel};

/// Share of the cells with fringes that the weak modulation is exceeded by.
const STRONGER: f64 = 0.95;

/// Figures of one view's cells.
#[derive(Clone, Debug)]
pub struct CellFigures {
    /// Amplitude of the finest fringes, DN per pixel and µs of exposure: median over the cells with fringes, and what the weakest
    /// twentieth of them does not exceed. Absent without such cells.
    pub modulation_dn_per_us: Option<[f64; 2]>,
    /// Share of the cells that each exposure saturates, shortest exposure first, 0..1.
    pub saturated_ratios: Vec<f64>,
    /// Median contrast of each frequency over the cells with a point.
    pub contrast: Vec<f64>,
    /// Mean contrast of the finest fringes in the middle of the field.
    pub focus_contrast: Option<f64>,
    /// Cells of the field.
    pub cells: usize,
    /// Cells with a point.
    pub points: usize,
    /// Cells without one.
    pub rejected: Rejected,
}

impl CellFigures {
    /// Evaluates the sums of a view that was captured with these exposures.
    ///
    /// # Errors
    /// The sums are not those of a whole view of this decoder.
    pub fn from_sums(
        decoder: &Decoder,
        head: &HeadModel,
        sums: &Accumulator,
        exposures_us: &[u32],
        finest_set: usize,
    ) -> Result<Self, DecodeError> {
        let decoded = decoder.finish(sums)?;
        let columns = decoder.columns(sums)?;
        let gain = decoder.sensor().gain_e_per_dn * decoder.grid().pixels_per_cell() as f64;
        let least_contrast = DecodeOptions::for_head(head).min_contrast;
        let mut used = vec![0_usize; exposures_us.len() + 1];
        let mut rates = Vec::with_capacity(columns.len());
        for (cell, column) in columns.iter().enumerate() {
            let exposures = sums.phasor(finest_set, cell).map_or(0, |sum| sum.exposures);
            let exposures = usize::from(exposures).min(exposures_us.len());
            used[exposures] += 1;
            // The exposures of a cell are the shortest ones, because those that saturate are the longer ones.
            let lit_us: f64 = exposures_us[..exposures]
                .iter()
                .map(|&us| f64::from(us))
                .sum();
            // Written so that a NaN, of a cell without light, is left out.
            if column.contrast >= least_contrast && lit_us > 0.0 {
                rates.push(column.mean_e * column.contrast / gain / lit_us);
            }
        }
        let cells = columns.len().max(1) as f64;
        let saturated = |at: usize| used[..=at].iter().sum::<usize>() as f64 / cells;
        Ok(Self {
            modulation_dn_per_us: median_of(rates.iter().copied())
                .zip(weakest(&mut rates))
                .map(<[f64; 2]>::from),
            saturated_ratios: (0..exposures_us.len()).map(saturated).collect(),
            contrast: decoded.contrast,
            focus_contrast: Sharpness::from_view(0, &lit_cells(columns), head)
                .ok()
                .map(|seen| seen.contrast),
            cells: decoded.cells,
            points: decoded.cloud.len(),
            rejected: decoded.rejected,
        })
    }
}

/// The value that a share of [`STRONGER`] exceeds; `None` without values.
fn weakest(rates: &mut [f64]) -> Option<f64> {
    rates.sort_by(f64::total_cmp);
    let at = ((1.0 - STRONGER) * rates.len() as f64) as usize;
    rates.get(at).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_weakest_twentieth_is_told_from_the_rest() {
        let mut rates: Vec<f64> = (0..100).rev().map(f64::from).collect();
        assert_eq!(weakest(&mut rates), Some(5.0));
        assert_eq!(weakest(&mut [3.0]), Some(3.0));
        assert_eq!(weakest(&mut []), None);
    }
}
