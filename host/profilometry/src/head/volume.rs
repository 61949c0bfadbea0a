//! What the head can see: depths along the axis, the lit part of the sensor.

use serde::{Deserialize, Serialize};

use crate::textfile::BadValue;

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

/// The part of the sensor that the optics light.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImageCircle {
    /// Column, row.
    pub centre_px: [f64; 2],
    /// Radius.
    pub radius_px: f64,
}
