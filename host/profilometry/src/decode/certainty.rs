//! What a depth's uncertainty is worth: a phase that is mostly noise makes no point.

use std::f32::consts::{PI, TAU};

use rayon::prelude::*;

use super::cell::{CellResult, Fate};

/// Largest standard uncertainty of a depth in turns of the finest phase. A phase of noise alone has 0.29 (uniform over the turn).
pub(super) const MAX_TURNS: f32 = 0.1;

/// Standard deviation of a phase from the linear one, amplitude of noise over amplitude of signal.
///
/// The amplitude seen is that of signal and noise together, in the square larger by twice the variance of either part of the phasor:
/// without that, noise alone would pass for a signal of its own size. No phase is less certain than one that is uniform over the turn.
fn phase_sigma_rad(linear_rad: f32) -> f32 {
    let seen = linear_rad * linear_rad;
    let uniform_rad = PI / 3f32.sqrt();
    let signal = 1.0 - 2.0 * seen;
    match signal > 0.0 {
        true => (seen / signal).sqrt().min(uniform_rad),
        false if linear_rad.is_nan() => f32::NAN,
        false => uniform_rad,
    }
}

/// Gives every depth the uncertainty of its phase, and drops those above [`MAX_TURNS`] or the limit.
pub(super) fn keep_certain(results: &mut [CellResult], max_sigma_z_mm: Option<f64>) {
    let limit_mm = max_sigma_z_mm.map_or(f32::INFINITY, |limit| limit as f32);
    let points = results
        .par_iter_mut()
        .filter(|result| result.fate == Fate::Point);
    points.for_each(|result| {
        let linear_rad = result.sigma_z_mm / result.turn_mm * TAU;
        result.sigma_z_mm = phase_sigma_rad(linear_rad) / TAU * result.turn_mm;
        // Written so that a NaN fails.
        let certain =
            result.sigma_z_mm <= limit_mm && result.sigma_z_mm <= MAX_TURNS * result.turn_mm;
        if !certain {
            result.reject(Fate::UncertainDepth);
        }
    });
}

#[cfg(test)]
mod tests {
    use flankscope_test_requisites::Random;

    use super::*;

    /// Phases of signal and noise drawn here, their spread against what the amplitude seen says.
    #[test]
    fn the_spread_of_a_noisy_phase_is_told_from_its_amplitude() {
        let mut random = Random(3);
        let draws = 20_000;
        for (signal, least, most) in [(0.0, 0.95, 1.05), (3.0, 0.9, 1.2), (10.0, 0.98, 1.02)] {
            let (mut squares, mut told) = (0.0, Vec::new());
            for _ in 0..draws {
                let (re, im) = (signal + random.normal(), random.normal());
                squares += im.atan2(re).powi(2);
                let linear_rad = 1.0 / re.hypot(im);
                told.push(f64::from(phase_sigma_rad(linear_rad as f32)));
            }
            told.sort_by(f64::total_cmp);
            let ratio = told[draws / 2] / (squares / draws as f64).sqrt();
            assert!((least..most).contains(&ratio), "{signal}: {ratio}");
        }
        assert!(phase_sigma_rad(f32::NAN).is_nan());
        assert_eq!(phase_sigma_rad(f32::INFINITY), PI / 3f32.sqrt());
    }
}
