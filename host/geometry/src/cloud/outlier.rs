//! Statistical outlier removal.

use crate::cloud::neighbours::mean_distances;

/// Marks the points to keep: a point goes when the mean distance to its `k` nearest neighbours exceeds the mean of that
/// quantity over the cloud by more than `std_ratio` standard deviations.
///
/// `points` are finite, mm. Clouds of at most `k` points are kept whole: there is nothing to compare with.
pub fn statistical(points: &[[f64; 3]], k: usize, std_ratio: f64) -> Vec<bool> {
    let Some(mean_distances_mm) = mean_distances(points, k) else {
        return vec![true; points.len()];
    };
    let n = points.len() as f64;
    let mean = mean_distances_mm.iter().sum::<f64>() / n;
    let variance = mean_distances_mm
        .iter()
        .map(|d| (d - mean).powi(2))
        .sum::<f64>()
        / (n - 1.0);
    let limit_mm = mean + std_ratio * variance.sqrt();
    mean_distances_mm.iter().map(|&d| d <= limit_mm).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use flankscope_foundation::random::uniform;

    fn brute_force(points: &[[f64; 3]], k: usize, std_ratio: f64) -> Vec<bool> {
        let distance = |a: &[f64; 3], b: &[f64; 3]| {
            ((a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2) + (a[2] - b[2]).powi(2)).sqrt()
        };
        let means: Vec<f64> = (0..points.len())
            .map(|i| {
                let mut all: Vec<f64> = (0..points.len())
                    .filter(|&j| j != i)
                    .map(|j| distance(&points[i], &points[j]))
                    .collect();
                all.sort_by(f64::total_cmp);
                all[..k].iter().sum::<f64>() / k as f64
            })
            .collect();
        let n = means.len() as f64;
        let mean = means.iter().sum::<f64>() / n;
        let std = (means.iter().map(|m| (m - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
        means.iter().map(|&m| m <= mean + std_ratio * std).collect()
    }

    #[test]
    fn agrees_with_brute_force_and_removes_the_far_points() {
        let mut points: Vec<[f64; 3]> = (0..900)
            .map(|i| std::array::from_fn(|c| 5.0 * uniform(7, 3 * i + c as u64)))
            .collect();
        points.extend([[20.0, 0.0, 0.0], [-9.0, -9.0, 1.0]]);
        // Identical points once broke a k-d tree's split; they must not here.
        points.extend([[1.0, 1.0, 1.0]; 60]);
        for (k, ratio) in [(1, 1.0), (8, 2.0), (20, 2.0)] {
            let keep = statistical(&points, k, ratio);
            assert_eq!(keep, brute_force(&points, k, ratio), "k = {k}");
            assert!(!keep[900] && !keep[901], "k = {k}");
        }
    }

    #[test]
    fn too_few_points_are_kept() {
        assert_eq!(statistical(&[[0.0; 3]; 5], 8, 1.0), [true; 5]);
        assert!(statistical(&[], 8, 1.0).is_empty());
    }
}
