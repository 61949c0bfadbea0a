//! Statistics over neighbouring cells: disagreement between frequencies, scatter of phases.
//!
//! Predicted noise is that of light and sensor. Other errors (interreflections, fibres, the lamp) show as frequencies that disagree on
//! the column, and as scatter between neighbours. Both are averaged over some cells about each and compared with the
//! prediction.

use rayon::prelude::*;

use super::cell::{CellResult, Fate};
use super::options::OrderConsistency;
use crate::cells::{CellGrid, Grid};
use crate::phase::smoothing::{Blur, CellPlane};

/// Averaging over cells.
pub(super) struct Neighbourhood<'a> {
    grid: &'a Grid,
    plane: &'a CellPlane,
    /// Sigma of the Gaussian over the coarser phasors, or a cell where there is none.
    unit_cells: f64,
    /// Variance of a cell's difference from the mean of its two neighbours, in variances of a cell.
    bend_variance: f64,
}

/// Sigma of the Gaussian over what was measured, in units: some hundred values that were not smoothed together.
const NEAR_UNITS: f64 = 3.0;
/// Sigma of the Gaussian over which frequencies must mostly agree, in units: wider than the strips in which a spoiled phase
/// happens to fit a wrong order.
const WIDE_UNITS: f64 = 15.0;
/// Ratio to the predicted variance up to which the scatter about a cell may be chance: three standard deviations of the mean of some
/// seventy squares.
const CHANCE_VARIANCES: f32 = 1.5;
/// Ratio to the predicted variance beyond which the exposures about a cell disagree: some hundred cells leave 1.0 ± 0.1 by chance, and a
/// sensor whose noise was described too low by a third leaves 1.8.
const APART_VARIANCES: f32 = 2.0;
/// Ratio to the predicted variance beyond which a bend is an edge. With noise of ten times the prediction, fewer than one bend in a
/// hundred exceeds it.
const EDGE_VARIANCES: f64 = 700.0;

/// Three places are evenly spaced when the middle one is off by less than this part of the way between the others.
const UNEVEN_RATIO: f64 = 0.05;

/// A value per cell where there is one.
pub(super) type Values = Vec<Option<f32>>;

impl<'a> Neighbourhood<'a> {
    /// `plane` is the grid's; `smoothing_cells`: of the finest fringes and of the coarser ones.
    pub fn new(grid: &'a Grid, plane: &'a CellPlane, smoothing_cells: [f64; 2]) -> Self {
        // Neighbours that were smoothed together continue each other the better.
        let correlation = |cells| {
            let smoothed = Blur::new(smoothing_cells[0]);
            smoothed.map_or(0.0, |blur| blur.correlation(cells))
        };
        Self {
            grid,
            plane,
            unit_cells: smoothing_cells[1].max(1.0),
            bend_variance: 1.5 + 0.5 * correlation(2) - 2.0 * correlation(1),
        }
    }

    /// Drops cells about which the exposures disagree, though in each cell alone noise hides it. `found` is in predicted variances.
    pub fn judge_exposures(&self, results: &mut [CellResult], found: &Values) {
        if found.iter().all(Option::is_none) {
            return;
        }
        let around = self.mean(|cell| found[cell], NEAR_UNITS);
        let judged = results.par_iter_mut().zip(around);
        judged.for_each(|(result, apart)| {
            if result.fate == Fate::Point && apart > APART_VARIANCES {
                result.reject(Fate::ExposuresDisagree);
            }
        });
    }

    /// Drops cells about which the frequencies disagree so much, whatever their noise should be, that the order is not sure.
    pub fn judge_orders(&self, results: &mut [CellResult], least: OrderConsistency) {
        // A cell with a single possible order gives no information on the disagreement.
        let asked = |result: &CellResult| {
            let decided = matches!(result.fate, Fate::Point | Fate::Disagreeing);
            decided && result.clue_chi_square.is_finite()
        };
        // In distances to the next order: bright cells, whose predicted noise is small, must not dominate dim ones.
        let missed = |result: &CellResult| {
            let variance = result.separation.powi(-2);
            asked(result).then_some([result.clue_chi_square * variance, variance])
        };
        let agreed = |result: &CellResult| {
            let agreed = f32::from(u8::from(result.fate == Fate::Point));
            asked(result).then_some(agreed)
        };
        let ([missed, predicted], agreed) = rayon::join(
            || self.means(|cell| missed(&results[cell]), NEAR_UNITS),
            || self.mean(|cell| agreed(&results[cell]), WIDE_UNITS),
        );
        let around = missed.par_iter().zip(&predicted).zip(&agreed);
        let judged = results.par_iter_mut().zip(around);
        judged.for_each(|(result, ((missed, predicted), agreed))| {
            // By the noise measured about it, and whatever a bright cell's own is: by how far its neighbours miss.
            let variances = (missed / predicted.max(f32::MIN_POSITIVE)).max(1.0);
            let separation = result.separation / variances.sqrt();
            let told_apart = separation >= least.separation && *missed <= least.separation.powi(-2);
            let sure = told_apart && *agreed >= least.agreeing_share;
            if asked(result) && result.fate == Fate::Point && !sure {
                result.reject(Fate::Disagreeing);
            }
        });
    }

    /// Raises uncertainties to the scatter of the frames about each cell, in predicted variances.
    pub fn raise_to_frames(&self, results: &mut [CellResult], found: &Values) {
        if found.iter().all(Option::is_none) {
            return;
        }
        let around = self.mean(|cell| found[cell], NEAR_UNITS);
        let raised = results.par_iter_mut().zip(around);
        raised.for_each(|(result, variance)| {
            if variance > CHANCE_VARIANCES {
                result.sigma_z_mm *= variance.sqrt();
            }
        });
    }

    /// Raises uncertainties to what frequencies and neighbours show.
    pub fn raise_uncertainties(&self, results: &mut [CellResult]) {
        let disagreement = |result: &CellResult| {
            let found = result.column_chi_square;
            (result.fate == Fate::Point && found.is_finite()).then_some(found)
        };
        let by_frequencies = || {
            let known = results.iter().any(|result| disagreement(result).is_some());
            known.then(|| self.mean(|cell| disagreement(&results[cell]), NEAR_UNITS))
        };
        let by_neighbours = || match self.grid {
            Grid::Blocks(grid) => {
                let bends = self.bends(grid, results);
                Some(self.mean(|cell| bends[cell], NEAR_UNITS))
            }
            Grid::Cores(_) => None,
        };
        let (frequencies, neighbours) = rayon::join(by_frequencies, by_neighbours);
        let of = |variances: &Option<Vec<f32>>, cell: usize| {
            variances.as_ref().map_or(0.0, |variances| variances[cell])
        };
        results
            .par_iter_mut()
            .enumerate()
            .for_each(|(cell, result)| {
                let variance = of(&frequencies, cell).max(of(&neighbours, cell));
                if variance > CHANCE_VARIANCES {
                    result.sigma_z_mm *= variance.sqrt();
                }
            });
    }

    /// Squares of how far a depth lies from the mean of its neighbours in the row, in predicted variances. A surface is straight
    /// over three cells; noise is not.
    fn bends(&self, grid: &CellGrid, results: &[CellResult]) -> Values {
        let mut bends = vec![None; results.len()];
        for row in 0..grid.rows {
            let span = grid.span(row);
            let cells = span.first_cell..span.first_cell + span.len();
            let triples = results[cells.clone()].windows(3);
            // The outermost cells of a row have one neighbour.
            for (bend, triple) in bends[cells].iter_mut().skip(1).zip(triples) {
                let [before, here, after] = [&triple[0], &triple[1], &triple[2]];
                let off_mm = here.depth_mm - 0.5 * (before.depth_mm + after.depth_mm);
                let ratio = off_mm / f64::from(here.sigma_z_mm);
                // Cells without a point have no depth: NaN fails. Beyond an edge lies another surface.
                let square = ratio * ratio / self.bend_variance;
                *bend = (square < EDGE_VARIANCES && evenly_spaced(triple)).then_some(square as f32);
            }
        }
        bends
    }

    fn mean(&self, value: impl Fn(usize) -> Option<f32> + Sync, units: f64) -> Vec<f32> {
        self.plane.mean(self.grid, value, units * self.unit_cells)
    }

    fn means<const N: usize>(
        &self,
        values: impl Fn(usize) -> Option<[f32; N]> + Sync,
        units: f64,
    ) -> [Vec<f32>; N] {
        self.plane.means(self.grid, values, units * self.unit_cells)
    }
}

/// Whether the light of three cells comes from places as evenly spaced as the cells: smoothing beside an edge of light draws them
/// together, and their depths lie on the surface still, but not in a row.
fn evenly_spaced(triple: &[CellResult]) -> bool {
    let [before, here, after] = [0, 1, 2].map(|at: usize| triple[at].direction);
    let square = |[x, y]: [f64; 2]| x * x + y * y;
    let step = [0, 1].map(|axis| after[axis] - before[axis]);
    let off = [0, 1].map(|axis| here[axis] - 0.5 * (before[axis] + after[axis]));
    square(off) <= UNEVEN_RATIO * UNEVEN_RATIO * square(step)
}
