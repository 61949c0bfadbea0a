//! Result of a view: points, and the reasons why the other cells gave none.

mod patches;

use flankscope_foundation::order::median_of;
use serde::Serialize;

use crate::phase::parts::LightParts;

pub use patches::PatchOptions;
pub(crate) use patches::{Depths, small_patches};

/// Points of one view. All vectors have one entry per point, in row order of the cells.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cloud {
    /// Position in the camera frame.
    pub points_mm: Vec<[f64; 3]>,
    /// Predicted standard uncertainty of z; the point moves along its camera ray.
    pub sigma_z_mm: Vec<f32>,
    /// Column and row in the grid of blocks; on the core grid, of the pixel nearest to the core.
    pub cell: Vec<[u16; 2]>,
    /// Amplitude of the finest fringes in electrons per millisecond, summed over the cell's pixels: it says nothing of which exposures
    /// saturated.
    pub fringes_e_per_ms: Vec<f32>,
    /// Light straight from the projector and over other ways.
    pub light: Vec<LightParts>,
    /// Modulation for the mask: smoothed standard deviation over the finest fringes' steps, counts per pixel and exposure.
    /// Empty when no mask was asked for; a mask with threshold 0 drops nothing.
    pub fringes_dn: Vec<f32>,
}

impl Cloud {
    pub(crate) fn with_capacity(points: usize) -> Self {
        Self {
            points_mm: Vec::with_capacity(points),
            sigma_z_mm: Vec::with_capacity(points),
            cell: Vec::with_capacity(points),
            fringes_e_per_ms: Vec::with_capacity(points),
            light: Vec::new(),
            fringes_dn: Vec::new(),
        }
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.points_mm.len()
    }

    /// Whether it has no points.
    pub fn is_empty(&self) -> bool {
        self.points_mm.is_empty()
    }
}

/// Decoded projector column of a cell, before triangulation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CellColumn {
    /// Position of the cell: column, row of the camera.
    pub pixel: [f64; 2],
    /// Mean light over the finest frequency's steps in electrons, NaN where every exposure was saturated.
    pub mean_e: f64,
    /// Contrast of those steps; not a number likewise.
    pub contrast: f64,
    /// Projector column that lights the cell, where it was decoded.
    pub column_px: Option<f64>,
}

/// Numbers of cells without a point, by the first reason found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Rejected {
    /// Every exposure was saturated.
    pub saturated: usize,
    /// Contrast below the limit: no fringes here.
    pub low_contrast: usize,
    /// Amplitude of a frequency below the floor: what is left of the fringes may be rounding.
    pub low_modulation: usize,
    /// Too noisy to tell the fringe order.
    pub uncertain_order: usize,
    /// The frequencies name different columns, here or all about: light over a second surface, an edge.
    pub disagreeing: usize,
    /// The phase belongs to no projector column, or to none that counts.
    pub outside_projector: usize,
    /// The ray meets the sheet of light outside the measuring volume, or nowhere.
    pub outside_volume: usize,
    /// Predicted uncertainty above the limit.
    pub uncertain_depth: usize,
    /// The frames do not follow one fringe: vibration, a flickering lamp, saturation.
    pub inconsistent: usize,
    /// The exposures do not show one scene: beyond noise their phases or amplitudes differ.
    pub exposures_disagree: usize,
    /// Dropped by the mask.
    pub masked: usize,
    /// Part of a small isolated patch.
    pub isolated: usize,
}

impl Rejected {
    /// Each reason by its name.
    pub fn reasons(&self) -> [(&'static str, usize); 12] {
        [
            ("saturated", self.saturated),
            ("low_contrast", self.low_contrast),
            ("low_modulation", self.low_modulation),
            ("uncertain_order", self.uncertain_order),
            ("disagreeing", self.disagreeing),
            ("outside_projector", self.outside_projector),
            ("outside_volume", self.outside_volume),
            ("uncertain_depth", self.uncertain_depth),
            ("inconsistent", self.inconsistent),
            ("exposures_disagree", self.exposures_disagree),
            ("masked", self.masked),
            ("isolated", self.isolated),
        ]
    }

    /// All of them.
    pub fn total(&self) -> usize {
        self.reasons().iter().map(|(_, count)| count).sum()
    }
}

/// Parts of the light of a view's points; each figure is a median of its own.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LightMedians {
    /// Straight from the projector with every mirror on, electrons.
    pub direct_e: f64,
    /// By any other path, electrons.
    pub global_e: f64,
    /// Share of the latter.
    pub global_ratio: f64,
}

impl LightMedians {
    /// Medians over some points; `None` without any.
    pub fn from_points(light: &[LightParts]) -> Option<Self> {
        let median = |part: fn(&LightParts) -> f64| median_of(light.iter().map(part));
        Some(Self {
            direct_e: median(|light| light.direct_e)?,
            global_e: median(|light| light.global_e)?,
            global_ratio: median(|light| light.global_ratio())?,
        })
    }
}

/// Comparison of both projectors in a view.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Projectors {
    /// Cells that each of them measured alone.
    pub alone: [usize; 2],
    /// Cells that both measured, and agreed on.
    pub both: usize,
    /// Cells that both measured without agreeing: none of them is a point.
    pub disagreeing: usize,
    /// Depth by the second minus depth by the first over all cells that both measured, median, um; absent without any. It is what
    /// their calibrations differ by.
    pub apart_um: Option<f64>,
}

/// A decoded view.
#[derive(Clone, Debug, PartialEq)]
pub struct Decoded {
    /// The points.
    pub cloud: Cloud,
    /// Cells looked at: points plus rejected.
    pub cells: usize,
    /// Numbers of the cells without a point, in row order: [`crate::decode::Decoder::direction`] says where they look.
    pub without_point: Vec<u32>,
    /// For each of them, whether no fringes were seen that belong to a place within the measuring volume; otherwise there was light,
    /// but no valid point.
    pub is_dark: Vec<bool>,
    /// Cells without a point.
    pub rejected: Rejected,
    /// Ratio of the frames' scatter to the one predicted from light and sensor, median over the view; limits and
    /// uncertainties have been raised by it. 1 unless [`crate::decode::ConsistencyOptions::relative_to_view`].
    pub frame_noise_ratio: f64,
    /// Direct and global light, medians over the points; `None` without any.
    pub light: Option<LightMedians>,
    /// Median contrast (amplitude over mean) of each frequency over the cells with a point, low to high; empty without points.
    /// Light that comes over a second surface has lost its fringes, the sooner the finer they are: it is at most what this lacks of
    /// one (Nayar et al., Fast separation of direct and global components, SIGGRAPH 2006), and the optics take their part of that.
    pub contrast: Vec<f64>,
    /// Comparison of both projectors; `None` for a head with one.
    pub projectors: Option<Projectors>,
}
