//! Loss that may be hidden in the unseen part of each measured cell.
//!
//! ```text
//!  rays that meet the cell, points that lie there ──► shadows: fewer points than rays                    ─┐
//!  cells deeper than both neighbours              ──► single openings too narrow to look into             ├─► share, depth
//!  scatter of points within cells (texture.rs)    ──► openings side by side, each narrower than a cell    │
//!  points below the surface, none above it (one_sided.rs) ──► openings apart from each other              │
//!  light that no slope explains (brightness.rs)   ──► the same, where their points hardly scatter        ─┘
//! ```
//!
//! A camera that looks along a flank at an angle of tangent t to its normal sees down to w / t into an opening of width w: where
//! the floor is not seen, depths from nought to w / t come back, evenly, from the far wall. Where they pile up at the deepest,
//! that is a floor. An opening's hidden floor is supposed [`DEPTH_PER_WIDTH`] times as deep as the opening is wide, and never
//! deeper than the settings suppose of a hole. What no evidence shows is in docs/method.md: texture of openings narrower than
//! some 0.03 mm that leave little of the surface in place scatters evenly, and no more than a rough surface does.

use super::disc::Discs;
use super::sight::Visibility;
use super::{brightness, one_sided, texture};

/// Depth over width that is supposed of an opening whose floor is not seen: scores, pits and V grooves of worn dies are not
/// steeper; a crack that is narrower than a cell takes up little of a disc.
const DEPTH_PER_WIDTH: f64 = 3.0;
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
        if other.hides_more_than(self) {
            other
        } else {
            self
        }
    }

    /// Whether it may hide more loss.
    pub fn hides_more_than(self, other: Self) -> bool {
        let worth = |of: Self| of.share * of.depth_mm.min(1.0);
        worth(self) > worth(other)
    }
}

/// Unseen part of every cell. `scale` is the ratio of the cells' noise to the stated one.
pub(super) fn of_cells(
    discs: &Discs<'_>,
    visibility: Option<&Visibility>,
    scale: f64,
) -> Vec<Unseen> {
    let by_light = by_light(discs, visibility).into_iter();
    let all = by_geometry(discs, visibility, scale).into_iter();
    all.zip(by_light)
        .map(|(all, light)| all.or(light))
        .collect()
}

/// Unseen part of every cell by its points and rays: shadows, single openings, texture. A view from a steeper angle that shows
/// the same cell whole disproves it.
pub(super) fn by_geometry(
    discs: &Discs<'_>,
    visibility: Option<&Visibility>,
    scale: f64,
) -> Vec<Unseen> {
    let field = discs.field();
    let slant = visibility.map_or(SLANT, Visibility::slant);
    let mut all = texture::of_cells(discs, slant);
    for (unseen, apart) in all.iter_mut().zip(one_sided::of_cells(discs, slant)) {
        *unseen = unseen.or(apart);
    }
    let reached_mm = |cells: &[usize], level_mm: f64| reached_mm(discs, cells, level_mm, scale);
    for (unseen, groove) in all.iter_mut().zip(field.grooves(slant, scale, reached_mm)) {
        *unseen = unseen.or(groove);
    }
    if let Some(visibility) = visibility {
        let shadows = visibility.shadows(field, scale);
        for (unseen, shadow) in all.iter_mut().zip(shadows) {
            *unseen = unseen.or(shadow);
        }
    }
    all
}

/// Unseen part of every cell by its light: evidence of openings whose points hardly scatter, which another view's points do not
/// disprove.
pub(super) fn by_light(discs: &Discs<'_>, visibility: Option<&Visibility>) -> Vec<Unseen> {
    let field = discs.field();
    match visibility {
        Some(seen) => brightness::of_cells(field, seen.light(), seen.slant()),
        None => vec![Unseen::default(); field.wear_mm.len()],
    }
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

#[cfg(test)]
pub(crate) mod tests {
    use super::super::field::{Field, WearSample};
    use super::super::sight::RayCounts;
    use super::super::{FlankWear, WearSettings};
    use super::*;
    use crate::gear::Flank;
    use flankscope_foundation::random::{normal, uniform};

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
        looked_at_in_rows(depth_mm, size_mm, slant, seed, |row| 0.5 * (row % 2) as f64)
    }

    /// The same; `row_shift` says by which share of the distance between two rays a row begins later.
    fn looked_at_in_rows(
        depth_mm: impl Fn([f64; 2]) -> f64,
        size_mm: [f64; 2],
        slant: f64,
        seed: u64,
        row_shift: impl Fn(u64) -> f64,
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
            let shifted = row_shift(row);
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
            &wear.measured.views[0].samples,
            WearSettings::default().area_mm2,
        );
        let unseen = of_cells(&discs, wear.measured.views[0].visibility.as_ref(), scale);
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
            let rough = waves(3e-3, 0.05, 8);
            let bowl =
                |[x, y]: [f64; 2]| (0.04 - 0.16 * ((x - 0.8).powi(2) + (y - 1.5).powi(2))).max(0.0);
            for (name, wear) in [
                ("rough", looked_at(&rough, SIZE_MM, slant, 9)),
                ("flat", looked_at(|_| 0.0, SIZE_MM, slant, 10)),
                ("bowl", looked_at(bowl, SIZE_MM, slant, 11)),
                ("slope", looked_at(|[_, y]| 0.01 * y, SIZE_MM, slant, 12)),
            ] {
                assert_eq!(flagged(&wear), 0.0, "{name} at {slant}");
            }
        }
    }

    /// Width that the cells' unseen parts add up to across the height, mm: the mean over all heights.
    fn unseen_width_mm(wear: &FlankWear) -> f64 {
        let scale = wear.field.noise_scale();
        let view = &wear.measured.views[0];
        let discs = Discs::new(&wear.field, &view.samples, WearSettings::default().area_mm2);
        let unseen = of_cells(&discs, view.visibility.as_ref(), scale);
        let shares: f64 = unseen.iter().map(|of| of.share).sum();
        shares * wear.field.cell_mm[0] / wear.field.rows as f64
    }

    #[test]
    fn an_opening_along_the_rim_of_the_zone_is_found_as_one_inside_is() {
        let opening = |from: f64, width: f64| {
            move |[x, _]: [f64; 2]| {
                if (from..from + width).contains(&x) {
                    0.4
                } else {
                    0.0
                }
            }
        };
        // No two rows alike, as on a flank that the rows of cores cross slantwise: else a few rays tell all depths.
        let golden = |row: u64| (0.618 * row as f64).fract();
        for slant in [1.7, 2.9] {
            let width = 0.1;
            for from in [0.0, 0.82, SIZE_MM[0] - width] {
                let opened = opening(from, width);
                let wear = looked_at_in_rows(opened, SIZE_MM, slant, 21, golden);
                let found = unseen_width_mm(&wear);
                // An opening of which every other part escapes counts by half.
                assert!(found > 0.5 * width, "from {from} at {slant}: {found}");
            }
            // A rim that is worn, rounded or stepped, is seen to its depth.
            let rounded = |[x, _]: [f64; 2]| 0.03 * (1.0 - x / 0.2).max(0.0).powi(2);
            let stepped = |[x, _]: [f64; 2]| if x > SIZE_MM[0] - 0.1 { 0.01 } else { 0.0 };
            for (name, wear) in [
                (
                    "rounded",
                    looked_at_in_rows(rounded, SIZE_MM, slant, 22, golden),
                ),
                (
                    "stepped",
                    looked_at_in_rows(stepped, SIZE_MM, slant, 23, golden),
                ),
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
    pub(crate) fn waves(rms_mm: f64, length_mm: f64, seed: u64) -> impl Fn([f64; 2]) -> f64 {
        const WAVES: u64 = 24;
        let waves: Vec<[f64; 3]> = (0..WAVES)
            .map(|k| {
                let n = |i: u64| normal(seed, 3 * k + i) / length_mm;
                let phase = std::f64::consts::TAU * uniform(seed + 1, k);
                [n(0), n(1), phase]
            })
            .collect();
        move |[x, y]| {
            let sum: f64 = waves
                .iter()
                .map(|[a, b, c]| (a * x + b * y + c).cos())
                .sum();
            rms_mm * sum * (2.0 / WAVES as f64).sqrt()
        }
    }
}
