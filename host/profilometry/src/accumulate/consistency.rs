//! Test whether a cell's frames follow one sinusoid within their noise.
//!
//! N frames of a fringe have three unknowns; the residual has N - 3 degrees of freedom and, divided by the predicted
//! variance of a frame, follows a chi-square distribution. Vibration between the frames, a flickering lamp and saturation too
//! short to reach the limit all enlarge it. Interreflections do not: two sinusoids of one frequency
//! add up to one sinusoid, with another phase, which only a comparison of frequencies could show.
//!
//! The residual is the sum of squares about the first frame (small numbers, so that single precision suffices) less the part
//! explained by mean and phasor.

use flankscope_foundation::normal::guard_factor;

/// Limits of the test of a cell's frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConsistencyOptions {
    /// A cell whose chi-square would be exceeded by noise alone with less than this probability is dropped; with 0 none is, and
    /// the scatter of the frames is measured only.
    pub least_probability: f64,
    /// Standard deviation of lamp and response from frame to frame, relative to the light, beside shot and read noise.
    pub response_ratio: f64,
    /// Whether cells are compared with the median of their view where that exceeds the predicted noise: for frames of instruments
    /// whose noise is known less well than that of their sensor. The instrument's own frames must keep to the prediction, since
    /// larger scatter means vibration.
    pub relative_to_view: bool,
}

impl ConsistencyOptions {
    /// One good cell in a thousand is lost; lamp noise of 0.1 % and fibres that bend the fringe by as much are no fault.
    pub const INSTRUMENT: Self = Self {
        least_probability: 1e-3,
        response_ratio: 1.5e-3,
        relative_to_view: false,
    };

    /// For images from other instruments, where noise alone drops a cell with this probability; 0 drops none.
    pub fn for_images(least_probability: f64) -> Self {
        Self {
            least_probability,
            relative_to_view: true,
            ..Self::INSTRUMENT
        }
    }
}

/// Standard deviation of one frame of one cell, counts.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FrameNoise {
    /// Counts without light.
    pub offset_dn: f32,
    /// Variance without light.
    pub dark_variance_dn2: f32,
    /// Variance per count of light.
    pub variance_per_dn: f32,
    /// See [`ConsistencyOptions::response_ratio`].
    pub response_ratio: f32,
}

/// Sums of one frequency and exposure, cell by cell.
#[derive(Clone, Copy)]
pub(crate) struct Sums<'a> {
    pub re: &'a [f32],
    pub im: &'a [f32],
    pub sum: &'a [f32],
    /// The first frame.
    pub first: &'a [f32],
    /// Squares of the others' differences to it.
    pub squares: &'a [f32],
}

/// Adds a frame to the squares.
#[inline(always)]
pub(crate) fn deviate(values: &[f32], first: &[f32], squares: &mut [f32]) {
    for ((&value, &first), square) in values.iter().zip(first).zip(squares) {
        let off = value - first;
        *square += off * off;
    }
}

/// Adds the chi-square of one exposure, cell by cell, unless it was saturated (its sum is then infinite).
#[inline(always)]
pub(crate) fn add_chi_square(
    sums: Sums<'_>,
    steps: u32,
    noise: &FrameNoise,
    first_exposure: bool,
    into: &mut [f32],
) {
    let count = steps as f32;
    if first_exposure {
        into.fill(0.0);
    }
    for (i, into) in into.iter_mut().enumerate() {
        let mean = sums.sum[i] / count;
        let off = mean - sums.first[i];
        let fringe = 2.0 / count * (sums.re[i] * sums.re[i] + sums.im[i] * sums.im[i]);
        let left = sums.squares[i] - count * off * off - fringe;
        let light = (mean - noise.offset_dn).max(0.0);
        let response = noise.response_ratio * light;
        let variance =
            noise.dark_variance_dn2 + noise.variance_per_dn * light + response * response;
        *into += if mean.is_finite() {
            left.max(0.0) / variance
        } else {
            0.0
        };
    }
}

/// The chi-square that noise alone exceeds with a probability, for degrees of freedom from 0 (Wilson and Hilferty 1931: to
/// 1 % at two degrees and more, 4 % at one).
pub(crate) fn limits(probability: f64, most: usize) -> Vec<f32> {
    if probability == 0.0 {
        return vec![f32::INFINITY; most + 1];
    }
    let z = guard_factor(1.0 - probability);
    let limit = |dof: usize| {
        if dof == 0 {
            return f32::INFINITY;
        }
        let spread = 2.0 / (9.0 * dof as f64);
        (dof as f64 * (1.0 - spread + z * spread.sqrt()).powi(3)) as f32
    };
    (0..=most).map(limit).collect()
}

/// Median of chi-square (Wilson and Hilferty).
pub(crate) fn median(freedom: usize) -> f64 {
    let freedom = freedom as f64;
    freedom * (1.0 - 2.0 / (9.0 * freedom)).powi(3)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// For even degrees of freedom the tail is a finite sum.
    #[test]
    fn the_limit_is_exceeded_as_often_as_asked() {
        for probability in [0.05, 1e-3] {
            let limits = limits(probability, 20);
            assert_eq!(
                limits[0],
                f32::INFINITY,
                "three steps leave nothing to test"
            );
            for dof in (2..=20).step_by(2) {
                let half = 0.5 * f64::from(limits[dof]);
                let (mut term, mut sum) = (1.0, 0.0);
                for k in 0..dof / 2 {
                    sum += term;
                    term *= half / (k as f64 + 1.0);
                }
                let tail = (-half).exp() * sum;
                assert!((tail / probability - 1.0).abs() < 0.15, "{dof}: {tail}");
            }
        }
    }

    #[test]
    fn a_frame_out_of_step_is_left_over() {
        let noise = FrameNoise {
            offset_dn: 100.0,
            dark_variance_dn2: 10.0,
            variance_per_dn: 0.1,
            response_ratio: 0.0,
        };
        let chi_square = |wrong_dn: f64| {
            let frames: Vec<f32> = (0..8)
                .map(|n| {
                    let shift = std::f64::consts::TAU * f64::from(n) / 8.0;
                    let extra = if n == 3 { wrong_dn } else { 0.0 };
                    (1_100.0 + 400.0 * (0.7 + shift).cos() + extra) as f32
                })
                .collect();
            let part = |f: fn(f64) -> f64| -> f32 {
                let term = |(n, &dn): (usize, &f32)| {
                    f64::from(dn) * f(std::f64::consts::TAU * n as f64 / 8.0)
                };
                frames.iter().enumerate().map(term).sum::<f64>() as f32
            };
            let mut squares = [0.0];
            for dn in &frames {
                deviate(&[*dn], &frames[..1], &mut squares);
            }
            let mut into = [7.0];
            let sums = Sums {
                re: &[part(f64::cos)],
                im: &[part(|x| -x.sin())],
                sum: &[frames.iter().sum()],
                first: &frames[..1],
                squares: &squares,
            };
            add_chi_square(sums, 8, &noise, true, &mut into);
            f64::from(into[0])
        };
        assert!(chi_square(0.0) < 0.01);
        // The fit absorbs 3/8 of one frame's error; the variance is 10 + 0.1 x 1000, and a little of the error.
        let expected = 60.0 * 60.0 * 0.625 / (110.0 + 0.1 * 60.0 / 8.0);
        assert!((chi_square(60.0) / expected - 1.0).abs() < 1e-3);
    }
}
