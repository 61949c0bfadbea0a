//! The live view for setting up a head at the die: levels, contrast, focus and points of each capture, and the exposures that would
//! suit. Nothing is judged by it, and no history keeps it.

use flankscope_profilometry::decode::Rejected;
use serde::Serialize;

use crate::origin::Origin;

/// All captures of one view, and what follows from the last one.
#[derive(Clone, Debug, Serialize)]
pub struct SetupView {
    /// Link, station, head and operator.
    pub origin: Origin,
    /// Name of the tool.
    pub tool: String,
    /// The tooth or patch in the middle of the view.
    pub tooth: u32,
    /// Name of the pattern set.
    pub pattern_set: String,
    /// Largest count of the sensor, DN.
    pub full_scale_dn: u16,
    /// Pixels above this count are taken as saturated, DN.
    pub saturation_limit_dn: u16,
    /// What the head file says of a view.
    pub expected: ExpectedByHead,
    /// The captures, the newest last; of a long run the last [`SetupView::KEPT`] ones.
    pub captures: Vec<SetupCapture>,
    /// Captures that could not be used, the newest last, as many at most.
    pub lost: Vec<LostCapture>,
    /// Why the run ended early, if it did.
    pub stopped: Option<String>,
    /// Exposures that would suit, by the last capture.
    pub proposal: Option<ProposedExposures>,
}

/// Figures of the head file beside which measured ones are shown.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ExpectedByHead {
    /// Level without light, DN (`sensor.offset_dn`).
    pub dark_dn: f64,
    /// Contrast of the finest fringes on a matt, convex surface in focus (`fringe_contrast`).
    pub contrast: Option<f64>,
    /// Amplitude of the finest fringes that is enough by the sensor's noise in the file, DN per pixel.
    pub modulation_dn: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SetupCapture {
    /// Its number in the run, from 1.
    pub number: u32,
    /// Date and time, ISO 8601, UTC.
    pub date: String,
    /// Median level of the dark frame, DN.
    pub dark_dn: Option<f64>,
    /// Each exposure, shortest first.
    pub exposures: Vec<ExposureLevels>,
    /// Median contrast (amplitude over mean) of each frequency over the cells with a point, low to high; empty without points.
    pub contrast: Vec<f64>,
    /// Focus figure: mean contrast of the finest fringes in the middle of the field, a quarter of its radius; absent where fewer
    /// than 200 cells there have fringes.
    pub focus_contrast: Option<f64>,
    /// Cells of the field.
    pub cells: usize,
    /// Cells with a usable point.
    pub points: usize,
    /// Cells without one, by the first reason found.
    pub rejected: Rejected,
}

/// Levels of all patterns at one exposure, over the pixels of the image circle.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ExposureLevels {
    /// Exposure time, µs.
    pub exposure_us: u32,
    /// Median level, DN.
    pub median_dn: f64,
    /// Level that one pixel in ten thousand exceeds, DN.
    pub bright_dn: f64,
    /// Highest level, DN.
    pub max_dn: f64,
    /// Share of saturated pixels, 0..1.
    pub saturated_pixel_ratio: f64,
    /// Share of the cells that are not used at this exposure because a pixel of theirs is saturated, 0..1.
    pub saturated_cell_ratio: f64,
    /// Median amplitude of the finest fringes over the cells with fringes, DN per pixel; by the linear response, from the exposures
    /// that do not saturate.
    pub modulation_dn: Option<f64>,
    /// The same, of the weakest twentieth of those cells.
    pub weak_modulation_dn: Option<f64>,
    /// Pixels in [`ExposureLevels::BINS`] equal parts of the sensor's levels.
    pub histogram: Vec<u64>,
}

/// A capture that could not be used.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct LostCapture {
    /// Its number in the run, from 1.
    pub number: u32,
    pub reason: String,
}

/// Exposures proposed by a capture.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ProposedExposures {
    /// Exposure times, ascending, µs.
    pub exposures_us: Vec<u32>,
    /// The line for the head file.
    pub line: String,
    /// What each is for, and what limits it.
    pub reasons: Vec<String>,
    /// Whether light was measured that they follow from; otherwise they are a step in the right direction, to be measured again.
    pub is_final: bool,
}

impl SetupView {
    /// Captures that are kept.
    pub const KEPT: usize = 1000;

    pub fn add(&mut self, capture: SetupCapture) {
        keep_last(&mut self.captures, capture);
    }

    /// Adds a capture that could not be used.
    pub fn lose(&mut self, lost: LostCapture) {
        keep_last(&mut self.lost, lost);
    }
}

impl SetupCapture {
    /// Share of the cells with a usable point, 0..1.
    pub fn point_ratio(&self) -> f64 {
        self.points as f64 / self.cells.max(1) as f64
    }

    /// Contrast of the finest fringes, median over the cells with a point.
    pub fn finest_contrast(&self) -> Option<f64> {
        self.contrast.last().copied()
    }
}

impl ExposureLevels {
    /// Parts of a histogram.
    pub const BINS: usize = 64;
}

fn keep_last<T>(of: &mut Vec<T>, new: T) {
    if of.len() == SetupView::KEPT {
        of.remove(0);
    }
    of.push(new);
}
