//! Identification of teeth by their own form: to the CAD all teeth look alike, but every flank of a real die stands off by
//! micrometres of its own. Two scans of the same die show the same pattern, turned by as many teeth as the die was.
//!
//! Slow changes around the bore (eccentricity, ovality) are subtracted from both patterns, and outliers (a flank
//! that wore in between) are cut. The correlation of the rest at every shift by whole teeth is tested by Fisher's
//! transformation (Biometrika 10, 1915): atanh r of n independent pairs without relation is normal with variance 1/(n - 3).

use std::f64::consts::TAU;

use flankscope_foundation::order::{SIGMA_PER_MAD, median_of};
use nalgebra::{DMatrix, DVector};

use crate::gear::Flank;

/// Up to this harmonic around the bore a deviation is form, not pattern.
const FORM_HARMONICS: u32 = 2;
const FORM_PARAMETERS: usize = 2 * FORM_HARMONICS as usize + 1;
/// Least number of flanks of a side, and of common teeth at a shift.
const LEAST_TEETH: usize = 12;
/// Deviations beyond so many robust standard deviations are cut.
const CUT_SIGMAS: f64 = 3.0;
/// A shift is significant beyond so many standard deviations: of 84 shifts without relation one exceeds it once in 900
/// comparisons ...
const LEAST_SIGMAS: f64 = 4.2;
/// ... and it is the one if every other shift stays this far behind: a pattern that repeats itself names no tooth.
const LEAST_LEAD_SIGMAS: f64 = 3.0;

/// Mean deviation of one flank.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FlankMean {
    /// Tooth, from 1.
    pub tooth: u32,
    /// Flank.
    pub flank: Flank,
    /// Deviation, µm.
    pub deviation_um: f64,
}

/// Correlation of two patterns at one shift by whole teeth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Likeness {
    /// Teeth that the later one is turned by, from minus half to half of them; positive counter-clockwise.
    pub turned_teeth: i64,
    /// Correlation.
    pub correlation: f64,
    /// Teeth that both show.
    pub common_teeth: usize,
    /// Standard deviations above what patterns without relation have.
    pub sigmas: f64,
}

/// Result of the comparison of two patterns.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Comparison {
    /// The best shift.
    pub best: Likeness,
    /// The next best.
    pub rival: Option<Likeness>,
}

impl Comparison {
    /// Number of teeth by which the die was turned in between; `None` when no shift is significant.
    #[must_use]
    pub fn turned_teeth(&self) -> Option<i64> {
        let lead = self
            .rival
            .map_or(f64::INFINITY, |r| self.best.sigmas - r.sigmas);
        (self.best.sigmas > LEAST_SIGMAS && lead > LEAST_LEAD_SIGMAS)
            .then_some(self.best.turned_teeth)
    }
}

/// Compares two patterns of a gear with so many teeth; `None` when they have too few teeth in common at any shift.
pub fn compare(teeth: u32, earlier: &[FlankMean], later: &[FlankMean]) -> Option<Comparison> {
    let (earlier, later) = (Pattern::new(teeth, earlier), Pattern::new(teeth, later));
    let mut found: Vec<Likeness> = (0..teeth)
        .filter_map(|turned| earlier.likeness(&later, turned))
        .collect();
    found.sort_by(|a, b| b.sigmas.total_cmp(&a.sigmas));
    let best = *found.first()?;
    Some(Comparison {
        best,
        rival: found.get(1).copied(),
    })
}

/// Pattern of each tooth's left and right flank: deviations less their low harmonics, µm.
struct Pattern {
    flanks: Vec<[Option<f64>; 2]>,
    /// Share of the independent deviations that taking off the form leaves.
    freedom: f64,
}

impl Pattern {
    fn new(teeth: u32, means: &[FlankMean]) -> Self {
        let mut flanks = vec![[None; 2]; teeth as usize];
        let mut freedom = 1.0_f64;
        for (side, flank) in Flank::BOTH.into_iter().enumerate() {
            let of_side: Vec<(u32, f64)> = means
                .iter()
                .filter(|mean| mean.flank == flank && (1..=teeth).contains(&mean.tooth))
                .map(|mean| (mean.tooth, mean.deviation_um))
                .collect();
            if of_side.len() < LEAST_TEETH {
                continue;
            }
            freedom = freedom.min(1.0 - FORM_PARAMETERS as f64 / of_side.len() as f64);
            for (tooth, left_um) in without_form(teeth, &of_side) {
                flanks[tooth as usize - 1][side] = Some(left_um);
            }
        }
        Self { flanks, freedom }
    }

    fn likeness(&self, later: &Self, turned: u32) -> Option<Likeness> {
        let count = self.flanks.len();
        let (mut common_teeth, mut product, mut squares) = (0, 0.0, [0.0; 2]);
        for (tooth, here) in self.flanks.iter().enumerate() {
            let there = &later.flanks[(tooth + turned as usize) % count];
            let mut seen = false;
            for (a, b) in here.iter().zip(there) {
                if let (Some(a), Some(b)) = (a, b) {
                    product += a * b;
                    squares[0] += a * a;
                    squares[1] += b * b;
                    seen = true;
                }
            }
            common_teeth += usize::from(seen);
        }
        let size = (squares[0] * squares[1]).sqrt();
        if common_teeth < LEAST_TEETH || size.is_nan() || size <= 0.0 {
            return None;
        }
        // Both flanks of a tooth were seen by the same views: they count as one pair.
        let independent = common_teeth as f64 * self.freedom.min(later.freedom);
        let correlation = product / size;
        let half = count as i64 / 2;
        Some(Likeness {
            turned_teeth: (i64::from(turned) + half).rem_euclid(count as i64) - half,
            correlation,
            common_teeth,
            sigmas: correlation.clamp(-0.999_999, 0.999_999).atanh()
                * (independent - 3.0).max(0.0).sqrt(),
        })
    }
}

/// Deviations less what low harmonics around the bore explain, cut where they stand far out.
fn without_form(teeth: u32, means: &[(u32, f64)]) -> Vec<(u32, f64)> {
    let row = |tooth: u32| {
        let angle = TAU * f64::from(tooth) / f64::from(teeth);
        let harmonics = (1..=FORM_HARMONICS).flat_map(move |order| {
            let (sin, cos) = (f64::from(order) * angle).sin_cos();
            [cos, sin]
        });
        std::iter::once(1.0).chain(harmonics)
    };
    let design = DMatrix::from_row_iterator(
        means.len(),
        FORM_PARAMETERS,
        means.iter().flat_map(|(tooth, _)| row(*tooth)),
    );
    let fit = |values: &DVector<f64>| {
        // Views that leave a gap may not tell all harmonics: the least of them all is taken then.
        let form = design.clone().svd(true, true).solve(values, 1e-6);
        form.map_or_else(|_| values.clone(), |form| values - &design * form)
    };
    // A flank far out bends the form: it is cut, and the form taken off again.
    let mut left = fit(&DVector::from_iterator(
        means.len(),
        means.iter().map(|m| m.1),
    ));
    for _ in 0..2 {
        let size = median_of(left.iter().map(|um| um.abs())).unwrap_or(0.0);
        let most = CUT_SIGMAS * SIGMA_PER_MAD * size;
        left.apply(|um| *um = um.clamp(-most, most));
        left = fit(&left);
    }
    means
        .iter()
        .map(|m| m.0)
        .zip(left.iter().copied())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use flankscope_foundation::random::uniform;

    const TEETH: u32 = 84;

    fn normal(seed: u64, index: u64) -> f64 {
        (0..12).map(|k| uniform(seed, 12 * index + k)).sum::<f64>() - 6.0
    }

    /// A scan of a die whose flanks stand off by `own_um`, put down turned, oval and eccentric, with 1 µm of noise.
    fn scan(
        seed: u64,
        turned: u32,
        seen: impl Fn(u32) -> bool,
        own_um: impl Fn(u32, usize) -> f64,
    ) -> Vec<FlankMean> {
        (1..=TEETH)
            .filter(|&tooth| seen(tooth))
            .flat_map(|tooth| [0, 1].map(|side| (tooth, side)))
            .map(|(tooth, side)| {
                let of_die = (tooth + TEETH - 1 - turned) % TEETH + 1;
                let angle = TAU * f64::from(tooth) / f64::from(TEETH);
                let form_um = 7.0 * (angle + seed as f64).cos() + 4.0 * (2.0 * angle).cos();
                let noise_um = normal(1000 + seed, u64::from(2 * tooth) + side as u64);
                FlankMean {
                    tooth,
                    flank: Flank::BOTH[side],
                    deviation_um: own_um(of_die, side) + form_um + noise_um,
                }
            })
            .collect()
    }

    fn random_um(tooth: u32, side: usize) -> f64 {
        4.0 * normal(7, u64::from(2 * tooth) + side as u64)
    }

    #[test]
    fn a_die_that_was_turned_by_whole_teeth_is_told_by_how_many() {
        let earlier = scan(1, 0, |_| true, random_um);
        for turned in [0, 1, 5, 42, 83] {
            let found = compare(TEETH, &earlier, &scan(2, turned, |_| true, random_um)).unwrap();
            let signed = if turned < 42 {
                i64::from(turned)
            } else {
                i64::from(turned) - 84
            };
            assert_eq!(found.turned_teeth(), Some(signed), "{found:?}");
            // Noise of 1 µm on 4 µm of each: 16 / 17.
            assert!(
                (found.best.correlation - 16.0 / 17.0).abs() < 0.04,
                "{found:?}"
            );
        }
        // Twelve views see three teeth of seven.
        let some = |tooth: u32| tooth % 7 < 3;
        let earlier = scan(1, 0, some, random_um);
        for turned in [0, 1] {
            let found = compare(TEETH, &earlier, &scan(2, turned, some, random_um)).unwrap();
            assert_eq!(found.turned_teeth(), Some(i64::from(turned)), "{found:?}");
        }
    }

    #[test]
    fn a_flank_that_wore_in_between_hides_nothing() {
        let earlier = scan(1, 0, |_| true, random_um);
        let worn = |tooth, side| {
            random_um(tooth, side) - if (tooth, side) == (12, 1) { 80.0 } else { 0.0 }
        };
        let found = compare(TEETH, &earlier, &scan(2, 3, |_| true, worn)).unwrap();
        assert_eq!(found.turned_teeth(), Some(3), "{found:?}");
    }

    #[test]
    fn patterns_without_relation_or_that_repeat_themselves_tell_nothing() {
        let earlier = scan(1, 0, |_| true, random_um);
        for seed in 0..40 {
            let other =
                |tooth: u32, side| 4.0 * normal(100 + seed, u64::from(2 * tooth) + side as u64);
            let found = compare(TEETH, &earlier, &scan(seed, 0, |_| true, other)).unwrap();
            assert_eq!(found.turned_teeth(), None, "{found:?}");
        }
        let perfect = |_, _| 0.0;
        let found = compare(
            TEETH,
            &scan(1, 0, |_| true, perfect),
            &scan(2, 0, |_| true, perfect),
        );
        assert_eq!(found.unwrap().turned_teeth(), None);
        // Every seventh tooth is the same.
        let repeats = |tooth: u32, side| random_um(tooth % 7, side);
        let found = compare(
            TEETH,
            &scan(1, 0, |_| true, repeats),
            &scan(2, 0, |_| true, repeats),
        );
        assert_eq!(found.unwrap().turned_teeth(), None);
        // Too few teeth.
        assert_eq!(compare(TEETH, &earlier[..20], &earlier), None);
    }
}
