//! Calibration record of a head: `[calibration]` in `head.toml`.

use serde::{Deserialize, Serialize};

use super::HeadModel;
use flankscope_foundation::date::Date;
use flankscope_foundation::normal::COVERAGE_95;
use flankscope_foundation::textfile::{self, BadValue};

/// Origin, quality and expiry of a head's geometry.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CalibrationRecord {
    /// Day of the captures.
    pub date: Date,
    /// Last day on which the calibration counts.
    pub expires: Date,
    /// The artefact's name.
    pub target: String,
    /// Through which link they were made, `sim` or `qemu` for the simulated bench; absent for images from elsewhere.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub link: Option<String>,
    /// Whether the images came from the simulated bench; absent if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub simulated: Option<bool>,
    /// Frames that the calibration ties together.
    pub frames: Vec<String>,
    /// Unit of its lengths: `mm`.
    pub unit: String,
    /// BLAKE3 of the geometry that it belongs to: camera, projector, their poses, core map.
    pub blake3: String,
    /// Views that took part.
    pub views: u32,
    /// Dots that took part.
    pub dots: u32,
    /// Dots left out.
    pub dropped: u32,
    /// Residuals of the dots' pixels, root mean square per axis.
    pub camera_rms_px: f64,
    /// Residuals of the dots' projector columns, root mean square.
    pub projector_rms_px: f64,
    /// Standard uncertainty of a point's depth by the calibration alone, over the measuring volume.
    pub depth_sigma_um: f64,
    /// The same across the view.
    pub lateral_sigma_um: f64,
    /// Standard uncertainty by the calibration alone of how much farther the projector's pinhole is from the middle of the measuring
    /// volume than the camera's, each along its axis; absent: not computed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub farther_sigma_um: Option<f64>,
    /// Plates that took no part, measured with the result.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hold_out: Option<HoldOut>,
    /// The same plates without the residual fields of the lenses.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub without_field: Option<HoldOut>,
    /// Present if calibrated with an ordinary board, whose poses are not certified: the board, and the quantities not determined.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub board: Option<BoardRecord>,
    /// Present for a head with two projectors: agreement of their points.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub second_projector: Option<ApartRecord>,
    /// Present if interpolated between focus settings: which settings, and the uncertainty of the interpolation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub focus: Option<FocusRecord>,
}

/// Difference between the depths of the same point by two projectors, second minus first.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ApartRecord {
    /// Standard uncertainty by the calibration alone, over the measuring volume.
    pub apart_sigma_um: f64,
    /// 95 % quantile of the cells' differences on plates that took no part, including errors of lenses and bundles beyond the model.
    pub apart_um: f64,
    /// Those plates by the second projector alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hold_out: Option<HoldOut>,
}

impl ApartRecord {
    /// Difference between the depths by both projectors that the calibration allows (95 %): measured, or by its uncertainty, whichever is larger.
    #[must_use]
    pub fn allowed_um(&self) -> f64 {
        self.apart_um.max(COVERAGE_95 * self.apart_sigma_um)
    }

    #[rustfmt::skip]
    fn check(&self) -> Result<(), BadValue> {
        let Self { apart_sigma_um, apart_um, .. } = self;
        let (limits_um, right) = (0.0..=1000.0, "must be 0 to 1000 um");
        textfile::require(&[
            (limits_um.contains(apart_sigma_um), "calibration.second_projector.apart_sigma_um", apart_sigma_um, right),
            (limits_um.contains(apart_um), "calibration.second_projector.apart_um", apart_um, right),
        ])
    }
}

/// At which focus a head is one that was computed between calibrated settings. Its parts of the uncertainty are root mean squares
/// over the measuring volume, along the view and across; `depth_sigma_um` and `lateral_sigma_um` contain them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FocusRecord {
    /// Lens driver counts.
    pub setting_dpt: f64,
    /// Temperature of the lens, °C.
    pub celsius: f64,
    /// Settings that were calibrated.
    pub between_dpt: Vec<f64>,
    /// Part due to the interpolation between settings.
    pub interpolation_um: [f64; 2],
    /// Part due to the uncertainty of the lens' drift and temperatures.
    pub drift_um: [f64; 2],
}

/// An ordinary board that a head was calibrated by.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BoardRecord {
    /// Checkerboard, ChArUco board or circles.
    pub kind: String,
    /// Points along its sides.
    pub points: [u32; 2],
    /// From point to point: all lengths of the head are in proportion to it.
    pub pitch_mm: f64,
    /// Standard uncertainty of that, as a part of it; absent: not known, and so is the scale of every length.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scale_sigma_ratio: Option<f64>,
    /// Depths of its nearest and farthest point along the camera's axis: outside, the lens models are extrapolated.
    pub depth_mm: [f64; 2],
    /// Quantities that such a calibration does not determine.
    pub unknown: Vec<String>,
}

/// Form errors of plates that took no part in the adjustment, measured with its result.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HoldOut {
    /// Views.
    pub views: u32,
    /// Distances of all points from the planes fitted to each view, root mean square.
    pub flatness_rms_um: f64,
    /// Largest minus smallest of them, worst view, without the farthest 0.3 % of its points.
    pub flatness_um: f64,
    /// Distances of the triangulated dots from where they are printed, after a rigid motion, root mean square.
    pub dots_rms_um: f64,
}

/// Why a calibration does not count today.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum RecordError {
    /// Too old.
    #[error(
        "the head's calibration of {date} expired after {expires}, today is {today}: calibrate again"
    )]
    Expired {
        /// Day of the captures.
        date: Date,
        /// Last day.
        expires: Date,
        /// Today.
        today: Date,
    },
    /// From the future: one of the clocks is wrong.
    #[error("the head's calibration is of {date}, but today is {today}: is the clock right?")]
    NotYet {
        /// Day of the captures.
        date: Date,
        /// Today.
        today: Date,
    },
}

/// Frames of a calibration, outermost last.
pub(crate) const FRAMES: [&str; 3] = ["camera", "projector", "stage"];

impl CalibrationRecord {
    /// Whether the calibration is valid on a day.
    ///
    /// # Errors
    /// [`RecordError`].
    pub fn counts_on(&self, today: Date) -> Result<(), RecordError> {
        let Self { date, expires, .. } = *self;
        if today > expires {
            return Err(RecordError::Expired {
                date,
                expires,
                today,
            });
        }
        // Midnight passes at different times: a day ahead is no wrong clock.
        if date > today.plus_days(1) {
            return Err(RecordError::NotYet { date, today });
        }
        Ok(())
    }

    #[rustfmt::skip]
    pub(super) fn check(&self, head: &HeadModel) -> Result<(), BadValue> {
        // An ordinary board stands anywhere: it ties the head to no stage.
        let (frames, expected) = match &self.board {
            None => (&FRAMES[..], "must be [\"camera\", \"projector\", \"stage\"]"),
            Some(_) => (&FRAMES[..2], "must be [\"camera\", \"projector\"] beside [calibration.board], which tells no place of the head on its stage"),
        };
        let second = self.second_projector.is_some();
        textfile::require(&[
            (self.unit == "mm", "calibration.unit", &self.unit, "must be \"mm\""),
            (self.frames == frames, "calibration.frames", &self.frames, expected),
            (self.expires >= self.date, "calibration.expires", &self.expires.to_string(), "must not lie before calibration.date"),
            (second == head.second_projector.is_some(), "calibration.second_projector", &second, "must be there with a [second_projector], and only with one: calibrate again, or remove [calibration]"),
        ])?;
        if let Some(apart) = &self.second_projector {
            apart.check()?;
        }
        let farther_um = self.farther_sigma_um.unwrap_or(0.0);
        textfile::require(&[
            ((0.0..=1000.0).contains(&farther_um), "calibration.farther_sigma_um", &farther_um, "must be 0 to 1000 um"),
            (self.blake3 == geometry_blake3(head), "calibration.blake3", &self.blake3, "is not the hash of this file's geometry and lens.counts: they were changed after the calibration; calibrate again, or remove [calibration]"),
        ])
    }
}

/// BLAKE3 of everything that a calibration determines, bit for bit.
pub(crate) fn geometry_blake3(head: &HeadModel) -> String {
    let mut hasher = blake3::Hasher::new();
    let mut numbers = |values: &[f64]| {
        for value in values {
            hasher.update(&value.to_bits().to_le_bytes());
        }
    };
    let second = head.second_projector.as_ref();
    let lenses = [&head.camera, &head.projector].into_iter();
    for lens in lenses.chain(second.map(|of| &of.projector)) {
        numbers(&[f64::from(lens.width_px), f64::from(lens.height_px)]);
        numbers(&lens.focal_px);
        numbers(&lens.principal_px);
        numbers(&lens.distortion);
        if let Some(field) = &lens.residual {
            numbers(&field.centre);
            numbers(&[field.half_side]);
            numbers(field.columns_px.as_flattened());
            numbers(
                field
                    .rows_px
                    .as_ref()
                    .map_or(&[], |rows| rows.as_flattened()),
            );
        }
    }
    let poses = [Some(head.projector_from_camera), head.stage_from_camera].into_iter();
    for pose in poses.chain(second.map(|of| Some(of.projector_from_camera))) {
        for row in pose.iter().flat_map(|pose| pose.rotation) {
            numbers(&row);
        }
        numbers(&pose.map_or([f64::NAN; 3], |pose| pose.translation_mm));
    }
    // Camera and projector are another pair at another setting of their liquid lenses.
    if let Some(lens) = &head.lens {
        numbers(&[f64::from(lens.counts)]);
    }
    if let Some(cores) = &head.cores {
        hasher.update(cores.blake3.as_bytes());
    }
    hasher.finalize().to_hex().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::head::{LensDrive, Pinhole, RigidTransform};

    /// A check drives the lens to the counts in the head's file: with other counts than the calibrated ones there is no calibration.
    #[test]
    fn a_calibration_is_for_one_setting_of_the_lens() {
        let lens = |width_px, height_px| Pinhole {
            width_px,
            height_px,
            focal_px: [2530.0; 2],
            principal_px: [0.5 * f64::from(width_px), 0.5 * f64::from(height_px)],
            distortion: [0.0; 5],
            residual: None,
        };
        let beside = RigidTransform {
            rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            translation_mm: [-11.0, 0.0, 0.0],
        };
        let mut head = HeadModel::from_lenses("liquid", lens(1920, 1200), lens(1024, 768), beside);
        let fixed = head.geometry_blake3();
        let drive = LensDrive {
            zero_counts: 516.0,
            dpt_per_count: 0.0399,
            range: [416, 616],
            settle_ms: 150,
            counts: 554,
        };
        head.lens = Some(drive);
        assert_ne!(head.geometry_blake3(), fixed);
        let record = |head: &HeadModel| -> CalibrationRecord {
            let text = format!(
                "date = \"2026-01-31\"\nexpires = \"2026-07-30\"\ntarget = \"dots\"\nunit = \"mm\"\nblake3 = \"{}\"\n\
                 frames = [\"camera\", \"projector\", \"stage\"]\nviews = 12\ndots = 2995\ndropped = 0\n\
                 camera_rms_px = 0.2\nprojector_rms_px = 0.2\ndepth_sigma_um = 0.9\nlateral_sigma_um = 1.6\n",
                head.geometry_blake3()
            );
            toml::from_str(&text).unwrap()
        };
        let record = record(&head);
        let mut with = |drive: LensDrive| {
            head.lens = Some(drive);
            record.check(&head)
        };
        assert_eq!(with(drive).map_err(|bad| format!("{bad:?}")), Ok(()));
        // How long it takes to come to rest is no property of the optics.
        let slower = LensDrive {
            settle_ms: 300,
            ..drive
        };
        assert!(with(slower).is_ok());
        let refused = with(LensDrive {
            counts: 555,
            ..drive
        });
        let said = format!("{:?}", refused.unwrap_err());
        assert!(
            said.contains("calibration.blake3") && said.contains("lens.counts"),
            "{said}"
        );
    }
}
