//! The head: camera, projector, their relative pose, the sensor and the measuring volume (`head.toml`).
//!
//! `docs/formats/head.md` describes the file; [`HeadModel::load`] also takes an OpenCV calibration (XML or YAML).

mod calibration;
mod camera;
mod core_map;
mod dates;
mod fringes;
mod lens;
mod mirrors;
mod opencv;
mod pose;
pub mod residual;
mod second_projector;
mod self_test;
mod sensor;
mod volume;

use std::path::Path;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::counts::CountRange;
use crate::io::opencv::is_file_storage;
use flankscope_foundation::date::Date;
use flankscope_foundation::seal::Seal;
use flankscope_foundation::textfile::{self, BadValue};

pub use calibration::{
    ApartRecord, BoardRecord, CalibrationRecord, FocusRecord, HoldOut, RecordError,
};
pub(crate) use calibration::{FRAMES, geometry_blake3};
pub(crate) use camera::Distorted;
pub use camera::Pinhole;
pub use core_map::{CoreMap, CoreMapError, CoreMapFile};
pub use dates::HeadDates;
pub use fringes::Fringes;
pub use lens::LensDrive;
pub use mirrors::{Arrangement, Mirrors};
pub use pose::RigidTransform;
pub use second_projector::SecondProjector;
pub use self_test::{
    Alone, Arrangements, Figures, Judged, Limits, PlaneFigures, SelfTest, SphereFigures, Unfit,
};
pub use sensor::Sensor;
pub use volume::{DepthRange, ImageCircle};

/// One measuring head. Millimetres, radians, pixels (centres at integers), electrons, microseconds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeadModel {
    /// Free text, on one line.
    #[serde(deserialize_with = "flankscope_foundation::display::name")]
    pub name: String,
    /// Distance from the front to the middle of the measuring volume.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub working_distance_mm: Option<f64>,
    /// Default pattern set by name: one that the instrument knows, or that of `fringes`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pattern_set: Option<String>,
    /// Frequencies of a set of its own, ascending; empty where the instrument knows the set by its name.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub fringes: Vec<Fringes>,
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
    /// Arrangement of its DMD's mirrors; absent: orthogonal.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mirrors: Option<Mirrors>,
    /// The part of its DMD whose fringes count, in the DMD's pixels; absent: all of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub projector_circle: Option<ImageCircle>,
    /// Contrast (amplitude over mean) that the optics leave the finest fringes on a matt, convex surface in focus; absent: not known,
    /// at most 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fringe_contrast: Option<f64>,
    /// `X_projector = rotation X_camera + translation_mm`.
    pub projector_from_camera: RigidTransform,
    /// A second projector on the other side of the camera, if there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub second_projector: Option<SecondProjector>,
    /// The liquid lens that its focus follows, and how it is driven; absent: it has none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lens: Option<LensDrive>,
    /// Hand-eye: `X_stage = rotation X_camera + translation_mm` with the vertical stage at its zero.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stage_from_camera: Option<RigidTransform>,
    /// The camera's sensor; unknown in an OpenCV calibration.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor: Option<Sensor>,
    /// The measuring volume along the camera's axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub volume: Option<DepthRange>,
    /// Part of the sensor with an image; everything outside is skipped.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub image_circle: Option<ImageCircle>,
    /// File of the bundle's core map.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cores: Option<CoreMapFile>,
    /// Origin and expiry of the geometry above; absent for a drawing's values.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibration: Option<CalibrationRecord>,
    /// Seal of the file, if it has one; checked before verdicts are given with this head.
    #[serde(default, skip_serializing)]
    pub seal: Option<Seal>,
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

impl HeadModel {
    /// Sets the sensor model of the frames: the plan's, else the head's, else one assumed for their counts. It ends where counts are
    /// clipped, if that is lower. Returns whether it was assumed.
    pub fn take_sensor(&mut self, of_plan: Option<Sensor>, counts: &CountRange) -> bool {
        let stated = of_plan.or(self.sensor);
        self.sensor = Some(match stated {
            Some(sensor) if counts.clipped_pixels > 0 => sensor.ending_at(counts.full_scale_dn),
            Some(sensor) => sensor,
            None => Sensor::assumed(counts.full_scale_dn),
        });
        stated.is_none()
    }

    /// Reads `head.toml`, or an OpenCV calibration (XML or YAML) with `Kc kc Kp kp Rp Tp`.
    ///
    /// # Errors
    /// [`CoreMapError`] with file, line and what would be right; [`CoreMapError::File`] for the head's own file.
    pub fn load(path: &Path) -> Result<Self, CoreMapError> {
        let text = textfile::read(path)?;
        let mut head = if is_file_storage(&text) {
            opencv::head_from_file_storage(path, &text)?
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

    /// A head of which nothing but lenses and their places is known.
    #[must_use]
    pub fn from_lenses(
        name: &str,
        camera: Pinhole,
        projector: Pinhole,
        projector_from_camera: RigidTransform,
    ) -> Self {
        Self {
            name: name.to_owned(),
            working_distance_mm: None,
            pattern_set: None,
            fringes: Vec::new(),
            exposures_us: Vec::new(),
            binning: 1,
            camera,
            projector,
            mirrors: None,
            projector_circle: None,
            fringe_contrast: None,
            projector_from_camera,
            second_projector: None,
            lens: None,
            stage_from_camera: None,
            sensor: None,
            volume: None,
            image_circle: None,
            cores: None,
            calibration: None,
            seal: None,
            self_test: None,
            core_map: None,
        }
    }

    /// Whether a calibrated head may be used for verdicts on a day: its calibration is valid, and its last self-test was passed and is not
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
        test.allows(&record.blake3, self.projectors(), today)
    }

    /// Arrangement of the mirrors of the projector's DMD.
    #[must_use]
    pub fn mirrors(&self) -> Mirrors {
        self.mirrors
            .unwrap_or_else(|| Mirrors::from_projector(&self.projector))
    }

    /// BLAKE3 of everything that a calibration determines, bit for bit: what `[calibration]` belongs to.
    #[must_use]
    pub fn geometry_blake3(&self) -> String {
        geometry_blake3(self)
    }

    /// The content of a `head.toml`.
    pub fn to_toml(&self) -> Result<String, toml::ser::Error> {
        toml::to_string(self)
    }

    /// Checks every value against its limits; [`HeadModel::load`] has done so already.
    ///
    /// # Errors
    /// The first value beyond its limits.
    #[rustfmt::skip]
    pub fn check(&self) -> Result<(), BadValue> {
        self.camera.check("camera")?;
        self.projector.check("projector")?;
        self.mirrors.iter().try_for_each(|mirrors| mirrors.check(&self.projector))?;
        self.projector_from_camera.check("projector_from_camera")?;
        self.second_projector.iter().try_for_each(SecondProjector::check)?;
        self.stage_from_camera.iter().try_for_each(|pose| pose.check("stage_from_camera"))?;
        self.sensor.iter().try_for_each(Sensor::check)?;
        self.lens.iter().try_for_each(LensDrive::check)?;
        self.volume.iter().try_for_each(DepthRange::check)?;
        self.cores.iter().try_for_each(CoreMapFile::check)?;
        self.calibration.iter().try_for_each(|record| record.check(self))?;
        self.image_circle.iter().try_for_each(|circle| circle.check("image_circle"))?;
        self.projector_circle.iter().try_for_each(|circle| circle.check("projector_circle"))?;
        let contrast = self.fringe_contrast.unwrap_or(1.0);
        let distance_mm = self.working_distance_mm.unwrap_or(1.0);
        let exposures_us = &self.exposures_us;
        let is_ascending = exposures_us.first() != Some(&0) && exposures_us.is_sorted_by(|a, b| a < b);
        textfile::require(&[
            (contrast > 0.0 && contrast <= 1.0, "fringe_contrast", &contrast, "must be above 0 and at most 1"),
            (distance_mm > 0.0 && distance_mm.is_finite(), "working_distance_mm", &distance_mm, "must be positive"),
            ((1..=64).contains(&self.binning), "binning", &self.binning, "must be 1 to 64 pixels"),
            (is_ascending, "exposures_us", exposures_us, "must be positive and ascending"),
        ])?;
        self.check_patterns()
    }
}
