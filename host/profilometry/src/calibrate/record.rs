//! The `[calibration]` record of a head, from an adjustment.

use super::adjust::Adjusted;
use super::board::{Board, BoardAdjusted};
use crate::head::{
    ApartRecord, BoardRecord, CalibrationRecord, FRAMES, HeadModel, HoldOut, geometry_blake3,
};
use flankscope_foundation::date::Date;

/// Mark in the name of a head whose values are those of its drawing.
const DRAWN: &str = ", drawing values";

impl CalibrationRecord {
    /// The record of an adjusted head. `hold_out` is that of the head and of the one without residual fields, `apart` how well two
    /// projectors go together.
    pub fn new(
        adjusted: &Adjusted,
        head: &HeadModel,
        target: &str,
        hold_out: [Option<HoldOut>; 2],
        apart: Option<ApartRecord>,
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
            farther_sigma_um: adjusted.farther_sigma_mm.map(|mm| 1e3 * mm),
            hold_out,
            without_field,
            board: None,
            second_projector: apart,
            focus: None,
        }
    }

    /// Name of the calibrated head, which every result states: the name of the head that the calibration started from, the date, and
    /// the first digits of the hash that identifies the calibrated geometry.
    #[must_use]
    pub fn name_of(&self, start: &str) -> String {
        let ends = [DRAWN, ", calibration "].map(|mark| start.find(mark).unwrap_or(start.len()));
        let head = &start[..ends[0].min(ends[1])];
        let id = &self.blake3[..8.min(self.blake3.len())];
        format!("{head}, calibration {id} of {}", self.date)
    }

    /// The record of a head calibrated with an ordinary board; `pitch_sigma_mm` is the standard uncertainty of a certified pitch.
    pub fn from_board(
        adjusted: &BoardAdjusted,
        board: &Board,
        pitch_sigma_mm: Option<f64>,
        date: Date,
        valid_days: u32,
    ) -> Self {
        let [depth_sigma_um, lateral_sigma_um] = adjusted.sigma_mm.map(|mm| 1e3 * mm);
        let used = adjusted.poses.iter().filter(|pose| pose.used).count();
        let scale = pitch_sigma_mm.is_none().then_some("scale");
        let unknown = ["stage_from_camera", "sensor", "volume"]
            .into_iter()
            .chain(scale);
        Self {
            date,
            expires: date.plus_days(valid_days),
            target: board.to_string(),
            link: None,
            simulated: None,
            frames: FRAMES[..2].iter().map(|&frame| frame.to_owned()).collect(),
            unit: "mm".to_owned(),
            blake3: geometry_blake3(&adjusted.head),
            views: used as u32,
            dots: adjusted.points as u32,
            dropped: adjusted.dropped as u32,
            camera_rms_px: adjusted.camera_rms_px[0],
            projector_rms_px: adjusted.projector_rms_px[0],
            depth_sigma_um,
            lateral_sigma_um,
            farther_sigma_um: None,
            hold_out: adjusted.hold_out,
            without_field: None,
            board: Some(BoardRecord {
                kind: board.kind.to_string(),
                points: board.points.map(|n| n as u32),
                pitch_mm: board.pitch_mm,
                scale_sigma_ratio: pitch_sigma_mm.map(|sigma| sigma / board.pitch_mm),
                depth_mm: adjusted.depth_mm,
                unknown: unknown.map(str::to_owned).collect(),
            }),
            second_projector: None,
            focus: None,
        }
    }
}
