//! Which fringe is it? From wrapped phases of several frequencies to one absolute phase.
//!
//! The lowest frequency's order comes from the measuring volume: along a camera ray the volume spans less than one of
//! its periods, so only one order fits (a single period over the projector needs no volume). Every finer frequency's
//! order comes from the one below it: with `R = periods / periods below`, `k = round((R phase_below - phase) / TAU)`.
//! That rounding fails with probability `erfc(PI / (sqrt(2) s))`, `s = sqrt(R^2 sigma_below^2 + sigma^2)`.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// `s` may be at most this: the fringe order is then wrong with a probability of 6e-7.
pub const MAX_ORDER_SIGMA_RAD: f64 = PI / 5.0;

/// The phase closest to `expected_rad` among all that differ from `wrapped_rad` by whole turns.
pub fn nearest_turn(wrapped_rad: f64, expected_rad: f64) -> f64 {
    wrapped_rad + TAU * ((expected_rad - wrapped_rad) / TAU).round()
}

/// Standard deviation of the prediction against the finer phase, the `s` above.
pub fn order_sigma_rad(ratio: f64, below_sigma_rad: f64, sigma_rad: f64) -> f64 {
    ((ratio * below_sigma_rad).powi(2) + sigma_rad * sigma_rad).sqrt()
}

/// A prediction that misses the finer phase by more than this lies nearly as close to the next order: something other
/// than noise (an edge inside the cell, stray light) is at work. Noise at its limit exceeds it in 1 % of the cells.
pub const MAX_DISAGREEMENT_RAD: f64 = FRAC_PI_2;

/// One step up: the absolute phase of the finer frequency, or `None` if noise or disagreement make the order uncertain.
pub fn refine(
    ratio: f64,
    below_rad: f64,
    below_sigma_rad: f64,
    wrapped_rad: f64,
    sigma_rad: f64,
) -> Option<f64> {
    let predicted_rad = ratio * below_rad;
    let absolute_rad = nearest_turn(wrapped_rad, predicted_rad);
    // Written so that a NaN fails.
    let certain = order_sigma_rad(ratio, below_sigma_rad, sigma_rad) <= MAX_ORDER_SIGMA_RAD
        && (absolute_rad - predicted_rad).abs() <= MAX_DISAGREEMENT_RAD;
    certain.then_some(absolute_rad)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wrap(phase: f64) -> f64 {
        phase.sin().atan2(phase.cos())
    }

    /// Against trying every order of every frequency and keeping the most consistent combination.
    #[test]
    fn agrees_with_trying_every_order() {
        let periods = [4.0, 13.0, 48.0];
        let noise = [0.05, -0.08, 0.04];
        for step in 0..997 {
            let x = 0.002 + 0.996 * f64::from(step) / 997.0;
            // The volume knows x to within 0.1 of the width: less than half a period of the lowest frequency.
            let expected_x = x + 0.1 * (f64::from(step) * 0.7).sin();
            let wrapped: Vec<f64> = (0..3)
                .map(|i| wrap(TAU * periods[i] * x + noise[i]))
                .collect();
            let mut best = (f64::INFINITY, 0.0);
            for k0 in -1..=5 {
                for k1 in -1..=14 {
                    for k2 in -1..=49 {
                        let xs = [k0, k1, k2].map(f64::from);
                        let xs: [f64; 3] = std::array::from_fn(|i| {
                            (wrapped[i] + TAU * xs[i]) / (TAU * periods[i])
                        });
                        if (xs[0] - expected_x).abs() > 0.125 {
                            continue;
                        }
                        let cost = (xs[0] - xs[1]).abs() + (xs[1] - xs[2]).abs();
                        if cost < best.0 {
                            best = (cost, TAU * periods[2] * xs[2]);
                        }
                    }
                }
            }
            let low = nearest_turn(wrapped[0], TAU * periods[0] * expected_x);
            let middle = refine(13.0 / 4.0, low, 0.05, wrapped[1], 0.05).unwrap();
            let high = refine(48.0 / 13.0, middle, 0.05, wrapped[2], 0.05).unwrap();
            assert!((high - best.1).abs() < 1e-9, "x = {x}");
            assert!((high - TAU * 48.0 * x).abs() < 0.05);
        }
    }

    #[test]
    fn a_prediction_between_two_orders_is_refused() {
        assert!(refine(12.0, 1.0, 0.0, 12.0 - TAU + 1.5, 0.0).is_some());
        assert!(refine(12.0, 1.0, 0.0, 12.0 - TAU + 1.6, 0.0).is_none());
    }

    #[test]
    fn uncertain_orders_are_refused() {
        let limit = MAX_ORDER_SIGMA_RAD / 145f64.sqrt();
        assert!(refine(12.0, 1.0, limit * 0.999, -0.3, limit * 0.999).is_some());
        assert!(refine(12.0, 1.0, limit * 1.001, -0.3, limit * 1.001).is_none());
        assert!(refine(12.0, 1.0, f64::NAN, -0.3, 0.1).is_none());
    }
}
