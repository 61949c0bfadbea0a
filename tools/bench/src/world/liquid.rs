//! A liquid lens before an objective: its focal power follows a driver, and moves focus, field and pinhole.
//!
//! A thin lens of power `P` stands `d` before the stop of the objective, its axis `c` beside the objective's. A chief ray that the
//! objective sees under the slope `t` crosses it at `d t` and has, before it, the slope `t' = t (1 - d P) + P c`. From outside it
//! comes from a pinhole at `-d P / (1 - d P)` times `(c, d)`, and the objective sees `t = (t' - P c) / (1 - d P)`: another focal
//! length, another principal point. Sharp is what the lens images to where the objective alone is sharp.

use serde::Deserialize;

/// A pair of equal lenses on one driver, one before each objective.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LiquidLens {
    /// What the driver can ask for, dpt: least and most.
    pub range_dpt: [f64; 2],
    /// Counts of the driver that give no power.
    pub zero_counts: f64,
    /// Power of one more.
    pub dpt_per_count: f64,
    /// From the voltage to rest.
    pub settle_ms: u32,
    /// From the lens to the stop of the objective behind it.
    pub apart_mm: f64,
    /// The camera's lens lies this far beside its objective's axis: along columns and rows.
    pub camera_decentre_mm: [f64; 2],
    /// The same of the projector's.
    pub projector_decentre_mm: [f64; 2],
    /// Power gained per kelvin.
    pub drift_dpt_per_kelvin: f64,
    /// Temperature at which the driver's figure is the power.
    pub neutral_celsius: f64,
}

/// How a lens is driven.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Driven {
    /// What the driver is told.
    pub setting_dpt: f64,
    /// How warm the lens is; absent: as the drawing says.
    pub celsius: Option<f64>,
}

/// What an objective behind the lens sees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Refracted {
    /// Slope behind the lens by slope before it.
    pub stretch: f64,
    /// Slope before the lens of what runs along the objective's axis behind it.
    pub bent_rad: [f64; 2],
    /// Where the pinhole appears from outside, in the frame of the objective's.
    pub pinhole_mm: [f64; 3],
}

impl Default for Refracted {
    /// No lens.
    fn default() -> Self {
        Self {
            stretch: 1.0,
            bent_rad: [0.0; 2],
            pinhole_mm: [0.0; 3],
        }
    }
}

impl LiquidLens {
    /// What so many counts of the driver ask for; within the range, beyond which the lens does not follow.
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

    /// Distance from the objective's pinhole of what is sharp; `stand_off_mm` without power.
    pub(super) fn best_focus_mm(&self, stand_off_mm: f64, power_per_mm: f64) -> f64 {
        self.apart_mm + 1.0 / (1.0 / (stand_off_mm - self.apart_mm) + power_per_mm)
    }

    /// What the objective sees through it.
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

    /// Height at `z_mm` of the ray that the stop sees under a slope, after a thin lens: traced, not solved.
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
            // Behind the lens they aim at one point of where the objective alone is sharp.
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
