//! Tolerances of ISO 1328-1:2013: class 5 by formula, the others by steps of the square root of two.
//!
//! The formulas are those that are commonly quoted; the standard's own text was not at hand. `d` is the reference diameter,
//! `m` the module and `b` the face width, mm; tolerances in um.

use serde::Serialize;

use crate::gear::GearData;

/// Best and worst class that the formulas are stated for.
pub const CLASSES: std::ops::RangeInclusive<u32> = 1..=11;

/// Quantities with a tolerance.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Quantity {
    /// Total profile deviation.
    ProfileTotal,
    /// Profile form deviation.
    ProfileForm,
    /// Profile slope deviation.
    ProfileSlope,
    /// Total helix deviation.
    HelixTotal,
    /// Helix form deviation.
    HelixForm,
    /// Helix slope deviation.
    HelixSlope,
    /// Largest single pitch deviation.
    SinglePitch,
    /// Total cumulative pitch deviation.
    CumulativePitch,
    /// Runout.
    Runout,
}

impl Quantity {
    /// All of them.
    pub const ALL: [Self; 9] = [
        Self::ProfileTotal,
        Self::ProfileForm,
        Self::ProfileSlope,
        Self::HelixTotal,
        Self::HelixForm,
        Self::HelixSlope,
        Self::SinglePitch,
        Self::CumulativePitch,
        Self::Runout,
    ];

    /// The standard's symbol.
    pub fn symbol(self) -> &'static str {
        match self {
            Self::ProfileTotal => "F_alpha",
            Self::ProfileForm => "f_f_alpha",
            Self::ProfileSlope => "f_H_alpha",
            Self::HelixTotal => "F_beta",
            Self::HelixForm => "f_f_beta",
            Self::HelixSlope => "f_H_beta",
            Self::SinglePitch => "f_p",
            Self::CumulativePitch => "F_p",
            Self::Runout => "F_r",
        }
    }

    /// Tolerance of class 5, unrounded, um.
    fn class_5_um(self, gear: &GearData) -> f64 {
        let (d, m) = (2.0 * gear.pitch_radius_mm(), gear.module_mm);
        let b = gear.height_mm[1] - gear.height_mm[0];
        match self {
            Self::ProfileTotal => Self::ProfileSlope
                .class_5_um(gear)
                .hypot(Self::ProfileForm.class_5_um(gear)),
            Self::ProfileForm => 0.55 * m + 5.0,
            Self::ProfileSlope => 0.4 * m + 0.001 * d + 4.0,
            Self::HelixTotal => Self::HelixSlope
                .class_5_um(gear)
                .hypot(Self::HelixForm.class_5_um(gear)),
            Self::HelixForm => 0.07 * d.sqrt() + 0.45 * b.sqrt() + 4.0,
            Self::HelixSlope => 0.05 * d.sqrt() + 0.35 * b.sqrt() + 4.0,
            Self::SinglePitch => 0.001 * d + 0.4 * m + 5.0,
            Self::CumulativePitch => 0.002 * d + 0.55 * d.sqrt() + 0.7 * m + 12.0,
            Self::Runout => 0.9 * Self::CumulativePitch.class_5_um(gear),
        }
    }

    /// Tolerance of a class, rounded as the standard does, um.
    pub fn tolerance_um(self, gear: &GearData, class: u32) -> f64 {
        let steps = f64::from(class) - 5.0;
        rounded(self.class_5_um(gear) * 2f64.powf(0.5 * steps))
    }

    /// The best class whose tolerance holds a value; none beyond the worst.
    pub fn class_of(self, gear: &GearData, value_um: f64) -> Option<u32> {
        CLASSES
            .into_iter()
            .find(|&class| value_um <= self.tolerance_um(gear, class))
    }
}

/// Above 10 to whole um, from 5 to 10 to half ones, below to tenths.
fn rounded(um: f64) -> f64 {
    let step = match um {
        um if um > 10.0 => 1.0,
        um if um >= 5.0 => 0.5,
        _ => 0.1,
    };
    (um / step).round() * step
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gear::GearKind;

    #[test]
    fn the_specimens_tolerances_are_those_of_the_table() {
        // Module 0.987, reference diameter 82.9 mm, face width 66 mm: unrounded values of classes 5 and 9.
        let gear = GearData {
            kind: GearKind::Internal,
            teeth: 84,
            module_mm: 82.9 / 84.0,
            pressure_angle_deg: 20.0,
            tip_radius_mm: 40.46,
            root_radius_mm: 42.68,
            first_tooth_centre_deg: 0.0,
            height_mm: [0.0, 66.0],
            radial_threshold_mm: 50.0,
        };
        for (quantity, five, nine) in [
            (Quantity::SinglePitch, 5.5, 21.9),
            (Quantity::CumulativePitch, 17.9, 71.5),
            (Quantity::ProfileSlope, 4.5, 17.9),
            (Quantity::ProfileForm, 5.5, 22.2),
            (Quantity::ProfileTotal, 7.1, 28.5),
            (Quantity::HelixSlope, 7.3, 29.2),
            (Quantity::HelixForm, 8.3, 33.2),
            (Quantity::HelixTotal, 11.0, 44.2),
        ] {
            let class_5 = quantity.class_5_um(&gear);
            assert!((class_5 - five).abs() < 0.051, "{quantity:?}: {class_5}");
            assert!((4.0 * class_5 - nine).abs() < 0.051, "{quantity:?}");
            let tolerance = quantity.tolerance_um(&gear, 9);
            assert!(
                (tolerance - nine).abs() <= 0.55,
                "{quantity:?}: {tolerance}"
            );
            assert_eq!(quantity.class_of(&gear, tolerance), Some(9));
            assert_eq!(quantity.class_of(&gear, tolerance + 0.1), Some(10));
            assert_eq!(quantity.class_of(&gear, 1e4), None);
        }
        assert_eq!(rounded(7.3), 7.5);
        assert_eq!(rounded(4.47), 4.5);
    }
}
