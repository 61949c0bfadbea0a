//! From a phasor to phase, modulation and their uncertainty.
//!
//! With `I_n = A + B cos(phase + TAU n / N)` the phasor `C = sum I_n exp(-j TAU n / N)` is `(N B / 2) exp(j phase)`.
//! N steps let no harmonic through to the phase but those of order m N ± 1.

mod arctangent;
pub mod mask;
pub mod parts;
pub(crate) mod smoothing;

use crate::accumulate::Phasor;
pub(crate) use arctangent::atan2;

/// Conversion of a cell's counts to electrons.
#[derive(Clone, Copy, Debug)]
pub struct CellNoise {
    /// Electrons per count.
    pub gain_e_per_dn: f64,
    /// Counts without light, per pixel.
    pub offset_dn: f64,
    /// Variance without light per pixel and frame.
    pub dark_variance_e2: f64,
    /// Pixels in the cell.
    pub pixels: f64,
}

/// Estimate from a phasor. Electrons are totals over the cell's pixels and the exposures used, per phase step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PhaseEstimate {
    /// Wrapped phase, -PI to PI.
    pub phase_rad: f64,
    /// Its amplitude and mean.
    pub light: LightEstimate,
    /// Predicted standard deviation of the phase.
    pub sigma_rad: f64,
}

/// Modulation and mean of a phasor of `steps` frames, without its phase.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LightEstimate {
    /// Amplitude B.
    pub modulation_e: f64,
    /// Mean A, ambient light included.
    pub mean_e: f64,
}

impl LightEstimate {
    /// From the sums of so many steps.
    #[inline(always)]
    pub fn new(phasor: &Phasor, steps: u32, noise: &CellNoise) -> Self {
        let count = f64::from(steps);
        let (re, im) = (f64::from(phasor.re), f64::from(phasor.im));
        let offset_dn = f64::from(phasor.exposures) * noise.pixels * noise.offset_dn;
        Self {
            // Counts are far from the overflow that `hypot` guards against at ten times the cost.
            modulation_e: 2.0 / count * (re * re + im * im).sqrt() * noise.gain_e_per_dn,
            mean_e: (f64::from(phasor.sum) / count - offset_dn) * noise.gain_e_per_dn,
        }
    }

    /// B / A, 0 for a cell without light.
    #[inline(always)]
    pub fn contrast(&self) -> f64 {
        if self.mean_e > 0.0 {
            self.modulation_e / self.mean_e
        } else {
            0.0
        }
    }
}

/// Phase, modulation, mean and predicted noise of a phasor of `steps` frames.
///
/// The variance is that of a phasor of independent frames with Poisson noise of their own light plus the dark
/// variance: `var = 2 V / (N B^2)` with `V = A + dark variance` for N >= 4 (exact in first order). With three steps
/// the light's own noise follows the fringe: `var = (4 / (9 B^2)) (3/2 V - 3/4 B cos 3 phase)`.
#[inline(always)]
pub fn estimate(phasor: &Phasor, steps: u32, step_sign: f64, noise: &CellNoise) -> PhaseEstimate {
    let light = LightEstimate::new(phasor, steps, noise);
    let LightEstimate {
        modulation_e,
        mean_e,
    } = light;
    let count = f64::from(steps);
    let exposures = f64::from(phasor.exposures);
    let (re, im) = (f64::from(phasor.re), f64::from(phasor.im));
    // Read noise can push the mean of an unlit cell below zero; its variance it cannot.
    let frame_variance_e2 = mean_e.max(0.0) + exposures * noise.pixels * noise.dark_variance_e2;
    let square_e2 = modulation_e * modulation_e;
    let variance = if steps == 3 {
        // cos 3 a = cos a (4 cos^2 a - 3)
        let square = re * re + im * im;
        let cos_of_three = re * (4.0 * re * re - 3.0 * square) / (square * square.sqrt());
        let signal_term = 0.75 * modulation_e * cos_of_three;
        // With more modulation than light (an impossible, noisy cell) the difference could turn negative.
        4.0 / 9.0 * (1.5 * frame_variance_e2 - signal_term).max(0.5 * frame_variance_e2) / square_e2
    } else {
        2.0 * frame_variance_e2 / (count * square_e2)
    };
    PhaseEstimate {
        phase_rad: step_sign * atan2(im, re),
        light,
        sigma_rad: variance.sqrt(),
    }
}

#[cfg(test)]
mod tests {
    use flankscope_test_requisites::Random;

    use super::*;
    use std::f64::consts::TAU;

    const NOISE: CellNoise = CellNoise {
        gain_e_per_dn: 2.0,
        offset_dn: 10.0,
        dark_variance_e2: 30.0,
        pixels: 1.0,
    };

    fn phasor(steps: u32, mut frames: impl FnMut(f64) -> f64) -> Phasor {
        let mut phasor = Phasor {
            exposures: 1,
            ..Phasor::default()
        };
        for n in 0..steps {
            let shift = TAU * f64::from(n) / f64::from(steps);
            let dn = frames(shift);
            phasor.re += (dn * shift.cos()) as f32;
            phasor.im -= (dn * shift.sin()) as f32;
            phasor.sum += dn as f32;
        }
        phasor
    }

    #[test]
    fn every_step_count_returns_what_went_in() {
        for steps in [3, 4, 5, 8] {
            for phase in [-3.0, -1.2, 0.0, 0.7, 3.1] {
                // 500 e mean and 200 e amplitude at 2 e/DN over an offset of 10 DN.
                let phasor = phasor(steps, |shift| {
                    10.0 + (500.0 + 200.0 * (phase + shift).cos()) / 2.0
                });
                let got = estimate(&phasor, steps, 1.0, &NOISE);
                assert!(
                    (got.phase_rad - phase).abs() < 1e-5,
                    "{steps} steps, {phase}: {got:?}"
                );
                assert!(
                    (got.light.modulation_e - 200.0).abs() < 1e-3
                        && (got.light.mean_e - 500.0).abs() < 1e-3
                );
                let backwards = estimate(&phasor, steps, -1.0, &NOISE);
                assert_eq!(backwards.phase_rad, -got.phase_rad);
            }
        }
    }

    /// Spread of phases from frames with noise drawn in the test, against the prediction.
    #[test]
    fn predicted_noise_is_the_spread() {
        let mut random = Random(7);
        let draws = 20_000;
        for steps in [3, 4, 8] {
            for phase in [0.2, 1.1, 2.4] {
                let (mut sum, mut squares, mut predicted) = (0.0, 0.0, 0.0);
                for _ in 0..draws {
                    let noisy = phasor(steps, |shift| {
                        let electrons = 2000.0 + 900.0 * (phase + shift).cos();
                        10.0 + (electrons
                            + random.normal() * (electrons + NOISE.dark_variance_e2).sqrt())
                            / 2.0
                    });
                    let got = estimate(&noisy, steps, 1.0, &NOISE);
                    let error = got.phase_rad - phase;
                    sum += error;
                    squares += error * error;
                    predicted += got.sigma_rad / f64::from(draws);
                }
                let spread = (squares / f64::from(draws) - (sum / f64::from(draws)).powi(2)).sqrt();
                // The spread of n draws is known to 1/sqrt(2 n) = 0.5 %; four of these, plus second order (sigma^2).
                assert!(
                    (spread / predicted - 1.0).abs() < 0.022,
                    "{steps} steps at {phase}: {spread} vs {predicted}"
                );
            }
        }
    }
}
