//! Nonlinear least squares by Levenberg and Marquardt (Marquardt 1963), on the normal equations.

use nalgebra::{DMatrix, DVector};

/// The sum of squared residuals with half its derivatives (the second ones after Gauss and Newton).
pub(crate) struct Normal {
    /// Sum of squares.
    pub cost: f64,
    /// J'J; of it only the lower half counts.
    pub hessian: DMatrix<f64>,
    /// J'r.
    pub gradient: DVector<f64>,
}

impl Normal {
    /// Equations that nothing was added to yet.
    pub fn zero(unknowns: usize) -> Self {
        Self {
            cost: 0.0,
            hessian: DMatrix::zeros(unknowns, unknowns),
            gradient: DVector::zeros(unknowns),
        }
    }

    /// Adds the equations of a part of the observations, whose unknowns stand at `places` here.
    pub fn add(&mut self, share: &Self, places: &[usize]) {
        self.cost += share.cost;
        for (i, &row) in places.iter().enumerate() {
            self.gradient[row] += share.gradient[i];
            for (j, &column) in places[..=i].iter().enumerate() {
                self.hessian[(row.max(column), row.min(column))] += share.hessian[(i, j)];
            }
        }
    }

    /// Adds what is known of an unknown before: that it is `off` from there, with a standard uncertainty.
    pub fn add_prior(&mut self, unknown: usize, off: f64, sigma: f64) {
        self.cost += (off / sigma).powi(2);
        self.gradient[unknown] += off / (sigma * sigma);
        self.hessian[(unknown, unknown)] += 1.0 / (sigma * sigma);
    }
}

/// A sum of squares to minimise. Unknowns are steps from the state that the problem holds.
pub(crate) trait Problem {
    /// Equations about the present state.
    fn normal(&self) -> Normal;
    /// The state after a step, and its sum of squares.
    fn stepped(&self, step: &DVector<f64>) -> (Self, f64)
    where
        Self: Sized;
}

/// Why there is no minimum.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum NoMinimum {
    /// The equations are singular.
    Singular,
    /// No minimum within this number of steps.
    NotSettled(usize),
}

pub(crate) struct Minimum<P> {
    /// The state there.
    pub state: P,
    /// Inverse of J'J: the covariance, for residuals of unit variance.
    pub covariance: DMatrix<f64>,
}

/// Relative improvement below which nothing is gained any more: of ten thousand residuals, a hundredth of one.
pub(crate) const SETTLED: f64 = 1e-6;
const FIRST_DAMPING: f64 = 1e-3;
/// Damped this much, a step is too short to matter.
const MOST_DAMPING: f64 = 1e12;

/// Walks downhill until a step gains no more than the part `settled` of the sum of squares.
pub(crate) fn minimise<P: Problem>(
    start: P,
    max_steps: usize,
    settled: f64,
) -> Result<Minimum<P>, NoMinimum> {
    let mut state = start;
    let mut damping = FIRST_DAMPING;
    for _ in 0..max_steps {
        let normal = state.normal();
        let step = loop {
            let mut damped = normal.hessian.clone();
            for i in 0..damped.nrows() {
                damped[(i, i)] *= 1.0 + damping;
            }
            let solved = damped.cholesky().map(|c| -c.solve(&normal.gradient));
            if let Some(step) = solved.filter(|step| step.iter().all(|x| x.is_finite())) {
                let (next, cost) = state.stepped(&step);
                // Written so that a NaN fails.
                if cost <= normal.cost {
                    break Some((next, cost));
                }
            }
            damping *= 10.0;
            if !(damping < MOST_DAMPING) {
                break None;
            }
        };
        let gain = step.as_ref().map_or(0.0, |(_, cost)| normal.cost - cost);
        if let Some((next, _)) = step {
            state = next;
            damping = (0.1 * damping).max(1e-12);
        } else if normal.hessian.clone().cholesky().is_none() {
            return Err(NoMinimum::Singular);
        }
        if gain <= settled * normal.cost {
            let covariance = state
                .normal()
                .hessian
                .cholesky()
                .ok_or(NoMinimum::Singular)?
                .inverse();
            return Ok(Minimum { state, covariance });
        }
    }
    Err(NoMinimum::NotSettled(max_steps))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rosenbrock's valley as two residuals: minimum at (1, 1), far from the start around a bend.
    #[derive(Clone)]
    struct Valley([f64; 2]);

    impl Problem for Valley {
        fn normal(&self) -> Normal {
            let [x, y] = self.0;
            let jacobian = DMatrix::from_row_slice(2, 2, &[-20.0 * x, 10.0, -1.0, 0.0]);
            let residual = DVector::from_column_slice(&[10.0 * (y - x * x), 1.0 - x]);
            Normal {
                cost: residual.norm_squared(),
                hessian: jacobian.transpose() * &jacobian,
                gradient: jacobian.transpose() * residual,
            }
        }

        fn stepped(&self, step: &DVector<f64>) -> (Self, f64) {
            let next = Self([self.0[0] + step[0], self.0[1] + step[1]]);
            let cost = next.normal().cost;
            (next, cost)
        }
    }

    #[test]
    fn a_bent_valley_is_followed_to_its_end() {
        let found = minimise(Valley([-1.2, 1.0]), 100, SETTLED).ok().unwrap();
        assert!((found.state.0[0] - 1.0).abs() < 1e-6 && (found.state.0[1] - 1.0).abs() < 1e-6);
        // (J'J)^-1 at (1, 1), by hand.
        let by_hand = [1.0, 2.0, 2.0, 4.01];
        for (got, expected) in found.covariance.iter().zip(by_hand) {
            assert!((got - expected).abs() < 1e-4, "{got} {expected}");
        }
    }

    /// Only the sum of two unknowns matters: no minimum to be had.
    #[derive(Clone)]
    struct Flat(f64);

    impl Problem for Flat {
        fn normal(&self) -> Normal {
            Normal {
                cost: self.0 * self.0,
                hessian: DMatrix::from_element(2, 2, 1.0),
                gradient: DVector::from_element(2, self.0),
            }
        }

        fn stepped(&self, step: &DVector<f64>) -> (Self, f64) {
            let next = self.0 + step.sum();
            (Self(next), next * next)
        }
    }

    #[test]
    fn what_is_not_determined_is_said() {
        assert_eq!(
            minimise(Flat(3.0), 100, SETTLED).err(),
            Some(NoMinimum::Singular)
        );
    }
}
