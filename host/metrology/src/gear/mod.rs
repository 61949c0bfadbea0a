//! Gear geometry: which flank a point lies on, where on it, and the involute in closed form.
//!
//! Spur gears about z. Tooth k (from 1) has its centre at [`GearData::tooth_centre_rad`]; its *left* flank is the one on the
//! side of increasing angle (counter-clockwise seen from +z), its *right* flank the other.

pub mod evaluation;

use std::f64::consts::{PI, TAU};

/// Depth to which a point counts for a tip or root land, modules.
pub const LAND_DEPTH_MODULES: f64 = 0.05;

/// On which side of the pitch circle the teeth point.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum GearKind {
    /// Teeth point inwards, material at larger radius.
    Internal,
    /// Teeth point outwards.
    External,
}

/// Cylindrical face between two flanks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Land {
    /// End of a tooth.
    Tip,
    /// Bottom of a space.
    Root,
}

/// A tooth's side, or the only one of what is no tooth.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Deserialize, serde::Serialize,
)]
#[serde(rename_all = "lowercase")]
pub enum Flank {
    /// Towards increasing angle.
    Left,
    /// Towards decreasing angle.
    Right,
    /// A patch's only side.
    Face,
}

impl Flank {
    /// Both of a tooth, in a fixed order.
    pub const BOTH: [Self; 2] = [Self::Left, Self::Right];

    /// +1 for left, -1 for right: the sign of the angle from the tooth's centre. A face has none.
    pub fn sign(self) -> f64 {
        match self {
            Self::Left => 1.0,
            Self::Right => -1.0,
            Self::Face => 0.0,
        }
    }

    /// Its word in files.
    pub fn word(self) -> &'static str {
        match self {
            Self::Left => "left",
            Self::Right => "right",
            Self::Face => "face",
        }
    }
}

impl std::str::FromStr for Flank {
    type Err = serde::de::value::Error;

    fn from_str(word: &str) -> Result<Self, Self::Err> {
        use serde::{Deserialize, de::IntoDeserializer};
        Self::deserialize(word.into_deserializer())
    }
}

impl std::fmt::Display for Flank {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.word())
    }
}

/// The gear as its drawing states it.
#[derive(Debug, Clone, PartialEq, serde::Deserialize, serde::Serialize)]
#[serde(deny_unknown_fields)]
pub struct GearData {
    /// Internal or external.
    pub kind: GearKind,
    /// Number of teeth.
    pub teeth: u32,
    /// Module, mm.
    pub module_mm: f64,
    /// Pressure angle at the pitch circle, degrees.
    pub pressure_angle_deg: f64,
    /// Radius of the tooth tips, mm.
    pub tip_radius_mm: f64,
    /// Radius of the roots, mm.
    pub root_radius_mm: f64,
    /// Angle of the centre of tooth 1, degrees; the others follow counter-clockwise.
    pub first_tooth_centre_deg: f64,
    /// Lower and upper end of the toothing, mm.
    pub height_mm: [f64; 2],
    /// Points farther from the axis than this are not toothing, mm.
    #[serde(default = "default_radial_threshold")]
    pub radial_threshold_mm: f64,
}

fn default_radial_threshold() -> f64 {
    50.0
}

/// Gear data that contradict themselves.
#[derive(Debug, thiserror::Error, PartialEq)]
#[non_exhaustive]
pub enum GearError {
    /// A value out of its range.
    #[error("gear.{key} = {value} is out of range; right would be {least} to {most}")]
    Range {
        /// Key in the tool file.
        key: &'static str,
        /// The value.
        value: f64,
        /// Least accepted.
        least: f64,
        /// Most accepted.
        most: f64,
    },
    /// Radii in the wrong order.
    #[error(
        "gear radii are out of order: tip {tip_mm}, pitch {pitch_mm} (module x teeth / 2), root {root_mm} mm; right would be {order}"
    )]
    Radii {
        /// Tip radius.
        tip_mm: f64,
        /// Pitch radius.
        pitch_mm: f64,
        /// Root radius.
        root_mm: f64,
        /// Right order.
        order: &'static str,
    },
}

/// A place on a flank, or on a patch ([`crate::feature`]).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FlankPlace {
    /// Tooth or patch, from 1.
    pub tooth: u32,
    /// Side.
    pub flank: Flank,
    /// Distance from the axis, mm; of a patch, the length along it.
    pub radius_mm: f64,
    /// Length along the involute from the base circle, mm; of a patch, along it from its origin.
    pub profile_mm: f64,
    /// Height, mm; of a patch, up from its origin.
    pub height_mm: f64,
}

impl GearData {
    /// Checks ranges and order of the data.
    ///
    /// # Errors
    /// [`GearError`] with the key, the value and what would be right.
    pub fn check(&self) -> Result<(), GearError> {
        let within = |key, value: f64, least: f64, most: f64| {
            if (least..=most).contains(&value) {
                Ok(())
            } else {
                Err(GearError::Range {
                    key,
                    value,
                    least,
                    most,
                })
            }
        };
        within("teeth", f64::from(self.teeth), 3.0, 1000.0)?;
        within("module_mm", self.module_mm, 0.05, 100.0)?;
        within("pressure_angle_deg", self.pressure_angle_deg, 5.0, 45.0)?;
        within("tip_radius_mm", self.tip_radius_mm, 0.1, 5000.0)?;
        within("root_radius_mm", self.root_radius_mm, 0.1, 5000.0)?;
        within(
            "first_tooth_centre_deg",
            self.first_tooth_centre_deg,
            -360.0,
            360.0,
        )?;
        within("height_mm[0]", self.height_mm[0], -5000.0, 5000.0)?;
        within("height_mm[1]", self.height_mm[1], self.height_mm[0], 5000.0)?;
        let (tip_mm, pitch_mm, root_mm) = (
            self.tip_radius_mm,
            self.pitch_radius_mm(),
            self.root_radius_mm,
        );
        let (ordered, order) = match self.kind {
            GearKind::Internal => (
                tip_mm < pitch_mm && pitch_mm < root_mm,
                "tip < pitch < root (internal)",
            ),
            GearKind::External => (
                root_mm < pitch_mm && pitch_mm < tip_mm,
                "root < pitch < tip (external)",
            ),
        };
        if !ordered {
            return Err(GearError::Radii {
                tip_mm,
                pitch_mm,
                root_mm,
                order,
            });
        }
        // No flank may lie beyond it: points there do not count as toothing.
        let [_, flank_end_mm] = self.active_flank_mm();
        within(
            "radial_threshold_mm",
            self.radial_threshold_mm,
            flank_end_mm.max(0.1),
            5000.0,
        )
    }

    /// Whether a place lies in the toothing: between tip and root circle, and more than 0.1 mm within its ends.
    pub fn is_toothing(&self, [x, y, z]: [f64; 3]) -> bool {
        const END_MM: f64 = 0.1;
        let radius_mm = x.hypot(y);
        let [low, high] = self.height_mm;
        let within = self.tip_radius_mm.min(self.root_radius_mm)
            ..=self.tip_radius_mm.max(self.root_radius_mm);
        within.contains(&radius_mm) && low + END_MM < z && z < high - END_MM
    }

    /// Pitch radius, mm.
    pub fn pitch_radius_mm(&self) -> f64 {
        0.5 * self.module_mm * f64::from(self.teeth)
    }

    /// Base circle radius, mm.
    pub fn base_radius_mm(&self) -> f64 {
        self.pitch_radius_mm() * self.pressure_angle_deg.to_radians().cos()
    }

    /// Angle from tooth to tooth, rad.
    pub fn pitch_rad(&self) -> f64 {
        TAU / f64::from(self.teeth)
    }

    /// Angle of the centre of tooth `tooth` (from 1), rad.
    pub fn tooth_centre_rad(&self, tooth: u32) -> f64 {
        self.first_tooth_centre_deg.to_radians() + (f64::from(tooth) - 1.0) * self.pitch_rad()
    }

    /// Angle from the centre of a tooth, rad, within half a turn.
    pub(crate) fn beside_tooth_centre_rad(&self, tooth: u32, angle_rad: f64) -> f64 {
        wrapped(angle_rad - self.tooth_centre_rad(tooth))
    }

    /// The tooth whose centre is nearest to an angle.
    pub fn tooth_at(&self, angle_rad: f64) -> u32 {
        let pitches = (angle_rad - self.tooth_centre_rad(1)) / self.pitch_rad();
        1 + (pitches.round() as i64).rem_euclid(i64::from(self.teeth)) as u32
    }

    /// Half the angle that a tooth's material covers at a radius, rad. Tooth and space are equal at the pitch circle; none
    /// inside the base circle, where there is no involute.
    pub fn half_tooth_rad(&self, radius_mm: f64) -> Option<f64> {
        let pressure_rad = self.pressure_angle_deg.to_radians();
        let rise =
            involute(self.base_radius_mm() / radius_mm)? - (pressure_rad.tan() - pressure_rad);
        let at_pitch = PI / (2.0 * f64::from(self.teeth));
        Some(match self.kind {
            // The tooth of an internal gear is the space of an external one: it widens outwards.
            GearKind::Internal => at_pitch + rise,
            GearKind::External => at_pitch - rise,
        })
    }

    /// The point of a flank's involute at a radius and height, mm.
    pub fn flank_point(
        &self,
        tooth: u32,
        flank: Flank,
        radius_mm: f64,
        height_mm: f64,
    ) -> Option<[f64; 3]> {
        let angle = self.tooth_centre_rad(tooth) + flank.sign() * self.half_tooth_rad(radius_mm)?;
        Some([radius_mm * angle.cos(), radius_mm * angle.sin(), height_mm])
    }

    /// Radius at which the involute is so long from the base circle, mm.
    pub fn radius_mm(&self, profile_mm: f64) -> f64 {
        let base = self.base_radius_mm();
        (base * (base + 2.0 * profile_mm)).max(0.0).sqrt()
    }

    /// Normal of a flank's involute at a place on it, out of the material: the gradient of
    /// [`Self::involute_deviation_mm`].
    pub fn flank_normal(&self, flank: Flank, point: [f64; 3]) -> [f64; 3] {
        let radius = point[0].hypot(point[1]);
        let cos = (self.base_radius_mm() / radius).min(1.0);
        let along = flank.sign() * cos;
        let out = match self.kind {
            GearKind::Internal => -1.0,
            GearKind::External => 1.0,
        } * (1.0 - cos * cos).sqrt();
        let [x, y] = [point[0] / radius, point[1] / radius];
        [out * x - along * y, out * y + along * x, 0.0]
    }

    /// Distance of a point from a flank's involute along the normal, mm; positive outside the material.
    ///
    /// Exact, because curves at a constant distance from an involute are involutes of the same base circle: turning the
    /// involute by an angle moves it by that angle times the base radius along every normal.
    pub fn involute_deviation_mm(&self, tooth: u32, flank: Flank, point: [f64; 3]) -> Option<f64> {
        let radius = point[0].hypot(point[1]);
        let from_centre = self.beside_tooth_centre_rad(tooth, point[1].atan2(point[0]));
        let beyond = flank.sign() * from_centre - self.half_tooth_rad(radius)?;
        Some(self.base_radius_mm() * beyond)
    }

    /// Flank of a surface point with outward `normal`, and its place there. None on tip and root lands, end faces and
    /// beyond the radial threshold.
    pub fn place(&self, point: [f64; 3], normal: [f64; 3]) -> Option<FlankPlace> {
        let radius_mm = point[0].hypot(point[1]);
        let across = (point[0] * normal[1] - point[1] * normal[0]) / radius_mm;
        // Flank normals are within the pressure angle of the tangent, lands across it: 45 degrees tells them apart.
        if across.abs() < std::f64::consts::FRAC_1_SQRT_2
            || radius_mm > self.radial_threshold_mm
            || radius_mm < self.base_radius_mm()
        {
            return None;
        }
        Some(FlankPlace {
            tooth: self.tooth_at(point[1].atan2(point[0])),
            flank: if across > 0.0 {
                Flank::Left
            } else {
                Flank::Right
            },
            radius_mm,
            profile_mm: self.profile_mm(radius_mm),
            height_mm: point[2],
        })
    }

    /// Radii between which the flank works, mm: from a tenth of a module behind the tip to three quarters of a module
    /// beyond the pitch circle; the smaller first.
    pub fn active_flank_mm(&self) -> [f64; 2] {
        let (tip, pitch, module) = (self.tip_radius_mm, self.pitch_radius_mm(), self.module_mm);
        match self.kind {
            GearKind::Internal => [tip + 0.1 * module, pitch + 0.75 * module],
            GearKind::External => [pitch - 0.75 * module, tip - 0.1 * module],
        }
    }

    /// The land on whose middle half a point lies, as far as its radius and angle tell: there, neither a worn flank nor a rounding
    /// beside the land changes it.
    pub fn middle_of_land(&self, [x, y, _]: [f64; 3]) -> Option<Land> {
        let radius = x.hypot(y);
        let outside = |of_land: f64, other: f64| {
            (radius - of_land) * (of_land - other).signum() >= -LAND_DEPTH_MODULES * self.module_mm
        };
        let (tip, root) = (self.tip_radius_mm, self.root_radius_mm);
        let (land, at) = match (outside(tip, root), outside(root, tip)) {
            (true, _) => (Land::Tip, tip),
            (_, true) => (Land::Root, root),
            (false, false) => return None,
        };
        let angle = y.atan2(x);
        let off = wrapped(angle - self.tooth_centre_rad(self.tooth_at(angle))).abs();
        let half_tooth = self.half_tooth_rad(at.max(self.base_radius_mm()))?;
        let half_pitch = 0.5 * self.pitch_rad();
        let is_in_middle = match land {
            Land::Tip => off <= 0.5 * half_tooth,
            Land::Root => half_pitch - off <= 0.5 * (half_pitch - half_tooth),
        };
        is_in_middle.then_some(land)
    }

    /// Area of the toothing without end faces, mm²: lands and involutes; the root's rounding is not in the data.
    pub fn area_mm2(&self) -> f64 {
        let land = |radius_mm: f64, tip: bool| {
            let tooth = 2.0 * self.half_tooth_rad(radius_mm).unwrap_or(0.0);
            radius_mm * if tip { tooth } else { self.pitch_rad() - tooth }
        };
        let flank = self.profile_mm(self.root_radius_mm) - self.profile_mm(self.tip_radius_mm);
        let profile =
            2.0 * flank.abs() + land(self.tip_radius_mm, true) + land(self.root_radius_mm, false);
        f64::from(self.teeth) * profile * (self.height_mm[1] - self.height_mm[0])
    }

    /// Length of the involute from the base circle to a radius, mm.
    pub fn profile_mm(&self, radius_mm: f64) -> f64 {
        let base = self.base_radius_mm();
        (radius_mm * radius_mm - base * base).max(0.0) / (2.0 * base)
    }
}

/// inv a = tan a - a for the angle with the given cosine; none when that is above 1.
pub(crate) fn involute(cosine: f64) -> Option<f64> {
    // The tangent by its sides: what takes longest here is asked for every point of a scan.
    (0.0..=1.0)
        .contains(&cosine)
        .then(|| ((1.0 - cosine) * (1.0 + cosine)).sqrt() / cosine - cosine.acos())
}

/// The same angle in -pi..pi.
fn wrapped(angle: f64) -> f64 {
    (angle + PI).rem_euclid(TAU) - PI
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub fn ring84() -> GearData {
        GearData {
            kind: GearKind::Internal,
            teeth: 84,
            module_mm: 1.0,
            pressure_angle_deg: 20.0,
            tip_radius_mm: 41.0,
            root_radius_mm: 43.25,
            first_tooth_centre_deg: 180.0 / 84.0,
            height_mm: [0.0, 66.0],
            radial_threshold_mm: 50.0,
        }
    }

    #[test]
    fn the_closed_form_is_the_distance_to_the_curve() {
        let gear = ring84();
        for (tooth, flank) in [(1, Flank::Left), (17, Flank::Right), (84, Flank::Left)] {
            for offset in [-0.08, -0.01, 0.0, 0.02, 0.1] {
                let on = |r: f64| gear.flank_point(tooth, flank, r, 0.0).unwrap();
                let (a, b) = (on(42.0 - 1e-4), on(42.0 + 1e-4));
                let tangent = [b[0] - a[0], b[1] - a[1]];
                let length = tangent[0].hypot(tangent[1]);
                // Out of the material: away from the tooth's centre.
                let mut normal = [-tangent[1] / length, tangent[0] / length];
                let centre = gear.tooth_centre_rad(tooth);
                let outwards = flank.sign() * (normal[1] * centre.cos() - normal[0] * centre.sin());
                normal = normal.map(|n| n * outwards.signum());
                let foot = on(42.0);
                let p = [
                    foot[0] + offset * normal[0],
                    foot[1] + offset * normal[1],
                    0.0,
                ];
                // Brute force: the nearest of many points of the curve.
                let nearest = (0..400_000)
                    .map(|i| on(41.5 + 1.0 * f64::from(i) / 400_000.0))
                    .map(|q| (q[0] - p[0]).hypot(q[1] - p[1]))
                    .fold(f64::INFINITY, f64::min);
                let exact = gear.involute_deviation_mm(tooth, flank, p).unwrap();
                // Points of the curve are 2.5e-6 mm apart.
                assert!(
                    (exact.abs() - nearest).abs() < 2e-6,
                    "{offset}: {exact} against {nearest}"
                );
                assert!((exact - offset).abs() < 1e-9, "{offset}: {exact}");
            }
        }
    }

    #[test]
    fn middle_of_a_land_begins_half_way_from_its_middle_to_the_flank() {
        let ring = ring84();
        let wheel = GearData {
            kind: GearKind::External,
            teeth: 24,
            tip_radius_mm: 13.0,
            root_radius_mm: 10.75,
            ..ring84()
        };
        for gear in [ring, wheel] {
            let (tip, root) = (gear.tip_radius_mm, gear.root_radius_mm);
            let inwards = (root - tip).signum();
            for (tooth, flank) in [(1, Flank::Left), (7, Flank::Right)] {
                let centre = gear.tooth_centre_rad(tooth);
                let space = centre + flank.sign() * 0.5 * gear.pitch_rad();
                for (radius, middle, land) in [(tip, centre, Land::Tip), (root, space, Land::Root)]
                {
                    // Inside the base circle there is no involute.
                    let edge = gear
                        .half_tooth_rad(radius.max(gear.base_radius_mm()))
                        .unwrap();
                    let edge = centre + flank.sign() * edge;
                    let at = |share: f64, radius: f64| {
                        let angle = middle + share * (edge - middle);
                        gear.middle_of_land([radius * angle.cos(), radius * angle.sin(), 3.0])
                            == Some(land)
                    };
                    assert!(at(0.0, radius) && at(0.49, radius) && !at(0.51, radius));
                    let into_tooth = if land == Land::Tip { inwards } else { -inwards };
                    assert!(
                        at(0.3, radius + 0.04 * into_tooth) && !at(0.3, radius + 0.06 * into_tooth)
                    );
                    assert!(at(0.3, radius - 0.06 * into_tooth));
                }
            }
        }
    }

    #[test]
    fn teeth_are_numbered_counter_clockwise_with_left_on_the_far_side() {
        let gear = ring84();
        for tooth in [1, 2, 42, 84] {
            for flank in Flank::BOTH {
                let p = gear.flank_point(tooth, flank, 42.1, 30.0).unwrap();
                let angle = p[1].atan2(p[0]);
                let normal = [-flank.sign() * angle.sin(), flank.sign() * angle.cos(), 0.0];
                let place = gear.place(p, normal).unwrap();
                assert_eq!((place.tooth, place.flank), (tooth, flank));
                let radial = [angle.cos(), angle.sin(), 0.0];
                assert_eq!(gear.place(p, radial), None);
            }
        }
    }

    #[test]
    fn the_profile_length_is_that_of_the_curve() {
        let gear = ring84();
        let on = |r: f64| gear.flank_point(1, Flank::Left, r, 0.0).unwrap();
        let n = 20_000;
        let mut length = 0.0;
        for i in 0..n {
            let (a, b) = (
                on(41.0 + 2.0 * f64::from(i) / f64::from(n)),
                on(41.0 + 2.0 * f64::from(i + 1) / f64::from(n)),
            );
            length += (a[0] - b[0]).hypot(a[1] - b[1]);
        }
        assert!((gear.profile_mm(43.0) - gear.profile_mm(41.0) - length).abs() < 1e-6);
    }

    #[test]
    fn contradictions_are_named() {
        assert!(ring84().check().is_ok());
        let wrong = GearData {
            tip_radius_mm: 43.5,
            ..ring84()
        };
        assert!(matches!(wrong.check(), Err(GearError::Radii { .. })));
        let wrong = GearData {
            module_mm: f64::NAN,
            ..ring84()
        };
        assert!(matches!(
            wrong.check(),
            Err(GearError::Range {
                key: "module_mm",
                ..
            })
        ));
    }
}
