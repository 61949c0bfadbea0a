//! The numbers that define a gear, their limits, and the involute they imply.

use std::f64::consts::{PI, TAU};

/// Where the teeth point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GearKind {
    /// Ring gear: the teeth point towards the axis, the body is a wall outside.
    Internal,
    /// Pinion: the teeth point away from the axis, the body is a bore inside.
    External,
}

/// One side of a tooth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Flank {
    /// The side of increasing angle (counter-clockwise seen from +z).
    Left,
    /// The side of decreasing angle.
    Right,
}

/// A spur gear whose tooth and space share the pitch circle equally.
#[derive(Clone, Debug, PartialEq)]
pub struct GearSpec {
    /// Internal or external.
    pub kind: GearKind,
    /// Number of teeth.
    pub teeth: u32,
    /// Pitch diameter over tooth count, mm.
    pub module_mm: f64,
    /// Pressure angle on the pitch circle, rad.
    pub pressure_angle_rad: f64,
    /// Radius of the tooth tips: the smallest of an internal gear, the largest of an external one, mm.
    pub tip_radius_mm: f64,
    /// Radius of the bottom of the tooth spaces, mm.
    pub root_radius_mm: f64,
    /// Radius of the fillet between flank and root circle, mm; 0 leaves a sharp corner.
    pub root_fillet_radius_mm: f64,
    /// Turn about the axis, rad; at 0 the middle of the space before tooth 1 lies on +x.
    pub turned_rad: f64,
    /// Outer wall of an internal gear or bore of an external one, mm.
    pub body_radius_mm: f64,
    /// Lower and upper end face, mm.
    pub height_mm: [f64; 2],
}

/// Why a [`GearSpec`] describes no gear.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SpecError {
    /// A number is NaN or infinite.
    #[error("{name} is {value}; a finite number is needed")]
    NotFinite {
        /// Field at fault.
        name: &'static str,
        value: f64,
    },
    /// Too few teeth for an involute gear, or more than a mesh can index.
    #[error("{got} teeth; {min} to {max} are supported")]
    Teeth {
        /// Number asked for.
        got: u32,
        /// Fewest.
        min: u32,
        /// Most.
        max: u32,
    },
    /// The pressure angle is not that of a gear.
    #[error(
        "pressure angle {got_rad} rad; it must lie between {min_rad} and {max_rad} rad (20 deg is 0.349 rad)"
    )]
    PressureAngle {
        /// Angle asked for, rad.
        got_rad: f64,
        /// Smallest, rad.
        min_rad: f64,
        /// Largest, rad.
        max_rad: f64,
    },
    /// Radii do not follow each other from the axis outwards.
    #[error("{inner} ({inner_mm} mm) must be smaller than {outer} ({outer_mm} mm)")]
    RadiusOrder {
        /// Name of the radius that must be smaller.
        inner: &'static str,
        /// Its value, mm.
        inner_mm: f64,
        /// Name of the radius that must be larger.
        outer: &'static str,
        /// Its value, mm.
        outer_mm: f64,
    },
    /// Both flanks of a tooth or of a space meet before the given radius.
    #[error(
        "the {feature} has closed before radius {radius_mm} mm (half width {half_angle_rad} rad; it must be positive)"
    )]
    Pointed {
        /// "tooth" or "space".
        feature: &'static str,
        /// Radius at which it has no width left, mm.
        radius_mm: f64,
        /// Negative or zero half width, rad.
        half_angle_rad: f64,
    },
    /// The fillet does not fit between flank and root.
    #[error(
        "a root fillet of {got_mm} mm does not fit: at most about {limit_mm:.4} mm do here, 0 leaves a sharp corner"
    )]
    Fillet {
        /// Radius asked for, mm.
        got_mm: f64,
        /// Estimate of the largest that fits, mm.
        limit_mm: f64,
    },
    /// End faces in the wrong order.
    #[error("height runs from {low_mm} to {high_mm} mm; the second must be larger")]
    Height {
        /// Lower face, mm.
        low_mm: f64,
        /// Upper face, mm.
        high_mm: f64,
    },
}

/// `tan a - a`: polar angle of an involute where its pressure angle is `a`, rad.
pub fn involute(pressure_angle_rad: f64) -> f64 {
    pressure_angle_rad.tan() - pressure_angle_rad
}

impl GearSpec {
    /// Radius of the pitch circle, mm.
    pub fn pitch_radius_mm(&self) -> f64 {
        0.5 * self.module_mm * f64::from(self.teeth)
    }

    /// Radius of the base circle from which the involute unwinds, mm.
    pub fn base_radius_mm(&self) -> f64 {
        self.pitch_radius_mm() * self.pressure_angle_rad.cos()
    }

    /// Angle from one tooth to the next, rad.
    pub fn pitch_angle_rad(&self) -> f64 {
        TAU / f64::from(self.teeth)
    }

    /// Angle of the centre of tooth `tooth` (1-based), rad.
    pub fn tooth_centre_rad(&self, tooth: u32) -> f64 {
        self.turned_rad + (f64::from(tooth) - 0.5) * self.pitch_angle_rad()
    }

    /// Roll angle of the involute at `radius_mm`: unwound string length over base radius. NaN inside the base circle.
    pub fn roll_angle_rad(&self, radius_mm: f64) -> f64 {
        let base = self.base_radius_mm();
        ((radius_mm - base) * (radius_mm + base)).sqrt() / base
    }

    /// Half of the angle that a tooth takes at `radius_mm`, rad. NaN inside the base circle.
    ///
    /// The flanks of an internal tooth are those of the external gear that would fill its spaces, hence the mirrored sign.
    pub fn tooth_half_angle_rad(&self, radius_mm: f64) -> f64 {
        let roll = self.roll_angle_rad(radius_mm);
        let thinning = (roll - roll.atan()) - involute(self.pressure_angle_rad);
        let quarter_pitch = 0.5 * PI / f64::from(self.teeth);
        match self.kind {
            GearKind::Internal => quarter_pitch + thinning,
            GearKind::External => quarter_pitch - thinning,
        }
    }

    /// Polar angle of a flank at `radius_mm`, rad.
    pub fn flank_angle_rad(&self, tooth: u32, flank: Flank, radius_mm: f64) -> f64 {
        let half = self.tooth_half_angle_rad(radius_mm);
        match flank {
            Flank::Left => self.tooth_centre_rad(tooth) + half,
            Flank::Right => self.tooth_centre_rad(tooth) - half,
        }
    }

    /// Outward unit normal (away from the material, in the plane z = const) of a flank at `radius_mm`.
    ///
    /// The normal of an involute is the string that unwinds it, so it is tangent to the base circle.
    pub fn flank_normal(&self, tooth: u32, flank: Flank, radius_mm: f64) -> [f64; 2] {
        let pressure = (self.base_radius_mm() / radius_mm).acos();
        let side = match flank {
            Flank::Left => 1.0,
            Flank::Right => -1.0,
        };
        let angle = self.flank_angle_rad(tooth, flank, radius_mm);
        // Away from the tooth in the circumferential direction; radially towards the space: inwards for an internal gear.
        let radial = match self.kind {
            GearKind::Internal => -pressure.sin(),
            GearKind::External => pressure.sin(),
        };
        let tangential = side * pressure.cos();
        [
            radial * angle.cos() - tangential * angle.sin(),
            radial * angle.sin() + tangential * angle.cos(),
        ]
    }

    /// Radius at which the involute ends towards the root: the root circle, the fillet, or the base circle, mm.
    pub fn flank_root_radius_mm(&self) -> f64 {
        let fillet = self.root_fillet_radius_mm;
        if fillet == 0.0 {
            return self.root_radius_mm.max(self.base_radius_mm());
        }
        let base = self.base_radius_mm();
        let (centre_radius, towards_flank) = match self.kind {
            GearKind::Internal => (self.root_radius_mm - fillet, fillet),
            GearKind::External => (self.root_radius_mm + fillet, -fillet),
        };
        // The fillet centre lies on a parallel of the involute, which is an involute of the same base circle with a
        // string changed by the fillet radius.
        let string = (centre_radius * centre_radius - base * base).sqrt() + towards_flank;
        if string < 0.0 {
            f64::NAN
        } else {
            base.hypot(string)
        }
    }

    /// Checks every limit a mesh needs.
    pub fn validate(&self) -> Result<(), SpecError> {
        let numbers = [
            ("module_mm", self.module_mm),
            ("pressure_angle_rad", self.pressure_angle_rad),
            ("tip_radius_mm", self.tip_radius_mm),
            ("root_radius_mm", self.root_radius_mm),
            ("root_fillet_radius_mm", self.root_fillet_radius_mm),
            ("turned_rad", self.turned_rad),
            ("body_radius_mm", self.body_radius_mm),
            ("height_mm[0]", self.height_mm[0]),
            ("height_mm[1]", self.height_mm[1]),
        ];
        for (name, value) in numbers {
            if !value.is_finite() {
                return Err(SpecError::NotFinite { name, value });
            }
        }
        const TEETH: [u32; 2] = [5, 10_000];
        if self.teeth < TEETH[0] || self.teeth > TEETH[1] {
            return Err(SpecError::Teeth {
                got: self.teeth,
                min: TEETH[0],
                max: TEETH[1],
            });
        }
        const PRESSURE_RAD: [f64; 2] = [0.08, 0.8];
        if self.pressure_angle_rad < PRESSURE_RAD[0] || self.pressure_angle_rad > PRESSURE_RAD[1] {
            return Err(SpecError::PressureAngle {
                got_rad: self.pressure_angle_rad,
                min_rad: PRESSURE_RAD[0],
                max_rad: PRESSURE_RAD[1],
            });
        }
        let pitch = ("pitch radius", self.pitch_radius_mm());
        let base = ("base radius", self.base_radius_mm());
        let tip = ("tip_radius_mm", self.tip_radius_mm);
        let root = ("root_radius_mm", self.root_radius_mm);
        let body = ("body_radius_mm", self.body_radius_mm);
        let chain = match self.kind {
            GearKind::Internal => vec![base, tip, pitch, root, body],
            GearKind::External => vec![("the axis", 0.0), body, root, pitch, tip],
        };
        for pair in chain.windows(2) {
            if pair[0].1 >= pair[1].1 {
                return Err(SpecError::RadiusOrder {
                    inner: pair[0].0,
                    inner_mm: pair[0].1,
                    outer: pair[1].0,
                    outer_mm: pair[1].1,
                });
            }
        }
        if self.height_mm[0] >= self.height_mm[1] {
            return Err(SpecError::Height {
                low_mm: self.height_mm[0],
                high_mm: self.height_mm[1],
            });
        }
        let tooth = self.tooth_half_angle_rad(self.tip_radius_mm);
        if tooth <= 0.0 {
            return Err(SpecError::Pointed {
                feature: "tooth",
                radius_mm: self.tip_radius_mm,
                half_angle_rad: tooth,
            });
        }
        let bottom_mm = self.root_radius_mm.max(self.base_radius_mm());
        let space = 0.5 * self.pitch_angle_rad() - self.tooth_half_angle_rad(bottom_mm);
        if space <= 0.0 {
            return Err(SpecError::Pointed {
                feature: "space",
                radius_mm: bottom_mm,
                half_angle_rad: space,
            });
        }
        self.validate_fillet(space * self.root_radius_mm)
    }

    fn validate_fillet(&self, half_root_mm: f64) -> Result<(), SpecError> {
        let got_mm = self.root_fillet_radius_mm;
        if got_mm == 0.0 {
            return Ok(());
        }
        let refused = SpecError::Fillet {
            got_mm,
            limit_mm: half_root_mm,
        };
        if got_mm < 0.0 || got_mm > (self.root_radius_mm - self.tip_radius_mm).abs() {
            return Err(refused);
        }
        let flank_mm = self.flank_root_radius_mm();
        let on_flank = (flank_mm - self.tip_radius_mm).abs() > 0.0
            && (flank_mm - self.root_radius_mm).abs()
                < (self.tip_radius_mm - self.root_radius_mm).abs();
        let root_left = 0.5 * self.pitch_angle_rad() - self.fillet_centre_from_tooth_rad();
        if flank_mm.is_finite() && on_flank && root_left > 0.0 {
            Ok(())
        } else {
            Err(refused)
        }
    }

    /// Angle from the tooth centre to the centre of the left root fillet, rad.
    pub(crate) fn fillet_centre_from_tooth_rad(&self) -> f64 {
        let flank_mm = self.flank_root_radius_mm();
        let half = self.tooth_half_angle_rad(flank_mm);
        let [nx, ny] = self.flank_normal(1, Flank::Left, flank_mm);
        let angle = self.tooth_centre_rad(1) + half;
        let fillet = self.root_fillet_radius_mm;
        let centre = [
            flank_mm * angle.cos() + fillet * nx,
            flank_mm * angle.sin() + fillet * ny,
        ];
        centre[1].atan2(centre[0]) - self.tooth_centre_rad(1)
    }
}
