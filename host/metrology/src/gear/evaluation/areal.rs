//! The deviations of a whole flank as a few smooth terms and what they leave.

use nalgebra::{Matrix6, Vector6};
use serde::Serialize;

/// Legendre terms over the flank: u runs from -1 at the root end to 1 at the tip end of the profile, v from -1 to 1 with the
/// height; um.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ArealTerms {
    /// Thickness.
    pub c00_um: f64,
    /// Profile slope: rise from the middle to the tip end.
    pub c10_um: f64,
    /// Helix slope: rise from the middle to the upper end.
    pub c01_um: f64,
    /// Profile crowning.
    pub c20_um: f64,
    /// Twist.
    pub c11_um: f64,
    /// Helix crowning.
    pub c02_um: f64,
    /// Root mean square of what the terms leave: noise, waviness, and where wear is local, wear.
    pub residual_um: f64,
    /// Points that went in.
    pub points: usize,
}

/// Fits the terms to (u, v, deviation in mm); none when the points do not fix them.
pub fn terms(points: &[(f64, f64, f64)]) -> Option<ArealTerms> {
    let row = |u: f64, v: f64| {
        let second = |x: f64| 0.5 * (3.0 * x * x - 1.0);
        Vector6::new(1.0, u, v, second(u), u * v, second(v))
    };
    let (mut information, mut gradient) = (Matrix6::<f64>::zeros(), Vector6::<f64>::zeros());
    for &(u, v, deviation) in points {
        let row = row(u, v);
        information += row * row.transpose();
        gradient += row * deviation;
    }
    let count = points.len() as f64;
    let eigen = nalgebra::SymmetricEigen::new(information / count.max(1.0));
    // An even cover gives 1 for the first and 1/9 for the twist; below a hundredth of that a term is a guess.
    if points.len() < 12 || eigen.eigenvalues.min() < 1e-3 {
        return None;
    }
    let c = information.cholesky()?.solve(&gradient);
    let rest: f64 = points
        .iter()
        .map(|&(u, v, deviation)| (deviation - row(u, v).dot(&c)).powi(2))
        .sum();
    Some(ArealTerms {
        c00_um: 1e3 * c[0],
        c10_um: 1e3 * c[1],
        c01_um: 1e3 * c[2],
        c20_um: 1e3 * c[3],
        c11_um: 1e3 * c[4],
        c02_um: 1e3 * c[5],
        residual_um: 1e3 * (rest / count).sqrt(),
        points: points.len(),
    })
}
