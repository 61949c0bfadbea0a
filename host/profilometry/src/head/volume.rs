//! Measuring volume: depths along the camera's axis, and the lit part of the sensor.

use serde::{Deserialize, Serialize};

use flankscope_foundation::textfile::BadValue;

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
    pub(super) fn check(&self) -> Result<(), BadValue> {
        if !(self.near_mm > 0.0 && self.near_mm < 1e6) {
            return Err(BadValue::new(
                "volume.near_mm",
                self.near_mm,
                "must be in front of the camera (positive)",
            ));
        }
        if !(self.far_mm > self.near_mm && self.far_mm < 1e6) {
            return Err(BadValue::new(
                "volume.far_mm",
                self.far_mm,
                "must lie beyond near_mm",
            ));
        }
        Ok(())
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
    pub(super) fn check(&self, name: &str) -> Result<(), BadValue> {
        if self.centre_px.iter().any(|value| !value.is_finite()) {
            return Err(BadValue::new(
                format!("{name}.centre_px"),
                self.centre_px,
                "must be finite pixels",
            ));
        }
        if !(self.radius_px > 0.0 && self.radius_px.is_finite()) {
            return Err(BadValue::new(
                format!("{name}.radius_px"),
                self.radius_px,
                "must be positive",
            ));
        }
        Ok(())
    }

    /// Whether a pixel lies in it.
    #[must_use]
    pub fn contains(&self, pixel: [f64; 2]) -> bool {
        let [x, y] = [0, 1].map(|axis| pixel[axis] - self.centre_px[axis]);
        x.hypot(y) <= self.radius_px
    }
}
