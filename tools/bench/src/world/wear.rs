//! What the press did to the die: wear on a tooth's flank, and the depth it has at every point.

use flankscope_gear_cad::{Flank, GearSpec};
use std::f64::consts::PI;
use std::str::FromStr;

/// Shape of the damage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WearKind {
    /// The same depth over the whole flank.
    Uniform,
    /// Deepest at the tip edge, fading out over half a millimetre of profile.
    Tip,
    /// One local pit of 1 mm² at half height in the middle of the profile.
    Pit,
    /// Material of the workpiece stuck on a patch at half height in the middle of the profile.
    Buildup,
}

/// One damage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wear {
    /// Tooth, from 1.
    pub tooth: u32,
    /// Its flank.
    pub flank: Flank,
    /// Largest depth, mm; of [`WearKind::Buildup`] the height. Never negative.
    pub depth_mm: f64,
    /// Its shape.
    pub kind: WearKind,
}

/// Deepest damage that the model describes: beyond it flanks of neighbouring features would meet.
pub const MAX_DEPTH_UM: f64 = 300.0;

/// Why a text describes no wear, or not one of this gear.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum WearError {
    /// Too few or too many parts.
    #[error(
        "wear \"{text}\" has {parts} parts; write TOOTH:FLANK:DEPTH_UM or TOOTH:FLANK:DEPTH_UM:KIND, e.g. 12:left:80"
    )]
    Parts {
        /// The text.
        text: String,
        /// Parts found between colons.
        parts: usize,
    },
    /// The tooth is not a number.
    #[error("tooth \"{got}\" is not a whole number from 1")]
    Tooth {
        /// The part at fault.
        got: String,
    },
    /// The flank has no such name.
    #[error("flank \"{got}\" is unknown; left (l) or right (r) are possible")]
    Flank {
        /// The part at fault.
        got: String,
    },
    /// The depth is not a number in range.
    #[error(
        "depth \"{got}\" is not usable; a number from 0 to {max_um} µm is (built-up material: kind buildup)"
    )]
    Depth {
        /// The part at fault.
        got: String,
        /// Largest, µm.
        max_um: f64,
    },
    /// The kind has no such name.
    #[error("kind \"{got}\" is unknown; uniform, tip, pit or buildup are possible")]
    Kind {
        /// The part at fault.
        got: String,
    },
    /// The gear has fewer teeth.
    #[error("tooth {got} does not exist; this gear has teeth 1 to {teeth}")]
    NoSuchTooth {
        /// Tooth asked for.
        got: u32,
        /// Teeth there are.
        teeth: u32,
    },
}

impl FromStr for Wear {
    type Err = WearError;

    /// `TOOTH:FLANK:DEPTH_UM[:KIND]`, e.g. `12:left:80` or `40:r:30:pit`.
    fn from_str(text: &str) -> Result<Self, WearError> {
        let parts: Vec<&str> = text.split(':').map(str::trim).collect();
        let (tooth, flank, depth, kind) = match parts[..] {
            [tooth, flank, depth] => (tooth, flank, depth, "uniform"),
            [tooth, flank, depth, kind] => (tooth, flank, depth, kind),
            _ => {
                return Err(WearError::Parts {
                    text: text.to_owned(),
                    parts: parts.len(),
                });
            }
        };
        let number = tooth.parse().ok().filter(|&n: &u32| n >= 1);
        let depth_um = depth
            .parse()
            .ok()
            .filter(|d: &f64| (0.0..=MAX_DEPTH_UM).contains(d));
        Ok(Self {
            tooth: number.ok_or_else(|| WearError::Tooth {
                got: tooth.to_owned(),
            })?,
            flank: match flank.to_ascii_lowercase().as_str() {
                "left" | "l" => Flank::Left,
                "right" | "r" => Flank::Right,
                _ => {
                    return Err(WearError::Flank {
                        got: flank.to_owned(),
                    });
                }
            },
            depth_mm: depth_um.ok_or_else(|| WearError::Depth {
                got: depth.to_owned(),
                max_um: MAX_DEPTH_UM,
            })? * 1e-3,
            kind: match kind.to_ascii_lowercase().as_str() {
                "uniform" => WearKind::Uniform,
                "tip" => WearKind::Tip,
                "pit" => WearKind::Pit,
                "buildup" => WearKind::Buildup,
                _ => {
                    return Err(WearError::Kind {
                        got: kind.to_owned(),
                    });
                }
            },
        })
    }
}

/// A flank of a numbered tooth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct FlankId {
    /// Tooth, from 1.
    pub tooth: u32,
    /// Its flank.
    pub flank: Flank,
}

/// Rectangle on a flank: profile length (from the base circle along the involute) by height, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlankZone {
    /// Smallest and largest profile length, mm.
    pub profile_mm: [f64; 2],
    /// Smallest and largest height, mm.
    pub height_mm: [f64; 2],
}

/// Depth of all wear at every point of every flank.
#[derive(Clone, Debug)]
pub struct WearField {
    gear: GearSpec,
    wear: Vec<Wear>,
}

/// Length of profile over which tip rounding fades, mm.
const TIP_FADE_MM: f64 = 0.5;
/// Area of a pit, mm².
const PIT_AREA_MM2: f64 = 1.0;
/// Area of a patch of built-up material, mm².
const BUILDUP_AREA_MM2: f64 = 2.0;

impl WearField {
    /// All of `wear` on `gear`.
    pub fn new(gear: &GearSpec, wear: &[Wear]) -> Result<Self, WearError> {
        for one in wear {
            if one.tooth == 0 || one.tooth > gear.teeth {
                return Err(WearError::NoSuchTooth {
                    got: one.tooth,
                    teeth: gear.teeth,
                });
            }
            let um = one.depth_mm * 1e3;
            if !(0.0..=MAX_DEPTH_UM * (1.0 + 1e-12)).contains(&um) {
                return Err(WearError::Depth {
                    got: um.to_string(),
                    max_um: MAX_DEPTH_UM,
                });
            }
        }
        Ok(Self {
            gear: gear.clone(),
            wear: wear
                .iter()
                .copied()
                .filter(|one| one.depth_mm > 0.0)
                .collect(),
        })
    }

    /// The gear whose flanks wear.
    pub fn gear(&self) -> &GearSpec {
        &self.gear
    }

    /// Flanks that carry any wear, each once.
    pub fn worn_flanks(&self) -> Vec<FlankId> {
        let mut ids: Vec<FlankId> = self
            .wear
            .iter()
            .map(|w| FlankId {
                tooth: w.tooth,
                flank: w.flank,
            })
            .collect();
        ids.sort_unstable();
        ids.dedup();
        ids
    }

    /// Depth of material lost along the normal, mm (negative: material gained), where the nominal flank has this radius
    /// and height.
    pub fn depth_mm(&self, id: FlankId, radius_mm: f64, height_mm: f64) -> f64 {
        let at = self.profile_mm(radius_mm);
        self.on(id)
            .map(|w| w.depth_mm * self.shape(w.kind, at, height_mm))
            .sum()
    }

    /// Where the depth on a flank is not the same everywhere: a mesh must be fine there.
    pub fn varying_zones(&self, id: FlankId) -> Vec<FlankZone> {
        let whole_height = self.gear.height_mm;
        self.on(id)
            .filter_map(|w| match w.kind {
                WearKind::Uniform => None,
                WearKind::Tip => {
                    let ends = self.tip_fade_mm();
                    Some(FlankZone {
                        profile_mm: [ends[0].min(ends[1]), ends[0].max(ends[1])],
                        height_mm: whole_height,
                    })
                }
                WearKind::Pit | WearKind::Buildup => {
                    let ([profile, height], reach) = (self.middle_mm(), patch_radius_mm(w.kind));
                    Some(FlankZone {
                        profile_mm: [profile - reach, profile + reach],
                        height_mm: [height - reach, height + reach],
                    })
                }
            })
            .collect()
    }

    /// Length of the involute from the base circle to a radius: half the squared roll angle times the base radius, mm.
    pub fn profile_mm(&self, radius_mm: f64) -> f64 {
        0.5 * self.gear.base_radius_mm() * self.gear.roll_angle_rad(radius_mm).powi(2)
    }

    fn on(&self, id: FlankId) -> impl Iterator<Item = &Wear> {
        self.wear
            .iter()
            .filter(move |w| w.tooth == id.tooth && w.flank == id.flank)
    }

    /// Depth relative to the largest, with the sign of the loss.
    fn shape(&self, kind: WearKind, profile_mm: f64, height_mm: f64) -> f64 {
        match kind {
            WearKind::Uniform => 1.0,
            WearKind::Tip => {
                let [edge, end] = self.tip_fade_mm();
                let left = 1.0 - (profile_mm - edge) / (end - edge);
                left.clamp(0.0, 1.0).powi(2)
            }
            WearKind::Pit | WearKind::Buildup => {
                let [profile, height] = self.middle_mm();
                let away = (profile_mm - profile).hypot(height_mm - height) / patch_radius_mm(kind);
                // Smooth at its rim.
                let bowl = (1.0 - away * away).max(0.0).powi(2);
                if kind == WearKind::Pit { bowl } else { -bowl }
            }
        }
    }

    /// Profile length of the tip edge and of the end of its rounding, mm.
    fn tip_fade_mm(&self) -> [f64; 2] {
        let edge = self.profile_mm(self.gear.tip_radius_mm);
        let root = self.profile_mm(self.gear.flank_root_radius_mm());
        [edge, edge + TIP_FADE_MM * (root - edge).signum()]
    }

    /// Profile length and height of the middle of a flank, mm.
    fn middle_mm(&self) -> [f64; 2] {
        let [tip, root] =
            [self.gear.tip_radius_mm, self.gear.flank_root_radius_mm()].map(|r| self.profile_mm(r));
        [
            0.5 * (tip + root),
            0.5 * (self.gear.height_mm[0] + self.gear.height_mm[1]),
        ]
    }
}

fn patch_radius_mm(kind: WearKind) -> f64 {
    let area_mm2 = if kind == WearKind::Buildup {
        BUILDUP_AREA_MM2
    } else {
        PIT_AREA_MM2
    };
    (area_mm2 / PI).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_are_read() {
        let read = |text: &str| text.parse::<Wear>();
        let plain = Wear {
            tooth: 12,
            flank: Flank::Left,
            depth_mm: 0.08,
            kind: WearKind::Uniform,
        };
        assert_eq!(read("12:left:80"), Ok(plain));
        assert_eq!(read(" 12 : L : 80 : uniform"), Ok(plain));
        assert_eq!(
            read("12:r:80:PIT"),
            Ok(Wear {
                flank: Flank::Right,
                kind: WearKind::Pit,
                ..plain
            })
        );
        assert_eq!(read("12:r:80:tip").map(|w| w.kind), Ok(WearKind::Tip));
        assert_eq!(
            read("12:r:80:buildup").map(|w| w.kind),
            Ok(WearKind::Buildup)
        );
    }

    #[test]
    fn wrong_texts_are_named() {
        let error = |text: &str| text.parse::<Wear>().expect_err(text);
        assert!(matches!(
            error("12:left"),
            WearError::Parts { parts: 2, .. }
        ));
        assert!(matches!(
            error("1:l:2:pit:5"),
            WearError::Parts { parts: 5, .. }
        ));
        assert!(matches!(error("0:left:80"), WearError::Tooth { .. }));
        assert!(matches!(error("-3:left:80"), WearError::Tooth { .. }));
        assert!(matches!(error("3:top:80"), WearError::Flank { .. }));
        for depth in ["-0.1", "-5", "nan", "inf", "301", "deep"] {
            assert!(
                matches!(error(&format!("3:left:{depth}")), WearError::Depth { .. }),
                "{depth}"
            );
        }
        assert!(matches!(error("3:left:80:dent"), WearError::Kind { .. }));
    }
}
