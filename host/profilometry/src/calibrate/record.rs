//! What an adjustment writes into the head's file.

use super::adjust::Adjusted;
use crate::date::Date;
use crate::head::{CalibrationRecord, FRAMES, HeadModel, HoldOut, geometry_blake3};

impl CalibrationRecord {
    /// The record of an adjusted head. `hold_out` is that of the head and of the one without residual fields.
    pub fn new(
        adjusted: &Adjusted,
        head: &HeadModel,
        target: &str,
        hold_out: [Option<HoldOut>; 2],
        date: Date,
        valid_days: u32,
    ) -> Self {
        let [hold_out, without_field] = hold_out;
        Self {
            date,
            expires: date.plus_days(valid_days),
            target: target.to_owned(),
            link: None,
            simulated: None,
            frames: FRAMES.map(str::to_owned).to_vec(),
            unit: "mm".to_owned(),
            blake3: geometry_blake3(head),
            views: adjusted.views as u32,
            dots: adjusted.marks as u32,
            dropped: adjusted.dropped as u32,
            camera_rms_px: adjusted.camera_rms_px,
            projector_rms_px: adjusted.projector_rms_px,
            depth_sigma_um: 1e3 * adjusted.depth_sigma_mm,
            lateral_sigma_um: 1e3 * adjusted.lateral_sigma_mm,
            hold_out,
            without_field,
        }
    }
}
