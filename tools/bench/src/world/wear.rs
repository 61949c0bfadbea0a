//! Damage of the die by the press: wear of a tooth's flank, and its depth at every point.

use flankscope_gear_cad::{Flank, GearSpec};
use std::f64::consts::PI;
use std::str::FromStr;

/// Shape of the damage.
///
/// Positions are relative to the middle of the flank's profile and of the die's height, which the head views. The judged part of
/// a flank is taken to extend [`VIEW_HALF_MM`] to either side in height.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WearKind {
    /// Constant depth over the whole flank.
    Uniform,
    /// Deepest at the tip edge, fading out over half a millimetre of profile.
    Tip,
    /// One local pit of 1 mm² at half height in the middle of the profile.
    Pit,
    /// Workpiece material adhering to a patch at half height in the middle of the profile.
    Buildup,
    /// Everything above half height, with a slope 0.2 mm wide between sound and worn.
    Half,
    /// Rises linearly from zero at half height to the full depth 4 mm above; constant from there on.
    Ramp,
    /// Worn from an entry edge 4 mm above half height: falls by a factor of e every 2 mm downwards, full above.
    Edge,
    /// A round hole of 2.1 mm diameter with a flat bottom and a rim 0.1 mm wide.
    Spall,
    /// A groove 0.3 mm wide along the whole height, round at the bottom.
    ScratchAlong,
    /// A groove 0.3 mm wide across the whole profile, round at the bottom.
    ScratchAcross,
    /// A bowl of 1.2 mm diameter with a raised wall, a quarter as high as the bowl is deep.
    Crater,
    /// A gap 0.1 mm wide at its mouth, sharp at its bottom, and 3 mm long along the height.
    Crack,
    /// Constant depth over this flank of every tooth.
    Side,
    /// Constant depth over the whole toothing: both flanks of every tooth and the lands between them.
    Ring,
}

impl WearKind {
    /// Every kind by its name.
    pub const NAMED: [(&'static str, Self); 14] = [
        ("uniform", Self::Uniform),
        ("tip", Self::Tip),
        ("pit", Self::Pit),
        ("buildup", Self::Buildup),
        ("half", Self::Half),
        ("ramp", Self::Ramp),
        ("edge", Self::Edge),
        ("spall", Self::Spall),
        ("scratch-along", Self::ScratchAlong),
        ("scratch-across", Self::ScratchAcross),
        ("crater", Self::Crater),
        ("crack", Self::Crack),
        ("side", Self::Side),
        ("ring", Self::Ring),
    ];

    fn names() -> String {
        Self::NAMED.map(|(name, _)| name).join(", ")
    }
}

/// One damage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wear {
    /// Tooth, from 1.
    pub tooth: u32,
    pub flank: Flank,
    /// Largest depth, mm; of [`WearKind::Buildup`] the height. Never negative.
    pub depth_mm: f64,
    /// Its shape.
    pub kind: WearKind,
}

/// Deepest damage that the model describes: with more, neighbouring features would meet.
pub const MAX_DEPTH_UM: f64 = 300.0;

/// Why a text does not describe wear, or not of this gear.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum WearError {
    /// The number of parts is wrong.
    #[error(
        "wear \"{text}\" has {parts} parts; write TOOTH:FLANK:DEPTH_UM or TOOTH:FLANK:DEPTH_UM:KIND, e.g. 12:left:80"
    )]
    Parts {
        text: String,
        /// Parts found between colons.
        parts: usize,
    },
    #[error("tooth \"{got}\" is not a whole number from 1")]
    Tooth {
        /// The part at fault.
        got: String,
    },
    /// The flank's name is unknown.
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
    /// The kind's name is unknown.
    #[error("kind \"{got}\" is unknown; possible are {}", WearKind::names())]
    Kind {
        /// The part at fault.
        got: String,
    },
    /// The gear has fewer teeth.
    #[error("tooth {got} does not exist; this gear has teeth 1 to {teeth}")]
    NoSuchTooth {
        /// Requested tooth.
        got: u32,
        /// Number of teeth.
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
            kind: WearKind::NAMED
                .into_iter()
                .find(|(name, _)| name.eq_ignore_ascii_case(kind))
                .map(|(_, kind)| kind)
                .ok_or_else(|| WearError::Kind {
                    got: kind.to_owned(),
                })?,
        })
    }
}

/// A flank of a numbered tooth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct FlankId {
    /// Tooth, from 1.
    pub tooth: u32,
    pub flank: Flank,
}

/// Rectangle on a flank: profile length (from the base circle along the involute) by height, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlankZone {
    /// Smallest and largest profile length, mm.
    pub profile_mm: [f64; 2],
    /// Smallest and largest height, mm.
    pub height_mm: [f64; 2],
    /// Longest edge that a mesh of the damage may have there, mm.
    pub longest_mm: f64,
}

/// Depth of all wear at every point of every flank.
#[derive(Clone, Debug)]
pub struct WearField {
    gear: GearSpec,
    wear: Vec<Wear>,
}

/// Half the height of the part of a flank that a head sees and judges, mm.
pub const VIEW_HALF_MM: f64 = 4.0;

/// Longest edge of the mesh where wear varies, mm: a pit of 1 mm² and 80 µm is then nowhere 0.2 µm shallower than its shape.
const WORN_EDGE_MM: f64 = 0.035;
/// Longest edge where wear varies slowly, as at an edge, mm: the chord error is 0.1² / 8 of 0.3 / 2², 0.1 µm.
const SLOW_EDGE_MM: f64 = 0.1;
/// Longest edge in a crack, mm: an eighth of its width.
const CRACK_EDGE_MM: f64 = 0.0125;
/// Length of profile over which tip rounding fades, mm.
const TIP_FADE_MM: f64 = 0.5;
/// Area of a pit, mm².
const PIT_AREA_MM2: f64 = 1.0;
/// Area of a patch of built-up material, mm².
const BUILDUP_AREA_MM2: f64 = 2.0;
/// Width of the slope between the worn and the sound half, mm.
const HALF_SLOPE_MM: f64 = 0.2;
/// Length over which wear from an edge falls by a factor of e, mm.
const EDGE_DECAY_MM: f64 = 2.0;
/// Number of decay lengths after which the mesh at an edge is no longer fine: e^-7 of 300 µm is 0.3 µm.
const EDGE_DECAYS: f64 = 7.0;
/// Radius of a spall in the middle of its rim, and the rim's width, mm.
const SPALL_RADIUS_MM: f64 = 1.05;
const SPALL_RIM_MM: f64 = 0.1;
/// Half the width of a scratch, mm.
const SCRATCH_HALF_MM: f64 = 0.15;
/// Radius of a crater's bowl, and of its wall on the outside, mm.
const CRATER_RADIUS_MM: f64 = 0.6;
const CRATER_WALL_MM: f64 = 0.9;
/// Height of that wall relative to the bowl's depth.
const CRATER_WALL_RATIO: f64 = 0.25;
/// Half the width and half the length of a crack, and the length over which its ends rise, mm.
const CRACK_HALF_MM: f64 = 0.05;
const CRACK_HALF_LENGTH_MM: f64 = 1.5;
const CRACK_END_MM: f64 = 0.1;

impl WearField {
    /// The wear field of `wear` on `gear`.
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

    /// Flanks with wear, without duplicates.
    pub fn worn_flanks(&self) -> Vec<FlankId> {
        let mut ids: Vec<FlankId> = Vec::new();
        for one in &self.wear {
            let flanks: &[Flank] = match one.kind {
                WearKind::Ring => &[Flank::Left, Flank::Right],
                _ => &[one.flank],
            };
            let teeth = match one.kind {
                WearKind::Side | WearKind::Ring => 1..=self.gear.teeth,
                _ => one.tooth..=one.tooth,
            };
            ids.extend(
                teeth.flat_map(|tooth| flanks.iter().map(move |&flank| FlankId { tooth, flank })),
            );
        }
        ids.sort_unstable();
        ids.dedup();
        ids
    }

    /// Uniform loss of the whole toothing, mm: included in [`Self::depth_mm`] on every flank.
    pub fn ring_mm(&self) -> f64 {
        self.wear
            .iter()
            .filter(|w| w.kind == WearKind::Ring)
            .map(|w| w.depth_mm)
            .sum()
    }

    /// Loss along the normal, mm (negative: material gained), at this radius and height of the nominal flank.
    pub fn depth_mm(&self, id: FlankId, radius_mm: f64, height_mm: f64) -> f64 {
        let at = self.profile_mm(radius_mm);
        self.on(id)
            .map(|w| w.depth_mm * self.shape(w.kind, at, height_mm))
            .sum()
    }

    /// Zones of a flank in which the depth varies, so that the mesh must be fine.
    pub fn varying_zones(&self, id: FlankId) -> Vec<FlankZone> {
        self.on(id).flat_map(|w| self.varying(w.kind)).collect()
    }

    fn varying(&self, kind: WearKind) -> Vec<FlankZone> {
        let [profile, height] = self.middle_mm();
        let ends =
            [self.gear.tip_radius_mm, self.gear.flank_root_radius_mm()].map(|r| self.profile_mm(r));
        let whole_profile = [ends[0].min(ends[1]), ends[0].max(ends[1])];
        let zone = |profile_mm, height_mm| FlankZone {
            profile_mm,
            height_mm,
            longest_mm: WORN_EDGE_MM,
        };
        let patch = |reach: f64| {
            vec![zone(
                [profile - reach, profile + reach],
                [height - reach, height + reach],
            )]
        };
        // A fold across the profile: the mesh is fine within an edge's length of it.
        let fold = |at: f64| {
            let near = [at - WORN_EDGE_MM, at + WORN_EDGE_MM];
            zone(whole_profile, near.map(|above| height + above))
        };
        match kind {
            WearKind::Uniform | WearKind::Side | WearKind::Ring => Vec::new(),
            WearKind::Tip => {
                let fade = self.tip_fade_mm();
                let profile_mm = [fade[0].min(fade[1]), fade[0].max(fade[1])];
                vec![zone(profile_mm, self.gear.height_mm)]
            }
            WearKind::Pit | WearKind::Buildup => patch(patch_radius_mm(kind)),
            WearKind::Half => {
                let reach = 0.5 * HALF_SLOPE_MM + WORN_EDGE_MM;
                vec![zone(whole_profile, [height - reach, height + reach])]
            }
            WearKind::Ramp => vec![fold(0.0), fold(VIEW_HALF_MM)],
            WearKind::Edge => {
                let from = height + VIEW_HALF_MM;
                let slow = FlankZone {
                    longest_mm: SLOW_EDGE_MM,
                    ..zone(whole_profile, [from - EDGE_DECAYS * EDGE_DECAY_MM, from])
                };
                vec![slow, fold(VIEW_HALF_MM)]
            }
            WearKind::Spall => patch(SPALL_RADIUS_MM + SPALL_RIM_MM),
            WearKind::ScratchAlong => {
                let reach = SCRATCH_HALF_MM + WORN_EDGE_MM;
                vec![zone(
                    [profile - reach, profile + reach],
                    self.gear.height_mm,
                )]
            }
            WearKind::ScratchAcross => {
                let reach = SCRATCH_HALF_MM + WORN_EDGE_MM;
                vec![zone(whole_profile, [height - reach, height + reach])]
            }
            WearKind::Crater => patch(CRATER_WALL_MM),
            WearKind::Crack => {
                let [wide, long] = [CRACK_HALF_MM, CRACK_HALF_LENGTH_MM].map(|r| r + CRACK_EDGE_MM);
                vec![FlankZone {
                    longest_mm: CRACK_EDGE_MM,
                    ..zone(
                        [profile - wide, profile + wide],
                        [height - long, height + long],
                    )
                }]
            }
        }
    }

    /// Length of the involute from the base circle to a radius: half the squared roll angle times the base radius, mm.
    pub fn profile_mm(&self, radius_mm: f64) -> f64 {
        0.5 * self.gear.base_radius_mm() * self.gear.roll_angle_rad(radius_mm).powi(2)
    }

    fn on(&self, id: FlankId) -> impl Iterator<Item = &Wear> {
        self.wear.iter().filter(move |w| match w.kind {
            WearKind::Ring => true,
            WearKind::Side => w.flank == id.flank,
            _ => w.tooth == id.tooth && w.flank == id.flank,
        })
    }

    /// Depth relative to the largest, with the sign of the loss.
    fn shape(&self, kind: WearKind, profile_mm: f64, height_mm: f64) -> f64 {
        let [profile, height] = self.middle_mm();
        let (along, above) = (profile_mm - profile, height_mm - height);
        let groove = |across: f64| (1.0 - (across / SCRATCH_HALF_MM).powi(2)).max(0.0);
        match kind {
            WearKind::Uniform | WearKind::Side | WearKind::Ring => 1.0,
            WearKind::Half => (above / HALF_SLOPE_MM + 0.5).clamp(0.0, 1.0),
            WearKind::Ramp => (above / VIEW_HALF_MM).clamp(0.0, 1.0),
            WearKind::Edge => ((above - VIEW_HALF_MM).min(0.0) / EDGE_DECAY_MM).exp(),
            WearKind::Spall => {
                let inside_mm = SPALL_RADIUS_MM - along.hypot(above);
                (inside_mm / SPALL_RIM_MM + 0.5).clamp(0.0, 1.0)
            }
            WearKind::ScratchAlong => groove(along),
            WearKind::ScratchAcross => groove(above),
            WearKind::Crater => {
                let away = along.hypot(above);
                if away < CRATER_RADIUS_MM {
                    1.0 - (away / CRATER_RADIUS_MM).powi(2)
                } else if away < CRATER_WALL_MM {
                    let share = (away - CRATER_RADIUS_MM) / (CRATER_WALL_MM - CRATER_RADIUS_MM);
                    -CRATER_WALL_RATIO * (PI * share).sin().powi(2)
                } else {
                    0.0
                }
            }
            WearKind::Crack => {
                let mouth = (1.0 - along.abs() / CRACK_HALF_MM).max(0.0);
                mouth * ((CRACK_HALF_LENGTH_MM - above.abs()) / CRACK_END_MM).clamp(0.0, 1.0)
            }
            WearKind::Tip => {
                let [edge, end] = self.tip_fade_mm();
                let left = 1.0 - (profile_mm - edge) / (end - edge);
                left.clamp(0.0, 1.0).powi(2)
            }
            WearKind::Pit | WearKind::Buildup => {
                let away = along.hypot(above) / patch_radius_mm(kind);
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
        for (name, kind) in WearKind::NAMED {
            assert_eq!(read(&format!("12:r:80:{name}")).map(|w| w.kind), Ok(kind));
        }
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
