//! Between which radii and heights the standard reads its figures, and which points lie on a flank there.
//!
//! ```text
//!  root circle   control radius r_Cf                    95 %   tip form radius r_Fa   tip circle r_a
//!  |-- fillet --|------------ evaluated: mean line, ranges ----|------ not read ------|-- edge --|
//!               |------------ f_H_alpha: the mean line, extrapolated -----------------|--------->|
//! ```

use serde::Serialize;

use super::{EvaluationSettings, PointNearFlank};
use crate::gear::{Flank, GearData};
use flankscope_foundation::normal::guard_factor;

/// Of the roll length from control radius to tip form radius this much is evaluated, from the root end on: tips are rounded.
const EVALUATED_SHARE: f64 = 0.95;
/// Share of the face width, and share of the module, that is left out at either end of a helix: the smaller counts.
const END_SHARES: [f64; 2] = [0.05, 1.0];
/// Within this many standard uncertainties of tip or root circle a point may be the land's: 1 in 16 000 of its points lies
/// farther off.
const LAND_SIGMAS: f64 = 4.0;

/// Radii and heights between which figures are evaluated.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct EvaluationRange {
    /// Profile control radius: the root end of what must conform, mm.
    pub control_radius_mm: f64,
    /// Tip form radius: the tip end of the flank, where its edge begins, mm.
    pub tip_form_radius_mm: f64,
    /// Radius at which the evaluated part of the profile ends, mm.
    pub evaluated_to_radius_mm: f64,
    /// Radii between which the profile slope is stated, root end first, mm: control and tip radius, unless chosen.
    pub slope_radii_mm: [f64; 2],
    /// Heights between which the helix is evaluated, mm; its slope is stated over the whole face width.
    pub helix_heights_mm: [f64; 2],
    /// Within this distance of tip and root circle no point counts as flank, mm.
    pub land_strip_mm: f64,
}

impl EvaluationRange {
    pub(super) fn new(gear: &GearData, settings: &EvaluationSettings) -> Self {
        let [control_radius_mm, tip_form_radius_mm] = root_first(gear, settings.usable_mm);
        let slope = settings
            .slope_mm
            .unwrap_or([control_radius_mm, gear.tip_radius_mm]);
        let (from, to) = (
            roll_mm(gear, control_radius_mm),
            roll_mm(gear, tip_form_radius_mm),
        );
        let evaluated = from + EVALUATED_SHARE * (to - from);
        let [low, high] = gear.height_mm;
        let strip = LAND_SIGMAS * settings.u_mm();
        let end = (END_SHARES[0] * (high - low))
            .min(END_SHARES[1] * gear.module_mm)
            .max(strip);
        Self {
            control_radius_mm,
            tip_form_radius_mm,
            evaluated_to_radius_mm: evaluated.hypot(gear.base_radius_mm()),
            slope_radii_mm: root_first(gear, slope),
            helix_heights_mm: [low + end, high - end],
            land_strip_mm: strip,
        }
    }

    /// The flank that a point lies on. Points of end faces, of lands and beyond the usable radii lie on none: wherever such
    /// a surface comes near to a flank, a strip is left out.
    pub(super) fn flank_point(
        &self,
        gear: &GearData,
        point: [f64; 3],
        capture_mm: f64,
    ) -> Option<((u32, Flank), PointNearFlank)> {
        let radius = point[0].hypot(point[1]);
        let (a, b) = (self.control_radius_mm, self.tip_form_radius_mm);
        let on_land = [gear.tip_radius_mm, gear.root_radius_mm]
            .iter()
            .any(|land| (radius - land).abs() < self.land_strip_mm);
        let [low, high] = self.helix_heights_mm;
        if on_land || !(a.min(b)..=a.max(b)).contains(&radius) || !(low..=high).contains(&point[2])
        {
            return None;
        }
        let angle = point[1].atan2(point[0]);
        let tooth = gear.tooth_at(angle);
        // In a space the nearer tooth is the one whose flank is nearer, on the side that the angle says.
        let (flank, deviation_mm) = Flank::BOTH
            .into_iter()
            .filter_map(|flank| Some((flank, gear.involute_deviation_mm(tooth, flank, point)?)))
            .min_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))?;
        if deviation_mm.abs() > capture_mm {
            return None;
        }
        let place = PointNearFlank {
            roll_mm: roll_mm(gear, radius),
            height_mm: point[2],
            deviation_mm,
        };
        Some(((tooth, flank), place))
    }
}

/// One standard uncertainty of a figure that is stated with 95 % (both sides).
pub(super) fn standard_of_u95(u95: f64) -> f64 {
    u95 / guard_factor(0.975)
}

/// Roll length at a radius, mm.
pub(super) fn roll_mm(gear: &GearData, radius_mm: f64) -> f64 {
    let base = gear.base_radius_mm();
    (radius_mm * radius_mm - base * base).max(0.0).sqrt()
}

/// Two radii, that nearer to the root first.
fn root_first(gear: &GearData, [a, b]: [f64; 2]) -> [f64; 2] {
    let root = gear.root_radius_mm;
    if (a - root).abs() < (b - root).abs() {
        [a, b]
    } else {
        [b, a]
    }
}
