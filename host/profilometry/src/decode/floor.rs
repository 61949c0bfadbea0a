//! Least modulation at which the fringe order is certain.

use super::DecodeOptions;
use super::cell::FINE_RATIO;
use crate::head::Sensor;
use crate::pattern::PatternSet;
use crate::unwrap::order_step_rad;

/// Least distance of neighbouring orders in standard deviations of a pixel's own dark noise and rounding. Smoothing takes over
/// from there; what of it does not average must not reach half the distance.
const ALONE_SEPARATION: f64 = 5.0;

/// Least amplitude of each frequency in counts per pixel and exposure.
///
/// By default the amplitude at which a pixel's dark noise and rounding alone, unsmoothed, leave neighbouring orders
/// [`ALONE_SEPARATION`] standard deviations apart: `B = sqrt(2 / N) sigma_dark / sigma_phase`.
pub(super) fn floors_dn(
    patterns: &PatternSet,
    options: &DecodeOptions,
    sensor: &Sensor,
) -> Vec<f64> {
    let smoothed = options.smoothing_px > 0.0 || options.coarse_smoothing_px > 0.0;
    if let Some(floor_dn) = options.min_modulation_dn {
        return vec![floor_dn; patterns.sets.len()];
    }
    if !smoothed {
        return vec![0.0; patterns.sets.len()];
    }
    let dark_dn = sensor.dark_variance_e2().sqrt() / sensor.gain_e_per_dn;
    let periods: Vec<f64> = patterns.sets.iter().map(|set| set.periods).collect();
    let others = &periods[..periods.len() - 1];
    let finest = patterns.finest().periods;
    let by_clues_rad = order_step_rad(&periods) / ALONE_SEPARATION;
    let by_turn_rad = std::f64::consts::TAU / ALONE_SEPARATION;
    let beats = others.iter().any(|other| *other > FINE_RATIO * finest);
    let floor_dn = |set: usize| {
        // The finest of a hierarchy is only counted; of high frequencies it is one side of every beat.
        let alone = set == others.len() && !beats;
        let sigma_rad = if alone { by_turn_rad } else { by_clues_rad };
        let steps = f64::from(patterns.sets[set].steps);
        // Without a clue (a single frequency) orders cannot be distinguished.
        if sigma_rad > 0.0 {
            (2.0 / steps).sqrt() * dark_dn / sigma_rad
        } else {
            0.0
        }
    };
    (0..patterns.sets.len()).map(floor_dn).collect()
}
