//! Projector coordinates of a point of the board: columns and rows decoded about it, interpolated by a polynomial.
//!
//! On a plane the projector's coordinates follow the camera's by a homography, bent by both lenses; over half a square a quadratic
//! polynomial follows it to thousandths of a pixel. A mean over many pixels averages noise as well as what the edges between black and
//! white do to a phase (Moreno and Taubin 2012).

use flankscope_foundation::order::{SIGMA_PER_MAD, median};
use nalgebra::{Matrix6, Vector6};

use super::image::Grey;
use crate::cloud::CellColumn;

/// Decoded pixels of a whole view: projector columns or rows with the light that they rest on.
pub(super) struct Coordinates<'a> {
    /// One per pixel, row by row.
    pub cells: &'a [CellColumn],
    /// Size of a fringe in the projector: what an order that is wrong is off by, at least.
    pub fringe_px: f64,
}

/// Half the side of the square that is averaged, in distances of points: as far as the board surely reaches.
const REACH: f64 = 0.45;
/// Least pixels with a coordinate, of those asked.
const LEAST_SHARE: f64 = 0.3;
const LEAST_PIXELS: usize = 30;
const ROUNDS: usize = 4;
const OUTLIER: f64 = 3.0;

impl Coordinates<'_> {
    /// The projector's coordinate at a place of the image whose neighbours are `spacing_px` away.
    pub fn at(&self, image: &Grey, place: [f64; 2], spacing_px: f64) -> Option<f64> {
        let reach = REACH * spacing_px;
        let mut asked = 0;
        let mut samples: Vec<(Vector6<f64>, f64, f64)> = Vec::new();
        for [column, row] in image.about(place, reach, 0) {
            asked += 1;
            let cell = &self.cells[row * image.columns + column];
            let Some(coordinate) = cell.column_px else {
                continue;
            };
            let [x, y] = [0, 1].map(|axis| (cell.pixel[axis] - place[axis]) / reach);
            let terms = Vector6::new(1.0, x, y, x * x, x * y, y * y);
            if cell.mean_e > 0.0 {
                samples.push((terms, coordinate, cell.mean_e));
            }
        }
        let enough =
            |count: usize| count >= LEAST_PIXELS && count as f64 >= LEAST_SHARE * f64::from(asked);
        let mut coordinates: Vec<f64> = samples.iter().map(|s| s.1).collect();
        let middle = median(&mut coordinates)?;
        // Half a fringe or what a surface spans, whichever is more, tells a wrong order.
        let mut limit = (0.5 * self.fringe_px).max(2.0 * reach);
        let mut fit = Vector6::new(middle, 0.0, 0.0, 0.0, 0.0, 0.0);
        for _ in 0..ROUNDS {
            let kept: Vec<_> = samples
                .iter()
                .filter(|(terms, value, _)| (value - terms.dot(&fit)).abs() <= limit)
                .collect();
            if !enough(kept.len()) {
                return None;
            }
            let (mut normal, mut right) = (Matrix6::zeros(), Vector6::zeros());
            for (terms, value, weight) in &kept {
                normal += *weight * terms * terms.transpose();
                right += *weight * *value * terms;
            }
            fit = normal.cholesky()?.solve(&right);
            let mut off: Vec<f64> = kept
                .iter()
                .map(|(terms, value, _)| (value - terms.dot(&fit)).abs())
                .collect();
            limit = (OUTLIER * SIGMA_PER_MAD * median(&mut off)?).max(1e-3);
        }
        fit[0].is_finite().then_some(fit[0])
    }
}
