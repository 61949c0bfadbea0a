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

/// Student's factor: coverage of 95 %, two-sided, of a mean whose standard deviation has so many degrees of freedom (JCGM 100, table G.2).
pub fn student_factor(degrees_of_freedom: u32) -> f64 {
    let (mut low, mut high) = (0.0, 20.0);
    for _ in 0..50 {
        let middle = 0.5 * (low + high);
        if student_within(middle, degrees_of_freedom) < 0.95 {
            low = middle;
        } else {
            high = middle;
        }
    }
    high
}

/// Probability that Student's t lies within this of zero (Abramowitz and Stegun 1964, 26.7.3 and 26.7.4).
fn student_within(t: f64, degrees_of_freedom: u32) -> f64 {
    let nu = f64::from(degrees_of_freedom);
    let angle = (t / nu.sqrt()).atan();
    let (sine, cosine) = angle.sin_cos();
    let is_odd = degrees_of_freedom % 2 == 1;
    let (mut term, mut sum) = match (is_odd, degrees_of_freedom) {
        (true, 1) => (0.0, 0.0),
        (true, _) => (cosine, cosine),
        (false, _) => (1.0, 1.0),
    };
    // Ratio of one term to the one before it.
    let mut k = if is_odd { 3 } else { 2 };
    while k < degrees_of_freedom {
        term *= cosine * cosine * f64::from(k - 1) / f64::from(k);
        sum += term;
        k += 2;
    }
    match is_odd {
        true => std::f64::consts::FRAC_2_PI * (angle + sine * sum),
        false => sine * sum,
    }
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

    #[test]
    fn student_s_factors_are_those_of_the_tables() {
        for (degrees, factor) in [
            (1, 12.706),
            (2, 4.303),
            (3, 3.182),
            (4, 2.776),
            (5, 2.571),
            (12, 2.179),
            (29, 2.045),
            (120, 1.980),
        ] {
            assert!(
                (student_factor(degrees) - factor).abs() < 5.1e-4,
                "{degrees}"
            );
        }
    }
}
