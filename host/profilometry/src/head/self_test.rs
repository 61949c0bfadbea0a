//! The last self-test of a head, `<head>.check.toml` beside its file, and whether it allows the head to judge.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use flankscope_foundation::date::Date;
use flankscope_foundation::seal::Seal;
use flankscope_foundation::textfile::{self, BadValue, TextFileError};

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
    /// Sphere spacing: measured minus certified distance of two spheres, either way.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sphere_spacing_um: Option<f64>,
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
        let where_limited = [
            ("limits.flatness_cells_um", self.flatness_cells_um),
            ("limits.probing_form_cells_um", self.probing_form_cells_um),
            ("limits.sphere_spacing_um", self.sphere_spacing_um),
        ];
        let where_limited = where_limited
            .into_iter()
            .filter_map(|(key, um)| Some((key, um?)));
        for (key, got) in limits.into_iter().chain(where_limited) {
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
    /// Places at which plane and spheres were measured, where it was more than one; the figures are those of the worst.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub places: Option<u32>,
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
    /// Measured minus certified distance of the two spheres, where there are two.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sphere_spacing_um: Option<f64>,
    /// What was allowed.
    pub limits: Limits,
    /// Whose word the file is, where it says so.
    #[serde(default, skip_serializing)]
    pub seal: Option<Seal>,
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

impl SelfTest {
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
        let check = |test: &Self| test.limits.check();
        let (test, _) = textfile::load_toml(&path, textfile::MAX_BYTES, check)?;
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
        let where_limited = [
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
            (
                "sphere spacing",
                self.sphere_spacing_um.map(f64::abs),
                self.limits.sphere_spacing_um,
            ),
        ];
        let where_limited = where_limited
            .into_iter()
            .filter_map(|(what, got, limit)| Some((what, got.unwrap_or(f64::NAN), limit?)));
        for (what, got_um, limit_um) in figures.into_iter().chain(where_limited) {
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
