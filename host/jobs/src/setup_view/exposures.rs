//! Exposures that suit the light of a capture.
//!
//! The response of the sensor is linear, so a level above dark is proportional to the exposure. The short exposure brings the
//! brightest pixels (all but one in ten thousand) to [`FULL`] of the range up to saturation; the long one gives the weakest twentieth
//! of the cells with fringes the modulation that is enough. Cells that saturate in the long exposure are measured by the short one.

use flankscope_protocol::Limits;
use flankscope_record::document::ProposedExposures;

/// Part of the range from dark to saturation that the brightest pixels may fill: the rest is for a die that reflects more.
const FULL: f64 = 0.9;
/// A second exposure is worth its time if it is longer than the first by this factor.
const WORTH: f64 = 1.25;
/// Exposures are whole multiples of this, µs.
const STEP_US: f64 = 100.0;
/// If every exposure saturates, the light is unknown; the next try has this part of the shortest one.
const NEXT_TRY: f64 = 0.25;

/// The light of a capture.
#[derive(Clone, Debug)]
pub struct MeasuredLight {
    /// Level of the dark frame, DN.
    pub dark_dn: f64,
    /// Count above which a pixel is saturated, DN.
    pub saturation_limit_dn: f64,
    /// Every exposure, µs, ascending, and the level there that one pixel in ten thousand exceeds, DN.
    pub bright_dn: Vec<(u32, f64)>,
    /// Amplitude of the finest fringes that the weakest twentieth of the cells does not exceed, DN per pixel and µs.
    pub weak_dn_per_us: Option<f64>,
    /// Amplitude that is enough, DN per pixel.
    pub enough_dn: f64,
}

/// The exposures that suit this light within the controller's limits; `None` if no light was seen at all.
pub fn propose(light: &MeasuredLight, limits: &Limits) -> Option<ProposedExposures> {
    let allowed_us = [limits.exposure_min.get(), limits.exposure_max.get()].map(f64::from);
    let within = |us: f64| us.clamp(allowed_us[0], allowed_us[1]);
    let span_dn = light.saturation_limit_dn - light.dark_dn;
    let unsaturated = light.bright_dn.iter().rev();
    let unsaturated = unsaturated
        .copied()
        .find(|(_, dn)| *dn <= light.saturation_limit_dn);
    let (&(shortest_us, _), mut reasons) = (light.bright_dn.first()?, Vec::new());
    let short_us = match unsaturated {
        Some((_, bright_dn)) if bright_dn <= light.dark_dn => return None,
        Some((at_us, bright_dn)) => {
            let wanted_us = FULL * span_dn * f64::from(at_us) / (bright_dn - light.dark_dn);
            let short_us = within((wanted_us / STEP_US).floor() * STEP_US);
            reasons.push(format!(
                "{} ms bring the brightest pixels to {:.0} DN, saturation begins at {:.0} DN{}",
                milliseconds(short_us),
                light.dark_dn + short_us / f64::from(at_us) * (bright_dn - light.dark_dn),
                light.saturation_limit_dn,
                limited(wanted_us, allowed_us)
            ));
            short_us
        }
        None => {
            let short_us = within((NEXT_TRY * f64::from(shortest_us) / STEP_US).floor() * STEP_US);
            reasons.push(format!(
                "pixels are saturated at every exposure, so how bright they are is not known: try {} ms and look again, or lower \
                 the LED's current",
                milliseconds(short_us)
            ));
            return Some(proposal(&[short_us], reasons, false));
        }
    };
    let Some(weak_dn_per_us) = light.weak_dn_per_us.filter(|rate| *rate > 0.0) else {
        reasons.push("no cell shows fringes, so the long exposure is not known".into());
        return Some(proposal(&[short_us], reasons, false));
    };
    let wanted_us = light.enough_dn / weak_dn_per_us;
    let long_us = within((wanted_us / STEP_US).ceil() * STEP_US);
    if long_us < WORTH * short_us {
        reasons.push(format!(
            "a longer one is not needed: the fringes of the weakest cells have {:.0} DN, {:.0} DN are enough",
            weak_dn_per_us * short_us,
            light.enough_dn
        ));
        return Some(proposal(&[short_us], reasons, true));
    }
    reasons.push(format!(
        "{} ms give the fringes of the weakest cells {:.0} DN, {:.0} DN are enough{}",
        milliseconds(long_us),
        weak_dn_per_us * long_us,
        light.enough_dn,
        limited(wanted_us, allowed_us)
    ));
    Some(proposal(&[short_us, long_us], reasons, true))
}

fn proposal(exposures_us: &[f64], reasons: Vec<String>, is_final: bool) -> ProposedExposures {
    let exposures_us: Vec<u32> = exposures_us.iter().map(|us| us.round() as u32).collect();
    ProposedExposures {
        line: super::head_file::line(&exposures_us),
        exposures_us,
        reasons,
        is_final,
    }
}

fn milliseconds(us: f64) -> f64 {
    us.round() / 1000.0
}

/// Says that a wanted exposure lies outside the controller's limits.
fn limited(wanted_us: f64, [least_us, most_us]: [f64; 2]) -> String {
    if (least_us..=most_us).contains(&wanted_us) {
        return String::new();
    }
    format!(
        "; {:.1} ms would be right, the controller takes {} to {} ms: change the LED's current (station.toml, light)",
        wanted_us / 1000.0,
        milliseconds(least_us),
        milliseconds(most_us)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Levels of a sensor of linear response: `rate` DN per ms above a dark level of 100 DN, up to full scale.
    fn light(rate_dn_per_ms: f64, exposures_us: &[u32], weak_dn_per_ms: f64) -> MeasuredLight {
        let level = |&us: &u32| {
            let dn = 100.0 + rate_dn_per_ms * f64::from(us) / 1000.0;
            (us, dn.min(4095.0))
        };
        MeasuredLight {
            dark_dn: 100.0,
            saturation_limit_dn: 3890.0,
            bright_dn: exposures_us.iter().map(level).collect(),
            weak_dn_per_us: Some(weak_dn_per_ms / 1000.0),
            enough_dn: 40.0,
        }
    }

    fn proposed(light: &MeasuredLight) -> ProposedExposures {
        propose(light, &Limits::DEFAULT).unwrap()
    }

    #[test]
    fn a_linear_sensor_gets_the_exposures_of_the_closed_form() {
        // 0.9 (3890 - 100) / 200 = 17.055 ms, and 40 / 1 = 40 ms.
        for exposures_us in [&[10_000][..], &[5_000, 15_000], &[10_000, 90_000]] {
            let got = proposed(&light(200.0, exposures_us, 1.0));
            assert_eq!(got.exposures_us, [17_000, 40_000], "{exposures_us:?}");
            assert_eq!(got.line, "exposures_us = [17000, 40000]");
            assert!(got.is_final && got.reasons.len() == 2, "{got:?}");
        }
        // Twice the light, half the time.
        let got = proposed(&light(400.0, &[5_000], 2.0));
        assert_eq!(got.exposures_us, [8_500, 20_000]);
    }

    #[test]
    fn one_exposure_is_enough_where_dark_cells_are_bright_enough() {
        let got = proposed(&light(200.0, &[10_000], 10.0));
        assert_eq!(got.exposures_us, [17_000]);
        assert!(got.is_final && got.reasons[1].contains("not needed"));
    }

    #[test]
    fn where_everything_saturates_a_next_try_is_proposed() {
        let got = proposed(&light(2000.0, &[10_000, 20_000], 10.0));
        assert_eq!(got.exposures_us, [2_500]);
        assert!(!got.is_final && got.reasons[0].contains("saturated at every exposure"));
    }

    #[test]
    fn the_controllers_limits_are_kept_and_named() {
        let dim = proposed(&light(5.0, &[10_000], 0.1));
        // 0.9 * 3790 / 5 = 682 ms, and 400 ms: 100 ms is the longest.
        assert_eq!(dim.exposures_us, [100_000]);
        assert!(
            dim.reasons[0].contains("682.2 ms would be right"),
            "{dim:?}"
        );
        let bright = proposed(&light(3789.0, &[1_000], 100.0));
        assert_eq!(bright.exposures_us, [1_000]);
        assert!(bright.reasons[0].contains("the controller takes 1 to 100 ms"));
    }

    #[test]
    fn without_light_nothing_is_proposed() {
        assert_eq!(propose(&light(0.0, &[10_000], 0.0), &Limits::DEFAULT), None);
        let mut smooth = light(200.0, &[10_000], 1.0);
        smooth.weak_dn_per_us = None;
        let got = proposed(&smooth);
        assert!(got.exposures_us == [17_000] && !got.is_final);
    }
}
