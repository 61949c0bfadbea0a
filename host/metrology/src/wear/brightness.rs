//! Light that the shape seen does not explain.
//!
//! Walls of openings narrower than a cell face lamp and camera otherwise than the flank does: where the flank is lit at a grazing
//! angle, a wall that faces the lamp comes back brighter by the ratio of the cosines, a floor in shadow does not come back at
//! all. Single points show neither, because what comes back from such an opening comes from near its rim.
//!
//! Brightness is compared with what lamp, optics and the slopes of the cells make of it: a smooth polynomial over the flank and its
//! response to slope, fitted robustly to the flank itself, so that no reflectance is presumed. Texture all over a flank is not
//! seen in this way, but by the scatter of its points (`texture.rs`); nor are openings that happen to look as bright as the flank.

use flankscope_foundation::order::{SIGMA_PER_MAD, median_of};
use nalgebra::{SMatrix, SVector};

use super::field::Field;
use super::unseen::Unseen;

/// Cubic in profile and height without mixed terms of third order, and both slopes.
const TERMS: usize = 10;
/// Least number of cells with light for a fit.
const LEAST_CELLS: usize = 10 * TERMS;
/// Steps of the fit; weights settle within ten.
const STEPS: usize = 10;
/// Residuals, in scatters, from which a cell takes no part (Tukey's biweight).
const OUTSIDE: f64 = 4.0;
/// Cells to each side of a cell that together are about a disc.
const WINDOW: usize = 2;
/// Least number of cells with light in a window.
const LEAST_IN_WINDOW: usize = 15;
/// Mean residual over a window, in scatters of single cells, that counts. By chance it would be a tenth of that; sprayed flanks of
/// class 7, and flanks of 3 um roughness, reach 1.7 on the bench.
const SHOWN: f64 = 2.0;

/// Unseen part of every cell by its light: `light` is the logarithm of each cell's mean brightness, not a number where there is none;
/// `slant` the tangent of the angle between rays and normal.
pub(super) fn of_cells(field: &Field, light: &[f64], slant: f64) -> Vec<Unseen> {
    let Some((residuals, scatter)) = residuals(field, light) else {
        return vec![Unseen::default(); light.len()];
    };
    let width_mm = field.cell_area_mm2().sqrt();
    (0..light.len())
        .map(|cell| {
            let of_window = field.window(cell, WINDOW).map(|c| residuals[c]);
            let (mut sum, mut count) = (0.0, 0_usize);
            for residual in of_window.filter(|residual| residual.is_finite()) {
                sum += residual;
                count += 1;
            }
            let mean = sum / count as f64;
            if count < LEAST_IN_WINDOW || mean.abs() <= SHOWN * scatter {
                return Unseen::default();
            }
            let gain = mean.exp_m1();
            // A wall that faces the lamp is brighter by that; a shadow is darker by all.
            let of_wall = if gain > 0.0 {
                1_f64.hypot(slant) - 1.0
            } else {
                -1.0
            };
            let rim_mm = field.wear_mm[cell].max(0.0);
            Unseen::opening(gain / of_wall, width_mm, rim_mm)
        })
        .collect()
}

/// Residuals of each cell's light, and their scatter over the flank; none with too few cells.
fn residuals(field: &Field, light: &[f64]) -> Option<(Vec<f64>, f64)> {
    let known: Vec<usize> = (0..light.len()).filter(|&c| light[c].is_finite()).collect();
    if known.len() < LEAST_CELLS {
        return None;
    }
    let rows: Vec<SVector<f64, TERMS>> = known.iter().map(|&c| terms(field, c)).collect();
    let mut weights = vec![1.0; known.len()];
    let mut off = vec![0.0; known.len()];
    let mut scatter = 0.0;
    for _ in 0..STEPS {
        let mut normal = SMatrix::<f64, TERMS, TERMS>::zeros();
        let mut right = SVector::<f64, TERMS>::zeros();
        for ((row, &cell), &weight) in rows.iter().zip(&known).zip(&weights) {
            normal += weight * row * row.transpose();
            right += weight * light[cell] * row;
        }
        // Slopes that are all alike, as on an exact flank, must not make the equations singular.
        for term in 0..TERMS {
            normal[(term, term)] += 1e-9;
        }
        let fit = normal.cholesky()?.solve(&right);
        for ((off, row), &cell) in off.iter_mut().zip(&rows).zip(&known) {
            *off = light[cell] - row.dot(&fit);
        }
        scatter = SIGMA_PER_MAD * median_of(off.iter().map(|off| off.abs()))?;
        for (weight, off) in weights.iter_mut().zip(&off) {
            let ratio = off / (OUTSIDE * scatter).max(f64::MIN_POSITIVE);
            *weight = (1.0 - ratio * ratio).max(0.0).powi(2);
        }
    }
    let mut residuals = vec![f64::NAN; light.len()];
    for (&cell, off) in known.iter().zip(off) {
        residuals[cell] = off;
    }
    Some((residuals, scatter))
}

/// What a cell's light may depend on: its place on the flank, from -1 to 1 along profile and height, and its slopes.
fn terms(field: &Field, cell: usize) -> SVector<f64, TERMS> {
    let place = |index: usize, count: usize| 2.0 * (index as f64 + 0.5) / count as f64 - 1.0;
    let u = place(cell % field.columns, field.columns);
    let v = place(cell / field.columns, field.rows);
    let [along, up] = field.slopes(cell);
    SVector::from([
        1.0,
        u,
        v,
        u * u,
        u * v,
        v * v,
        u * u * u,
        v * v * v,
        along,
        up,
    ])
}

#[cfg(test)]
mod tests {
    use super::*;
    use flankscope_foundation::random::normal;

    const SLANT: f64 = 2.9;

    /// A flank of 2 by 6 mm in cells of a disc of 0.25 mm2.
    fn field(wear_mm: impl Fn(f64, f64) -> f64) -> Field {
        let mut field = Field::unmeasured([2.0, 6.0], 0.1128);
        for cell in 0..field.wear_mm.len() {
            let [x, y] = middle(&field, cell);
            field.wear_mm[cell] = wear_mm(x, y);
            field.variance_mm2[cell] = 1e-7;
        }
        field
    }

    fn middle(field: &Field, cell: usize) -> [f64; 2] {
        let (column, row) = (cell % field.columns, cell / field.columns);
        [
            (column as f64 + 0.5) * field.cell_mm[0],
            (row as f64 + 0.5) * field.cell_mm[1],
        ]
    }

    /// Light that falls off over the flank and grows by its slope, with 8 % of scatter; `seed` draws it.
    fn light(field: &Field, seed: u64, beside: impl Fn(f64, f64) -> f64) -> Vec<f64> {
        let of = |cell: usize| {
            let [x, y] = middle(field, cell);
            let lamp = 9.0 - 0.3 * (x - 1.2) - 0.02 * (y - 2.0).powi(2);
            lamp + SLANT * field.slopes(cell)[0]
                + 0.08 * normal(seed, cell as u64)
                + beside(x, y).ln()
        };
        (0..field.wear_mm.len()).map(of).collect()
    }

    fn most_share(field: &Field, light: &[f64]) -> f64 {
        let unseen = of_cells(field, light, SLANT);
        unseen.iter().map(|of| of.share).fold(0.0, f64::max)
    }

    #[test]
    fn sound_and_gently_worn_flanks_are_as_bright_as_their_slopes_say() {
        let dish = |x: f64, y: f64| 25e-3 * (-((x - 1.0).hypot(y - 3.0) / 0.7).powi(2)).exp();
        for seed in 0..20 {
            for field in [field(|_, _| 0.0), field(dish)] {
                let share = most_share(&field, &light(&field, seed, |_, _| 1.0));
                assert_eq!(share, 0.0, "{seed}");
            }
        }
    }

    #[test]
    fn a_patch_that_is_brighter_or_darker_than_its_shape_is_charged_by_what_walls_or_shadows_would_take()
     {
        let flat = field(|_, _| 0.0);
        let in_patch = |x: f64, y: f64| (x - 1.0).abs() < 0.35 && (y - 3.0).abs() < 0.35;
        // A third of the patch is walls that face the lamp, or shadows.
        let of_wall = 1_f64.hypot(SLANT);
        for (factor, share) in [((2.0 + of_wall) / 3.0, 1.0 / 3.0), (2.0 / 3.0, 1.0 / 3.0)] {
            for seed in 0..20 {
                let seen = light(
                    &flat,
                    seed,
                    |x, y| if in_patch(x, y) { factor } else { 1.0 },
                );
                let found = most_share(&flat, &seen);
                // The patch covers the window; the scatter of its mean is 8 % / 5.
                assert!((found - share).abs() < 0.08, "{factor} {seed}: {found}");
            }
        }
    }

    #[test]
    fn little_light_says_nothing() {
        let flat = field(|_, _| 0.0);
        let none = vec![f64::NAN; flat.wear_mm.len()];
        assert_eq!(most_share(&flat, &none), 0.0);
        let mut few = none;
        few[..50].fill(3.0);
        assert_eq!(most_share(&flat, &few), 0.0);
    }
}
