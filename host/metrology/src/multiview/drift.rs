//! Test of a series for drift from view to view.
//!
//! Neighbouring members of a series that has no trend differ as much as any two; when it drifts, neighbours are alike.
//! The statistic of Durbin and Watson (Biometrika 37, 1950) of a series about its mean is von Neumann's ratio of the mean
//! square successive difference (Annals of Mathematical Statistics 12, 1941): 2 for independent members, less for a drift.

/// Least number of members of a series.
const LEAST: usize = 5;
/// Beyond so many standard deviations a series is said to drift: once in 700 series that do not.
const LIMIT_SIGMAS: f64 = 3.0;

/// Statistic of Durbin and Watson of a series.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drift {
    /// Durbin-Watson statistic, 0 to 4.
    pub durbin_watson: f64,
    /// Distance of the statistic below 2, in its standard deviations for independent normal members.
    pub sigmas: f64,
    /// Standard deviation of the part that neighbours share, in the unit of the series: what is left of the variance when
    /// half the mean square of the steps, which is what independent members add, is taken off.
    pub trend: f64,
}

impl Drift {
    /// Whether the drift is significant and larger than `least`.
    pub fn drifts(&self, least: f64) -> bool {
        self.sigmas > LIMIT_SIGMAS && self.trend > least
    }
}

/// The statistic of a series in its order; none for fewer than five members or for members that are all the same.
pub fn durbin_watson(series: &[f64]) -> Option<Drift> {
    let n = series.len() as f64;
    let mean = series.iter().sum::<f64>() / n;
    let squares: f64 = series.iter().map(|value| (value - mean).powi(2)).sum();
    if series.len() < LEAST || squares.is_nan() || squares <= 0.0 {
        return None;
    }
    let steps: f64 = series
        .windows(2)
        .map(|pair| (pair[1] - pair[0]).powi(2))
        .sum();
    let durbin_watson = steps / squares;
    // Its mean is 2 and its variance this, for independent normal members about their own mean (von Neumann).
    let variance = 4.0 * (n - 2.0) / (n * n - 1.0);
    Some(Drift {
        durbin_watson,
        sigmas: (2.0 - durbin_watson) / variance.sqrt(),
        trend: ((squares - 0.5 * steps) / (n - 1.0)).max(0.0).sqrt(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use flankscope_foundation::random::uniform;

    fn normal(seed: u64, index: u64) -> f64 {
        (0..12).map(|k| uniform(seed, 12 * index + k)).sum::<f64>() - 6.0
    }

    #[test]
    fn a_series_by_hand() {
        // About the mean 3: squares 4 + 1 + 0 + 1 + 4 = 10, four steps of 1.
        let found = durbin_watson(&[1.0, 2.0, 3.0, 4.0, 5.0]).unwrap();
        assert!((found.durbin_watson - 0.4).abs() < 1e-12);
        assert!((found.sigmas - 1.6 / 0.5f64.sqrt()).abs() < 1e-12);
        assert!((found.trend - 2f64.sqrt()).abs() < 1e-12);
        assert_eq!(durbin_watson(&[1.0, 2.0, 3.0, 4.0]), None);
        assert_eq!(durbin_watson(&[2.0; 9]), None);
        assert_eq!(durbin_watson(&[1.0, 2.0, f64::NAN, 4.0, 5.0]), None);
    }

    #[test]
    fn independent_members_scatter_as_promised_and_a_drift_is_seen() {
        const SERIES: u64 = 4000;
        for n in [12u64, 84] {
            let sigmas: Vec<f64> = (0..SERIES)
                .map(|seed| {
                    let series: Vec<f64> = (0..n).map(|i| normal(seed, i)).collect();
                    durbin_watson(&series).unwrap().sigmas
                })
                .collect();
            let count = sigmas.len() as f64;
            let mean = sigmas.iter().sum::<f64>() / count;
            let std = (sigmas.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / count).sqrt();
            // Five standard deviations of a mean and of a standard deviation of 4000 near-normal numbers.
            assert!(mean.abs() < 5.0 / count.sqrt(), "n = {n}: {mean}");
            assert!(
                (std - 1.0).abs() < 5.0 / (2.0 * count).sqrt(),
                "n = {n}: {std}"
            );
        }
        // As large as the scatter from end to end: seen in a full turn.
        let drifting: Vec<f64> = (0..84)
            .map(|i| normal(1, i) + 4.0 * i as f64 / 83.0)
            .collect();
        let found = durbin_watson(&drifting).unwrap();
        // A ramp of 4 has a standard deviation of 4 / sqrt(12).
        assert!(found.drifts(0.5) && !found.drifts(3.0));
        assert!(
            (found.trend - 4.0 / 12f64.sqrt()).abs() < 0.4,
            "{}",
            found.trend
        );
    }
}
