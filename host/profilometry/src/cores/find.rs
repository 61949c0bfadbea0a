//! The cores of a bundle in a flat-field capture: sub-pixel centres and brightness.

use rayon::prelude::*;

use super::buckets::Buckets;
use super::map::CoreMap;
use crate::accumulate::Accumulator;
use crate::frame::{FrameError, FrameView};
use crate::grid::Grid;

/// Why no cores were found.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FindError {
    /// No frame was added.
    #[error("no flat-field frame: at least one is needed")]
    NoFrame,
    /// Not pixels.
    #[error(
        "the flat field was summed in cells: cores show in single pixels only (pixel grid, binning 1)"
    )]
    Cells,
    /// Too bright.
    #[error(
        "{got} pixels of the flat field are saturated (above {limit_dn} counts), none may be: expose shorter"
    )]
    Saturated {
        /// How many.
        got: usize,
        /// Counts that count as saturated.
        limit_dn: u16,
    },
    /// Too dark.
    #[error(
        "the flat field's bright cores have {got_dn:.1} counts above the dark level, at least {limit_dn} are needed: expose longer, face a white matt target"
    )]
    Dim {
        /// Counts of the 99th percentile.
        got_dn: f64,
        /// Least.
        limit_dn: f64,
    },
    /// Hardly any peaks.
    #[error(
        "{got} cores in the flat field, at least {limit} are needed: is there a bundle, in focus?"
    )]
    Few {
        /// How many.
        got: usize,
        /// Least.
        limit: usize,
    },
    /// Cores too close to tell apart.
    #[error(
        "the cores lie {got_px:.2} px apart, at least {limit_px} px are needed to tell them apart: magnify more, or use the pixel grid"
    )]
    Pitch {
        /// Pitch.
        got_px: f64,
        /// Least.
        limit_px: f64,
    },
    /// The fit did not settle.
    #[error(
        "after {sweeps} sweeps core centres still move by {got_px:.4} px rms, {limit_px} px are needed: is the flat field in focus?"
    )]
    Unsettled {
        /// Sweeps done.
        sweeps: usize,
        /// Last step.
        got_px: f64,
        /// Largest step that counts as settled.
        limit_px: f64,
    },
}

/// Frames of an evenly lit white target, averaged; several take the photon noise out.
#[derive(Clone, Debug)]
pub struct FlatField {
    width: usize,
    height: usize,
    sums: Vec<f32>,
    frames: u32,
    saturated: usize,
    offset_dn: f64,
    saturation_limit_dn: u16,
}

impl FlatField {
    /// For frames of `width` x `height` pixels with `offset_dn` counts in the dark.
    pub fn new(width: usize, height: usize, offset_dn: f64, saturation_limit_dn: u16) -> Self {
        Self {
            width,
            height,
            sums: vec![0.0; width * height],
            frames: 0,
            saturated: 0,
            offset_dn,
            saturation_limit_dn,
        }
    }

    /// The sums of a whole view of an evenly white target: over the steps of a frequency its fringes cancel. The view must
    /// have been summed pixel by pixel.
    ///
    /// # Errors
    /// [`FindError::Cells`] for a view summed otherwise.
    pub fn of_view(view: &Accumulator, offset_dn: f64) -> Result<Self, FindError> {
        let layout = &*view.layout;
        let Grid::Blocks(grid) = &layout.grid else {
            return Err(FindError::Cells);
        };
        if grid.binning != 1 {
            return Err(FindError::Cells);
        }
        let per_exposure: u32 = layout.steps.iter().sum();
        let frames = per_exposure * layout.exposures as u32;
        // Where nothing was summed it counts as dark.
        let dark = (f64::from(frames) * offset_dn) as f32;
        let mut flat = Self {
            sums: vec![dark; layout.width * layout.height],
            frames,
            ..Self::new(
                layout.width,
                layout.height,
                offset_dn,
                layout.saturation_limit_dn,
            )
        };
        for band in &view.bands {
            for row in band.rows.clone() {
                let span = grid.span(row);
                for column in span.begin..span.end {
                    let cell = span.first_cell + column - span.begin - band.first_cell;
                    let sets = (0..layout.steps.len()).map(|set| band.phasor(set, cell));
                    let (mut sum, mut whole) = (0.0, true);
                    for phasor in sets {
                        sum += phasor.sum;
                        whole &= usize::from(phasor.exposures) == layout.exposures;
                    }
                    flat.sums[row * layout.width + column] = sum;
                    flat.saturated += usize::from(!whole);
                }
            }
        }
        Ok(flat)
    }

    /// Adds a frame.
    ///
    /// # Errors
    /// A frame of another size.
    pub fn add(&mut self, frame: FrameView<'_>) -> Result<(), FrameError> {
        frame.check(self.width, self.height)?;
        for (row, sums) in self.sums.chunks_exact_mut(self.width.max(1)).enumerate() {
            for (sum, &pixel) in sums.iter_mut().zip(frame.row(row)) {
                *sum += f32::from(pixel);
                self.saturated += usize::from(pixel > self.saturation_limit_dn);
            }
        }
        self.frames += 1;
        Ok(())
    }

    fn mean(&self) -> Result<Vec<f32>, FindError> {
        if self.frames == 0 {
            return Err(FindError::NoFrame);
        }
        if self.saturated > 0 {
            return Err(FindError::Saturated {
                got: self.saturated,
                limit_dn: self.saturation_limit_dn,
            });
        }
        let (scale, offset) = (1.0 / self.frames as f32, self.offset_dn as f32);
        Ok(self.sums.iter().map(|sum| sum * scale - offset).collect())
    }
}

/// Photon noise at this level still centres a core to 0.02 px.
const LEAST_BRIGHT_DN: f64 = 50.0;
const LEAST_CORES: usize = 7;
/// Closer than this, peaks of neighbouring cores merge for the blur of any relay lens.
const LEAST_PITCH_PX: f64 = 2.8;
/// Peaks below this part of the 99th percentile are halo or noise.
const FAINTEST_RATIO: f32 = 0.05;
/// What the first fit leaves over of a hidden core; noise and pixel response leave a tenth of that.
const HIDDEN_RATIO: f64 = 0.1;
/// All cores step at once, each as if the others stood still: undamped, neighbours would correct the same error twice.
const DAMPING: f64 = 0.6;
/// The common width is coupled to every amplitude.
const WIDTH_DAMPING: f64 = 0.25;
const MAX_SWEEPS: usize = 60;
/// A tenth of what photon noise leaves.
const SETTLED_PX: f64 = 5e-4;

/// Finds every core: peaks first, then centres, brightness and the common width of all cores' images together by least
/// squares (Gauss–Newton, core by core on the residual of all), because neighbouring images overlap.
///
/// # Errors
/// [`FindError`].
pub fn find(flat: &FlatField) -> Result<CoreMap, FindError> {
    let image = flat.mean()?;
    let bright_dn = percentile_99(&image);
    if !(bright_dn >= LEAST_BRIGHT_DN) {
        return Err(FindError::Dim {
            got_dn: bright_dn,
            limit_dn: LEAST_BRIGHT_DN,
        });
    }
    let peaks = peaks(
        &image,
        flat.width,
        flat.height,
        FAINTEST_RATIO * bright_dn as f32,
    );
    let mut map = CoreMap {
        width_px: flat.width as u32,
        height_px: flat.height as u32,
        core_sigma_px: 0.0,
        gains: vec![1.0; peaks.len()],
        positions_px: peaks,
    };
    let few = |got| FindError::Few {
        got,
        limit: LEAST_CORES,
    };
    let pitch = map.pitch_px().ok_or_else(|| few(map.gains.len()))?;
    if !(pitch >= LEAST_PITCH_PX) {
        return Err(FindError::Pitch {
            got_px: pitch,
            limit_px: LEAST_PITCH_PX,
        });
    }
    let mut fit = Fit::new(&image, flat.width, flat.height, &map, pitch);
    fit.settle()?;
    // A dim core close to a bright one is no peak, but what is left when the others are taken away.
    if fit.add_hidden(pitch) > 0 {
        fit.settle()?;
    }
    fit.keep_into(&mut map, pitch);
    if map.gains.len() < LEAST_CORES {
        return Err(few(map.gains.len()));
    }
    Ok(map)
}

fn percentile_99(image: &[f32]) -> f64 {
    let mut sorted = image.to_vec();
    let place = sorted.len() * 99 / 100;
    if sorted.is_empty() {
        return 0.0;
    }
    f64::from(*sorted.select_nth_unstable_by(place, f32::total_cmp).1)
}

/// Pixels brighter than all their neighbours.
fn peaks(image: &[f32], width: usize, height: usize, least: f32) -> Vec<[f64; 2]> {
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

struct Fit<'a> {
    image: &'a [f32],
    width: usize,
    height: usize,
    spots: Vec<Spot>,
    start: Vec<[f64; 2]>,
    sigma: f64,
}

/// What one spot's window says: its step, and its share in the step of the common width.
struct Step {
    amplitude: f64,
    at: [f64; 2],
    width_gradient: f64,
    width_curvature: f64,
}

impl<'a> Fit<'a> {
    fn new(image: &'a [f32], width: usize, height: usize, map: &CoreMap, pitch: f64) -> Self {
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
            for (row, weight) in rows.zip(down) {
                let scale = (spot.amplitude * weight) as f32;
                let pixels = &mut residual[row * self.width..][columns.clone()];
                for (pixel, weight) in pixels.iter_mut().zip(across) {
                    *pixel -= scale * weight as f32;
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
        for (row, down) in rows.zip(down) {
            let y = row as f64 - spot.at[1];
            for (column, across) in columns.clone().zip(across) {
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

    fn settle(&mut self) -> Result<(), FindError> {
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
    fn add_hidden(&mut self, pitch: f64) -> usize {
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
        let middle = amplitudes.len() / 2;
        *amplitudes.select_nth_unstable_by(middle, f64::total_cmp).1
    }

    /// The cores that stayed where their peaks were and do not share their place with a brighter one.
    fn keep_into(&self, map: &mut CoreMap, pitch: f64) {
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
