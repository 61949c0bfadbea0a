//! `optics.toml`: a head as it was made, with all that light does in it; the bench's alone, for no head file tells that.

use std::path::Path;
use std::str::FromStr;

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde::Deserialize;

use super::{FileError, parse, read};
use crate::world::{BundleSpec, HeadOptics, Objective, Pinhole, SensorSpec, WorldConfig};

/// Name of the file, beside a tool's or a target's.
pub const FILE: &str = "optics.toml";

/// The heads that come along: name and file.
const AT_HAND: [(&str, &str); 2] = [
    ("10mm", include_str!("../../heads/10mm.toml")),
    ("20mm", include_str!("../../heads/20mm.toml")),
];
/// The one of them that stands before the demo die.
const DEMO: usize = 1;

/// A head as it was made: camera and projector meet under an angle in best focus. Camera columns lie along the axis of the die,
/// and the projector is turned about the camera's y axis through the focus.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OpticsFile {
    /// Free text.
    pub name: String,
    /// From the front to best focus.
    pub working_distance_mm: f64,
    /// From the pinholes of camera and projector to best focus.
    pub stand_off_mm: f64,
    /// Best focus lies this far from the axis of the rotary stage, the head looks outwards.
    pub focus_radius_mm: f64,
    /// Diameter of the field in best focus: as wide as either bundle's image.
    pub field_mm: f64,
    /// Between camera and projector.
    pub angle_deg: f64,
    /// Depths that the head measures, from the camera's pinhole.
    pub volume_mm: [f64; 2],
    /// Modulation of a coarse pattern at the centre of the field: the rest is stray light.
    pub contrast_centre: f64,
    /// The same at the edge of the field.
    pub contrast_edge: f64,
    /// Light that the DMD still sends when all mirrors are off, relative to all on.
    pub dmd_leak_ratio: f64,
    /// What the DMD shows unless the head file says otherwise.
    pub pattern_set: String,
    /// Exposures for a sprayed die.
    pub exposures_us: Vec<u32>,
    /// Exposure for a white plate.
    pub white_exposure_us: u32,
    /// Pixels along a measuring cell.
    pub binning: u32,
    /// Between bundle and sensor, and the objective before the bundle.
    pub camera: Side,
    /// Between DMD and bundle, and the objective after it.
    pub projector: Side,
    /// Both bundles.
    pub bundle: Fibres,
    /// The camera's sensor and the lamp.
    pub sensor: SensorSpec,
}

/// One of the two ways of light.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Side {
    /// Columns and rows of sensor or DMD; the bundle's image lies in its middle.
    pub size_px: [usize; 2],
    /// Diameter of the bundle's image.
    pub circle_px: f64,
    /// Rotation of the bundle's lattice against the rows.
    pub bundle_turn_rad: f64,
    /// k1, k2, p1, p2, k3.
    pub distortion: [f64; 5],
    /// As [`Objective::field_curvature_per_mm`].
    pub field_curvature_per_mm: f64,
    /// As [`Objective::focus_sigma_pitch`].
    pub focus_sigma_pitch: f64,
    /// As [`Objective::defocus_sigma_pitch_per_mm`].
    pub defocus_sigma_pitch_per_mm: f64,
    /// As [`Objective::edge_loss_ratio`].
    pub edge_loss_ratio: f64,
}

/// What both bundles are made of, as in [`BundleSpec`].
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fibres {
    /// Number of cores.
    pub cores: usize,
    /// Standard deviation of a core's place, in pitches.
    pub jitter_ratio: f64,
    /// Standard deviation of the transmission.
    pub gain_spread_ratio: f64,
    /// Share of cores without light.
    pub dead_ratio: f64,
    /// Share of its light that a core loses to its neighbours.
    pub crosstalk_ratio: f64,
}

impl OpticsFile {
    /// The head of the built-in demo.
    #[must_use]
    pub fn demo() -> Self {
        let (name, text) = AT_HAND[DEMO];
        parse(Path::new(name), text).expect("a head that comes along")
    }

    /// The head beside a tool's or target's file, else that of the demo.
    ///
    /// # Errors
    /// [`FileError`].
    pub fn beside(file: &Path) -> Result<Self, FileError> {
        let path = file.with_file_name(FILE);
        match path.exists() {
            true => Self::load(&path),
            false => Ok(Self::demo()),
        }
    }

    fn load(path: &Path) -> Result<Self, FileError> {
        let file: Self = read(path)?;
        file.checked(path)
    }

    /// What a file states and no part of a world checks.
    fn checked(self, path: &Path) -> Result<Self, FileError> {
        let lengths = [
            ("working_distance_mm", self.working_distance_mm),
            ("stand_off_mm", self.stand_off_mm),
            ("focus_radius_mm", self.focus_radius_mm),
            ("field_mm", self.field_mm),
            ("camera.circle_px", self.camera.circle_px),
            ("projector.circle_px", self.projector.circle_px),
            ("volume_mm[0]", self.volume_mm[0]),
            ("volume_mm[1]", self.volume_mm[1]),
        ];
        let bad = |key: &'static str, got: f64, expected: &'static str| FileError::Value {
            path: path.to_path_buf(),
            key,
            got,
            expected,
        };
        for (key, got) in lengths {
            // Written so that a NaN fails.
            if !(got > 0.0 && got < 1e4) {
                return Err(bad(key, got, "above 0 and below 10 000"));
            }
        }
        if !(self.angle_deg > 0.0 && self.angle_deg < 90.0) {
            return Err(bad("angle_deg", self.angle_deg, "above 0 and below 90"));
        }
        if self.volume_mm[0] >= self.volume_mm[1] {
            let expected = "beyond volume_mm[0]";
            return Err(bad("volume_mm[1]", self.volume_mm[1], expected));
        }
        Ok(self)
    }

    /// Where light goes in it.
    #[must_use]
    pub fn optics(&self) -> HeadOptics {
        // Columns along +z of the stage, rows along -y, view along +x.
        let axes = Matrix3::from_columns(&[Vector3::z(), -Vector3::y(), Vector3::x()]);
        let stage_from_camera = Isometry3::from_parts(
            Translation3::new(self.focus_radius_mm - self.stand_off_mm, 0.0, 0.0),
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes)),
        );
        let focus = Vector3::new(0.0, 0.0, self.stand_off_mm);
        // A positive turn about y moves the view towards +x, so the projector itself sits at negative x.
        let camera_from_projector =
            Rotation3::from_axis_angle(&Vector3::y_axis(), self.angle_deg.to_radians());
        let rotation = camera_from_projector.inverse();
        let projector_from_camera = Isometry3::from_parts(
            Translation3::from(focus - rotation * focus),
            UnitQuaternion::from(rotation),
        );
        HeadOptics {
            camera: self.pinhole(&self.camera),
            camera_size_px: self.camera.size_px,
            camera_objective: self.objective(&self.camera),
            projector: self.pinhole(&self.projector),
            projector_size_px: self.projector.size_px,
            projector_objective: self.objective(&self.projector),
            projector_from_camera,
            stage_from_camera,
            contrast_centre: self.contrast_centre,
            contrast_edge: self.contrast_edge,
            dmd_leak_ratio: self.dmd_leak_ratio,
        }
    }

    fn pinhole(&self, side: &Side) -> Pinhole {
        Pinhole {
            focal_px: [side.circle_px * self.stand_off_mm / self.field_mm; 2],
            centre_px: side.centre_px(),
            distortion: side.distortion,
            uneven: None,
        }
    }

    fn objective(&self, side: &Side) -> Objective {
        Objective {
            focus_mm: self.stand_off_mm,
            field_curvature_per_mm: side.field_curvature_per_mm,
            field_radius_mm: 0.5 * self.field_mm,
            focus_sigma_pitch: side.focus_sigma_pitch,
            defocus_sigma_pitch_per_mm: side.defocus_sigma_pitch_per_mm,
            edge_loss_ratio: side.edge_loss_ratio,
        }
    }

    /// The bundle of one side.
    #[must_use]
    pub fn bundle(&self, side: &Side) -> BundleSpec {
        let fibres = &self.bundle;
        BundleSpec {
            cores: fibres.cores,
            diameter_px: side.circle_px,
            centre_px: side.centre_px(),
            rotation_rad: side.bundle_turn_rad,
            jitter_ratio: fibres.jitter_ratio,
            gain_spread_ratio: fibres.gain_spread_ratio,
            dead_ratio: fibres.dead_ratio,
            crosstalk_ratio: fibres.crosstalk_ratio,
        }
    }

    /// Puts the head into a world.
    pub fn impose(&self, config: &mut WorldConfig) {
        config.optics = self.optics();
        config.camera_bundle = self.bundle(&self.camera);
        config.projector_bundle = self.bundle(&self.projector);
        config.sensor = self.sensor.clone();
    }
}

impl Side {
    fn centre_px(&self) -> [f64; 2] {
        self.size_px.map(|n| 0.5 * (n as f64 - 1.0))
    }
}

/// A head that comes along, by its name, or any other, by its file; its text goes into a folder as it is.
#[derive(Clone, Debug, PartialEq)]
pub struct MadeHead {
    /// As it was asked for.
    pub given: String,
    /// What it is.
    pub optics: Box<OpticsFile>,
    /// As it is written.
    pub text: String,
}

impl FromStr for MadeHead {
    type Err = FileError;

    fn from_str(given: &str) -> Result<Self, FileError> {
        let path = Path::new(given);
        let text = match AT_HAND.iter().find(|(name, _)| *name == given) {
            Some((_, text)) => (*text).to_owned(),
            None => super::text(path)?,
        };
        let optics = parse::<OpticsFile>(path, &text)?.checked(path)?;
        Ok(Self {
            given: given.to_owned(),
            optics: Box::new(optics),
            text,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_head_is_refused_with_its_key() {
        let text = AT_HAND[DEMO].1;
        let refused = |from: &str, to: &str| {
            assert!(text.contains(from), "{from}");
            let given = text.replacen(from, to, 1);
            let made = parse::<OpticsFile>(Path::new("x"), &given)
                .and_then(|file| file.checked(Path::new("x")));
            made.err().map(|error| error.to_string())
        };
        assert_eq!(refused("30.0", "29.0"), None);
        for (from, to, key) in [
            ("stand_off_mm = 22.0", "stand_off_mm = 0.0", "stand_off_mm"),
            ("field_mm = 10.0", "field_mm = nan", "field_mm"),
            ("angle_deg = 30.0", "angle_deg = inf", "angle_deg"),
            ("20.3, 23.7", "23.7, 20.3", "volume_mm[1]"),
            ("field_mm", "feld_mm", "feld_mm"),
        ] {
            let words = refused(from, to).unwrap_or_default();
            assert!(words.contains(key), "{to}: {words}");
        }
    }
}
