//! Features of a tool that are judged, and the place of a surface point on them: flanks of a gear, or patches of the CAD.
//!
//! Either way a feature has a number and a side, and is laid out flat by two lengths, along and up. A tooth has two flanks, laid
//! out by profile and height; a patch has one side, [`Flank::Face`], laid out by its own frame.

use crate::gear::{Flank, FlankPlace, GearData};
use crate::patch::{Patch, Patches};
use crate::surface::Closest;

/// The features of a tool.
#[derive(Debug, Clone, Copy)]
pub enum Features<'a> {
    /// Flanks, by tooth.
    Gear(&'a GearData),
    /// Patches, by number.
    Patches(&'a Patches),
}

impl<'a> From<&'a GearData> for Features<'a> {
    fn from(gear: &'a GearData) -> Self {
        Self::Gear(gear)
    }
}

impl<'a> Features<'a> {
    /// The gear, where that is it.
    pub fn gear(self) -> Option<&'a GearData> {
        match self {
            Self::Gear(gear) => Some(gear),
            Self::Patches(_) => None,
        }
    }

    /// A patch, where that is it.
    pub fn patch(self, number: u32) -> Option<&'a Patch> {
        match self {
            Self::Gear(_) => None,
            Self::Patches(patches) => patches.get(number),
        }
    }

    /// Name of the feature with this number: a tooth by its number, a patch by its name.
    pub fn name(self, number: u32) -> String {
        match self.patch(number) {
            Some(patch) => format!("patch {}", patch.name),
            None => format!("tooth {number}"),
        }
    }

    /// Sides that a number has.
    pub fn sides(self) -> &'static [Flank] {
        match self {
            Self::Gear(_) => &Flank::BOTH,
            Self::Patches(_) => &[Flank::Face],
        }
    }

    /// Place of a surface point; none off all features.
    pub fn place(self, closest: &Closest) -> Option<FlankPlace> {
        self.place_near(closest.point, closest)
    }

    /// Place of a point on the tangent plane of a surface point.
    pub fn place_near(self, point: [f64; 3], closest: &Closest) -> Option<FlankPlace> {
        match self {
            Self::Gear(gear) => gear.place(point, closest.normal),
            Self::Patches(patches) => {
                let (number, patch) = patches.at(closest.triangle, point)?;
                let [along_mm, up_mm] = patch.place_mm(point);
                Some(FlankPlace {
                    tooth: number,
                    flank: Flank::Face,
                    radius_mm: along_mm,
                    profile_mm: along_mm,
                    height_mm: up_mm,
                })
            }
        }
    }

    /// Length along at which a zone begins or ends that is stated by radius; a patch's is stated by that length.
    pub fn along_mm(self, radius_mm: f64) -> f64 {
        self.gear()
            .map_or(radius_mm, |gear| gear.profile_mm(radius_mm))
    }

    /// Point of the nominal surface at lengths along and up, mm: the involute, or the reference plane of a patch. None for an
    /// unknown patch and inside a gear's base circle.
    pub fn point_mm(
        self,
        number: u32,
        flank: Flank,
        [along_mm, up_mm]: [f64; 2],
    ) -> Option<[f64; 3]> {
        match self {
            Self::Gear(gear) => gear.flank_point(number, flank, gear.radius_mm(along_mm), up_mm),
            Self::Patches(patches) => Some(patches.get(number)?.point_mm([along_mm, up_mm])),
        }
    }

    /// Unit normal of the nominal surface there, out of the material.
    pub fn outward(self, number: u32, flank: Flank, at_mm: [f64; 2]) -> Option<[f64; 3]> {
        match self {
            Self::Gear(gear) => {
                Some(gear.flank_normal(flank, self.point_mm(number, flank, at_mm)?))
            }
            Self::Patches(patches) => Some(patches.get(number)?.axes[2]),
        }
    }
}
