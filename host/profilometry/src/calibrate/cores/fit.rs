//! Centres, brightness and the common width of all cores' images together, by least squares.

use flankscope_foundation::order::median;
use rayon::prelude::*;

use super::FindError;
use crate::cells::buckets::Buckets;
use crate::head::CoreMap;

/// Residual of the first fit where a core was missed, relative to its peak; noise and pixel response leave a tenth of that.
const HIDDEN_RATIO: f64 = 0.1;
/// All cores step at once, each as if the others stood still: undamped, neighbours would correct the same error twice.
const DAMPING: f64 = 0.6;
/// The common width is coupled to every amplitude.
const WIDTH_DAMPING: f64 = 0.25;
const MAX_SWEEPS: usize = 60;
/// A tenth of what photon noise leaves.
const SETTLED_PX: f64 = 5e-4;

/// Pixels brighter than all their neighbours.
pub(super) fn peaks(image: &[f32], width: usize, height: usize, least: f32) -> Vec<[f64; 2]> {
    let mut found = Vec::new();
    for row in 1..height.saturating_sub(1) {
        for column in 1..width.saturating_sub(1) {
            let centre = row * width + column;
            let value = image[centre];
            if !(value > least) {
                continue;
            }
            // Of equal neighbours the first in reading order is the peak.
            let before = [
                centre - width - 1,
                centre - width,
                centre - width + 1,
                centre - 1,
            ];
            let after = [
                centre + 1,
                centre + width - 1,
                centre + width,
                centre + width + 1,
            ];
            if before.iter().all(|&other| value > image[other])
                && after.iter().all(|&other| value >= image[other])
            {
                found.push([column as f64, row as f64]);
            }
        }
    }
    found
}

/// One core: `amplitude exp(-r^2 / (2 sigma^2))` about `at`.
#[derive(Clone, Copy, Debug)]
struct Spot {
    at: [f64; 2],
    amplitude: f64,
}

pub(super) struct Fit<'a> {
    image: &'a [f32],
    width: usize,
    height: usize,
    spots: Vec<Spot>,
    start: Vec<[f64; 2]>,
    sigma: f64,
}

/// Result of one spot's window: the step of its own unknowns, and its share in the equations of the common width.
struct Step {
    amplitude: f64,
    at: [f64; 2],
    width_gradient: f64,
    width_curvature: f64,
}

impl<'a> Fit<'a> {
    pub fn new(image: &'a [f32], width: usize, height: usize, map: &CoreMap, pitch: f64) -> Self {
        let spot = |&at: &[f64; 2]| Spot {
            at,
            amplitude: 0.7 * f64::from(image[at[1] as usize * width + at[0] as usize]),
        };
        Self {
            image,
            width,
            height,
            spots: map.positions_px.iter().map(spot).collect(),
            start: map.positions_px.clone(),
            sigma: 0.3 * pitch,
        }
    }

    /// The pixels within `reach` of a spot.
    fn window(&self, at: [f64; 2], reach: f64) -> [std::ops::Range<usize>; 2] {
        let range = |centre: f64, size: usize| {
            let first = (centre.round() - reach).max(0.0) as usize;
            let last = (centre.round() + reach + 1.0).max(0.0) as usize;
            first.min(size)..last.min(size)
        };
        [range(at[0], self.width), range(at[1], self.height)]
    }

    fn profile(&self, range: &std::ops::Range<usize>, centre: f64) -> [f64; 64] {
        let mut profile = [0.0; 64];
        for (value, pixel) in profile.iter_mut().zip(range.clone()) {
            *value = (-0.5 * ((pixel as f64 - centre) / self.sigma).powi(2)).exp();
        }
        profile
    }

    fn residual(&self) -> Vec<f32> {
        let mut residual = self.image.to_vec();
        let reach = (4.0 * self.sigma).ceil().min(31.0);
        for spot in &self.spots {
            let [columns, rows] = self.window(spot.at, reach);
            let across = self.profile(&columns, spot.at[0]);
            let down = self.profile(&rows, spot.at[1]);
            for (row, weight) in rows.zip(&down) {
                let scale = (spot.amplitude * weight) as f32;
                let pixels = &mut residual[row * self.width..][columns.clone()];
                for (pixel, weight) in pixels.iter_mut().zip(&across) {
                    *pixel -= scale * *weight as f32;
                }
            }
        }
        residual
    }

    /// Gauss–Newton on amplitude and centre in the window where this core dominates.
    fn step(&self, spot: &Spot, residual: &[f32]) -> Step {
        let [columns, rows] = self.window(spot.at, (1.5 * self.sigma + 0.5).round().min(31.0));
        let across = self.profile(&columns, spot.at[0]);
        let down = self.profile(&rows, spot.at[1]);
        let mut normal = [[0.0; 3]; 3];
        let mut right = [0.0; 3];
        let (mut width_gradient, mut width_curvature) = (0.0, 0.0);
        let by_sigma2 = 1.0 / (self.sigma * self.sigma);
        for (row, down) in rows.zip(&down) {
            let y = row as f64 - spot.at[1];
            for (column, across) in columns.clone().zip(&across) {
                let x = column as f64 - spot.at[0];
                let shape = across * down;
                let model = spot.amplitude * shape;
                let gradient = [shape, model * x * by_sigma2, model * y * by_sigma2];
                let error = f64::from(residual[row * self.width + column]);
                for i in 0..3 {
                    right[i] += gradient[i] * error;
                    for j in 0..3 {
                        normal[i][j] += gradient[i] * gradient[j];
                    }
                }
                let by_width = model * (x * x + y * y) * by_sigma2 / self.sigma;
                width_gradient += by_width * error;
                width_curvature += by_width * by_width;
            }
        }
        let [amplitude, x, y] = solve(normal, right);
        Step {
            amplitude,
            at: [x, y],
            width_gradient,
            width_curvature,
        }
    }

    pub fn settle(&mut self) -> Result<(), FindError> {
        let mut moved_px = f64::INFINITY;
        for _ in 0..MAX_SWEEPS {
            let residual = self.residual();
            let steps: Vec<Step> = self
                .spots
                .par_iter()
                .map(|spot| self.step(spot, &residual))
                .collect();
            let limit = 0.3 * self.sigma;
            let mut squares = 0.0;
            for (spot, step) in self.spots.iter_mut().zip(&steps) {
                spot.amplitude = (spot.amplitude + DAMPING * step.amplitude).max(0.0);
                for axis in 0..2 {
                    let change = (DAMPING * step.at[axis]).clamp(-limit, limit);
                    spot.at[axis] += change;
                    squares += change * change;
                }
            }
            let gradient: f64 = steps.iter().map(|step| step.width_gradient).sum();
            let curvature: f64 = steps.iter().map(|step| step.width_curvature).sum();
            if curvature > 0.0 {
                let change = (WIDTH_DAMPING * gradient / curvature)
                    .clamp(-0.1 * self.sigma, 0.1 * self.sigma);
                self.sigma = (self.sigma + change).clamp(0.3, 7.0);
            }
            moved_px = (squares / self.spots.len() as f64).sqrt();
            if moved_px < SETTLED_PX {
                return Ok(());
            }
        }
        Err(FindError::Unsettled {
            sweeps: MAX_SWEEPS,
            got_px: moved_px,
            limit_px: SETTLED_PX,
        })
    }

    /// Adds the peaks of what the fit leaves over, well away from all spots; returns how many.
    pub fn add_hidden(&mut self, pitch: f64) -> usize {
        let least = HIDDEN_RATIO * self.median_amplitude();
        let left_over = peaks(&self.residual(), self.width, self.height, least as f32);
        let places: Vec<[f64; 2]> = self.spots.iter().map(|spot| spot.at).collect();
        let buckets = Buckets::new(&places, pitch);
        let apart = |at: &[f64; 2]| {
            buckets.near(*at).all(|other| {
                (places[other][0] - at[0]).hypot(places[other][1] - at[1]) > 0.55 * pitch
            })
        };
        let before = self.spots.len();
        for at in left_over.into_iter().filter(apart) {
            self.start.push(at);
            self.spots.push(Spot {
                at,
                amplitude: least,
            });
        }
        self.spots.len() - before
    }

    fn median_amplitude(&self) -> f64 {
        let mut amplitudes: Vec<f64> = self.spots.iter().map(|spot| spot.amplitude).collect();
        median(&mut amplitudes).unwrap_or(0.0)
    }

    /// The cores that stayed where their peaks were and do not share their place with a brighter one.
    pub fn keep_into(&self, map: &mut CoreMap, pitch: f64) {
        let median = self.median_amplitude();
        let places: Vec<[f64; 2]> = self.spots.iter().map(|spot| spot.at).collect();
        let buckets = Buckets::new(&places, pitch);
        let distance = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
        map.core_sigma_px = self.sigma;
        map.positions_px.clear();
        map.gains.clear();
        for (index, (spot, start)) in self.spots.iter().zip(&self.start).enumerate() {
            let doubled = buckets.near(spot.at).any(|other| {
                let rival = self.spots[other];
                other != index
                    && distance(rival.at, spot.at) < 0.5 * pitch
                    && (rival.amplitude, index) > (spot.amplitude, other)
            });
            let inside = (0.0..self.width as f64).contains(&spot.at[0])
                && (0.0..self.height as f64).contains(&spot.at[1]);
            let gain = spot.amplitude / median;
            // Written so that a NaN fails.
            if !doubled && inside && gain > 0.02 && distance(spot.at, *start) < 0.5 * pitch {
                map.positions_px.push(spot.at);
                map.gains.push(gain as f32);
            }
        }
    }
}

/// Symmetric 3 x 3 by Cramer's rule; no step where the window does not determine one.
fn solve(m: [[f64; 3]; 3], r: [f64; 3]) -> [f64; 3] {
    let minor = |i: usize, j: usize| {
        let [a, b] = [(i + 1) % 3, (i + 2) % 3];
        let [c, d] = [(j + 1) % 3, (j + 2) % 3];
        m[a][c] * m[b][d] - m[a][d] * m[b][c]
    };
    let determinant: f64 = (0..3).map(|j| m[0][j] * minor(0, j)).sum();
    if !(determinant.abs() > 1e-9 * m[0][0] * m[1][1] * m[2][2]) {
        return [0.0; 3];
    }
    std::array::from_fn(|j| (0..3).map(|i| minor(i, j) * r[i]).sum::<f64>() / determinant)
}
