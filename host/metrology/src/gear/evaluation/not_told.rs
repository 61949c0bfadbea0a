//! Reasons for which a figure is missing, and their remedies.

use serde::ser::SerializeStruct;

use crate::gear::Flank;

/// Reason for which a figure cannot be stated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum NotTold {
    /// A part of the profile was not seen.
    #[error(
        "the profile has a gap from radius {:.3} to {:.3} mm: {points} points in its band, {least} are needed at every place",
        radii_mm[0], radii_mm[1]
    )]
    ProfileGap {
        /// Ends of the first gap, root end first, mm.
        radii_mm: [f64; 2],
        /// Points in the band.
        points: usize,
        /// Points needed under the filter at every place.
        least: usize,
    },
    /// A part of the face width was not seen near the measuring circle.
    #[error(
        "the helix has a gap from height {:.2} to {:.2} mm: {points} points near the measuring circle, {least} are needed at every place",
        heights_mm[0], heights_mm[1]
    )]
    HelixGap {
        /// Ends of the first gap, mm.
        heights_mm: [f64; 2],
        /// Points near the measuring circle.
        points: usize,
        /// Points needed under the filter at every place.
        least: usize,
    },
    /// Points walk along the profile as they walk along the helix.
    #[error(
        "the points' radius follows their height: profile and helix deviations cannot be told apart"
    )]
    Entangled,
    /// Too few points where pitch is measured.
    #[error(
        "{points} points at the measuring circle at mid face, at least {least} that span radius and height are needed"
    )]
    FewPoints {
        /// Points there.
        points: usize,
        /// Least number.
        least: usize,
    },
    /// The flank is covered too unevenly for its terms.
    #[error("{points} points do not fix the six terms of the flank")]
    Terms {
        /// Points on the flank.
        points: usize,
    },
    /// No flank gave this figure.
    #[error("none of the {flanks} flanks seen gives it; tooth {tooth} {flank}: {first}")]
    NoFlank {
        /// Flanks of which something was seen.
        flanks: usize,
        /// The first one's tooth.
        tooth: u32,
        /// The first one's side.
        flank: Flank,
        /// Reason of the first one.
        first: Box<NotTold>,
    },
    /// No two (or three) neighbouring flanks were seen.
    #[error("no {count} neighbouring {flank} flanks have a position")]
    NoNeighbours {
        /// Number of consecutive ones that are needed.
        count: usize,
        /// Side.
        flank: Flank,
    },
    /// A figure over the whole gear without the whole gear.
    #[error(
        "{missing} of {teeth} teeth have no {flank} flank with a position, the first is tooth {first}"
    )]
    TeethMissing {
        /// Side.
        flank: Flank,
        /// Teeth without position.
        missing: usize,
        /// All teeth.
        teeth: usize,
        /// The first missing.
        first: u32,
    },
    /// Nothing was seen.
    #[error("nothing was seen")]
    NotSeen,
    /// Flanks on one side of the gear fix no axis.
    #[error("the flanks seen do not fix an axis")]
    Axis,
}

impl NotTold {
    /// A short stable name.
    pub fn code(&self) -> &'static str {
        match self {
            Self::ProfileGap { .. } => "profile_gap",
            Self::HelixGap { .. } => "helix_gap",
            Self::Entangled => "entangled",
            Self::FewPoints { .. } => "few_points",
            Self::Terms { .. } => "terms",
            Self::NoFlank { .. } => "no_flank",
            Self::NoNeighbours { .. } => "no_neighbours",
            Self::TeethMissing { .. } => "teeth_missing",
            Self::NotSeen => "not_seen",
            Self::Axis => "axis",
        }
    }

    /// Remedy.
    pub fn next_step(&self) -> &'static str {
        match self {
            Self::ProfileGap { .. } => {
                "merge single views of mid face (a scan's map.ply is too coarse for a profile), widen the band (--band-mm), or name \
                 the radii that were seen (--usable-mm)"
            }
            Self::HelixGap { .. } => {
                "scan the whole height of the flank, or widen the band (--band-mm)"
            }
            Self::Entangled => "merge views that see several radii at every height",
            Self::FewPoints { .. } => "merge more views of mid face, or widen the band (--band-mm)",
            Self::Terms { .. } => "scan more of the flank's profile and height",
            Self::NoFlank { first, .. } => first.next_step(),
            Self::NoNeighbours { .. } => {
                "scan neighbouring teeth at mid face, or widen the band there (--band-mm)"
            }
            Self::TeethMissing { .. } => {
                "scan all teeth, both sides, at mid face, or widen the band there (--band-mm)"
            }
            Self::NotSeen => "scan the gear's flanks",
            Self::Axis => "scan flanks all around the gear",
        }
    }
}

impl serde::Serialize for NotTold {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut fields = serializer.serialize_struct("NotTold", 3)?;
        fields.serialize_field("code", self.code())?;
        fields.serialize_field("reason", &self.to_string())?;
        fields.serialize_field("next", self.next_step())?;
        fields.end()
    }
}

/// A figure, or the reason for which it is missing.
pub(super) fn split<T>(told: Result<T, NotTold>) -> (Option<T>, Option<NotTold>) {
    match told {
        Ok(figure) => (Some(figure), None),
        Err(why) => (None, Some(why)),
    }
}

/// The two as they were before [`split`].
pub(super) fn joined<T: Copy>(figure: Option<T>, why: &Option<NotTold>) -> Result<T, NotTold> {
    figure.ok_or_else(|| why.clone().unwrap_or(NotTold::NotSeen))
}
