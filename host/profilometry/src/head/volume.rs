//! Measuring volume: depths along the camera's axis, and the lit part of the sensor.

use serde::{Deserialize, Serialize};

use flankscope_foundation::textfile::{self, BadValue};

/// Depths that can be measured, along the camera's axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DepthRange {
    /// Nearest z in the camera frame.
    pub near_mm: f64,
    /// Farthest z in the camera frame.
    pub far_mm: f64,
}

impl DepthRange {
    #[rustfmt::skip]
    pub(super) fn check(&self) -> Result<(), BadValue> {
        let Self { near_mm, far_mm } = self;
        textfile::require(&[
            (*near_mm > 0.0 && *near_mm < 1e6, "volume.near_mm", near_mm, "must be in front of the camera (positive)"),
            (far_mm > near_mm && *far_mm < 1e6, "volume.far_mm", far_mm, "must lie beyond near_mm"),
        ])
    }
}

/// The part of the sensor, or of a DMD, that the optics show.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImageCircle {
    /// Column, row.
    pub centre_px: [f64; 2],
    /// Radius.
    pub radius_px: f64,
}

impl ImageCircle {
    #[rustfmt::skip]
    pub(super) fn check(&self, name: &str) -> Result<(), BadValue> {
        let Self { centre_px, radius_px } = self;
        textfile::require(&[
            (centre_px.iter().all(|px| px.is_finite()), &format!("{name}.centre_px"), centre_px, "must be finite pixels"),
            (*radius_px > 0.0 && radius_px.is_finite(), &format!("{name}.radius_px"), radius_px, "must be positive"),
        ])
    }

    /// Whether a pixel lies in it.
    #[must_use]
    pub fn contains(&self, pixel: [f64; 2]) -> bool {
        let [x, y] = [0, 1].map(|axis| pixel[axis] - self.centre_px[axis]);
        x.hypot(y) <= self.radius_px
    }
}
