//! Thresholds and smoothing of a decoder.

use super::DecodeError;
use crate::accumulate::consistency::ConsistencyOptions;
use serde::{Deserialize, Serialize};

use crate::cloud::PatchOptions;
use crate::head::HeadModel;
use crate::phase::mask::MaskOptions;

/// Cell of the grid: a block of pixels or a fibre core.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum GridKind {
    /// Blocks of pixels: for a lens.
    #[default]
    Pixel,
    /// Cores of the head's map: for a fibre bundle.
    Core,
}

/// Thresholds and smoothing. [`DecodeOptions::for_head`] is the instrument's choice.
#[derive(Clone, Debug, PartialEq)]
pub struct DecodeOptions {
    /// Cell of the grid: a block of pixels or a fibre core.
    pub grid: GridKind,
    /// Pixels along a cell's side, on the pixel grid.
    pub binning: usize,
    /// Whether a view starts with a dark frame.
    pub dark_frame: bool,
    /// Least contrast B / A in every frequency.
    pub min_contrast: f64,
    /// Least amplitude of every frequency, counts per pixel and exposure. `None`: where phasors are smoothed, what leaves the order
    /// sure without smoothing, for rounding and a sensor's dark pattern are the same in every cell and do not average. Where they
    /// are not, the order's own noise limit asks for more.
    pub min_modulation_dn: Option<f64>,
    /// Largest standard uncertainty of the depth.
    pub max_sigma_z_mm: Option<f64>,
    /// Sigma of the Gaussian on the phasors of the finest frequency, camera pixels; 0 for none.
    pub smoothing_px: f64,
    /// The same for all coarser frequencies, whose only task is the fringe order.
    pub coarse_smoothing_px: f64,
    /// Drops cells whose frames do not follow one fringe.
    pub consistency: Option<ConsistencyOptions>,
    /// Drops cells about which the frequencies name other columns.
    pub order_consistency: OrderConsistency,
    /// The article's mask.
    pub mask: Option<MaskOptions>,
    /// Drops small isolated patches.
    pub patches: Option<PatchOptions>,
}

/// Required certainty of the fringe orders about a cell, by the measured scatter instead of the predicted noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrderConsistency {
    /// Least distance to the next order in standard deviations measured from how far the clues about the cell miss, which takes
    /// in what no prediction knows: a second reflection, a lamp, a bent response. As clues must lie within a quarter of the
    /// distance, a wrong order passes with an error of three quarters and more.
    pub separation: f32,
    /// Least share of the cells about one in which the frequencies agree. Where they name unrelated columns half of the cells
    /// agree by chance.
    pub agreeing_share: f32,
}

impl OrderConsistency {
    /// For verdicts: a wrong order passes with an error of five standard deviations, one cell in five million; where nine of ten
    /// agree at most one of nine can be a chance, and a quarter of the distance is more than 1.6 standard deviations of the
    /// error, three quarters 4.9. Costs the rims of surfaces before an empty background, whose cells disagree, too.
    pub const INSTRUMENT: Self = Self {
        separation: 7.0,
        agreeing_share: 0.9,
    };
    /// For scenes of whose sensor nothing is known: three standard deviations, and more agreement than chance gives.
    pub const SCENE: Self = Self {
        separation: 4.0,
        agreeing_share: 0.7,
    };
}

impl DecodeOptions {
    /// Cores if the head has a map of them, else blocks of the head's binning; a dark frame first, contrast of at least 0.05, patches of at least 10 cells.
    pub fn for_head(head: &HeadModel) -> Self {
        Self {
            grid: if head.core_map.is_some() {
                GridKind::Core
            } else {
                GridKind::Pixel
            },
            binning: head.binning as usize,
            dark_frame: true,
            min_contrast: 0.05,
            min_modulation_dn: None,
            max_sigma_z_mm: None,
            smoothing_px: 0.0,
            coarse_smoothing_px: 0.0,
            // Without a sensor model no noise can be predicted.
            consistency: head.sensor.map(|_| ConsistencyOptions::INSTRUMENT),
            order_consistency: OrderConsistency::INSTRUMENT,
            mask: None,
            // 72 degrees of surface tilt: steeper surfaces hardly return light to a lens.
            patches: Some(PatchOptions {
                min_cells: 10,
                max_slope: 3.0,
            }),
        }
    }

    /// For images of any scene from other instruments, by a head that knows its sensor ([`HeadModel::take_sensor`]): contrast of at least
    /// [`Self::IMAGE_CONTRAST`], patches of at least [`Self::IMAGE_PATCH`] cells, phasors smoothed by less than a lens blurs. The
    /// noise of an assumed sensor rejects no cell.
    pub fn for_images(head: &HeadModel, dark_frame: bool, sensor_assumed: bool) -> Self {
        let defaults = Self::for_head(head).with_smoothed_orders();
        Self {
            dark_frame,
            min_contrast: Self::IMAGE_CONTRAST,
            smoothing_px: match defaults.grid {
                GridKind::Pixel => 0.7,
                GridKind::Core => 0.0,
            },
            consistency: Some(ConsistencyOptions::for_images(match sensor_assumed {
                true => 0.0,
                false => ConsistencyOptions::INSTRUMENT.least_probability,
            })),
            order_consistency: match sensor_assumed {
                true => OrderConsistency::SCENE,
                false => OrderConsistency::INSTRUMENT,
            },
            patches: defaults.patches.map(|patches| PatchOptions {
                min_cells: Self::IMAGE_PATCH,
                ..patches
            }),
            ..defaults
        }
    }

    /// Least contrast of images from other instruments.
    pub const IMAGE_CONTRAST: f64 = 0.1;
    /// Cells of the smallest patch of images from other instruments.
    pub const IMAGE_PATCH: usize = 200;

    /// The same with smoothing of what only counts fringes, on the pixel grid; points stay their own cell's. Cores stay as they are.
    pub fn with_smoothed_orders(self) -> Self {
        let coarse_smoothing_px = match self.grid {
            GridKind::Core => 0.0,
            GridKind::Pixel => 2.0,
        };
        Self {
            coarse_smoothing_px,
            ..self
        }
    }

    /// Checks every option against its limits.
    #[rustfmt::skip]
    pub(crate) fn check(&self) -> Result<(), DecodeError> {
        let (smoothing_px, coarse_px) = (self.smoothing_px, self.coarse_smoothing_px);
        let on_pixels = self.grid == GridKind::Pixel;
        let none_on_cores = "must be 0 (none) on the core grid: it acts on pixels";
        let floor_dn = self.min_modulation_dn.unwrap_or(0.0);
        let max_sigma_mm = self.max_sigma_z_mm.unwrap_or(1.0);
        let [probability, response] =
            self.consistency.map_or([0.0; 2], |gate| [gate.least_probability, gate.response_ratio]);
        let [mask_dn, mask_px] = self.mask.map_or([0.0; 2], |mask| [mask.threshold_dn, mask.smoothing_px]);
        let max_slope = self.patches.map_or(1.0, |patches| patches.max_slope);
        for (holds, option, got, expected) in [
            ((1..=64).contains(&self.binning), "binning", self.binning as f64, "must be 1 to 64 pixels"),
            ((0.0..1.0).contains(&self.min_contrast), "min_contrast", self.min_contrast, "must be at least 0 and below 1"),
            ((0.0..=100.0).contains(&smoothing_px), "smoothing_px", smoothing_px, "must be 0 to 100 pixels"),
            ((0.0..=100.0).contains(&coarse_px), "coarse_smoothing_px", coarse_px, "must be 0 to 100 pixels"),
            (on_pixels || smoothing_px == 0.0, "smoothing_px", smoothing_px, none_on_cores),
            (on_pixels || coarse_px == 0.0, "coarse_smoothing_px", coarse_px, none_on_cores),
            ((0.0..=65_535.0).contains(&floor_dn), "min_modulation_dn", floor_dn, "must be 0 to 65535 counts"),
            (max_sigma_mm > 0.0, "max_sigma_z_mm", max_sigma_mm, "must be positive"),
            ((0.0..0.5).contains(&probability), "consistency.least_probability", probability, "must be at least 0 and below 0.5"),
            ((0.0..0.5).contains(&response), "consistency.response_ratio", response, "must be at least 0 and below 0.5"),
            (mask_dn >= 0.0 && mask_dn.is_finite(), "mask.threshold_dn", mask_dn, "must be at least 0 counts"),
            ((0.0..=100.0).contains(&mask_px), "mask.smoothing_px", mask_px, "must be 0 to 100 pixels"),
            (max_slope > 0.0 && max_slope.is_finite(), "patches.max_slope", max_slope, "must be positive"),
        ] {
            if !holds {
                return Err(DecodeError::Option { option, got, expected });
            }
        }
        Ok(())
    }
}
