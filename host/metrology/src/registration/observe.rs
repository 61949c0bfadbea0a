//! Directions of the pose that the points determine, in mm and rad.
//!
//! With rotations scaled by the cloud's arm all six variables are lengths, so an eigenvalue of the information matrix is
//! the inverse square of a standard deviation in mm, and the limit between observed and not is a length as well.

use nalgebra::{Matrix6, SymmetricEigen, Vector6};

use super::WeakDirection;

/// Information (inverse covariance) of the points in its own directions.
#[derive(Debug, Clone)]
pub(super) struct Observability {
    vectors: Matrix6<f64>,
    values: Vector6<f64>,
}

impl Observability {
    /// `information` is symmetric, 1/mm2.
    pub fn new(information: &Matrix6<f64>) -> Self {
        let eigen = SymmetricEigen::new(*information);
        // Rounding leaves tiny values of either sign where there is no information: below 1e-12 of the largest (a
        // millionth in standard deviation) nothing was measured.
        let floor = 1e-12 * eigen.eigenvalues.max();
        Self {
            vectors: eigen.eigenvectors,
            values: eigen.eigenvalues.map(|v| if v > floor { v } else { 0.0 }),
        }
    }

    /// Standard deviation along direction `j`, mm; infinite where nothing is known.
    pub fn sigma_mm(&self, j: usize) -> f64 {
        1.0 / self.values[j].sqrt()
    }

    /// Number of directions with a standard deviation above `limit_mm`.
    pub fn count_above(&self, limit_mm: f64) -> usize {
        (0..6).filter(|&j| self.sigma_mm(j) > limit_mm).count()
    }

    /// The Newton step -(I + damping) \ gradient, without its parts along directions above `limit_mm`.
    pub fn step(&self, gradient: &Vector6<f64>, damping: f64, limit_mm: f64) -> Vector6<f64> {
        let mut step = Vector6::zeros();
        for j in 0..6 {
            if self.sigma_mm(j) <= limit_mm {
                let direction = self.vectors.column(j);
                let along = direction.dot(gradient) / (self.values[j] * (1.0 + damping));
                step -= direction * along;
            }
        }
        step
    }

    /// Covariance, mm2, with `unknown_mm2` along directions without information.
    pub fn covariance(&self, unknown_mm2: f64) -> Matrix6<f64> {
        let variances = self.values.map(|v| {
            if v > 0.0 {
                (1.0 / v).min(unknown_mm2)
            } else {
                unknown_mm2
            }
        });
        self.vectors * Matrix6::from_diagonal(&variances) * self.vectors.transpose()
    }

    /// Directions above `limit_mm`, weakest first, with the share of `prior` in their total information.
    pub fn weak(&self, limit_mm: f64, prior: Option<&Matrix6<f64>>) -> Vec<WeakDirection> {
        let mut weak: Vec<WeakDirection> = (0..6)
            .filter(|&j| self.sigma_mm(j) > limit_mm)
            .map(|j| {
                let direction: Vector6<f64> = self.vectors.column(j).into_owned();
                // The sign of an eigenvector is arbitrary: the largest part is made positive.
                let lead = direction[direction.iamax()];
                let direction = if lead < 0.0 { -direction } else { direction };
                let from_prior = prior.map_or(0.0, |p| direction.dot(&(p * direction)));
                let total = from_prior + self.values[j];
                WeakDirection {
                    // Adding zero turns minus zero into zero, for readers of the file.
                    vector: direction.map(|part| part + 0.0).into(),
                    sigma_mm: self.sigma_mm(j),
                    prior_share: if total > 0.0 { from_prior / total } else { 0.0 },
                }
            })
            .collect();
        weak.sort_by(|a, b| b.sigma_mm.total_cmp(&a.sigma_mm));
        weak
    }
}
