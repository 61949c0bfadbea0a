//! Order statistics. Values are reordered, never averaged: what comes back is one of them.

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

/// The middle value, of an even number the upper of the two.
pub fn median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
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
    }
}
