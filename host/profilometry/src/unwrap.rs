//! Phase unwrapping: from the wrapped phases of several frequencies to one absolute phase of the finest.
//!
//! The finest frequency's phase leaves a ladder of columns, one per fringe order. Every other frequency is a [`Clue`]: it
//! says what its phase should be at each of these columns. The order is the one with the smallest chi-square of all clues
//! together, each weighted by its variance (maximum likelihood except for their common part, the finest phase). Any ratios of
//! frequencies are allowed: coarse and fine fringes, or high frequencies with a slow beat (Gupta and Nayar, Micro phase shifting,
//! CVPR 2012). Interreflections disturb low frequencies, while high ones average them out.
//!
//! Two orders lie `d` standard deviations of the clues apart ([`Decision::separation`]); noise takes the one for the other with
//! probability `erfc(d / (2 sqrt 2)) / 2`. For one clue of ratio `R` that is the familiar
//! `d = TAU / sqrt(R^2 sigma_coarse^2 + sigma_fine^2)`.

use std::f64::consts::TAU;

/// Least distance to the next order in predicted standard deviations: of two neighbours one is taken by mistake in 6e-7 of the
/// cells.
pub const MIN_SEPARATION: f64 = 10.0;

/// The phase closest to `expected_rad` among all that differ from `wrapped_rad` by whole turns.
pub fn nearest_turn(wrapped_rad: f64, expected_rad: f64) -> f64 {
    wrapped_rad + TAU * nearest_whole((expected_rad - wrapped_rad) / TAU)
}

/// The nearest whole number below 2^51, the even one at halves, by the rounding of an addition: [`f64::round`] is a call of the
/// mathematical library on processors of the x86-64 baseline, and this is asked for every order of every cell.
fn nearest_whole(value: f64) -> f64 {
    // 1.5 * 2^52: from here to twice as much a float has no fraction.
    const NO_FRACTION: f64 = 6_755_399_441_055_744.0;
    (value + NO_FRACTION) - NO_FRACTION
}

/// Clue of one frequency other than the finest to the projector column.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clue {
    /// Periods of its phase per period of the finest; negative for a phase less that of the finest.
    pub ratio: f64,
    /// Its wrapped phase.
    pub phase_rad: f64,
    /// Variance of what only this clue gets wrong.
    pub own_variance_rad2: f64,
    /// Standard deviation of what it gets wrong together with the other clues: the finest frequency's own noise.
    pub shared_rad: f64,
}

/// Says nothing.
pub(crate) const NO_CLUE: Clue = Clue {
    ratio: 0.0,
    phase_rad: 0.0,
    own_variance_rad2: 1.0,
    shared_rad: 0.0,
};

impl Clue {
    /// Difference of its phase from the one predicted by the finest frequency's absolute phase, rad.
    fn residual_rad(&self, absolute_rad: f64) -> f64 {
        nearest_turn(self.phase_rad - self.ratio * absolute_rad, 0.0)
    }

    fn variance_rad2(&self) -> f64 {
        let variance = self.own_variance_rad2 + self.shared_rad * self.shared_rad;
        // Written so that a NaN stays one.
        if variance < LEAST_VARIANCE_RAD2 {
            LEAST_VARIANCE_RAD2
        } else {
            variance
        }
    }

    /// Change of its phase over this number of orders, rad.
    fn step_rad(&self, orders: f64) -> f64 {
        nearest_turn(self.ratio * TAU * orders, 0.0)
    }
}

/// The ladder of frequencies restricted to the columns that the measuring volume allows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ladder {
    /// Phase of the finest frequency in the middle.
    pub middle_rad: f64,
    /// Orders that the clues tell apart, about the middle.
    pub orders: usize,
    /// Within this of the middle a surface is expected: orders beyond may win, but do not make one within doubtful.
    pub expected_rad: f64,
}

/// The order found, and how sure it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Decision {
    /// Absolute phase of the finest frequency.
    pub absolute_rad: f64,
    /// Chi-square of the clues about it; as many degrees of freedom as clues.
    pub chi_square: f64,
    /// Distance of the nearest other order, in predicted standard deviations.
    pub separation: f64,
    /// Whether the clues lie within a quarter of the distance from this order to any other; clues farther off are not explained by
    /// noise (an edge inside the cell, stray light).
    pub agreed: bool,
}

/// Orders of which the chi-square is kept; the built-in sets have at most 48.
const KEPT_ORDERS: usize = 64;

/// Keeps noiseless clues finite; far below any camera.
const LEAST_VARIANCE_RAD2: f64 = 1e-16;

/// Weighting of clues by their own variances. Their common error (the finest phase) is left out of the weights, so that each clue can be
/// wrapped independently, but is included in the uncertainty of their sum.
struct Weights<'a>(&'a [Clue]);

impl Weights<'_> {
    /// Chi-square of the clues about an absolute phase.
    fn chi_square(&self, absolute_rad: f64) -> f64 {
        let part = |clue: &Clue| clue.residual_rad(absolute_rad).powi(2) / clue.variance_rad2();
        self.0.iter().map(part).sum()
    }

    /// Weighted square of how far the clues move over so many orders, and its ratio to the standard deviation of the sum that
    /// decides between the two: with weights w and steps s that sum is `sum w s r`, its limit half of `sum w s^2`.
    fn step(&self, orders: f64) -> (f64, f64) {
        let (mut square, mut own, mut shared) = (0.0, 0.0, 0.0);
        for clue in self.0 {
            let step_rad = clue.step_rad(orders);
            let weighted = step_rad / clue.variance_rad2();
            square += step_rad * weighted;
            own += weighted * weighted * clue.own_variance_rad2.max(0.0);
            // At half a turn either sign may be met: the larger sum.
            shared += (weighted * clue.shared_rad).abs();
        }
        let deviation = (own + shared * shared).sqrt();
        (
            square,
            if square > 0.0 {
                square / deviation
            } else {
                0.0
            },
        )
    }
}

/// The most likely order of the finest frequency, whose wrapped phase is `wrapped_rad`.
pub fn decide(clues: &[Clue], wrapped_rad: f64, ladder: &Ladder) -> Decision {
    let weights = Weights(clues);
    let lowest_rad = ladder.middle_rad - 0.5 * TAU * ladder.orders as f64;
    let first = ((lowest_rad - wrapped_rad) / TAU).ceil();
    let phase_rad = |order: usize| wrapped_rad + TAU * (first + order as f64);
    // Clue by clue over all orders, which the compiler vectorises.
    let mut kept = [0.0; KEPT_ORDERS];
    let kept = &mut kept[..ladder.orders.min(KEPT_ORDERS)];
    for clue in clues {
        let variance_rad2 = clue.variance_rad2();
        for (order, chi_square) in kept.iter_mut().enumerate() {
            *chi_square += clue.residual_rad(phase_rad(order)).powi(2) / variance_rad2;
        }
    }
    let chi_square = |order: usize| match kept.get(order) {
        Some(&kept) => kept,
        None => weights.chi_square(phase_rad(order)),
    };
    let (mut best, mut least) = (0, f64::INFINITY);
    for order in 0..ladder.orders {
        let found = chi_square(order);
        if found < least {
            (best, least) = (order, found);
        }
    }
    let mut decision = Decision {
        absolute_rad: phase_rad(best),
        chi_square: least,
        // A NaN is never certain.
        separation: if least.is_finite() {
            f64::INFINITY
        } else {
            0.0
        },
        agreed: true,
    };
    let is_expected = |order: &usize| {
        let from_middle_rad = (phase_rad(*order) - ladder.middle_rad).abs();
        *order < ladder.orders && !(from_middle_rad > ladder.expected_rad)
    };
    for away in 1..ladder.orders {
        // Orders as far below as above are as hard to tell apart.
        let others = [best.checked_sub(away), Some(best + away)];
        let mut others = others.into_iter().flatten().filter(is_expected).peekable();
        if others.peek().is_none() {
            continue;
        }
        let (square, separation) = weights.step(away as f64);
        // A NaN must not be lost in the minimum.
        let nearer = !(separation >= decision.separation);
        decision.separation = if nearer {
            separation
        } else {
            decision.separation
        };
        decision.agreed &= others.all(|other| chi_square(other) - least >= 0.5 * square);
    }
    decision
}

/// Separation that counts as telling two orders apart, radians of equally noisy clues: ten standard deviations of 0.05 rad.
const TOLD_APART_RAD: f64 = 0.5;

/// Number of neighbouring orders of the finest frequency that a set distinguishes, the finest last in `periods`.
///
/// With a frequency of at most one period it is all of them: each column has a phase of its own there, and how well it is told
/// is each cell's [`Decision::separation`]. Else it ends at the first order that could be exchanged with the present one by noise
/// that does not exchange neighbours, or by 0.05 rad in every phase. A single frequency distinguishes none; with 1 and 16 periods
/// it is all 16, with 4 and 48 it is 12, with 41, 45 and 48 all 48, with 41 and 48 only 7.
pub fn distinct_orders(periods: &[f64]) -> usize {
    let Some(finest) = periods.last() else {
        return 1;
    };
    let apart = |orders: usize| apart_rad(periods, orders as f64);
    // The sum cannot tell more than the projector holds.
    let most = finest.ceil().max(1.0) as usize;
    if periods.iter().any(|&periods| periods <= 1.0) {
        return most;
    }
    let needed = TOLD_APART_RAD.min(apart(1) * (1.0 - 1e-9));
    (1..most)
        .find(|&n| !(apart(n) > 0.0 && apart(n) >= needed))
        .unwrap_or(most)
}

/// Separation of orders this far apart for equally noisy phases, in standard deviations of one phase.
fn apart_rad(periods: &[f64], orders: f64) -> f64 {
    let Some((finest, others)) = periods.split_last() else {
        return 0.0;
    };
    let clue = |periods: &f64| Clue {
        ratio: periods / finest,
        phase_rad: 0.0,
        own_variance_rad2: 1.0,
        shared_rad: periods / finest,
    };
    let clues: Vec<Clue> = others.iter().map(clue).collect();
    Weights(&clues).step(orders).1
}

/// [`Decision::separation`] of neighbouring orders times the standard deviation of every phase.
pub fn order_step_rad(periods: &[f64]) -> f64 {
    apart_rad(periods, 1.0)
}

#[cfg(test)]
mod tests {
    use flankscope_test_requisites::Random;

    use super::*;

    fn wrap(phase: f64) -> f64 {
        phase.sin().atan2(phase.cos())
    }

    fn clue(ratio: f64, phase_rad: f64, sigma_rad: f64, finest_sigma_rad: f64) -> Clue {
        Clue {
            ratio,
            phase_rad,
            own_variance_rad2: sigma_rad * sigma_rad,
            shared_rad: ratio * finest_sigma_rad,
        }
    }

    #[test]
    fn a_turn_is_counted_as_by_rounding() {
        let mut random = Random(5);
        for exponent in -3..40 {
            let value = random.normal() * 2f64.powi(exponent);
            assert_eq!(nearest_whole(value), value.round_ties_even(), "{value}");
        }
        assert_eq!([-0.5, 0.5, 1.5].map(nearest_whole), [0.0, 0.0, 2.0]);
        assert!(nearest_whole(f64::NAN).is_nan());
        assert_eq!(nearest_whole(f64::INFINITY), f64::INFINITY);
    }

    /// Orders beyond those that are kept are judged by the same figures.
    #[test]
    fn many_orders_are_judged_like_few() {
        let clues = [1.0, 16.0].map(|periods: f64| {
            let ratio = periods / 128.0;
            clue(ratio, wrap(ratio * (0.7 + 90.0 * TAU)), 0.02, 0.02)
        });
        let ladder = Ladder {
            middle_rad: 64.0 * TAU,
            orders: 128,
            expected_rad: f64::INFINITY,
        };
        let found = decide(&clues, 0.7, &ladder);
        assert!(
            (found.absolute_rad - (0.7 + 90.0 * TAU)).abs() < 1e-9,
            "{found:?}"
        );
        let near = Ladder {
            middle_rad: 90.0 * TAU,
            orders: 60,
            ..ladder
        };
        let alone = decide(&clues, 0.7, &near);
        assert_eq!(alone.absolute_rad, found.absolute_rad);
        assert!((alone.separation - found.separation).abs() < 1e-9);
    }

    /// Against trying every order of every frequency and keeping the most consistent combination.
    #[test]
    fn agrees_with_trying_every_order_of_every_frequency() {
        let noise = [0.05, -0.08, 0.04];
        for periods in [[4.0, 13.0, 48.0], [41.0, 45.0, 48.0], [29.3, 37.1, 48.0]] {
            for step in 0..397 {
                let x = 0.002 + 0.996 * f64::from(step) / 397.0;
                // The volume knows x to within 0.1 of the width.
                let expected_x = x + 0.1 * (f64::from(step) * 0.7).sin();
                let wrapped: [f64; 3] =
                    std::array::from_fn(|i| wrap(TAU * periods[i] * x + noise[i]));
                let mut best = (f64::INFINITY, 0.0);
                for k0 in -1..=50 {
                    for k1 in -1..=50 {
                        for k2 in -1..=50 {
                            let orders = [k0, k1, k2].map(f64::from);
                            let xs: [f64; 3] = std::array::from_fn(|i| {
                                (wrapped[i] + TAU * orders[i]) / (TAU * periods[i])
                            });
                            if (xs[2] - expected_x).abs() > 0.125 || (xs[0] - xs[2]).abs() > 0.13 {
                                continue;
                            }
                            // Weighted mean of the columns, and what is left.
                            let weights = periods.map(|p: f64| p * p);
                            let sum: f64 = weights.iter().sum();
                            let mean = (0..3).map(|i| weights[i] * xs[i]).sum::<f64>() / sum;
                            let cost: f64 =
                                (0..3).map(|i| weights[i] * (xs[i] - mean).powi(2)).sum();
                            if cost < best.0 {
                                best = (cost, TAU * periods[2] * xs[2]);
                            }
                        }
                    }
                }
                let clues: Vec<Clue> = (0..2)
                    .map(|i| clue(periods[i] / 48.0, wrapped[i], 0.02, 0.02))
                    .collect();
                let ladder = Ladder {
                    middle_rad: TAU * 48.0 * expected_x,
                    orders: 12,
                    expected_rad: f64::INFINITY,
                };
                let found = decide(&clues, wrapped[2], &ladder);
                assert!(
                    (found.absolute_rad - best.1).abs() < 1e-9,
                    "{periods:?} x = {x}"
                );
                assert!(found.separation > MIN_SEPARATION, "{found:?}");
            }
        }
    }

    #[test]
    fn one_clue_is_the_rule_of_its_ratio() {
        let ladder = Ladder {
            middle_rad: 0.0,
            orders: 12,
            expected_rad: f64::INFINITY,
        };
        let limit = TAU / MIN_SEPARATION / 145f64.sqrt();
        let at = |sigma: f64| decide(&[clue(1.0 / 12.0, 0.1, sigma, sigma)], 0.9, &ladder);
        assert!(at(limit * 0.999).separation > MIN_SEPARATION);
        assert!(at(limit * 1.001).separation < MIN_SEPARATION);
        assert!(at(f64::NAN).separation < MIN_SEPARATION);
        // A clue that asks for a phase a quarter of a turn off lies half way to the middle between two orders.
        let off = |rad: f64| decide(&[clue(1.0 / 12.0, rad / 12.0, 0.01, 0.01)], 0.0, &ladder);
        assert!(off(1.57).agreed && !off(1.58).agreed);
        assert_eq!(off(-1.57).absolute_rad, 0.0);
    }

    /// Errors drawn from the clues' own covariance take a neighbour as often as the separation says.
    #[test]
    fn the_separation_says_how_often_noise_takes_another_order() {
        let mut random = Random(11);
        let (sigma, draws) = (0.16, 200_000);
        let ladder = Ladder {
            middle_rad: 0.0,
            orders: 15,
            expected_rad: f64::INFINITY,
        };
        let (mut wrong, mut separation) = (0, 0.0);
        for _ in 0..draws {
            let own = sigma * random.normal();
            let clues = [41.0, 45.0].map(|p| clue(p / 48.0, sigma * random.normal(), sigma, sigma));
            let found = decide(&clues, own, &ladder);
            wrong += usize::from((found.absolute_rad - own).abs() > 1.0);
            separation = found.separation;
        }
        // erfc(d / (2 sqrt 2)) of both neighbours together, by Abramowitz and Stegun 7.1.26.
        let z: f64 = separation / 8f64.sqrt();
        let t = 1.0 / (1.0 + 0.327_591_1 * z);
        let poly = t
            * (0.254_829_592
                + t * (-0.284_496_736
                    + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
        let expected = poly * (-z * z).exp();
        let got = wrong as f64 / f64::from(draws);
        // The twelve-fold sum has light tails, and farther orders add a little.
        assert!(
            (got / expected - 1.0).abs() < 0.12,
            "{got} of {expected} at {separation}"
        );
    }

    #[test]
    fn what_a_set_tells_apart() {
        for (periods, orders) in [
            (&[16.0][..], 1),
            (&[1.0, 16.0], 16),
            (&[1.0, 64.0], 64),
            (&[1.0, 16.0, 128.0], 128),
            (&[1.0, 12.5], 13),
            (&[4.0, 48.0], 12),
            (&[4.1, 48.0], 11),
            (&[4.0, 13.0, 48.0], 48),
            (&[41.0, 45.0, 48.0], 48),
            (&[36.0, 39.0, 48.0], 16),
            (&[41.0, 48.0], 7),
            (&[47.0, 48.0], 48),
        ] {
            assert_eq!(distinct_orders(periods), orders, "{periods:?}");
        }
    }

    /// With 36 and 48 periods the next order but one lies half a turn away, where noise decides the sign of what is left.
    #[test]
    fn half_a_turn_has_two_signs() {
        let ladder = Ladder {
            middle_rad: 0.0,
            orders: 16,
            expected_rad: f64::INFINITY,
        };
        for noise in [-0.1, -0.01, 0.0, 0.01, 0.1] {
            let clues = [36.0, 39.0].map(|p: f64| Clue {
                ratio: p / 48.0 - 1.0,
                phase_rad: noise,
                own_variance_rad2: 1e-4,
                shared_rad: 0.03,
            });
            let found = decide(&clues, 0.0, &ladder);
            assert!(
                found.absolute_rad == 0.0 && found.agreed,
                "{noise}: {found:?}"
            );
        }
    }

    /// The table of docs/formats/plan.md, and that no pair of frequencies tells as many orders apart by more than `high12` does.
    #[test]
    fn margins_of_the_built_in_sets() {
        let margin = |periods: &[f64]| {
            let margins = (1..12).map(|orders| apart_rad(periods, f64::from(orders)));
            margins.fold(f64::INFINITY, f64::min)
        };
        for (name, orders, expected_rad) in [
            ("article8", 12, 0.52),
            ("insitu12", 12, 0.52),
            ("scan16", 48, 0.53),
            ("high12", 16, 1.19),
            ("high16", 48, 0.66),
        ] {
            let sets = crate::PatternSet::named(name).unwrap().sets;
            let periods: Vec<f64> = sets.iter().map(|set| set.periods).collect();
            assert_eq!(distinct_orders(&periods), orders, "{name}");
            assert!(
                (margin(&periods) - expected_rad).abs() < 0.005,
                "{name}: {}",
                margin(&periods)
            );
        }
        let high = margin(&[36.0, 39.0, 48.0]);
        for low in 36..48 {
            for middle in low + 1..48 {
                let periods = [f64::from(low), f64::from(middle), 48.0];
                let better = margin(&periods) > high && distinct_orders(&periods) >= 16;
                assert!(!better, "{periods:?}: {}", margin(&periods));
            }
        }
    }

    /// Orders outside the volume may win, but do not make a surface within it doubtful.
    #[test]
    fn only_expected_orders_compete() {
        let clues = [clue(1.0 / 12.0, 0.0, 0.02, 0.02)];
        let narrow = Ladder {
            middle_rad: 0.0,
            orders: 12,
            expected_rad: 1.0,
        };
        assert_eq!(decide(&clues, 0.0, &narrow).separation, f64::INFINITY);
        let far = [clue(1.0 / 12.0, 2.0 * TAU / 12.0, 0.02, 0.02)];
        assert_eq!(decide(&far, 0.0, &narrow).absolute_rad, 2.0 * TAU);
    }
}
