//! Two projectors, one camera: each gives a depth along the same camera ray, from its own frames, lens and place.
//!
//! Where both measured a cell and agree, its depth is their mean, weighted by their variances; where one of them did, it is that
//! one's. Where they do not agree one of them was misled, by light over a second surface, a wrong order, or a calibration that
//! holds no more; which of them cannot be told, and the cell gives no point.

use flankscope_foundation::order::median;

use super::cell::{CellResult, Fate};
use crate::cloud::Projectors;

/// Depths may differ by this many standard deviations of noise: one pair in 16 000 does by chance.
const APART_SIGMA: f64 = 4.0;
/// Besides, by this calibration error between both projectors, mm, for a head without calibration record (drawing values).
pub(super) const UNCALIBRATED_MM: f64 = 0.02;

/// Puts the depths of both into `first`. `allowed_mm` is the allowed difference of their calibrations.
pub(super) fn join(first: &mut [CellResult], second: &[CellResult], allowed_mm: f64) -> Projectors {
    let mut found = Projectors {
        alone: [0; 2],
        both: 0,
        disagreeing: 0,
        apart_um: None,
    };
    let mut apart_um = Vec::new();
    for (one, two) in first.iter_mut().zip(second) {
        match (one.fate, two.fate) {
            (Fate::Point, Fate::Point) => {
                let off_mm = two.depth_mm - one.depth_mm;
                apart_um.push(1e3 * off_mm);
                let [a, b] = [one, two].map(|of| f64::from(of.sigma_z_mm).powi(2));
                let noise_mm = APART_SIGMA * (a + b).sqrt();
                // Written so that a NaN fails.
                if !(off_mm.abs() <= noise_mm.hypot(allowed_mm)) {
                    one.reject(Fate::Disagreeing);
                    found.disagreeing += 1;
                    continue;
                }
                let share = match a + b > 0.0 {
                    true => a / (a + b),
                    false => 0.5,
                };
                found.both += 1;
                // The truth need not lie nearer to their mean than to one of them.
                let sigma_mm = (share * b).sqrt().max(0.5 * off_mm.abs());
                let between = |one: f64, two: f64| one + share * (two - one);
                *one = CellResult {
                    by_second: share > 0.5,
                    depth_mm: between(one.depth_mm, two.depth_mm),
                    direction: [0, 1].map(|axis| between(one.direction[axis], two.direction[axis])),
                    sigma_z_mm: sigma_mm as f32,
                    fringes_e_per_ms: one.fringes_e_per_ms + two.fringes_e_per_ms,
                    ..*one
                };
            }
            (Fate::Point, _) => found.alone[0] += 1,
            (_, Fate::Point) => {
                found.alone[1] += 1;
                *one = CellResult {
                    by_second: true,
                    ..*two
                };
            }
            _ => {}
        }
    }
    found.apart_um = median(&mut apart_um);
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(depth_mm: f64, sigma_z_mm: f32) -> CellResult {
        CellResult {
            fate: Fate::Point,
            by_second: false,
            depth_mm,
            direction: [0.1, -0.2],
            sigma_z_mm,
            turn_mm: 0.3,
            fringes_e_per_ms: 100.0,
            clue_chi_square: 1.0,
            separation: 9.0,
            column_chi_square: 1.0,
        }
    }

    #[test]
    fn the_better_one_counts_more_and_what_contradicts_is_no_point() {
        let lost = CellResult::rejected(Fate::Saturated);
        let mut first = [
            point(22.0, 0.001),
            point(22.0, 0.003),
            point(22.0, 0.001),
            point(22.0, 0.001),
            lost,
            lost,
        ];
        let second = [
            point(22.002, 0.001),
            point(22.004, 0.001),
            point(22.1, 0.001),
            lost,
            point(22.5, 0.002),
            lost,
        ];
        let found = join(&mut first, &second, 0.01);
        assert_eq!((found.alone, found.both, found.disagreeing), ([1, 1], 2, 1));
        // The middle of 2, 4 and 100 um.
        assert!((found.apart_um.unwrap() - 4.0).abs() < 1e-9);
        let by_second = first.map(|cell| cell.by_second);
        assert_eq!(by_second, [false, true, false, false, true, false]);
        // Weights are 1 / sigma^2: nine tenths of the way where the second is three times as good.
        assert!((first[0].depth_mm - 22.001).abs() < 1e-12);
        assert!((first[1].depth_mm - 22.0036).abs() < 1e-9);
        // 1 um by their noise, but 2 and 1 um from either; at least half of what lies between them.
        assert!((f64::from(first[1].sigma_z_mm) - 0.002).abs() < 1e-6);
        assert_eq!(first[2].fate, Fate::Disagreeing);
        assert_eq!(first[3].depth_mm, 22.0);
        assert_eq!(first[4].depth_mm, 22.5);
        assert_eq!(first[5].fate, Fate::Saturated);
        // No more is allowed than calibrations and noise leave open.
        let mut one = [point(22.0, 0.001)];
        join(&mut one, &[point(22.012, 0.001)], 0.01);
        assert_eq!(one[0].fate, Fate::Disagreeing);
        let mut one = [point(22.0, 0.001)];
        join(&mut one, &[point(22.011, 0.001)], 0.01);
        assert_eq!(one[0].fate, Fate::Point);
    }
}
