//! The head: camera, projector, their relative pose, the sensor and the measuring volume (`head.toml`).
//!
//! `docs/formats.md` describes the file; [`HeadModel::load`] also takes an OpenCV calibration (XML or YAML).

use std::path::Path;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::calibrate::{CalibrationRecord, SelfTest, Unfit};
pub use crate::camera::Pinhole;
use crate::cores::{CoreMap, CoreMapError, CoreMapFile};
use crate::date::Date;
use crate::textfile::{self, BadValue};

/// One measuring head. Millimetres, radians, pixels (centres at integers), electrons, microseconds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeadModel {
    /// Free text.
    pub name: String,
    /// Distance from the front to the middle of the measuring volume.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub working_distance_mm: Option<f64>,
    /// Default pattern set by name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pattern_set: Option<String>,
    /// Default exposures, ascending; may be empty.
    #[serde(default)]
    pub exposures_us: Vec<u32>,
    /// Pixels along the side of a measuring cell.
    #[serde(default = "one")]
    pub binning: u32,
    /// The camera.
    pub camera: Pinhole,
    /// The projector, as an inverse camera.
    pub projector: Pinhole,
    /// `X_projector = rotation X_camera + translation_mm`.
    pub projector_from_camera: RigidTransform,
    /// Hand-eye: `X_stage = rotation X_camera + translation_mm` with the vertical stage at its zero.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stage_from_camera: Option<RigidTransform>,
    /// The camera's sensor. An OpenCV calibration says nothing about it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor: Option<Sensor>,
    /// The measuring volume along the camera's axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub volume: Option<DepthRange>,
    /// Where the optics show an image; everything outside is skipped.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub image_circle: Option<ImageCircle>,
    /// Where the map of the bundle's cores lies.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cores: Option<CoreMapFile>,
    /// Where the geometry above comes from, and until when it counts; absent for a drawing's values.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibration: Option<CalibrationRecord>,
    /// The last test of that calibration, `<head>.check.toml` beside the file; [`HeadModel::load`] reads it.
    #[serde(skip)]
    pub self_test: Option<SelfTest>,
    /// The core map itself; [`HeadModel::load`] reads it.
    #[serde(skip)]
    pub core_map: Option<Arc<CoreMap>>,
}

fn one() -> u32 {
    1
}

/// A rotation and a translation, named `<to>_from_<from>` where it is used.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RigidTransform {
    /// Row by row.
    pub rotation: [[f64; 3]; 3],
    /// Translation.
    pub translation_mm: [f64; 3],
}

impl RigidTransform {
    /// Applies it to a point.
    pub fn point(&self, point: [f64; 3]) -> [f64; 3] {
        let rotated = self.direction(point);
        std::array::from_fn(|axis| rotated[axis] + self.translation_mm[axis])
    }

    /// Applies the rotation alone.
    pub fn direction(&self, vector: [f64; 3]) -> [f64; 3] {
        self.rotation
            .map(|row| row[0] * vector[0] + row[1] * vector[1] + row[2] * vector[2])
    }

    /// As a 4x4 matrix, row by row.
    pub fn rows(&self) -> [[f64; 4]; 4] {
        let [r, t] = [self.rotation, [self.translation_mm; 3]];
        let row = |i: usize| [r[i][0], r[i][1], r[i][2], t[i][i]];
        [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
    }

    pub(crate) fn check(&self, table: &str) -> Result<(), BadValue> {
        let bad = |got: [f64; 3]| {
            BadValue::new(
                format!("{table}.rotation"),
                got,
                "must be a rotation matrix, row by row: orthonormal to 1e-5 and right-handed",
            )
        };
        let r = &self.rotation;
        for i in 0..3 {
            for j in 0..3 {
                let product: f64 = (0..3).map(|k| r[i][k] * r[j][k]).sum();
                let ideal = f64::from(u8::from(i == j));
                // Nine printed digits of a single-precision calibration leave about 1e-7.
                if !((product - ideal).abs() < 1e-5) {
                    return Err(bad(r[i]));
                }
            }
        }
        let determinant = r[0][0] * (r[1][1] * r[2][2] - r[1][2] * r[2][1])
            - r[0][1] * (r[1][0] * r[2][2] - r[1][2] * r[2][0])
            + r[0][2] * (r[1][0] * r[2][1] - r[1][1] * r[2][0]);
        if determinant < 0.0 {
            return Err(bad(r[2]));
        }
        if self
            .translation_mm
            .iter()
            .any(|value| value.is_nan() || value.abs() > 1e6)
        {
            return Err(BadValue::new(
                format!("{table}.translation_mm"),
                self.translation_mm,
                "must be finite millimetres",
            ));
        }
        Ok(())
    }
}

/// From counts to electrons: `electrons = (dn - offset_dn) gain_e_per_dn`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sensor {
    /// Electrons at saturation.
    pub full_well_e: f64,
    /// Electrons per count.
    pub gain_e_per_dn: f64,
    /// Standard deviation of the dark noise per pixel and frame.
    pub read_noise_e: f64,
    /// Counts without light.
    pub offset_dn: f64,
    /// Bits per pixel.
    pub bits: u32,
}

impl Sensor {
    /// For frames of unknown origin: a 10 000 electron sensor that fills its bits, 10 electrons of read noise, no offset.
    ///
    /// Sensible for an 8 or 10 bit industrial camera; predicted uncertainties are then indicative only.
    pub fn assumed(bits: u32) -> Self {
        let full_scale_dn = full_scale_dn(bits);
        Self {
            full_well_e: 10_000.0,
            gain_e_per_dn: 10_000.0 / full_scale_dn,
            read_noise_e: 10.0,
            offset_dn: 0.0,
            bits,
        }
    }

    /// Above this count a pixel is taken as saturated: 95 % of where either the bits or the full well end.
    pub fn saturation_limit_dn(&self) -> u16 {
        let full_well_dn = self.offset_dn + self.full_well_e / self.gain_e_per_dn;
        (0.95 * full_well_dn.min(full_scale_dn(self.bits))) as u16
    }

    /// Variance per pixel and frame that does not come from light: read noise and rounding, in electrons squared.
    pub fn dark_variance_e2(&self) -> f64 {
        self.read_noise_e * self.read_noise_e + self.gain_e_per_dn * self.gain_e_per_dn / 12.0
    }

    fn check(&self) -> Result<(), BadValue> {
        let positive = |value: f64| value > 0.0 && value < 1e9;
        if !positive(self.full_well_e) {
            return Err(BadValue::new(
                "sensor.full_well_e",
                self.full_well_e,
                "must be positive electrons",
            ));
        }
        if !positive(self.gain_e_per_dn) {
            return Err(BadValue::new(
                "sensor.gain_e_per_dn",
                self.gain_e_per_dn,
                "must be positive electrons per count",
            ));
        }
        if !(self.read_noise_e >= 0.0 && self.read_noise_e < 1e6) {
            return Err(BadValue::new(
                "sensor.read_noise_e",
                self.read_noise_e,
                "must be zero or positive electrons",
            ));
        }
        if !(8..=16).contains(&self.bits) {
            return Err(BadValue::new("sensor.bits", self.bits, "must be 8 to 16"));
        }
        if !(self.offset_dn >= 0.0 && self.offset_dn < 0.5 * full_scale_dn(self.bits)) {
            return Err(BadValue::new(
                "sensor.offset_dn",
                self.offset_dn,
                "must be at least 0 and below half of full scale",
            ));
        }
        Ok(())
    }
}

fn full_scale_dn(bits: u32) -> f64 {
    2f64.powi(bits as i32) - 1.0
}

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
    pub(crate) fn check(&self) -> Result<(), BadValue> {
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

impl HeadModel {
    /// Reads `head.toml`, or an OpenCV calibration (XML, or YAML) with `Kc kc Kp kp Rp Tp`.
    ///
    /// # Errors
    /// [`CoreMapError`] with file, line and what would be right; [`CoreMapError::File`] for the head's own file.
    pub fn load(path: &Path) -> Result<Self, CoreMapError> {
        let text = textfile::read(path)?;
        let start = text.trim_start_matches('\u{feff}').trim_start();
        let mut head = if start.starts_with('<') || start.starts_with("%YAML") {
            crate::opencv::head_from_file_storage(path, &text)?
        } else {
            textfile::parse_toml::<Self>(path, &text)?
        };
        head.check().map_err(|bad| bad.in_file(path, &text))?;
        if let Some(cores) = &head.cores {
            let map = cores.load(path, head.camera.width_px, head.camera.height_px)?;
            head.core_map = Some(Arc::new(map));
        }
        if head.calibration.is_some() {
            head.self_test = SelfTest::load(path)?;
        }
        Ok(head)
    }

    /// Whether a calibrated head may judge on a day: its calibration counts, and its last self-test was passed and is not
    /// overdue. Of a head without `[calibration]` nothing was promised.
    ///
    /// # Errors
    /// [`Unfit`]: why not.
    pub fn fit_on(&self, today: Date) -> Result<(), Unfit> {
        let Some(record) = &self.calibration else {
            return Ok(());
        };
        record.counts_on(today)?;
        let test = self.self_test.as_ref().ok_or(Unfit::Untested)?;
        test.allows(&record.blake3, today)
    }

    /// The content of a `head.toml`.
    pub fn to_toml(&self) -> Result<String, toml::ser::Error> {
        toml::to_string(self)
    }

    /// Checks every value against its limits; [`HeadModel::load`] has done so already.
    ///
    /// # Errors
    /// The first value beyond its limits.
    pub fn check(&self) -> Result<(), BadValue> {
        self.camera.check("camera")?;
        self.projector.check("projector")?;
        self.projector_from_camera.check("projector_from_camera")?;
        if let Some(hand_eye) = &self.stage_from_camera {
            hand_eye.check("stage_from_camera")?;
        }
        if let Some(sensor) = &self.sensor {
            sensor.check()?;
        }
        if let Some(volume) = &self.volume {
            volume.check()?;
        }
        if let Some(cores) = &self.cores {
            cores.check()?;
        }
        if let Some(record) = &self.calibration {
            record.check(self)?;
        }
        if let Some(circle) = &self.image_circle {
            if circle.centre_px.iter().any(|value| !value.is_finite()) {
                return Err(BadValue::new(
                    "image_circle.centre_px",
                    circle.centre_px,
                    "must be finite pixels",
                ));
            }
            if !(circle.radius_px > 0.0 && circle.radius_px.is_finite()) {
                return Err(BadValue::new(
                    "image_circle.radius_px",
                    circle.radius_px,
                    "must be positive",
                ));
            }
        }
        if let Some(distance) = self.working_distance_mm
            && !(distance > 0.0 && distance.is_finite())
        {
            return Err(BadValue::new(
                "working_distance_mm",
                distance,
                "must be positive",
            ));
        }
        if !(1..=64).contains(&self.binning) {
            return Err(BadValue::new(
                "binning",
                self.binning,
                "must be 1 to 64 pixels",
            ));
        }
        if self.exposures_us.windows(2).any(|pair| pair[0] >= pair[1])
            || self.exposures_us.first() == Some(&0)
        {
            return Err(BadValue::new(
                "exposures_us",
                &self.exposures_us,
                "must be positive and ascending",
            ));
        }
        if let Some(name) = &self.pattern_set
            && crate::pattern::PatternSet::named(name).is_err()
        {
            return Err(BadValue::new(
                "pattern_set",
                name,
                "must be article8, insitu12 or scan16",
            ));
        }
        Ok(())
    }
}
