//! The phasors of a view as they are asked: smoothed, if that is wanted.

use std::borrow::Cow;

use super::Decoder;
use super::cell::FINE_RATIO;
use crate::accumulate::{Accumulator, Band};
use crate::cells::Grid;
use crate::phase::smoothing::{self, Blur, Difference};

/// Phasors to take phases from.
pub(super) struct Conditioned<'a> {
    pub accumulator: Cow<'a, Accumulator>,
    /// Factor by which smoothing changed the standard deviation of each frequency's phase.
    pub sigma_ratios: Vec<f64>,
    /// Centroid of the light of the finest frequency, in cells from each cell; empty where nothing was smoothed.
    pub centroids: Vec<[f32; 2]>,
    /// Per frequency its phase difference to the finest, where that is used instead of its own phase.
    pub differences: Vec<Option<Difference>>,
    /// Ratio of the frames' scatter to the one predicted from light and sensor; 1 where it is not determined.
    pub frame_noise_ratio: f64,
}

impl Decoder {
    /// Phasors as they were added.
    pub(super) fn plain<'a>(&self, accumulator: &'a Accumulator) -> Conditioned<'a> {
        let sets = self.patterns.sets.len();
        Conditioned {
            accumulator: Cow::Borrowed(accumulator),
            sigma_ratios: vec![1.0; sets],
            centroids: Vec::new(),
            differences: vec![None; sets],
            frame_noise_ratio: 1.0,
        }
    }

    /// Phasors smoothed as the options say: of fine frequencies a little, of coarse ones more, and of fine ones that only
    /// together tell the order, their differences as much as the coarse ones.
    pub(super) fn condition<'a>(&self, accumulator: &'a Accumulator) -> Conditioned<'a> {
        let mut view = self.plain(accumulator);
        view.frame_noise_ratio = self.frame_noise_ratio(accumulator);
        let [fine_cells, coarse_cells] = self.smoothing_cells();
        let Grid::Blocks(grid) = &self.layout.grid else {
            return view;
        };
        if !(fine_cells > 0.0 || coarse_cells > 0.0) {
            return view;
        }
        let finest = self.patterns.sets.len() - 1;
        let is_fine = |set: usize| {
            self.patterns.sets[set].periods > FINE_RATIO * self.patterns.finest().periods
        };
        if let Some(blur) = Blur::new(coarse_cells) {
            for set in (0..finest).filter(|&set| is_fine(set)) {
                let weight = |band: &Band, cell: usize| self.phase_weight(band, cell, set);
                let difference = Difference::new(accumulator, grid, [set, finest], &blur, weight);
                view.differences[set] = Some(difference);
            }
        }
        let cells = |set: usize| {
            if is_fine(set) {
                fine_cells
            } else {
                coarse_cells
            }
        };
        view.centroids =
            smoothing::centroids(accumulator, grid, finest, fine_cells).unwrap_or_default();
        let sigmas: Vec<f64> = (0..=finest).map(cells).collect();
        let ratios = smoothing::smooth(view.accumulator.to_mut(), grid, &sigmas);
        view.sigma_ratios = ratios.iter().map(|ratio| ratio.sqrt()).collect();
        view
    }

    /// Weight of a cell's phase of one frequency among its neighbours: by its variance, but levelling off where the phase alone makes the
    /// order certain. Otherwise a highlight beside an edge would dominate the cells beyond the edge.
    fn phase_weight(&self, band: &Band, index: usize, set: usize) -> f32 {
        let sigma_rad = self.phase_sigma_rad(band, index, set);
        let enough_rad2 = self.enough_rad * self.enough_rad;
        sigma_rad.map_or(0.0, |sigma_rad| {
            (enough_rad2 / (sigma_rad * sigma_rad + enough_rad2)) as f32
        })
    }

    /// Sigma of the Gaussian over the phasors in cells: of the finest fringes, and of coarser ones.
    pub(super) fn smoothing_cells(&self) -> [f64; 2] {
        let pitch_px = match &self.layout.grid {
            Grid::Blocks(grid) => grid.binning as f64,
            Grid::Cores(_) => return [0.0; 2],
        };
        [self.options.smoothing_px, self.options.coarse_smoothing_px].map(|px| px / pitch_px)
    }
}
