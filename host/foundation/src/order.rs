//! Order statistics. Values are reordered, never averaged: what comes back is one of them (but of [`midpoint_median`]).

/// Standard deviation of a normal variable over the median of its size: what makes a robust standard deviation of the median
/// absolute deviation.
pub const SIGMA_PER_MAD: f64 = 1.482_602_218_505_602;

/// The value below which a `part` (0 to 1) of the others lies: the one at rank `part (n - 1)`, rounded. NaN sorts last. `None`
/// of no values.
pub fn quantile(values: &mut [f64], part: f64) -> Option<f64> {
    let last = values.len().checked_sub(1)?;
    let rank = (part * last as f64).round() as usize;
    Some(
        *values
            .select_nth_unstable_by(rank.min(last), f64::total_cmp)
            .1,
    )
}

/// Difference between the largest and the smallest of the numbers; negative infinity of none.
pub fn range_of(values: impl IntoIterator<Item = f64>) -> f64 {
    let none = [f64::INFINITY, f64::NEG_INFINITY];
    // The smaller and the larger of a number and NaN is the number.
    let [least, most] = values.into_iter().fold(none, |[least, most], value| {
        [least.min(value), most.max(value)]
    });
    most - least
}

/// The middle value, of an even number the upper of the two.
pub fn median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// The middle one of the finite values.
pub fn median_of(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.into_iter().filter(|v| v.is_finite()).collect();
    median(&mut values)
}

/// The middle value, of an even number the mean of the two: what rank statistics of few values ask for (Theil and Sen).
pub fn midpoint_median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    let even = values.len().is_multiple_of(2);
    if values.is_empty() {
        return None;
    }
    let (below, &mut upper, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    let lower = below
        .iter()
        .copied()
        .max_by(f64::total_cmp)
        .filter(|_| even);
    Some(lower.map_or(upper, |lower| 0.5 * (lower + upper)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranks_are_those_of_the_sorted_values() {
        for count in 1..40_usize {
            // Another order: 41 is prime, so no two values get the same key.
            let shuffled = || -> Vec<f64> {
                let mut values: Vec<f64> = (0..count).map(|i| i as f64).collect();
                values.sort_by_key(|value| (*value as usize * 29) % 41);
                values
            };
            assert_eq!(median(&mut shuffled()), Some((count / 2) as f64));
            assert_eq!(quantile(&mut shuffled(), 0.5), median(&mut shuffled()));
            assert_eq!(quantile(&mut shuffled(), 0.0), Some(0.0));
            assert_eq!(quantile(&mut shuffled(), 1.0), Some((count - 1) as f64));
        }
        assert_eq!(quantile(&mut [4.0, 2.0, 8.0, 6.0, 0.0], 0.75), Some(6.0));
        assert_eq!((median(&mut []), quantile(&mut [], 0.5)), (None, None));
        assert_eq!(
            median_of([f64::NAN, 3.0, f64::INFINITY, 1.0, 2.0]),
            Some(2.0)
        );
        assert_eq!(median_of([f64::NAN]), None);
        assert_eq!(midpoint_median(&mut [8.0, 1.0, 4.0, 2.0]), Some(3.0));
        assert_eq!(midpoint_median(&mut [8.0, 1.0, 4.0]), Some(4.0));
        assert_eq!(midpoint_median(&mut []), None);
    }

    #[test]
    fn the_median_size_of_a_normal_variable_is_its_sigma_over_the_factor() {
        let within = |size: f64| 2.0 * crate::normal::probability_below(size, 0.0, 1.0) - 1.0;
        assert!((within(1.0 / SIGMA_PER_MAD) - 0.5).abs() < 1e-12);
    }
}
