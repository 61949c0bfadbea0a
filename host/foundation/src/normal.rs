//! The normal distribution: coverage and guard factors, probability of conformity (JCGM 106).

/// Coverage factor of U95, two-sided 95 % (JCGM 100, table G.1), as rounded as it is stated beside every figure.
pub const COVERAGE_95: f64 = 1.96;

/// Probability that a normal figure with expectation `value` and standard uncertainty `u` lies at or below a limit: of
/// conformity when the limit is an upper one.
pub fn probability_below(limit: f64, value: f64, u: f64) -> f64 {
    0.5 * libm::erfc((value - limit) / (u * std::f64::consts::SQRT_2))
}

/// How many standard uncertainties a figure must keep from a limit, so that the limit is kept or exceeded with this
/// probability: the quantile of the normal distribution, for probabilities from one half up to (not including) one. The one
/// source of every coverage and guard factor: 1.645 for a one-sided 95 %, `guard_factor(0.975)` = 1.960 for U95.
pub fn guard_factor(probability: f64) -> f64 {
    let (mut low, mut high) = (0.0, 10.0);
    // 50 halvings of 10 end below 1e-14.
    for _ in 0..50 {
        let middle = 0.5 * (low + high);
        if probability_below(middle, 0.0, 1.0) < probability {
            low = middle;
        } else {
            high = middle;
        }
    }
    high
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn factors_are_the_quantiles_of_the_tables() {
        for (probability, quantile) in [
            (0.5, 0.0),
            (0.95, 1.644_854),
            (0.975, 1.959_964),
            (0.999, 3.090_232),
        ] {
            assert!((guard_factor(probability) - quantile).abs() < 1e-6);
            assert!((probability_below(quantile, 0.0, 1.0) - probability).abs() < 1e-6);
        }
        assert!((COVERAGE_95 - guard_factor(0.975)).abs() < 5e-5);
    }
}
