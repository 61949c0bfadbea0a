//! Texture of openings narrower than a cell: their floors are hidden, and single points do not show it.
//!
//! The points of one cell scatter by their noise and the surface's roughness, or there is structure below the cell. Windows of a disc's
//! size are looked at: all of one may be rough, or a part of it be rougher. What a flank is finished like shows all over it: a window
//! that scatters much more than most of its flank is textured, unless few straight scratches explain it (`scratches.rs`).

use flankscope_foundation::order::{median_of, quantile, range_of};
use rayon::prelude::*;

use super::disc::Discs;
use super::field::WearSample;
use super::scratches;
use super::unseen::Unseen;

/// Scatter within a cell that counts as roughness, mm: a surface of Ra 3.2 um (grade N8 of ISO 1302) has an Rq of 4 um, of which a core's
/// footprint, 0.09 mm long at a grazing angle, and the cell's own plane take some away (white roughness of 3 um is seen as 2.1 um at
/// the median, and as 3.4 um in one window of a hundred).
const ROUGHNESS_MM: f64 = 3.8e-3;
/// Cells to each side of a cell that together are about a disc.
const WINDOW: usize = 2;
/// Least number of cells with an estimate in a window.
const LEAST_CELLS: usize = 8;
/// A window is textured when at least three quarters of its cells scatter that much: a single scratch crosses fewer.
const SMOOTH_RATIO: f64 = 0.25;
/// Standard normal quantile of [`SMOOTH_RATIO`].
const SMOOTH_DEVIATE: f64 = -0.674_490;
/// It is, too, when its points scatter so many times as much as those of the flank's middle window do: texture in a patch. Windows of
/// a flank that is evenly rough reach 1.9 times, on the bench, and pits a fifth of whose area is open 2.5 times.
const PATCH_RATIO: f64 = 2.4;
/// At least by that, mm: a sound flank may have an Rq of 3 um, be it in places.
const LEAST_PATCH_MM: f64 = 3e-3;
/// And at most, mm, however rough the flank: most of it may be textured.
const PARTLY_ROUGH_MM: f64 = 4.2e-3;
/// Scatter between the means of nine cells that is no step, mm: three standard deviations of a mean's noise on a smooth flank.
const LEAST_STEP_MM: f64 = 3e-3;
/// Most that a step of height h leaves of a cell's variance about the plane that fits best, in h squared: wherever the step lies, a
/// share s(1 - s) less its slope's part 3 s²(1 - s)², of which this is the largest.
const STEP_VARIANCE: f64 = 1.0 / 12.0;
/// Where more than that part of a flank's windows scatter too much it is no matter of few scratches.
const MOST_SCRATCHED: f64 = 1.0 / 3.0;
/// Quantiles of the depths in a window that stand for the unworn surface between the openings, and for the deepest that light
/// came back from: one point in thirty may be wrong.
const LAND_RATIO: f64 = 0.1;
const DEEPEST_RATIO: f64 = 0.97;

/// Scatter of a cell's points about their plane.
#[derive(Clone, Copy)]
struct Scatter {
    /// Their variance, mm2.
    variance_mm2: f64,
    /// Variance of the points' noise, mm2.
    noise_mm2: f64,
    /// Most of the variance that a step between the levels about the cell explains, mm2.
    of_step_mm2: f64,
    /// Degrees of freedom.
    freedom: f64,
}

impl Scatter {
    /// Variance less that of noise, mm2.
    fn excess_mm2(&self) -> f64 {
        self.variance_mm2 - self.noise_mm2
    }

    /// Variance less that of noise, were this cell's the [`SMOOTH_RATIO`] quantile of equal ones, mm2: Wilson and Hilferty 1931.
    fn excess_as_quantile_mm2(&self) -> f64 {
        let ninth = 2.0 / (9.0 * self.freedom);
        let quantile = (1.0 - ninth + SMOOTH_DEVIATE * ninth.sqrt()).powi(3);
        self.variance_mm2 / quantile - self.noise_mm2
    }
}

/// The cells of a window that have an estimate.
struct Window {
    cells: Vec<Scatter>,
    /// Three standard deviations of the noise's own variance, mm2.
    by_chance_mm2: f64,
}

impl Window {
    /// None with too few cells.
    fn of(cells: Vec<Scatter>) -> Option<Self> {
        let freedom: f64 = cells.iter().map(|of| of.freedom).sum();
        let noise_mm2 = cells.iter().map(|of| of.noise_mm2).sum::<f64>() / cells.len() as f64;
        (cells.len() >= LEAST_CELLS).then(|| Self {
            by_chance_mm2: 3.0 * noise_mm2 * (2.0 / freedom).sqrt(),
            cells,
        })
    }

    /// Mean of the cells' variances beyond noise and steps, mm2: an edge is no texture.
    fn mean_mm2(&self) -> f64 {
        let beside_steps = |of: &Scatter| of.excess_mm2() - of.of_step_mm2;
        self.cells.iter().map(beside_steps).sum::<f64>() / self.cells.len() as f64
    }

    /// Whether a variance is beyond a limit by more than chance.
    fn exceeds(&self, mm2: f64, limit_mm: f64) -> bool {
        mm2 > limit_mm * limit_mm + self.by_chance_mm2
    }

    /// The scatter beyond which this window is textured, mm, if it is beyond it: all of it but for what a single scratch leaves alone,
    /// or its mean.
    fn limit_exceeded_mm(&self, patch_limit_mm: f64) -> Option<f64> {
        if self.exceeds(self.mean_mm2(), patch_limit_mm) {
            return Some(patch_limit_mm);
        }
        let all = self.cells.iter().map(Scatter::excess_as_quantile_mm2);
        let lower_mm2 = quantile(&mut all.collect::<Vec<_>>(), SMOOTH_RATIO)?;
        self.exceeds(lower_mm2, ROUGHNESS_MM)
            .then_some(ROUGHNESS_MM)
    }

    /// Whether its points scatter beyond a limit beside all scratches that may be in it, too.
    fn scatters_beside_scratches(&self, points: &[&WearSample], limit_mm: f64) -> bool {
        scratches::scatter_beside_mm2(points).is_none_or(|variance_mm2| {
            self.exceeds(variance_mm2 - mean_noise_mm2(points), limit_mm)
        })
    }
}

/// Scatter from which a window of this flank is a patch of texture, mm.
fn patch_limit_mm(windows: &[Option<Window>]) -> f64 {
    let scatter = |of: &Window| of.mean_mm2().max(0.0).sqrt();
    let scatters = windows.iter().flatten().map(scatter);
    let typical_mm = median_of(scatters).unwrap_or(PARTLY_ROUGH_MM);
    (PATCH_RATIO * typical_mm).clamp(LEAST_PATCH_MM, PARTLY_ROUGH_MM)
}

/// Mean variance of points' noise, mm2; nought where it is not stated.
fn mean_noise_mm2(points: &[&WearSample]) -> f64 {
    let count: f64 = points.iter().map(|p| p.merged).sum();
    let noise = points.iter().map(|p| p.variance_mm2 * p.merged);
    let mean_mm2 = noise.sum::<f64>() / count;
    if mean_mm2.is_finite() { mean_mm2 } else { 0.0 }
}

/// Scatter of a cell's points, where the means of the cells around it differ by so much; none of a cell with too few.
fn scatter(points: &[&WearSample], range_mm: f64) -> Option<Scatter> {
    let count: f64 = points.iter().map(|p| p.merged).sum();
    let freedom = count - 3.0;
    if points.len() < 4 || freedom < 2.0 {
        return None;
    }
    let within_mm2: f64 = points.iter().map(|p| p.within_mm2).sum();
    let squares = squares_about_plane(points)? + within_mm2;
    Some(Scatter {
        variance_mm2: squares / freedom,
        noise_mm2: mean_noise_mm2(points),
        of_step_mm2: STEP_VARIANCE * (range_mm - LEAST_STEP_MM).max(0.0).powi(2),
        freedom,
    })
}

/// Sum of squares of points about the plane that fits them best, each counted as often as points were merged into it, mm2;
/// none where they lie on a line.
fn squares_about_plane(points: &[&WearSample]) -> Option<f64> {
    let mut normal = nalgebra::Matrix3::<f64>::zeros();
    let mut right = nalgebra::Vector3::<f64>::zeros();
    let [x0, y0] = points[0].at_mm;
    let row = |p: &WearSample| nalgebra::Vector3::new(1.0, p.at_mm[0] - x0, p.at_mm[1] - y0);
    for point in points {
        let row = row(point);
        normal += point.merged * row * row.transpose();
        right += point.merged * point.wear_mm * row;
    }
    let plane = normal.cholesky()?.solve(&right);
    let squares = points
        .iter()
        .map(|p| p.merged * (p.wear_mm - row(p).dot(&plane)).powi(2));
    Some(squares.sum())
}

/// Unseen part of every cell by texture. `slant` is the tangent of the angle between rays and normal.
pub(super) fn of_cells(discs: &Discs<'_>, slant: f64) -> Vec<Unseen> {
    let field = discs.field();
    let count = field.wear_mm.len();
    let of_cell = |cell| {
        let range_mm = range_of(field.window(cell, 1).map(|c| field.wear_mm[c]));
        scatter(&discs.of_cell(cell).collect::<Vec<_>>(), range_mm)
    };
    let scatters: Vec<Option<Scatter>> = (0..count).map(of_cell).collect();
    let window = |cell| {
        let known = field.window(cell, WINDOW).filter_map(|c| scatters[c]);
        Window::of(known.collect())
    };
    let windows: Vec<Option<Window>> = (0..count).map(window).collect();
    let limit_mm = patch_limit_mm(&windows);
    let exceeded = |window: &Option<Window>| window.as_ref()?.limit_exceeded_mm(limit_mm);
    let exceeded_mm: Vec<Option<f64>> = windows.iter().map(exceeded).collect();
    let suspected = exceeded_mm.iter().flatten().count() as f64;
    let is_all_over = suspected > MOST_SCRATCHED * windows.iter().flatten().count() as f64;
    let of_window = |middle: usize| {
        let (window, limit_mm) = (windows[middle].as_ref()?, exceeded_mm[middle]?);
        let points: Vec<&WearSample> = field
            .window(middle, WINDOW)
            .flat_map(|cell| discs.of_cell(cell))
            .collect();
        let is_textured = is_all_over || window.scatters_beside_scratches(&points, limit_mm);
        is_textured.then(|| opening(points.iter().map(|p| p.wear_mm).collect(), slant))
    };
    let textured: Vec<Option<Unseen>> = (0..count).into_par_iter().map(of_window).collect();
    // What a window hides lies somewhere in it, and less likely at its rim.
    let of_cell = |cell| {
        let windows = field.window(cell, WINDOW / 2).filter_map(|w| textured[w]);
        windows.fold(Unseen::default(), Unseen::or)
    };
    (0..count).map(of_cell).collect()
}

/// Unseen part of a window whose points have these wears, mm: openings as deep at their deepest seen point as light reaches into them.
pub(super) fn opening(mut wears: Vec<f64>, slant: f64) -> Unseen {
    let mean_mm = wears.iter().sum::<f64>() / wears.len() as f64;
    let [land_mm, deepest_mm] =
        [LAND_RATIO, DEEPEST_RATIO].map(|ratio| quantile(&mut wears, ratio).unwrap_or(mean_mm));
    let reach_mm = (deepest_mm - land_mm).max(ROUGHNESS_MM);
    // Even depths from nought to the deepest: the mean of an opening's is half of that.
    let share = 2.0 * (mean_mm - land_mm) / reach_mm;
    Unseen::opening(share, reach_mm * slant, deepest_mm)
}

#[cfg(test)]
mod tests {
    use super::*;
    use flankscope_foundation::random::uniform;

    #[test]
    fn squares_about_a_plane_are_those_about_the_best_of_many() {
        let points: Vec<WearSample> = (0..7)
            .map(|i| {
                let u = |k: u64| uniform(17, 3 * i + k);
                WearSample::of_point([u(0), u(1)], u(2) + 2.0 * u(0), 1e-6)
            })
            .collect();
        let of: Vec<&WearSample> = points.iter().collect();
        let least = squares_about_plane(&of).unwrap();
        let squares = |[a, b, c]: [f64; 3]| -> f64 {
            let off = |p: &WearSample| p.wear_mm - a - b * p.at_mm[0] - c * p.at_mm[1];
            points.iter().map(|p| off(p).powi(2)).sum()
        };
        // Downhill in ever smaller steps from anywhere.
        let (mut best, mut step) = ([0.0; 3], 1.0);
        while step > 1e-7 {
            let tries = (0..6).map(|k| {
                let mut next = best;
                next[k / 2] += if k % 2 == 0 { step } else { -step };
                next
            });
            let next = tries
                .min_by(|a, b| squares(*a).total_cmp(&squares(*b)))
                .unwrap();
            if squares(next) < squares(best) {
                best = next;
            } else {
                step *= 0.5;
            }
        }
        assert!(
            (squares(best) - least).abs() < 1e-6,
            "{} {least}",
            squares(best)
        );
        // On a line no plane fits better than others.
        let line: Vec<WearSample> = (0..5)
            .map(|i| WearSample::of_point([f64::from(i), 2.0 * f64::from(i)], 0.0, 1e-6))
            .collect();
        assert_eq!(squares_about_plane(&line.iter().collect::<Vec<_>>()), None);
    }
}
