//! Openings side by side that leave most of a surface in place: their points lie below the surface and never above it.
//!
//! Depths of points in an opening of width w whose floor is hidden are uniform on [0, w / t], t being the tangent of the angle between rays
//! and normal. Where a share s of the surface is open, the third central moment of all points is (w / t)³ s (1 - s)² / 4, which is
//! positive; their variance (w / t)² (s / 3 - s² / 4) is below that of a rough surface if s is small, so that `texture.rs` sees nothing.
//!
//! The null hypothesis is that noise and roughness are symmetric: given the amount of a cell's sum c without its sign, both signs are
//! equally likely, whatever the distribution is and however the points of one cell depend on each other. The ratio
//!
//! ```text
//!  z = Σ c / √(Σ c²),  c = Σ (r³ - 3 v r) over the points of one cell
//! ```
//!
//! (r: residual of the window's surface of second order, v: their variance in the window) then has mean 0 and variance 1, and
//! P(z > x) <= exp(-x² / 2) (Hoeffding 1963). The residuals add up to nought, so that 3 v r changes no window's sum: it takes off what the
//! fitted mean does to each cell's cubes (the third Hermite polynomial is orthogonal to the first). No single outlier brings z beyond 1.
//!
//! A scratch changes the windows that it crosses, grooves change all of them. A region of nine windows is one-sided if at least three
//! quarters of its windows exceed [`ONE_SIDED`]. Where several scratches cross, that may be, too, though not in all nine windows: where one
//! does not exceed it, up to three strips for each window are
//! fitted (`scratches.rs`) whose depth depends on the distance from their middle alone. That explains a scratch that is seen to its floor.
//! It does not explain grooves: from all along a far wall light comes back from any depth. The ratios of a region beside the strips add up
//! to more than [`BESIDE_SCRATCHES`] standard deviations of their sum then.

use std::collections::BTreeMap;

use nalgebra::{SMatrix, SVector};

use super::disc::Discs;
use super::field::WearSample;
use super::scratches;
use super::texture;
use super::unseen::Unseen;

/// Cells along either side of a window, together about a disc.
const WINDOW: usize = 5;
/// Windows along either side of a region, and their number.
const REGION: usize = 3;
const WINDOWS: usize = REGION * REGION;
/// Ratio z beyond which a window is one-sided: one window in ten is on a symmetric surface.
const ONE_SIDED: f64 = 1.282;
/// Share of a region's windows that are one-sided on a grooved surface. On a symmetric one, seven of nine are with a probability of 3e-6.
const MOST: f64 = 0.75;
/// Standard deviations by which the sum of a region's ratios beside straight scratches has to exceed nought: one region in a hundred does
/// by chance.
const BESIDE_SCRATCHES: f64 = 2.326;
/// Least number of windows with an estimate in a region.
const LEAST_WINDOWS: usize = 8;
/// Terms of the surface of second order, and the least number of points for each.
const TERMS: usize = 6;
const POINTS_PER_TERM: f64 = 4.0;

type Row = SVector<f64, TERMS>;

/// A window of cells with its ratio z and the residuals of its points.
struct Window {
    cells: Vec<usize>,
    ratio: f64,
    /// Mean wear of its points, mm.
    mean_mm: f64,
    /// Residuals of its points, mm; positive for loss.
    residuals_mm: Vec<f64>,
}

impl Window {
    /// None with too few points.
    fn of_cells(discs: &Discs<'_>, cells: Vec<usize>) -> Option<Self> {
        let points: Vec<(usize, &WearSample)> = cells
            .iter()
            .flat_map(|&cell| discs.of_cell(cell).map(move |point| (cell, point)))
            .collect();
        let count: f64 = points.iter().map(|(_, point)| point.merged).sum();
        if count < POINTS_PER_TERM * TERMS as f64 {
            return None;
        }
        let rows: Vec<Row> = rows(&points);
        let mut normal = SMatrix::<f64, TERMS, TERMS>::zeros();
        let mut right = Row::zeros();
        for (row, (_, point)) in rows.iter().zip(&points) {
            normal += point.merged * row * row.transpose();
            right += point.merged * point.wear_mm * row;
        }
        let fit = normal.cholesky()?.solve(&right);
        let residual =
            |(row, (_, point)): (&Row, &(usize, &WearSample))| point.wear_mm - row.dot(&fit);
        let residuals_mm: Vec<f64> = rows.iter().zip(&points).map(residual).collect();
        let ratio = ratio(&points, &residuals_mm)?;
        Some(Self {
            ratio,
            mean_mm: points
                .iter()
                .map(|(_, p)| p.merged * p.wear_mm)
                .sum::<f64>()
                / count,
            residuals_mm,
            cells,
        })
    }

    /// Ratio z of what straight scratches leave of the points; the ratio beside none where there are too few points for one.
    fn ratio_beside_scratches(&self, discs: &Discs<'_>) -> f64 {
        let points: Vec<(usize, &WearSample)> = self
            .cells
            .iter()
            .flat_map(|&cell| discs.of_cell(cell).map(move |point| (cell, point)))
            .collect();
        let alone: Vec<&WearSample> = points.iter().map(|(_, point)| *point).collect();
        let left = scratches::residuals_beside_mm(&alone);
        left.and_then(|left| ratio(&points, &left))
            .unwrap_or(self.ratio)
    }

    fn is_one_sided(&self) -> bool {
        self.ratio > ONE_SIDED
    }

    /// Opening that its points show.
    fn opening(&self, slant: f64) -> Unseen {
        let depths_mm = self.residuals_mm.iter().map(|r| self.mean_mm + r);
        texture::opening(depths_mm.collect(), slant)
    }
}

/// Ratio z of residuals by the cells of their points; none without any scatter.
fn ratio(points: &[(usize, &WearSample)], residuals_mm: &[f64]) -> Option<f64> {
    let count: f64 = points.iter().map(|(_, point)| point.merged).sum();
    let square =
        |((_, point), r): (&(usize, &WearSample), &f64)| point.merged * r * r + point.within_mm2;
    let variance_mm2 = points.iter().zip(residuals_mm).map(square).sum::<f64>() / count;
    let mut cubes_of_cell = BTreeMap::<usize, f64>::new();
    for ((cell, point), residual_mm) in points.iter().zip(residuals_mm) {
        *cubes_of_cell.entry(*cell).or_default() +=
            point.cubes_about_mm3(*residual_mm) - 3.0 * variance_mm2 * point.merged * residual_mm;
    }
    let sum: f64 = cubes_of_cell.values().sum();
    let squares: f64 = cubes_of_cell.values().map(|cubes| cubes * cubes).sum();
    let ratio = sum / squares.sqrt();
    ratio.is_finite().then_some(ratio)
}

/// Rows of the surface of second order, from the middle of the points in units of their spread: well conditioned.
fn rows(points: &[(usize, &WearSample)]) -> Vec<Row> {
    let count = points.len() as f64;
    let middle = [0, 1].map(|k| points.iter().map(|(_, p)| p.at_mm[k]).sum::<f64>() / count);
    let spread_mm = |k: usize| {
        let squares = points.iter().map(|(_, p)| (p.at_mm[k] - middle[k]).powi(2));
        (squares.sum::<f64>() / count).sqrt()
    };
    let spread = [0, 1].map(spread_mm);
    let row = |(_, point): &(usize, &WearSample)| {
        let [x, y] = [0, 1].map(|k| (point.at_mm[k] - middle[k]) / spread[k]);
        Row::from([1.0, x, y, x * x, x * y, y * y])
    };
    points.iter().map(row).collect()
}

/// Windows side by side over a zone, row by row; none where too few points lie.
struct Tiles {
    columns: usize,
    rows: usize,
    windows: Vec<Option<Window>>,
}

impl Tiles {
    fn of_zone(discs: &Discs<'_>) -> Self {
        let field = discs.field();
        let [columns, rows] = [field.columns, field.rows].map(|cells| cells.div_ceil(WINDOW));
        let side = |tile: usize, tiles: usize, cells: usize| {
            tile * cells / tiles..(tile + 1) * cells / tiles
        };
        let window = |tile: usize| {
            let across = side(tile % columns, columns, field.columns);
            let up = side(tile / columns, rows, field.rows);
            let cells = up.flat_map(|row| {
                across
                    .clone()
                    .map(move |column| row * field.columns + column)
            });
            Window::of_cells(discs, cells.collect())
        };
        Self {
            columns,
            rows,
            windows: (0..columns * rows).map(window).collect(),
        }
    }

    /// Regions of [`WINDOWS`] neighbours: three by three, longer where the zone is narrower than that.
    fn regions(&self) -> impl Iterator<Item = Vec<&Window>> {
        let across = self.columns.min(REGION);
        let up = self.rows.min(WINDOWS.div_ceil(across));
        let across = self.columns.min(WINDOWS.div_ceil(up)).max(across);
        let corners = (0..=self.rows - up)
            .flat_map(move |row| (0..=self.columns - across).map(move |column| (column, row)));
        corners.map(move |(column, row)| {
            let tiles = (row..row + up)
                .flat_map(|row| (column..column + across).map(move |column| (column, row)));
            tiles
                .filter_map(|(column, row)| self.windows[row * self.columns + column].as_ref())
                .collect()
        })
    }
}

/// Unseen part of every cell by openings that leave most of the surface in place. `slant` is the tangent of the angle between rays and
/// normal.
pub(super) fn of_cells(discs: &Discs<'_>, slant: f64) -> Vec<Unseen> {
    let mut unseen = vec![Unseen::default(); discs.field().wear_mm.len()];
    if unseen.is_empty() {
        return unseen;
    }
    let tiles = Tiles::of_zone(discs);
    for region in tiles.regions().filter(|region| is_one_sided(region)) {
        if !region.iter().all(|window| window.is_one_sided())
            && !is_one_sided_beside_scratches(&region, discs)
        {
            continue;
        }
        for window in region.into_iter().filter(|window| window.is_one_sided()) {
            let opening = window.opening(slant);
            for &cell in &window.cells {
                unseen[cell] = unseen[cell].or(opening);
            }
        }
    }
    unseen
}

fn is_one_sided(region: &[&Window]) -> bool {
    exceed_most(region.iter().map(|window| window.ratio))
}

/// Whether the ratios of a region's windows beside straight scratches add up to too much.
fn is_one_sided_beside_scratches(region: &[&Window], discs: &Discs<'_>) -> bool {
    let beside = region
        .iter()
        .map(|window| window.ratio_beside_scratches(discs));
    beside.sum::<f64>() > BESIDE_SCRATCHES * (region.len() as f64).sqrt()
}

/// Whether enough of a region's windows have a ratio beyond [`ONE_SIDED`].
fn exceed_most(ratios: impl ExactSizeIterator<Item = f64>) -> bool {
    let windows = ratios.len();
    let count = ratios.filter(|ratio| *ratio > ONE_SIDED).count();
    windows >= LEAST_WINDOWS && count as f64 >= MOST * windows as f64
}

#[cfg(test)]
mod tests {
    use super::super::WearSettings;
    use super::super::field::Field;
    use super::super::unseen::tests::looked_at;
    use super::*;
    use flankscope_foundation::random::{normal, uniform};

    const SIZE_MM: [f64; 2] = [1.7, 3.4];
    /// Points on a zone of that size: those of the 20 mm head.
    const POINTS: u64 = 2376;

    fn tiles_of(wear_mm: impl Fn(u64, [f64; 2]) -> f64, seed: u64) -> Vec<[f64; 2]> {
        let samples: Vec<WearSample> = (0..POINTS)
            .map(|i| {
                let at = [0, 1].map(|k| SIZE_MM[k as usize] * uniform(seed, 2 * i + k));
                WearSample::of_point(at, wear_mm(i, at), 1e-6)
            })
            .collect();
        let area_mm2 = WearSettings::default().area_mm2;
        let mut field = Field::unmeasured(SIZE_MM, WearSettings::default().cell_mm());
        field.average(&samples, None);
        let discs = Discs::new(&field, &samples, area_mm2);
        let tiles = Tiles::of_zone(&discs);
        let flagged = tiles
            .regions()
            .filter(|region| is_one_sided(region))
            .count();
        let count = tiles.regions().count();
        let ratios = tiles.windows.iter().flatten().map(|window| window.ratio);
        // The first entry counts regions, the others are one for each window.
        std::iter::once([flagged as f64, count as f64])
            .chain(ratios.map(|ratio| [ratio, 1.0]))
            .collect()
    }

    /// Symmetric, whatever their tails are: normal, mostly tiny with few large ones, of two values, and alike within grains of 0.1 mm.
    #[test]
    fn symmetric_surfaces_exceed_the_bounds_as_seldom_as_fair_coins_do() {
        type Noise = fn(u64, u64, [f64; 2]) -> f64;
        let noises: [(&str, Noise); 4] = [
            ("normal", |seed, i, _| 2e-3 * normal(seed, i)),
            ("heavy tails", |seed, i, _| 1e-3 * normal(seed, i).powi(3)),
            ("two values", |seed, i, _| {
                2e-3 * (uniform(seed, i) - 0.5).signum()
            }),
            ("grains", |seed, i, [x, y]| {
                let grain = (x / 0.1) as u64 * 1000 + (y / 0.1) as u64;
                2e-3 * normal(seed, 1_000_000 + grain) + 0.5e-3 * normal(seed, i)
            }),
        ];
        for (name, noise) in noises {
            let (mut ratios, mut flagged, mut regions) = (Vec::new(), 0.0, 0.0);
            for seed in 0..60 {
                let all = tiles_of(|i, at| noise(7000 + seed, i, at), 5000 + seed);
                flagged += all[0][0];
                regions += all[0][1];
                ratios.extend(all[1..].iter().map(|[ratio, _]| *ratio));
            }
            let count = ratios.len() as f64;
            let share =
                |beyond: f64| ratios.iter().filter(|ratio| **ratio > beyond).count() as f64 / count;
            println!(
                "{name}: {flagged} of {regions} regions; beyond its limit, 2: {:.3} {:.3}",
                share(ONE_SIDED),
                share(2.0)
            );
            // Were it one window in five, seven of nine would be in one region of 3000.
            assert!(share(ONE_SIDED) < 0.2, "{name}: {}", share(ONE_SIDED));
            assert!(share(2.0) < (-2f64).exp(), "{name}: {}", share(2.0));
            assert!(flagged <= 1e-3 * regions, "{name}: {flagged} of {regions}");
        }
    }

    /// Depths uniform on [0, m] in a share s of the points: the closed form of their moments says how far the ratio of a window is expected
    /// to be beyond nought.
    #[test]
    fn the_ratio_of_a_window_with_openings_is_that_of_their_moments() {
        for (share, deepest_mm) in [(0.1, 0.02), (0.2, 0.015), (0.35, 0.012)] {
            let mut sum = [0.0; 2];
            for seed in 0..40 {
                let depth = |i: u64, _: [f64; 2]| match uniform(900 + seed, 2 * i) < share {
                    true => deepest_mm * uniform(900 + seed, 2 * i + 1),
                    false => 0.0,
                };
                for [ratio, one] in &tiles_of(depth, 300 + seed)[1..] {
                    sum[0] += ratio;
                    sum[1] += one;
                }
            }
            let found = sum[0] / sum[1];
            // Moments of the cubes about the mean s m / 2, by quadrature over the mixture.
            let mean_mm = 0.5 * share * deepest_mm;
            let moment = |power: i32| {
                let inside = (0..2000)
                    .map(|k| (deepest_mm * (f64::from(k) + 0.5) / 2000.0 - mean_mm).powi(power));
                share * inside.sum::<f64>() / 2000.0 + (1.0 - share) * (-mean_mm).powi(power)
            };
            let third = deepest_mm.powi(3) * share * (1.0 - share).powi(2) / 4.0;
            assert!(
                (moment(3) / third - 1.0).abs() < 1e-3,
                "{share}: {} {third}",
                moment(3)
            );
            // Points for each window; the sum over cells of squared sums has the pairs of one cell, too.
            let points = POINTS as f64 / (sum[1] / 40.0);
            let in_cell = points / 25.0;
            let variance = moment(2);
            let of_one = moment(6) - 6.0 * variance * moment(4) + 9.0 * variance.powi(3);
            let squares = points * (of_one + in_cell * third * third);
            let expected = points * third / squares.sqrt();
            assert!(
                (found / expected - 1.0).abs() < 0.15,
                "{share}: {found} {expected}"
            );
        }
    }

    #[test]
    fn a_merged_point_has_the_cubes_of_the_points_in_it() {
        for seed in 0..50 {
            let wears: Vec<f64> = (0..6).map(|i| normal(seed, i)).collect();
            let mean = wears.iter().sum::<f64>() / 6.0;
            let power = |n: i32| wears.iter().map(|wear| (wear - mean).powi(n)).sum::<f64>();
            let merged = WearSample {
                merged: 6.0,
                within_mm2: power(2),
                cubes_mm3: power(3),
                ..WearSample::of_point([0.0; 2], mean, 1.0)
            };
            let surface = normal(seed, 99);
            let all: f64 = wears.iter().map(|wear| (wear - surface).powi(3)).sum();
            assert!(
                (merged.cubes_about_mm3(mean - surface) - all).abs() < 1e-9,
                "{seed}"
            );
        }
    }

    /// Share of draws in which grooves along the height are charged with at least 25 µm somewhere, by width and pitch, three and ten widths
    /// deep: the table in docs/method.md.
    #[test]
    fn power_over_width_and_pitch() {
        const DRAWS: u64 = 8;
        const PITCHES: [f64; 6] = [1.2, 2.0, 3.0, 5.0, 7.0, 10.0];
        const DEEPEST_MM: f64 = 0.4;
        let mut beyond: Vec<f64> = Vec::new();
        for depth_per_width in [3.0, 10.0] {
            println!("{depth_per_width} widths deep; pitch in widths: {PITCHES:?}");
            for width_mm in [0.02, 0.025, 0.03, 0.045, 0.06, 0.08, 0.12] {
                let power = PITCHES.map(|pitch| {
                    let found = (0..DRAWS).filter(|draw| {
                        let seed = 40_000 + draw;
                        let from_mm = width_mm * pitch * uniform(seed, 1);
                        let depth_mm = (depth_per_width * width_mm).min(DEEPEST_MM);
                        let grooves = |[x, _]: [f64; 2]| match (x + from_mm)
                            .rem_euclid(pitch * width_mm)
                            < width_mm
                        {
                            true => depth_mm,
                            false => 0.0,
                        };
                        let wear = looked_at(grooves, SIZE_MM, 2.9, seed);
                        let judged = wear.judged.expect("measured");
                        judged.hidden_mm.is_some_and(|hidden_mm| hidden_mm > 25e-3)
                    });
                    found.count() as f64 / DRAWS as f64
                });
                println!("{width_mm:.3} mm: {power:.2?}");
                // At the first pitch most of the surface is open, which makes the distribution of depths nearly symmetric.
                for (power, pitch) in power.into_iter().zip(PITCHES).skip(1) {
                    let depth_mm = (depth_per_width * width_mm).min(DEEPEST_MM);
                    if width_mm >= 0.03 && depth_mm / pitch > 50e-3 {
                        beyond.push(power);
                    }
                }
            }
        }
        let mean = beyond.iter().sum::<f64>() / beyond.len() as f64;
        assert!(mean >= 0.95, "{mean}");
    }
}
