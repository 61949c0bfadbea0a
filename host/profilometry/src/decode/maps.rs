//! Intermediate results of every cell of a view (phases, orders, modulation), for comparisons of decoders.

use std::f64::consts::TAU;

use super::estimates::Estimates;
use super::{DecodeError, Decoded, Decoder};
use crate::accumulate::Accumulator;
use crate::cells::Grid;

/// Maps of a view: one value per cell, rows by columns for blocks of pixels (nothing beyond the image circle), a list for
/// cores. Maps of all frequencies begin with the lowest.
#[derive(Clone, Debug)]
pub struct PhaseMaps {
    /// `[rows, columns]`, or `[cores]`.
    pub shape: Vec<usize>,
    /// Fringes over the projector's width (or height), low to high.
    pub periods: Vec<f64>,
    /// Camera pixel that the cell measures along, x and y; shape and 2.
    pub pixel_px: Vec<f64>,
    /// Wrapped phase as the frames have it, unsmoothed, 0 to 2 pi, of every frequency; NaN where no exposure is unsaturated.
    pub phase_rad: Vec<f32>,
    /// Amplitude of every frequency, electrons over the cell and all exposures used.
    pub modulation_e: Vec<f32>,
    /// Mean of every frequency, electrons, ambient light included.
    pub mean_e: Vec<f32>,
    /// Period of the finest fringes in which the wrapped phase lies; [`Self::NO_ORDER`] where it is unknown.
    pub order: Vec<i32>,
    /// Projector column (or row) that lights the cell, px, from all fine frequencies, smoothed as the points are; NaN where none
    /// was told.
    pub column_px: Vec<f64>,
    /// Depth of the point along the camera's axis, mm; NaN where there is none.
    pub depth_mm: Vec<f32>,
    /// Its standard uncertainty, mm.
    pub sigma_z_mm: Vec<f32>,
}

impl PhaseMaps {
    /// Order of a cell that has none.
    pub const NO_ORDER: i32 = i32::MIN;
}

impl Decoder {
    /// Maps of a complete view and of what came of it.
    ///
    /// # Errors
    /// As [`Self::finish`].
    pub fn maps(
        &self,
        accumulator: &Accumulator,
        decoded: &Decoded,
    ) -> Result<PhaseMaps, DecodeError> {
        self.admit(accumulator)?;
        let view = self.condition(accumulator);
        let (shape, places) = self.places();
        let size: usize = shape.iter().product();
        let sets = self.patterns.sets.len();
        let unknown = |count: usize| vec![f32::NAN; count * size];
        let mut maps = PhaseMaps {
            shape,
            periods: self.patterns.sets.iter().map(|set| set.periods).collect(),
            pixel_px: vec![f64::NAN; 2 * size],
            phase_rad: unknown(sets),
            modulation_e: unknown(sets),
            mean_e: unknown(sets),
            order: vec![PhaseMaps::NO_ORDER; size],
            column_px: vec![f64::NAN; size],
            depth_mm: unknown(1),
            sigma_z_mm: unknown(1),
        };
        let finest = self.patterns.finest();
        for (band, smoothed) in accumulator.bands.iter().zip(&view.accumulator.bands) {
            let mut estimates = Estimates::new(self, band);
            let mut of_smoothed = Estimates::new(self, smoothed);
            for index in 0..band.cells {
                let cell = band.first_cell + index;
                let place = places[cell];
                let ray = &self.rays[cell];
                maps.pixel_px[2 * place..2 * place + 2].copy_from_slice(&ray.pixel);
                for set in 0..sets {
                    if let Ok(seen) = estimates.get(index, set) {
                        let at = set * size + place;
                        maps.phase_rad[at] = seen.phase_rad.rem_euclid(TAU) as f32;
                        maps.modulation_e[at] = seen.light.modulation_e as f32;
                        maps.mean_e[at] = seen.light.mean_e as f32;
                    }
                }
                let column = self.column(&view, smoothed, index, &mut of_smoothed, ray);
                if let Ok(column) = column {
                    maps.column_px[place] = column.column_px;
                    let turns = finest.phase_rad(column.column_px, self.projector_width_px) / TAU;
                    let wrapped = f64::from(maps.phase_rad[(sets - 1) * size + place]) / TAU;
                    maps.order[place] = (turns - wrapped).round() as i32;
                }
            }
        }
        let mut has_point = vec![true; self.rays.len()];
        for &cell in &decoded.without_point {
            has_point[cell as usize] = false;
        }
        let with_point = (0..self.rays.len()).filter(|&cell| has_point[cell]);
        let points = decoded
            .cloud
            .points_mm
            .iter()
            .zip(&decoded.cloud.sigma_z_mm);
        for (cell, (point, sigma)) in with_point.zip(points) {
            maps.depth_mm[places[cell]] = point[2] as f32;
            maps.sigma_z_mm[places[cell]] = *sigma;
        }
        Ok(maps)
    }

    /// Shape of a map, and where in it each cell lies.
    fn places(&self) -> (Vec<usize>, Vec<usize>) {
        match &self.layout.grid {
            Grid::Cores(grid) => (vec![grid.len()], (0..grid.len()).collect()),
            Grid::Blocks(grid) => {
                let in_row = |row: usize| {
                    let span = grid.span(row);
                    (span.begin..span.end).map(move |column| row * grid.columns + column)
                };
                (
                    vec![grid.rows, grid.columns],
                    (0..grid.rows).flat_map(in_row).collect(),
                )
            }
        }
    }
}
