//! Distribution of a grid's columns around a bore.

use std::f64::consts::{PI, TAU};

use crate::gear::GearData;

/// Quantity that the columns divide evenly.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Around {
    /// The angle, from −π to π.
    Angle,
    /// The length of the toothing's profile, from the middle of the space before the first tooth: flanks are steep, and a column
    /// of an angle would be three times as long on them as on a land.
    Profile(Profile),
}

/// Profile of a toothing over the angle: lands, and flanks as straight lines.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Profile {
    teeth: f64,
    first_centre_rad: f64,
    /// From a tooth's centre: where its tip land, its flank and half of the space after it end, rad.
    ends_rad: [f64; 3],
    /// Length of the profile up to there, mm.
    ends_mm: [f64; 3],
}

impl Profile {
    /// Of the gear as drawn, without fillets.
    pub fn for_gear(gear: &GearData) -> Self {
        let half_pitch = 0.5 * gear.pitch_rad();
        let half = |radius_mm| gear.half_tooth_rad(radius_mm).unwrap_or(0.0).max(0.0);
        let tip = half(gear.tip_radius_mm).min(half_pitch);
        let root = half(gear.root_radius_mm).clamp(tip, half_pitch);
        let land_mm = gear.tip_radius_mm * tip;
        let flank_mm = gear.profile_mm(gear.root_radius_mm) - gear.profile_mm(gear.tip_radius_mm);
        let flank_mm = land_mm + flank_mm.abs();
        Self {
            teeth: f64::from(gear.teeth),
            first_centre_rad: gear.tooth_centre_rad(1),
            ends_rad: [tip, root, half_pitch],
            ends_mm: [
                land_mm,
                flank_mm,
                flank_mm + gear.root_radius_mm * (half_pitch - root),
            ],
        }
    }

    /// Length all around, mm.
    pub fn length_mm(&self) -> f64 {
        2.0 * self.teeth * self.ends_mm[2]
    }
}

impl Around {
    /// Share of the way around at an angle, 0 to 1.
    pub(super) fn share(&self, angle_rad: f64) -> f64 {
        let of = match self {
            Self::Angle => return angle_rad / TAU + 0.5,
            Self::Profile(of) => of,
        };
        let pitches = (angle_rad - of.first_centre_rad) * of.teeth / TAU;
        let tooth = pitches.round();
        let off_rad = (pitches - tooth) * TAU / of.teeth;
        let along_mm = between(off_rad.abs(), &of.ends_rad, &of.ends_mm).copysign(off_rad);
        ((tooth + 0.5 + 0.5 * along_mm / of.ends_mm[2]) / of.teeth).rem_euclid(1.0)
    }

    /// Angle at a share of the way around, rad, from −π to π.
    pub(super) fn angle_rad(&self, share: f64) -> f64 {
        let of = match self {
            Self::Angle => return TAU * (share - 0.5),
            Self::Profile(of) => of,
        };
        let teeth = share * of.teeth;
        let off = 2.0 * (teeth.fract() - 0.5);
        let off_rad = between(off.abs() * of.ends_mm[2], &of.ends_mm, &of.ends_rad).copysign(off);
        let angle = of.first_centre_rad + teeth.floor() * TAU / of.teeth + off_rad;
        (angle + PI).rem_euclid(TAU) - PI
    }
}

/// The piecewise linear function through the origin and these places.
fn between(at: f64, places: &[f64; 3], values: &[f64; 3]) -> f64 {
    let (mut from, mut from_value) = (0.0, 0.0);
    for (&to, &value) in places.iter().zip(values) {
        if at <= to && to > from {
            return from_value + (value - from_value) * (at - from) / (to - from);
        }
        (from, from_value) = (to, value);
    }
    from_value
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gear::Flank;
    use crate::gear::tests::ring84;

    #[test]
    fn columns_of_the_profile_are_as_long_as_each_other_and_found_again() {
        let gear = ring84();
        let profile = Profile::for_gear(&gear);
        let around = Around::Profile(profile);
        // Brute force: the length of a flank's curve between the ends of its columns.
        let on = |r: f64| gear.flank_point(5, Flank::Left, r, 0.0).unwrap();
        let n = 20_000;
        let radius = |i: i32| 41.0 + 2.25 * f64::from(i) / f64::from(n);
        let length: f64 = (0..n)
            .map(|i| {
                let (a, b) = (on(radius(i)), on(radius(i + 1)));
                (a[0] - b[0]).hypot(a[1] - b[1])
            })
            .sum();
        let share = |p: [f64; 3]| around.share(p[1].atan2(p[0]));
        let got = (share(on(radius(n))) - share(on(radius(0)))) * profile.length_mm();
        assert!((got - length).abs() < 1e-6, "{got} {length}");
        for i in 0..1000 {
            let share = (f64::from(i) + 0.5) / 1000.0;
            let again = around.share(around.angle_rad(share));
            assert!((again - share).abs() < 1e-9, "{share} {again}");
        }
    }
}
