//! Loss that may be hidden in the unseen part of each measured cell.
//!
//! ```text
//!  rays that meet the cell, points that lie there ──► shadows: fewer points than rays                    ─┐
//!  cells deeper than both neighbours              ──► single openings too narrow to look into             ├─► share, depth
//!  scatter of points within cells                 ──► openings side by side, each narrower than a cell   ─┘
//! ```
//!
//! A camera that looks along a flank at an angle of tangent t to its normal sees down to w / t into an opening of width w: where
//! the floor is not seen, depths from nought to w / t come back, evenly, from the far wall. Where they pile up at the deepest,
//! that is a floor. An opening's hidden floor is supposed [`DEPTH_PER_WIDTH`] times as deep as the opening is wide, and never
//! deeper than the settings suppose of a hole. What no evidence shows is in docs/method.md: texture of openings narrower than
//! some 0.03 mm scatters no more than a rough surface does.

use flankscope_foundation::order::quantile;

use super::disc::Discs;
use super::field::WearSample;
use super::sight::Visibility;

/// Depth over width that is supposed of an opening whose floor is not seen: scores, pits and V grooves of worn dies are not
/// steeper; a crack that is narrower than a cell takes up little of a disc.
const DEPTH_PER_WIDTH: f64 = 3.0;
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
/// It is, too, when its points scatter more than that on average, mm: texture that fills a part of a disc only. Hairlines that are seen
/// to their floor scatter in the few cells in which they begin and end.
const PARTLY_ROUGH_MM: f64 = 4.2e-3;
/// Cells of a window for each that a single straight edge crosses (at most nine of 25): an edge is no texture, so that no cell counts for
/// more than that many times the limit in the average.
const CELLS_PER_EDGE_CELL: f64 = 25.0 / 9.0;
/// Quantiles of the depths in a window that stand for the unworn surface between the openings, and for the deepest that light
/// came back from: one point in thirty may be wrong.
const LAND_RATIO: f64 = 0.1;
const DEEPEST_RATIO: f64 = 0.97;
/// Tangent of the angle between rays and normal where no rays are known.
const SLANT: f64 = 1.732;

/// Part of a cell that was not seen.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Unseen {
    /// Share of the cell.
    pub share: f64,
    /// Loss that is supposed there, mm, a hole's at most: infinite where nothing bounds it.
    pub depth_mm: f64,
    /// Whether walls hide it; else it merely brought no points.
    pub behind_walls: bool,
}

impl Unseen {
    /// An opening of that width that takes up a share of the cell, with a rim so deep.
    pub fn opening(share: f64, width_mm: f64, rim_mm: f64) -> Self {
        Self {
            share: share.clamp(0.0, 1.0),
            depth_mm: rim_mm + DEPTH_PER_WIDTH * width_mm,
            behind_walls: true,
        }
    }

    /// The one of the two that may hide more.
    pub fn or(self, other: Self) -> Self {
        let worth = |of: Self| of.share * of.depth_mm.min(1.0);
        if worth(other) > worth(self) {
            other
        } else {
            self
        }
    }
}

/// Unseen part of every cell. `scale` is the ratio of the cells' noise to the stated one.
pub(super) fn of_cells(
    discs: &Discs<'_>,
    visibility: Option<&Visibility>,
    scale: f64,
) -> Vec<Unseen> {
    let field = discs.field();
    let slant = visibility.map_or(SLANT, Visibility::slant);
    let mut all = textures(discs, slant);
    if let Some(visibility) = visibility {
        let reached_mm = |cells: &[usize], level_mm: f64| reached_mm(discs, cells, level_mm, scale);
        let grooves = field.grooves(slant, scale, reached_mm);
        let shadows = visibility.shadows(field, scale);
        for ((unseen, groove), shadow) in all.iter_mut().zip(grooves).zip(shadows) {
            *unseen = unseen.or(groove).or(shadow);
        }
    }
    all
}

/// Depth below a level from which light came back out of an opening with an unseen floor, mm: depths from nought to there are equally
/// frequent, and the ratio of their second moment to their first is two thirds of the deepest. One outlier among the points hardly
/// counts, as it would for the deepest of them. Points within two standard deviations of the level are noise on it. Infinite where
/// nothing lies below.
fn reached_mm(discs: &Discs<'_>, cells: &[usize], level_mm: f64, noise_scale: f64) -> f64 {
    let (mut first, mut second) = (0.0, 0.0);
    for sample in cells.iter().flat_map(|&cell| discs.of_cell(cell)) {
        let depth_mm = sample.wear_mm - level_mm;
        let noise_mm2 = noise_scale * noise_scale * sample.variance_mm2;
        if depth_mm <= 2.0 * noise_mm2.sqrt() {
            continue;
        }
        first += sample.merged * depth_mm;
        second += sample.within_mm2 + sample.merged * (depth_mm * depth_mm - noise_mm2);
    }
    if first > 0.0 {
        1.5 * second / first
    } else {
        f64::INFINITY
    }
}

/// Scatter of a cell's points about their plane.
#[derive(Clone, Copy)]
struct Scatter {
    /// Their variance, mm2.
    variance_mm2: f64,
    /// Variance of the points' noise, mm2.
    noise_mm2: f64,
    /// Degrees of freedom.
    freedom: f64,
}

impl Scatter {
    /// Variance less that of noise, were this cell's the [`SMOOTH_RATIO`] quantile of equal ones, mm2: Wilson and Hilferty 1931.
    fn excess_as_quantile_mm2(&self) -> f64 {
        let ninth = 2.0 / (9.0 * self.freedom);
        let quantile = (1.0 - ninth + SMOOTH_DEVIATE * ninth.sqrt()).powi(3);
        self.variance_mm2 / quantile - self.noise_mm2
    }
}

/// Whether the cells of a window scatter more than noise and a rough surface do, in all of it or in a part.
fn is_textured(cells: &[Scatter]) -> bool {
    let freedom: f64 = cells.iter().map(|of| of.freedom).sum();
    let noise_mm2 = cells.iter().map(|of| of.noise_mm2).sum::<f64>() / cells.len() as f64;
    // Three standard deviations of the noise's own variance.
    let by_chance_mm2 = 3.0 * noise_mm2 * (2.0 / freedom).sqrt();
    let exceeds = |mm2: f64, limit_mm: f64| mm2 > limit_mm * limit_mm + by_chance_mm2;
    let most_mm2 = CELLS_PER_EDGE_CELL * PARTLY_ROUGH_MM * PARTLY_ROUGH_MM;
    let excess_mm2 = |of: &Scatter| (of.variance_mm2 - of.noise_mm2).min(most_mm2);
    let mean_mm2 = cells.iter().map(excess_mm2).sum::<f64>() / cells.len() as f64;
    let mut excesses: Vec<f64> = cells.iter().map(Scatter::excess_as_quantile_mm2).collect();
    exceeds(mean_mm2, PARTLY_ROUGH_MM)
        || quantile(&mut excesses, SMOOTH_RATIO).is_some_and(|mm2| exceeds(mm2, ROUGHNESS_MM))
}

/// Scatter of a cell's points; none of a cell with too few.
fn scatter(points: &[&WearSample]) -> Option<Scatter> {
    let count: f64 = points.iter().map(|p| p.merged).sum();
    let freedom = count - 3.0;
    if points.len() < 4 || freedom < 2.0 {
        return None;
    }
    let of_noise = points.iter().map(|p| p.variance_mm2 * p.merged);
    let noise_mm2 = of_noise.sum::<f64>() / count;
    let within_mm2: f64 = points.iter().map(|p| p.within_mm2).sum();
    let squares = squares_about_plane(points)? + within_mm2;
    let noise_mm2 = if noise_mm2.is_finite() {
        noise_mm2
    } else {
        0.0
    };
    Some(Scatter {
        variance_mm2: squares / freedom,
        noise_mm2,
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

/// Texture of openings narrower than a cell: points of one cell scatter by their noise and the surface's roughness, or there is
/// structure below the cell.
fn textures(discs: &Discs<'_>, slant: f64) -> Vec<Unseen> {
    let field = discs.field();
    let count = field.wear_mm.len();
    let of_cell = |cell| scatter(&discs.of_cell(cell).collect::<Vec<_>>());
    let scatters: Vec<Option<Scatter>> = (0..count).map(of_cell).collect();
    (0..count)
        .map(|cell| {
            let window = || field.window(cell, WINDOW);
            let known: Vec<Scatter> = window().filter_map(|c| scatters[c]).collect();
            if known.len() < LEAST_CELLS || !is_textured(&known) {
                return Unseen::default();
            }
            let mut wears: Vec<f64> = window()
                .flat_map(|c| discs.of_cell(c).map(|p| p.wear_mm))
                .collect();
            let mean_mm = wears.iter().sum::<f64>() / wears.len() as f64;
            let [land_mm, deepest_mm] = [LAND_RATIO, DEEPEST_RATIO]
                .map(|ratio| quantile(&mut wears, ratio).unwrap_or(mean_mm));
            let reach_mm = (deepest_mm - land_mm).max(ROUGHNESS_MM);
            // Even depths from nought to the deepest: the mean of an opening's is half of that.
            let share = 2.0 * (mean_mm - land_mm) / reach_mm;
            Unseen::opening(share, reach_mm * slant, deepest_mm)
        })
        .collect()
}

#[cfg(test)]
pub(crate) mod tests {
    use super::super::field::Field;
    use super::super::sight::RayCounts;
    use super::super::{FlankWear, WearSettings};
    use super::*;
    use crate::gear::Flank;
    use crate::random::{normal, uniform};

    /// Rays of the 20 mm head on a flank: one per column and row of these, jittered by a tenth, mm.
    const RAYS_MM: [f64; 2] = [0.09, 0.027];
    /// Ripple of the projector's cores and photon noise, of which the second is stated, mm.
    const RIPPLE_MM: f64 = 1e-3;
    const NOISE_MM: f64 = 0.4e-3;
    /// Step of the march along a ray, mm.
    const STEP_MM: f64 = 4e-3;

    /// A zone as the camera sees it that looks along x at an angle of tangent `slant` to the normal: every ray is followed until
    /// it meets the surface, `depth_mm` below the drawing. Brute force, which knows nothing of walls and openings.
    pub(crate) fn looked_at(
        depth_mm: impl Fn([f64; 2]) -> f64,
        size_mm: [f64; 2],
        slant: f64,
        seed: u64,
    ) -> FlankWear {
        let settings = WearSettings::default();
        let empty = Field::unmeasured(size_mm, settings.cell_mm());
        let mut counts = RayCounts::new(empty.wear_mm.len());
        counts.slant = slant;
        let mut samples = Vec::new();
        // Rays that enter before the zone end in it.
        let columns = ((size_mm[0] + 2.0) / RAYS_MM[0]) as u64;
        let rows = (size_mm[1] / RAYS_MM[1]) as u64;
        for ray in 0..columns * rows {
            let (column, row) = (ray % columns, ray / columns);
            let jitter = |k: u64| 0.2 * (uniform(seed, 2 * ray + k) - 0.5);
            let shifted = 0.5 * (row % 2) as f64;
            let x = (column as f64 + shifted + jitter(0)) * RAYS_MM[0] - 1.9;
            let y = (row as f64 + 0.5 + jitter(1)) * RAYS_MM[1];
            if let Some(cell) = empty.cell_at([x, y]) {
                counts.rays[cell] += 1;
            }
            let Some(depth) = march(&depth_mm, [x, y], slant) else {
                continue;
            };
            let off = RIPPLE_MM * normal(seed + 1, ray) + NOISE_MM * normal(seed + 2, ray);
            let at_mm = [x + slant * (depth + off), y];
            if let Some(cell) = empty.cell_at(at_mm) {
                counts.points[cell] += 1;
                samples.push(WearSample::of_point(
                    at_mm,
                    depth + off,
                    NOISE_MM * NOISE_MM,
                ));
            }
        }
        let visibility = Visibility::from_counts(&counts, &empty);
        FlankWear::new(
            (40, Flank::Left),
            empty,
            samples,
            Some(visibility),
            0.0,
            &settings,
        )
    }

    /// Depth at which a ray through a place on the drawing meets the surface; none where that is deeper than a millimetre.
    fn march(depth_mm: &impl Fn([f64; 2]) -> f64, [x, y]: [f64; 2], slant: f64) -> Option<f64> {
        let step = STEP_MM / slant;
        // Proud material meets the ray before the drawing does.
        let mut depth = -0.03;
        let is_above = |depth: f64| depth < depth_mm([x + slant * depth, y]);
        while is_above(depth) {
            depth += step;
            if depth > 1.0 {
                return None;
            }
        }
        // Between the last two steps, to a hundredth of a micrometre.
        let mut half = 0.5 * step;
        depth -= half;
        while half > 1e-5 {
            half *= 0.5;
            depth += if is_above(depth) { half } else { -half };
        }
        Some(depth)
    }

    const SIZE_MM: [f64; 2] = [1.7, 3.0];

    /// Share of the cells that have an unseen part that a disc's verdict would feel.
    fn flagged(wear: &FlankWear) -> f64 {
        let scale = wear.field.noise_scale();
        let discs = Discs::new(
            &wear.field,
            &wear.measured.samples,
            WearSettings::default().area_mm2,
        );
        let unseen = of_cells(&discs, wear.measured.visibility.as_ref(), scale);
        let count = unseen
            .iter()
            .filter(|of| of.share * of.depth_mm > 20e-3)
            .count();
        count as f64 / unseen.len() as f64
    }

    #[test]
    fn texture_of_openings_with_hidden_floors_is_told_from_a_rough_surface() {
        let inside = |on: bool| if on { 0.15 } else { 0.0 };
        let along =
            |width: f64, pitch: f64| move |[x, _]: [f64; 2]| inside(x.rem_euclid(pitch) < width);
        let pits = |[x, y]: [f64; 2]| {
            let away = |v: f64| v.rem_euclid(0.09) - 0.045;
            inside(away(x).hypot(away(y)) < 0.042)
        };
        let vees = |[x, _]: [f64; 2]| 0.11 * (1.0 - (x.rem_euclid(0.05) / 0.025 - 1.0).abs());
        for slant in [1.7, 2.9] {
            for (name, wear) in [
                ("grooves", looked_at(along(0.04, 0.07), SIZE_MM, slant, 3)),
                (
                    "wide grooves",
                    looked_at(along(0.06, 0.09), SIZE_MM, slant, 4),
                ),
                ("pits", looked_at(pits, SIZE_MM, slant, 5)),
                ("V grooves", looked_at(vees, SIZE_MM, slant, 6)),
            ] {
                assert!(
                    flagged(&wear) > 0.5,
                    "{name} at {slant}: {}",
                    flagged(&wear)
                );
            }
            // Rq of 3 um, correlated over 50 um; nothing at all; a bowl 40 um deep; a slope.
            let rough = |p: [f64; 2]| waves(p, 3e-3, 0.05, 8);
            let bowl =
                |[x, y]: [f64; 2]| (0.04 - 0.16 * ((x - 0.8).powi(2) + (y - 1.5).powi(2))).max(0.0);
            for (name, wear) in [
                ("rough", looked_at(rough, SIZE_MM, slant, 9)),
                ("flat", looked_at(|_| 0.0, SIZE_MM, slant, 10)),
                ("bowl", looked_at(bowl, SIZE_MM, slant, 11)),
                ("slope", looked_at(|[_, y]| 0.01 * y, SIZE_MM, slant, 12)),
            ] {
                assert_eq!(flagged(&wear), 0.0, "{name} at {slant}");
            }
        }
    }

    /// Hairlines anywhere and in any direction.
    pub(crate) fn hairlines(
        count: u64,
        width_mm: [f64; 2],
        depth_mm: [f64; 2],
        seed: u64,
    ) -> impl Fn([f64; 2]) -> f64 {
        let between = |k: u64, [low, high]: [f64; 2]| low + (high - low) * uniform(seed, k);
        let lines: Vec<[f64; 4]> = (0..count)
            .map(|i| {
                let angle = between(5 * i, [0.0, std::f64::consts::PI]);
                let at = [0, 1].map(|k| between(5 * i + 1 + k as u64, [0.0, SIZE_MM[k]]));
                let across = at[0] * angle.cos() + at[1] * angle.sin();
                [
                    angle,
                    across,
                    between(5 * i + 3, width_mm),
                    between(5 * i + 4, depth_mm),
                ]
            })
            .collect();
        move |[x, y]| {
            let depth = |&[angle, at, width, depth]: &[f64; 4]| {
                let off = (x * angle.cos() + y * angle.sin() - at) / (0.5 * width);
                if off.abs() < 1.0 {
                    0.5 * depth * (1.0 + (std::f64::consts::PI * off).cos())
                } else {
                    0.0
                }
            };
            lines.iter().map(depth).fold(0.0, f64::max)
        }
    }

    /// A band-limited surface of a given rms and correlation length.
    pub(crate) fn waves([x, y]: [f64; 2], rms_mm: f64, length_mm: f64, seed: u64) -> f64 {
        const WAVES: u64 = 24;
        let sum: f64 = (0..WAVES)
            .map(|k| {
                let n = |i: u64| normal(seed, 3 * k + i) / length_mm;
                let phase = std::f64::consts::TAU * uniform(seed + 1, k);
                (n(0) * x + n(1) * y + phase).cos()
            })
            .sum();
        rms_mm * sum * (2.0 / WAVES as f64).sqrt()
    }

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
