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

// Lanes are counted: an iterator over several arrays at once hides from the compiler what a vector holds.
#![allow(clippy::needless_range_loop)]

use std::f64::consts::TAU;

use flankscope_foundation::simd::with_widest;

/// Least distance to the next order in predicted standard deviations: of two neighbours one is taken by mistake in 6e-7 of the
/// cells.
pub const MIN_SEPARATION: f64 = 10.0;

/// The phase closest to `expected_rad` among all that differ from `wrapped_rad` by whole turns.
#[inline(always)]
pub fn nearest_turn(wrapped_rad: f64, expected_rad: f64) -> f64 {
    wrapped_rad + TAU * nearest_whole((expected_rad - wrapped_rad) / TAU)
}

/// The nearest whole number below 2^51, the even one at halves, by the rounding of an addition: [`f64::round`] is a call of the
/// mathematical library on processors of the x86-64 baseline, and this is asked for every order of every cell.
#[inline(always)]
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
    #[inline(always)]
    fn variance_rad2(&self) -> f64 {
        let variance = self.own_variance_rad2 + self.shared_rad * self.shared_rad;
        // Written so that a NaN stays one.
        if variance < LEAST_VARIANCE_RAD2 {
            LEAST_VARIANCE_RAD2
        } else {
            variance
        }
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

/// Keeps noiseless clues finite; far below any camera.
const LEAST_VARIANCE_RAD2: f64 = 1e-16;

/// Orders that are judged together: vectors of any processor divide them, and few of them lie beyond the end of a ladder.
const LANES: usize = 8;

/// Their numbers.
const LANE_NUMBERS: Lanes = {
    let mut numbers = [0.0; LANES];
    let mut lane = 1;
    while lane < LANES {
        numbers[lane] = numbers[lane - 1] + 1.0;
        lane += 1;
    }
    numbers
};

/// A figure of so many consecutive orders.
type Lanes = [f64; LANES];

/// Chi-squares of the clues about the absolute phases from this one on, one order apart.
///
/// Clues are weighted by their own variances. Their common error (the finest phase) is left out of the weights, so that each clue can
/// be wrapped independently, but is included in the uncertainty of their sum.
#[inline(always)]
fn chi_squares(clues: &[Clue], absolute_rad: f64) -> Lanes {
    let mut found = [0.0; LANES];
    for clue in clues {
        let off_turns = (clue.phase_rad - clue.ratio * absolute_rad) / TAU;
        let per_turn2 = TAU * TAU / clue.variance_rad2();
        for (lane, found) in found.iter_mut().enumerate() {
            let turns = off_turns - clue.ratio * LANE_NUMBERS[lane];
            let residual = turns - nearest_whole(turns);
            *found += residual * residual * per_turn2;
        }
    }
    found
}

/// How far the clues tell orders apart.
struct Steps {
    /// Weighted square of how far the clues move.
    squares: Lanes,
    /// Square of its ratio to the standard deviation of the sum that decides between the two orders: with weights w and steps s
    /// that sum is `sum w s r`, its limit half of `sum w s^2`. Never NaN.
    separations2: Lanes,
}

/// Between orders so far apart, and each one farther.
#[inline(always)]
fn steps(clues: &[Clue], orders_apart: f64) -> Steps {
    let (mut squares, mut own, mut shared) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
    for clue in clues {
        let weight = TAU / clue.variance_rad2();
        let own_weight = weight * weight * clue.own_variance_rad2.max(0.0);
        let shared_weight = weight * clue.shared_rad.abs();
        for lane in 0..LANES {
            let turns = clue.ratio * (orders_apart + LANE_NUMBERS[lane]);
            let step = turns - nearest_whole(turns);
            squares[lane] += step * step * (TAU * weight);
            own[lane] += step * step * own_weight;
            // At half a turn either sign may be met: the larger sum.
            shared[lane] += step.abs() * shared_weight;
        }
    }
    let separation2 = |lane: usize| {
        let found = squares[lane] * squares[lane] / (own[lane] + shared[lane] * shared[lane]);
        // A NaN tells nothing apart.
        if found > 0.0 { found } else { 0.0 }
    };
    Steps {
        separations2: std::array::from_fn(separation2),
        squares,
    }
}

/// The most likely order of the finest frequency, whose wrapped phase is `wrapped_rad`.
pub fn decide(clues: &[Clue], wrapped_rad: f64, ladder: &Ladder) -> Decision {
    with_widest(
        #[inline(always)]
        || decide_in_lanes(clues, wrapped_rad, ladder),
    )
}

#[inline(always)]
fn decide_in_lanes(clues: &[Clue], wrapped_rad: f64, ladder: &Ladder) -> Decision {
    let lowest_rad = ladder.middle_rad - 0.5 * TAU * ladder.orders as f64;
    let first = ((lowest_rad - wrapped_rad) / TAU).ceil();
    let phase_rad = |order: usize| wrapped_rad + TAU * (first + order as f64);
    let (best, least) = least(clues, phase_rad, ladder.orders);
    let decision = Decision {
        absolute_rad: phase_rad(best),
        chi_square: least,
        separation: 0.0,
        agreed: true,
    };
    // A NaN is never certain.
    if !least.is_finite() {
        return decision;
    }
    // The orders within the expected phases.
    let turns_to = |rad: f64| (ladder.middle_rad + rad - phase_rad(0)) / TAU;
    let begin = turns_to(-ladder.expected_rad).ceil().max(0.0) as usize;
    let end = (turns_to(ladder.expected_rad).floor() + 1.0).max(0.0) as usize;
    let end = end.min(ladder.orders);
    let mut nearest2 = [f64::INFINITY; LANES];
    let mut agreed = true;
    for from in (begin..end).step_by(LANES) {
        let chi_squares = chi_squares(clues, phase_rad(from));
        let Steps {
            squares,
            separations2,
        } = steps(clues, from as f64 - best as f64);
        let from = from as f64;
        for lane in 0..LANES {
            let other = from + LANE_NUMBERS[lane];
            let competes = (other < end as f64) & (other != best as f64);
            let nearer = competes & (separations2[lane] < nearest2[lane]);
            nearest2[lane] = if nearer {
                separations2[lane]
            } else {
                nearest2[lane]
            };
            let farther = chi_squares[lane] - least >= 0.5 * squares[lane];
            agreed &= farther | !competes;
        }
    }
    Decision {
        separation: nearest2
            .into_iter()
            .fold(f64::INFINITY, |a, b| if b < a { b } else { a })
            .sqrt(),
        agreed,
        ..decision
    }
}

/// The first order with the least chi-square, and this; infinite where there is none.
#[inline(always)]
fn least(clues: &[Clue], phase_rad: impl Fn(usize) -> f64, orders: usize) -> (usize, f64) {
    let (mut best, mut least) = ([0.0; LANES], [f64::INFINITY; LANES]);
    for from in (0..orders).step_by(LANES) {
        let found = chi_squares(clues, phase_rad(from));
        let from = from as f64;
        for lane in 0..LANES {
            let order = from + LANE_NUMBERS[lane];
            let better = (order < orders as f64) & (found[lane] < least[lane]);
            best[lane] = if better { order } else { best[lane] };
            least[lane] = if better { found[lane] } else { least[lane] };
        }
    }
    let lowest = least
        .into_iter()
        .fold(f64::INFINITY, |a, b| if b < a { b } else { a });
    let mut first = f64::INFINITY;
    for lane in 0..LANES {
        let earlier = (least[lane] == lowest) & (best[lane] < first);
        first = if earlier { best[lane] } else { first };
    }
    (first as usize, lowest)
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
    steps(&clues, orders).separations2[0].sqrt()
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

    /// Clue by clue and order by order, as it is written in books.
    mod one_by_one {
        use super::super::{Clue, Decision, LEAST_VARIANCE_RAD2, Ladder, TAU};

        fn wrapped(rad: f64) -> f64 {
            rad - TAU * (rad / TAU).round_ties_even()
        }

        fn variance_rad2(clue: &Clue) -> f64 {
            let variance = clue.own_variance_rad2 + clue.shared_rad.powi(2);
            match variance < LEAST_VARIANCE_RAD2 {
                true => LEAST_VARIANCE_RAD2,
                false => variance,
            }
        }

        pub fn chi_square(clues: &[Clue], absolute_rad: f64) -> f64 {
            let part = |clue: &Clue| {
                let off_rad = wrapped(clue.phase_rad - clue.ratio * absolute_rad);
                off_rad.powi(2) / variance_rad2(clue)
            };
            clues.iter().map(part).sum()
        }

        fn step(clues: &[Clue], orders: f64) -> [f64; 2] {
            let (mut square, mut own, mut shared) = (0.0, 0.0, 0.0);
            for clue in clues {
                let step_rad = wrapped(clue.ratio * TAU * orders);
                let weighted = step_rad / variance_rad2(clue);
                square += step_rad * weighted;
                own += weighted.powi(2) * clue.own_variance_rad2.max(0.0);
                shared += (weighted * clue.shared_rad).abs();
            }
            let told = square > 0.0;
            [
                square,
                if told {
                    square / own.sqrt().hypot(shared)
                } else {
                    0.0
                },
            ]
        }

        pub fn decide(clues: &[Clue], wrapped_rad: f64, ladder: &Ladder) -> Decision {
            let lowest_rad = ladder.middle_rad - 0.5 * TAU * ladder.orders as f64;
            let first = ((lowest_rad - wrapped_rad) / TAU).ceil();
            let phase_rad = |order: usize| wrapped_rad + TAU * (first + order as f64);
            let chi_square = |order: usize| chi_square(clues, phase_rad(order));
            let (mut best, mut least) = (0, f64::INFINITY);
            for order in 0..ladder.orders {
                if chi_square(order) < least {
                    (best, least) = (order, chi_square(order));
                }
            }
            let mut decision = Decision {
                absolute_rad: phase_rad(best),
                chi_square: least,
                separation: if least.is_finite() {
                    f64::INFINITY
                } else {
                    0.0
                },
                agreed: true,
            };
            for other in (0..ladder.orders).filter(|&other| other != best) {
                if (phase_rad(other) - ladder.middle_rad).abs() > ladder.expected_rad {
                    continue;
                }
                let [square, separation] = step(clues, best.abs_diff(other) as f64);
                if !(separation >= decision.separation) {
                    decision.separation = separation;
                }
                decision.agreed &= chi_square(other) - least >= 0.5 * square;
            }
            decision
        }
    }

    /// Drawn clues, near an order and anywhere, with what a broken cell may hold.
    #[test]
    fn orders_judged_together_are_judged_as_one_by_one() {
        let mut random = Random(23);
        let (mut sure, mut refused) = (0, 0);
        for draw in 0..60_000 {
            let orders = [1, 3, 7, 8, 12, 16, 48, 130][draw % 8];
            let broken = [f64::NAN, f64::INFINITY, -f64::INFINITY, 0.0, 1e-200];
            let mut maybe = |value: f64| match (random.uniform() * 400.0) as usize {
                at if at < broken.len() => broken[at],
                _ => value,
            };
            // No ratio comes back to the same phase, so that the least is one order's.
            let periods = [[4.03, 13.07], [36.37, 39.0], [1.01, 29.3]][draw % 3];
            let mut random = Random(draw as u64);
            let sigma = 10f64.powf(-0.5 - 3.0 * random.uniform());
            let wrapped_rad = maybe(TAU * (random.uniform() - 0.5));
            let truth_rad = wrapped_rad + TAU * (random.uniform() * 48.0).floor();
            let off = if random.uniform() < 0.3 { 1.0 } else { sigma };
            let clues = periods.map(|periods: f64| {
                let ratio = periods / 48.0 - if draw % 2 == 0 { 0.0 } else { 1.0 };
                Clue {
                    ratio,
                    phase_rad: maybe(ratio * truth_rad + off * random.normal()),
                    own_variance_rad2: maybe(sigma * sigma),
                    shared_rad: maybe(ratio * sigma),
                }
            });
            let clues = &clues[..1 + draw / 3 % 2];
            let ladder = Ladder {
                middle_rad: truth_rad.max(0.0) + 20.0 * (random.uniform() - 0.5),
                orders,
                expected_rad: [f64::INFINITY, 10.0, 40.0][draw % 3],
            };
            let found = decide(clues, wrapped_rad, &ladder);
            let expected = one_by_one::decide(clues, wrapped_rad, &ladder);
            let sure_of = |of: &Decision| of.separation >= MIN_SEPARATION;
            let near =
                |a: f64, b: f64| a == b || (a - b).abs() <= 1e-9 * (1.0 + a.abs().max(b.abs()));
            assert_eq!(sure_of(&found), sure_of(&expected), "{clues:?} {ladder:?}");
            if !sure_of(&found) {
                refused += 1;
                continue;
            }
            sure += 1;
            assert!(
                near(found.chi_square, expected.chi_square),
                "{found:?} {expected:?}"
            );
            assert!(
                near(found.separation, expected.separation),
                "{found:?} {expected:?}"
            );
            assert_eq!(
                found.absolute_rad, expected.absolute_rad,
                "{clues:?} {ladder:?}"
            );
            assert_eq!(found.agreed, expected.agreed, "{clues:?} {ladder:?}");
        }
        assert!(sure > 20_000 && refused > 5_000, "{sure} and {refused}");
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

    /// Whatever their number, orders are judged by the same figures.
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
