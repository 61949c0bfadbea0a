//! Whether the head is fit today: a plane and a sphere of the target, measured as the acceptance tests of optical 3D systems
//! do (VDI/VDE 2634, parts 2 and 3): flatness, probing form and probing size.

use std::path::{Path, PathBuf};

use nalgebra::Point3;
use serde::{Deserialize, Serialize};

use super::eye::Eye;
use super::form;
use super::model::isometry;
use super::target::{Sphere, Target};
use crate::calibration::{HeadModel, RigidTransform};
use crate::cloud::CellColumn;
use crate::date::Date;
use crate::textfile::{self, BadValue, TextFileError};

/// Largest errors that a head may show, and how often that is to be asked.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Limits {
    /// Flatness of the blank plate: largest minus smallest distance from its plane.
    pub flatness_um: f64,
    /// Probing form: largest minus smallest distance from the fitted sphere.
    pub probing_form_um: f64,
    /// Probing size: fitted minus certified diameter, either way.
    pub probing_size_um: f64,
    /// Flatness of the blank plate's means over squares of 0.25 mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub flatness_cells_um: Option<f64>,
    /// Probing form of the sphere's means over squares of 0.25 mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub probing_form_cells_um: Option<f64>,
    /// Days until the next test.
    pub every_days: u32,
}

impl Limits {
    pub(crate) fn check(&self) -> Result<(), BadValue> {
        let limits = [
            ("limits.flatness_um", self.flatness_um),
            ("limits.probing_form_um", self.probing_form_um),
            ("limits.probing_size_um", self.probing_size_um),
        ];
        let of_cells = [
            ("limits.flatness_cells_um", self.flatness_cells_um),
            ("limits.probing_form_cells_um", self.probing_form_cells_um),
        ];
        let of_cells = of_cells
            .into_iter()
            .filter_map(|(key, um)| Some((key, um?)));
        for (key, got) in limits.into_iter().chain(of_cells) {
            if !(got > 0.0 && got < 1e6) {
                return Err(BadValue::new(key, got, "must be positive micrometres"));
            }
        }
        if !(1..=3650).contains(&self.every_days) {
            return Err(BadValue::new(
                "limits.every_days",
                self.every_days,
                "must be 1 to 3650 days",
            ));
        }
        Ok(())
    }
}

/// The last self-test of a head: `<head>.check.toml` beside its file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SelfTest {
    /// Day of the test.
    pub date: Date,
    /// Last day on which it counts.
    pub due: Date,
    /// BLAKE3 of the geometry that was tested, as in the head's `[calibration]`.
    pub geometry_blake3: String,
    /// Points on the plane.
    pub plane_points: u32,
    /// Largest minus smallest distance from the fitted plane, without the farthest 0.3 % of the points.
    pub flatness_um: f64,
    /// The same of means over squares of 0.25 mm, the cells that wear is judged by.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub flatness_cells_um: Option<f64>,
    /// Points on the sphere.
    pub sphere_points: u32,
    /// Largest minus smallest distance from the fitted sphere, without the farthest 0.3 % of the points.
    pub probing_form_um: f64,
    /// The same of means over squares of 0.25 mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub probing_form_cells_um: Option<f64>,
    /// Fitted minus certified diameter.
    pub probing_size_um: f64,
    /// What was allowed.
    pub limits: Limits,
}

/// Why a head must not judge today.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Unfit {
    /// Its calibration does not count.
    #[error(transparent)]
    Calibration(#[from] super::RecordError),
    /// Never tested.
    #[error("the head was calibrated but never tested: run flankscope calibrate --check")]
    Untested,
    /// Tested with another calibration.
    #[error(
        "the self-test of {date} was made with another calibration: run flankscope calibrate --check"
    )]
    Foreign {
        /// Day of the test.
        date: Date,
    },
    /// Tested too long ago.
    #[error(
        "the self-test of {date} counted until {due}, today is {today}: run flankscope calibrate --check"
    )]
    Overdue {
        /// Day of the test.
        date: Date,
        /// Last day.
        due: Date,
        /// Today.
        today: Date,
    },
    /// Beyond its limits.
    #[error(
        "the self-test of {date} failed: {what} {got_um:.1} um, at most {limit_um} um is allowed; clean the head, calibrate again"
    )]
    Failed {
        /// Day of the test.
        date: Date,
        /// Which figure.
        what: &'static str,
        /// Found.
        got_um: f64,
        /// Limit.
        limit_um: f64,
    },
}

/// Why a self-test says nothing.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SelfTestError {
    /// Target or head cannot be used for it.
    #[error("there is no {what}; a self-test needs it")]
    Lacks {
        /// What.
        what: &'static str,
    },
    /// The head is not calibrated.
    #[error("the head has no [calibration] to be tested; run flankscope calibrate first")]
    NotCalibrated,
    /// Nothing to be seen.
    #[error("{got} points on the {what}, at least {limit} are needed: is it there, clean and lit?")]
    FewPoints {
        /// Plane or sphere.
        what: &'static str,
        /// Points.
        got: usize,
        /// Least.
        limit: usize,
    },
}

const LEAST_POINTS: usize = 200;
/// Cell of the wear figures. Single points ripple with the cores of the projector's bundle, the same in every capture of a
/// place; means of some seventy points hardly do.
const CELL_MM: f64 = 0.25;
/// The cap of the sphere that counts: up to this angle from the direction to the camera. Beyond, light grazes.
const CAP_COS: f64 = 0.77;
/// Points farther off the certified radius than this are something else's, mm.
const BELONGS_MM: f64 = 0.15;
/// The same before the sphere was fitted, when only the stages say where it is, mm.
const EXPECTED_MM: f64 = 0.4;

impl SelfTest {
    /// Measures the blank plate and the sphere of a target with a calibrated head.
    ///
    /// # Errors
    /// [`SelfTestError`].
    pub fn of(
        head: &HeadModel,
        target: &Target,
        plane: &[CellColumn],
        sphere: &[CellColumn],
        date: Date,
    ) -> Result<Self, SelfTestError> {
        let lacks = |what| SelfTestError::Lacks { what };
        let limits = target.limits.ok_or(lacks("[limits] in the target"))?;
        let artefact = target.sphere.ok_or(lacks("[sphere] in the target"))?;
        let record = head.calibration.as_ref();
        let record = record.ok_or(SelfTestError::NotCalibrated)?;
        let few = |what, got| SelfTestError::FewPoints {
            what,
            got,
            limit: LEAST_POINTS,
        };
        let eye = Eye::new(head);
        let on_plane = eye.points(plane);
        let flat = Some(&on_plane)
            .filter(|cloud| cloud.len() >= LEAST_POINTS)
            .and_then(|cloud| form::plane(cloud))
            .ok_or(few("plane", on_plane.len()))?;
        let hand_eye = head
            .stage_from_camera
            .ok_or(lacks("head with a hand-eye"))?;
        let on_sphere = cap(
            &eye.points(sphere),
            &artefact,
            expected_centre(&hand_eye, &artefact),
        );
        let round = Some(&on_sphere)
            .filter(|cloud| cloud.len() >= LEAST_POINTS)
            .and_then(|cloud| form::sphere(cloud))
            .ok_or(few("sphere", on_sphere.len()))?;
        Ok(Self {
            date,
            due: date.plus_days(limits.every_days),
            geometry_blake3: record.blake3.clone(),
            plane_points: on_plane.len() as u32,
            flatness_um: 1e3 * flat.range_mm(),
            flatness_cells_um: Some(1e3 * flat.of_squares(&on_plane, CELL_MM).range_mm()),
            sphere_points: on_sphere.len() as u32,
            probing_form_um: 1e3 * round.residuals.range_mm(),
            probing_form_cells_um: Some(
                1e3 * round.residuals.of_squares(&on_sphere, CELL_MM).range_mm(),
            ),
            probing_size_um: 1e3 * (2.0 * round.radius_mm - artefact.diameter_mm),
            limits,
        })
    }

    /// Where the self-test of a head lies.
    #[must_use]
    pub fn path_of(head: &Path) -> PathBuf {
        head.with_extension("check.toml")
    }

    /// Reads the self-test of a head's file; `None` where there is none.
    ///
    /// # Errors
    /// [`TextFileError`] with file, line and what would be right.
    pub fn load(head: &Path) -> Result<Option<Self>, TextFileError> {
        let path = Self::path_of(head);
        if !path.exists() {
            return Ok(None);
        }
        let text = textfile::read(&path)?;
        let test: Self = textfile::parse_toml(&path, &text)?;
        test.limits
            .check()
            .map_err(|bad| bad.in_file(&path, &text))?;
        Ok(Some(test))
    }

    /// Its file's content.
    ///
    /// # Errors
    /// The writer's.
    pub fn to_toml(&self) -> Result<String, toml::ser::Error> {
        toml::to_string(self)
    }

    /// Whether it allows a calibration to be used on a day.
    ///
    /// # Errors
    /// [`Unfit`].
    pub fn allows(&self, geometry_blake3: &str, today: Date) -> Result<(), Unfit> {
        let Self { date, due, .. } = *self;
        if self.geometry_blake3 != geometry_blake3 {
            return Err(Unfit::Foreign { date });
        }
        if today > due {
            return Err(Unfit::Overdue { date, due, today });
        }
        let figures = [
            ("flatness", self.flatness_um, self.limits.flatness_um),
            (
                "probing form",
                self.probing_form_um,
                self.limits.probing_form_um,
            ),
            (
                "probing size",
                self.probing_size_um.abs(),
                self.limits.probing_size_um,
            ),
        ];
        let of_cells = [
            (
                "flatness of cells",
                self.flatness_cells_um,
                self.limits.flatness_cells_um,
            ),
            (
                "probing form of cells",
                self.probing_form_cells_um,
                self.limits.probing_form_cells_um,
            ),
        ];
        let of_cells = of_cells
            .into_iter()
            .filter_map(|(what, got, limit)| Some((what, got.unwrap_or(f64::NAN), limit?)));
        for (what, got_um, limit_um) in figures.into_iter().chain(of_cells) {
            // Written so that a NaN fails.
            if !(got_um <= limit_um) {
                return Err(Unfit::Failed {
                    date,
                    what,
                    got_um,
                    limit_um,
                });
            }
        }
        Ok(())
    }
}

/// Where the stages put the sphere's centre, which they turned and raised to the middle of the field, in the camera frame.
fn expected_centre(stage_from_camera: &RigidTransform, sphere: &Sphere) -> Point3<f64> {
    let [x, y, _] = sphere.centre_mm;
    isometry(stage_from_camera).inverse() * Point3::new(x.hypot(y), 0.0, 0.0)
}

/// The points of the sphere's cap that faces the camera. The stages say where the sphere is, a first fit says it better; the
/// ground behind it and its rim are left out.
fn cap(cloud: &[[f64; 3]], sphere: &Sphere, expected: Point3<f64>) -> Vec<[f64; 3]> {
    let radius_mm = 0.5 * sphere.diameter_mm;
    let around = |centre: Point3<f64>, belongs_mm: f64| -> Vec<[f64; 3]> {
        let to_camera = -centre.coords.normalize();
        let belongs = |p: &[f64; 3]| {
            let away = Point3::from(*p) - centre;
            (away.norm() - radius_mm).abs() < belongs_mm
                && away.dot(&to_camera) > CAP_COS * away.norm()
        };
        cloud.iter().copied().filter(belongs).collect()
    };
    let mut kept = around(expected, EXPECTED_MM);
    for _ in 0..3 {
        let Some(found) = form::sphere(&kept) else {
            return Vec::new();
        };
        kept = around(found.centre_mm, BELONGS_MM);
    }
    kept
}
