//! A liquid lens in front of an objective: a driver sets its focal power, which shifts focus, field and pinhole.
//!
//! A thin lens of power `P` is at distance `d` in front of the objective's stop, its axis decentred by `c` from the objective's.
//! A chief ray with slope `t` at the objective crosses the lens at `d t`; in front of the lens it has the slope
//! `t' = t (1 - d P) + P c`. Seen from outside, it comes from a pinhole at `-d P / (1 - d P)` times `(c, d)`, and the objective sees
//! `t = (t' - P c) / (1 - d P)`: another focal length and another principal point. Best focus is where the lens forms an image in the
//! best focus of the objective alone.

use serde::Deserialize;

/// A pair of equal lenses on one driver, one before each objective.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LiquidLens {
    /// Range of the driver, dpt: smallest and largest.
    pub range_dpt: [f64; 2],
    /// Counts of the driver at zero power.
    pub zero_counts: f64,
    /// Power per count, dpt.
    pub dpt_per_count: f64,
    /// Settling time after a change of the voltage.
    pub settle_ms: u32,
    /// Distance of the lens from the stop of the objective behind it.
    pub apart_mm: f64,
    /// Decentre of the camera's lens relative to its objective's axis: along columns and rows.
    pub camera_decentre_mm: [f64; 2],
    /// Decentre of the projector's lens relative to its objective's axis: along columns and rows.
    pub projector_decentre_mm: [f64; 2],
    /// Change of power per kelvin.
    pub drift_dpt_per_kelvin: f64,
    /// Temperature at which the power equals the driver's setting.
    pub neutral_celsius: f64,
}

/// Setting and temperature of a lens.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Driven {
    /// Power by the driver's setting.
    pub setting_dpt: f64,
    /// Temperature of the lens; absent: that of the drawing.
    pub celsius: Option<f64>,
}

/// Effect of the lens for the objective behind it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Refracted {
    /// Ratio of the slope behind the lens to that in front of it.
    pub stretch: f64,
    /// Slope in front of the lens of a ray that runs along the objective's axis behind it.
    pub bent_rad: [f64; 2],
    /// Position of the apparent pinhole, in the frame of the objective's.
    pub pinhole_mm: [f64; 3],
}

impl Default for Refracted {
    /// Without a lens.
    fn default() -> Self {
        Self {
            stretch: 1.0,
            bent_rad: [0.0; 2],
            pinhole_mm: [0.0; 3],
        }
    }
}

impl LiquidLens {
    /// Power at these counts of the driver, limited to the range of the lens.
    #[must_use]
    pub fn asked_dpt(&self, counts: u16) -> f64 {
        let [least, most] = self.range_dpt;
        ((f64::from(counts) - self.zero_counts) * self.dpt_per_count).clamp(least, most)
    }

    /// Focal power, 1/mm.
    pub(super) fn power_per_mm(&self, driven: Option<Driven>) -> f64 {
        let setting_dpt = driven.map_or(0.0, |driven| driven.setting_dpt);
        let celsius = driven.and_then(|driven| driven.celsius);
        let warmer = celsius.unwrap_or(self.neutral_celsius) - self.neutral_celsius;
        1e-3 * (setting_dpt + self.drift_dpt_per_kelvin * warmer)
    }

    /// Distance of best focus from the objective's pinhole; `stand_off_mm` without power.
    pub(super) fn best_focus_mm(&self, stand_off_mm: f64, power_per_mm: f64) -> f64 {
        self.apart_mm + 1.0 / (1.0 / (stand_off_mm - self.apart_mm) + power_per_mm)
    }

    /// Its effect for the objective behind it.
    pub(super) fn refracted(&self, power_per_mm: f64, decentre_mm: [f64; 2]) -> Refracted {
        let stretch = 1.0 / (1.0 - self.apart_mm * power_per_mm);
        let back = -self.apart_mm * power_per_mm * stretch;
        let [x, y] = decentre_mm;
        Refracted {
            stretch,
            bent_rad: decentre_mm.map(|mm| power_per_mm * mm),
            pinhole_mm: [back * x, back * y, back * self.apart_mm],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LENS: LiquidLens = LiquidLens {
        range_dpt: [-5.0, 5.0],
        zero_counts: 516.0,
        dpt_per_count: 0.04,
        settle_ms: 150,
        apart_mm: 1.5,
        camera_decentre_mm: [0.03, -0.02],
        projector_decentre_mm: [0.0, 0.0],
        drift_dpt_per_kelvin: 0.05,
        neutral_celsius: 20.0,
    };

    /// Height at `z_mm` of the ray that passes the stop with a slope, after a thin lens: by ray tracing, independent of the formulas above.
    fn traced(slope: f64, start_mm: f64, power_per_mm: f64, beside_mm: f64, z_mm: f64) -> f64 {
        let at_lens_mm = start_mm + LENS.apart_mm * slope;
        let before = slope - power_per_mm * (at_lens_mm - beside_mm);
        at_lens_mm + before * (z_mm - LENS.apart_mm)
    }

    #[test]
    fn chief_rays_meet_the_pinhole_and_the_slope_that_a_trace_gives() {
        for power_per_mm in [-4e-3, 2.5e-3] {
            let through = LENS.refracted(power_per_mm, LENS.camera_decentre_mm);
            for (axis, beside_mm) in LENS.camera_decentre_mm.into_iter().enumerate() {
                for slope in [-0.2, 0.0, 0.1] {
                    let at = |z_mm| traced(slope, 0.0, power_per_mm, beside_mm, z_mm);
                    let before = at(11.0) - at(10.0);
                    let pinhole_mm = at(through.pinhole_mm[2]);
                    assert!((pinhole_mm - through.pinhole_mm[axis]).abs() < 1e-12);
                    let seen = through.stretch * (before - through.bent_rad[axis]);
                    assert!((seen - slope).abs() < 1e-12);
                }
            }
        }
    }

    #[test]
    fn rays_of_the_whole_stop_cross_in_best_focus() {
        let stand_off_mm = 22.0;
        for power_per_mm in [-3e-3, 0.0, 3e-3] {
            let z_mm = LENS.best_focus_mm(stand_off_mm, power_per_mm);
            // Behind the lens, they aim at one point in the best focus of the objective alone.
            let crossing = |start_mm: f64| {
                let slope = (1.0 - start_mm) / stand_off_mm;
                traced(slope, start_mm, power_per_mm, 0.0, z_mm)
            };
            assert!((crossing(0.5) - crossing(-0.5)).abs() < 1e-12);
        }
        assert!(LENS.best_focus_mm(stand_off_mm, 3e-3) < 21.0);
    }

    #[test]
    fn warmth_is_as_good_as_current() {
        let driven = |setting_dpt, celsius| {
            LENS.power_per_mm(Some(Driven {
                setting_dpt,
                celsius,
            }))
        };
        assert_eq!(LENS.power_per_mm(None), 0.0);
        let warm = driven(1.0, Some(40.0));
        assert!((warm - driven(2.0, None)).abs() < 1e-15, "{warm}");
    }
}
