//! Adaptive illumination: which mirrors light which flank, computed from drawing and pose.
//!
//! Flanks face each other across a gap, and on bare steel each reflects light onto the other. The light of every mirror is traced
//! along one ray; the surface that it first meets on the drawing assigns it to a pass: left flanks, right flanks, or the rest
//! (lands and faces, which are used for registration). In each pass the other mirrors stay dark, so the light that a flank
//! reflects falls on a wall that is not measured in this pass.
//!
//! Lands face the lens and flanks do not: on a matt surface the rest would be several times as bright, and on steel its
//! highlights saturate first. The pass of the rest is therefore dimmed as a whole until both are equally bright by the drawing. A
//! pass has one brightness, because a brightness that varied across it would shift the phase.
//!
//! The pose is known to `margin_mm` before the first frame, so every pass extends that far beyond its own flanks. Rays are cast
//! for blocks of mirrors, which are smaller than the margin.

use flankscope_foundation::order::median;
use flankscope_foundation::rigid::{Camera, Projector, RigidError};
use flankscope_metrology::gear::Flank;
use flankscope_metrology::tool::Tool;
use flankscope_profilometry::head::{HeadModel, Mirrors};
use nalgebra::Vector3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use flankscope_metrology::view::PlannedView;

/// Sides of a block of mirrors, px.
const BLOCK: u32 = 4;
/// Rays end this far beyond the far end of the measuring volume.
const BEYOND_RATIO: f64 = 2.0;

/// Where the ray of a block of mirrors first meets the drawing.
#[derive(Clone, Copy, Debug)]
struct Met {
    region: Region,
    /// Relative irradiance of a matt surface: cosine divided by the square of the distance.
    brightness: f64,
}

/// Surfaces that a pass lights.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Region {
    /// Left flanks.
    Left,
    /// Right flanks.
    Right,
    /// Lands and faces.
    Rest,
}

impl Region {
    /// All passes, in the order in which they are shown.
    pub const ALL: [Self; 3] = [Self::Left, Self::Right, Self::Rest];

    /// Name of its folder.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Left => "left",
            Self::Right => "right",
            Self::Rest => "rest",
        }
    }
}

/// Which mirrors each pass lights.
#[derive(Clone, Debug)]
pub struct Passes {
    mirrors: Mirrors,
    view: PlannedView,
    margin_mm: f64,
    /// Number of blocks in a row.
    columns: usize,
    /// For each pass, whether a block is lit, row by row.
    lit: [Vec<bool>; 3],
    /// For each pass, relative brightness of its lit mirrors.
    brightness_ratios: [f64; 3],
}

/// Why the passes cannot be computed.
#[derive(Debug, thiserror::Error)]
pub enum PassesError {
    /// The tool or head file lacks an entry.
    #[error("{what} is missing; adaptive patterns need it (see docs/formats)")]
    Missing {
        /// The missing entry.
        what: &'static str,
    },
    /// The hand-eye transform is not a rigid motion.
    #[error(transparent)]
    Pose(#[from] RigidError),
    /// The margin is out of range.
    #[error(
        "a margin of {got} mm: must be 0 to 2 mm, what the pose may be off before the first frame"
    )]
    Margin {
        /// Requested margin, mm.
        got: f64,
    },
    #[error(
        "no mirror lights a flank of tooth {tooth}: check height, hand-eye and projector_from_camera"
    )]
    NothingLit {
        /// Tooth in the middle of the view.
        tooth: u32,
    },
}

impl Passes {
    /// Casts the ray of every block of mirrors on the drawing.
    pub fn new(
        tool: &Tool,
        head: &HeadModel,
        view: &PlannedView,
        margin_mm: f64,
    ) -> Result<Self, PassesError> {
        let missing = |what| PassesError::Missing { what };
        if !(0.0..=2.0).contains(&margin_mm) {
            return Err(PassesError::Margin { got: margin_mm });
        }
        let gear = tool
            .gear
            .as_ref()
            .ok_or(missing("[gear] in the tool file"))?;
        let volume = head.volume.ok_or(missing("[volume] in the head file"))?;
        let hand_eye = head
            .stage_from_camera
            .ok_or(missing("stage_from_camera in the head file"))?
            .rigid()?;
        let tool_from_camera = view.tool_from_camera(hand_eye);
        let camera_from_projector = head
            .projector_from_camera
            .rigid::<Projector, Camera>()?
            .inverse();
        let tool_from_projector = *(tool_from_camera * camera_from_projector).isometry();
        let origin = tool_from_projector.translation.vector;
        let mirrors = head.mirrors();
        let columns = mirrors.columns.div_ceil(BLOCK) as usize;
        let rows = mirrors.rows.div_ceil(BLOCK) as usize;
        let meets = |block: usize| -> Option<Met> {
            let [column, row] = [block % columns, block / columns]
                .map(|at| f64::from(BLOCK) * (at as f64 + 0.5) - 0.5);
            let [x, y] = head.projector.undistort([column, row])?;
            let direction = (tool_from_projector * Vector3::new(x, y, 1.0)).normalize();
            let reach_mm = [0.0, BEYOND_RATIO * volume.far_mm];
            let met = tool
                .surface
                .first_met(origin.into(), direction.into(), reach_mm)?;
            let away = Vector3::from(met.point) - origin;
            let cosine = -away.normalize().dot(&Vector3::from(met.normal));
            let region = match gear.place(met.point, met.normal) {
                Some(place) if place.flank == Flank::Left => Region::Left,
                Some(_) => Region::Right,
                None => Region::Rest,
            };
            Some(Met {
                region,
                brightness: cosine.max(0.0) / away.norm_squared(),
            })
        };
        let met: Vec<Option<Met>> = (0..columns * rows).into_par_iter().map(meets).collect();
        let brightness = |wanted: fn(Region) -> bool| {
            let of = met.iter().flatten().filter(|met| wanted(met.region));
            let mut of: Vec<f64> = of.map(|met| met.brightness).collect();
            median(&mut of)
        };
        let flanks = brightness(|region| region != Region::Rest);
        let rest = brightness(|region| region == Region::Rest);
        let dimmed = match (flanks, rest) {
            (Some(flanks), Some(rest)) if flanks > 0.0 && rest > flanks => flanks / rest,
            _ => 1.0,
        };
        // The margin in blocks, at the nearest distance of the surface.
        let focal_px = head.projector.focal_px;
        let margin = focal_px
            .map(|px| (margin_mm * px / (volume.near_mm * f64::from(BLOCK))).ceil() as usize);
        let lit = Region::ALL.map(|of| {
            let is_own = |met: &Option<Met>| met.is_some_and(|met| met.region == of);
            let own: Vec<bool> = met.iter().map(is_own).collect();
            widened(&own, columns, margin)
        });
        if !lit[0].contains(&true) && !lit[1].contains(&true) {
            return Err(PassesError::NothingLit { tooth: view.tooth });
        }
        Ok(Self {
            mirrors,
            view: view.clone(),
            margin_mm,
            columns,
            lit,
            brightness_ratios: [1.0, 1.0, dimmed],
        })
    }

    /// Layout of the mirrors.
    pub fn mirrors(&self) -> Mirrors {
        self.mirrors
    }

    /// Position of the stages.
    pub fn view(&self) -> &PlannedView {
        &self.view
    }

    /// Distance by which a pass extends beyond its own flanks, mm.
    pub fn margin_mm(&self) -> f64 {
        self.margin_mm
    }

    /// Whether a pass lights a mirror.
    #[must_use]
    pub fn is_lit(&self, pass: Region, column: u32, row: u32) -> bool {
        let block = (row / BLOCK) as usize * self.columns + (column / BLOCK) as usize;
        self.lit[pass as usize].get(block).is_some_and(|lit| *lit)
    }

    /// Relative brightness of the mirrors that a pass lights.
    #[must_use]
    pub fn brightness_ratio(&self, pass: Region) -> f64 {
        self.brightness_ratios[pass as usize]
    }

    /// Dims the mirrors that a pass lights, and darkens the others.
    pub fn mask(&self, pass: Region, shown: &mut [u8]) {
        let ratio = self.brightness_ratio(pass);
        let mirrors = (0..self.mirrors.rows)
            .flat_map(|row| (0..self.mirrors.columns).map(move |column| (column, row)));
        for (brightness, (column, row)) in shown.iter_mut().zip(mirrors) {
            *brightness = match self.is_lit(pass, column, row) {
                true => (ratio * f64::from(*brightness)).round() as u8,
                false => 0,
            };
        }
    }

    /// Number of mirrors that a pass lights here but not in `other`, which must be of the same head.
    #[must_use]
    pub fn beyond(&self, other: &Self, pass: Region) -> usize {
        let blocks = self.lit[pass as usize]
            .iter()
            .zip(&other.lit[pass as usize]);
        let beyond = blocks.filter(|(lit, other)| **lit && !**other).count();
        beyond * (BLOCK * BLOCK) as usize
    }

    /// Fraction of the mirrors that a pass lights.
    #[must_use]
    pub fn lit_ratio(&self, pass: Region) -> f64 {
        let lit = &self.lit[pass as usize];
        lit.iter().filter(|lit| **lit).count() as f64 / lit.len() as f64
    }
}

/// Dilates a set of blocks by `margin` columns and rows.
fn widened(set: &[bool], columns: usize, [across, down]: [usize; 2]) -> Vec<bool> {
    let rows = set.len() / columns;
    let near =
        |at: usize, reach: usize, end: usize| at.saturating_sub(reach)..(at + reach + 1).min(end);
    let along = |at: usize| {
        let (row, column) = (at / columns, at % columns);
        near(column, across, columns).any(|other| set[row * columns + other])
    };
    let rows_widened: Vec<bool> = (0..set.len()).map(along).collect();
    let over = |at: usize| {
        let (row, column) = (at / columns, at % columns);
        near(row, down, rows).any(|other| rows_widened[other * columns + column])
    };
    (0..set.len()).map(over).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_grow_by_the_margin_and_stay_on_the_chip() {
        let mut set = vec![false; 7 * 5];
        set[2 * 7 + 1] = true;
        let wide = widened(&set, 7, [2, 1]);
        for (at, lit) in wide.iter().enumerate() {
            let (row, column) = (at / 7, at % 7);
            assert_eq!(
                *lit,
                (1..=3).contains(&row) && column <= 3,
                "{row} {column}"
            );
        }
    }
}
