//! The last self-test of a head, `<head>.check.toml` beside its file, and whether it permits verdicts with this head.

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
        let lengths = [
            ("limits.flatness_um", Some(self.flatness_um)),
            ("limits.probing_form_um", Some(self.probing_form_um)),
            ("limits.probing_size_um", Some(self.probing_size_um)),
            ("limits.flatness_cells_um", self.flatness_cells_um),
            ("limits.probing_form_cells_um", self.probing_form_cells_um),
            ("limits.sphere_spacing_um", self.sphere_spacing_um),
        ];
        for (key, um) in lengths {
            let got = um.unwrap_or(1.0);
            let positive = "must be positive micrometres";
            textfile::require(&[(got > 0.0 && got < 1e6, key, &got, positive)])?;
        }
        let (days, right) = (self.every_days, "must be 1 to 3650 days");
        textfile::require(&[(
            (1..=3650).contains(&days),
            "limits.every_days",
            &days,
            right,
        )])
    }
}

/// Figures of one plane.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PlaneFigures {
    /// Points on the plane.
    pub plane_points: u32,
    /// Largest minus smallest distance from the fitted plane, without the farthest 0.3 % of the points.
    pub flatness_um: f64,
    /// The same of means over squares of 0.25 mm, the cells that wear is judged by.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub flatness_cells_um: Option<f64>,
}

/// Figures of one sphere or pair of spheres.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SphereFigures {
    /// Points on the sphere; of a pair, the fewer, as below the worse.
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
}

/// Figures of all planes and spheres: the worst of all places, and each place.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    /// The worst of the planes.
    #[serde(flatten)]
    pub of_planes: PlaneFigures,
    /// The worst of the spheres.
    #[serde(flatten)]
    pub of_spheres: SphereFigures,
    /// Place by place.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub plane: Vec<PlaneFigures>,
    /// Place by place.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sphere: Vec<SphereFigures>,
}

impl PlaneFigures {
    fn worse(self, other: Self) -> Self {
        Self {
            plane_points: self.plane_points.min(other.plane_points),
            flatness_um: worse(self.flatness_um, other.flatness_um),
            flatness_cells_um: worse_of(self.flatness_cells_um, other.flatness_cells_um),
        }
    }
}

impl SphereFigures {
    /// The worse of two, figure by figure.
    pub(crate) fn worse(self, other: Self) -> Self {
        Self {
            sphere_points: self.sphere_points.min(other.sphere_points),
            probing_form_um: worse(self.probing_form_um, other.probing_form_um),
            probing_form_cells_um: worse_of(
                self.probing_form_cells_um,
                other.probing_form_cells_um,
            ),
            probing_size_um: worse(self.probing_size_um, other.probing_size_um),
            sphere_spacing_um: worse_of(self.sphere_spacing_um, other.sphere_spacing_um),
        }
    }
}

/// The one that is farther from zero; what is no number is farthest.
fn worse(a: f64, b: f64) -> f64 {
    if a.is_nan() || b.abs() <= a.abs() {
        a
    } else {
        b
    }
}

/// The same where there may be none.
fn worse_of(a: Option<f64>, b: Option<f64>) -> Option<f64> {
    match (a, b) {
        (Some(a), Some(b)) => Some(worse(a, b)),
        (one, other) => one.or(other),
    }
}

/// Number of arrangements measured, and number required by VDI/VDE 2634, part 2.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Arrangements {
    /// Quantity that is limited.
    pub of: &'static str,
    /// Measured.
    pub measured: usize,
    /// Asked for.
    pub asked: usize,
}

/// Figures of each of two projectors alone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Alone {
    /// The first.
    pub first: Figures,
    /// The second.
    pub second: Figures,
}

/// A figure and its limit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Judged {
    /// The figure.
    pub what: &'static str,
    /// In whose light, where a head has two projectors; empty otherwise.
    pub by: &'static str,
    /// Found, without its sign.
    pub um: f64,
    /// Allowed.
    pub limit_um: f64,
}

impl Judged {
    /// Written so that a NaN is beyond.
    fn is_within(&self) -> bool {
        self.um <= self.limit_um
    }

    /// Ratio of the figure to its limit; infinite for NaN.
    fn share(&self) -> f64 {
        let share = self.um / self.limit_um;
        if share.is_nan() { f64::INFINITY } else { share }
    }
}

impl Figures {
    /// Worst figures of all places.
    pub(crate) fn from_places(plane: Vec<PlaneFigures>, sphere: Vec<SphereFigures>) -> Self {
        let of_planes = plane.iter().copied().reduce(PlaneFigures::worse);
        let of_spheres = sphere.iter().copied().reduce(SphereFigures::worse);
        Self {
            of_planes: of_planes.unwrap_or_default(),
            of_spheres: of_spheres.unwrap_or_default(),
            plane,
            sphere,
        }
    }

    /// Every figure that has a limit.
    fn judged(&self, by: &'static str, limits: &Limits) -> impl Iterator<Item = Judged> {
        let always = [
            ("flatness", self.of_planes.flatness_um, limits.flatness_um),
            (
                "probing form",
                self.of_spheres.probing_form_um,
                limits.probing_form_um,
            ),
            (
                "probing size",
                self.of_spheres.probing_size_um,
                limits.probing_size_um,
            ),
        ];
        let where_limited = [
            (
                "flatness of cells",
                self.of_planes.flatness_cells_um,
                limits.flatness_cells_um,
            ),
            (
                "probing form of cells",
                self.of_spheres.probing_form_cells_um,
                limits.probing_form_cells_um,
            ),
            (
                "sphere spacing",
                self.of_spheres.sphere_spacing_um,
                limits.sphere_spacing_um,
            ),
        ];
        let where_limited = where_limited
            .into_iter()
            .filter_map(|(what, got, limit)| Some((what, got.unwrap_or(f64::NAN), limit?)));
        always
            .into_iter()
            .chain(where_limited)
            .map(move |(what, um, limit_um)| Judged {
                what,
                by,
                um: um.abs(),
                limit_um,
            })
    }
}

/// The last self-test of a head: `<head>.check.toml` beside its file. The instrument writes it; a figure that is limited and under
/// another name counts as beyond its limit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SelfTest {
    /// Day of the test.
    pub date: Date,
    /// Last day on which it counts.
    pub due: Date,
    /// BLAKE3 of the geometry that was tested, as in the head's `[calibration]`.
    pub geometry_blake3: String,
    /// Places at which plane and spheres were measured, where it was more than one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub places: Option<u32>,
    /// Figures of the points that a check uses: with two projectors, the merged points.
    #[serde(flatten)]
    pub figures: Figures,
    /// Limits.
    pub limits: Limits,
    /// Figures of each projector of a head with two: merged points hide part of the error of either.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub alone: Option<Alone>,
    /// Whose word the file is, where it says so.
    #[serde(default, skip_serializing)]
    pub seal: Option<Seal>,
}

/// Why a head must not judge today.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Unfit {
    /// Its calibration has expired or does not match the head.
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
        "the self-test of {date} failed: {}{} {:.1} um, at most {} um is allowed; clean the head, calibrate again",
        .worst.what, .worst.by, .worst.um, .worst.limit_um
    )]
    Failed {
        /// Day of the test.
        date: Date,
        /// The figure farthest beyond its limit.
        worst: Judged,
    },
    /// The head has two projectors, the record lacks the figures of each.
    #[error(
        "the self-test of {date} says nothing of each projector alone: run flankscope calibrate --check"
    )]
    OnlyTogether {
        /// Day of the test.
        date: Date,
    },
}

impl SelfTest {
    /// Path of a head's self-test.
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

    /// All figures, and in whose light they are.
    pub fn each(&self) -> impl Iterator<Item = (&'static str, &Figures)> {
        let together = match self.alone {
            Some(_) => " by both projectors together",
            None => "",
        };
        let alone = self.alone.iter().flat_map(|alone| {
            [
                (" by the first projector alone", &alone.first),
                (" by the second projector alone", &alone.second),
            ]
        });
        std::iter::once((together, &self.figures)).chain(alone)
    }

    /// Arrangements measured out of those required by VDI/VDE 2634, part 2: the probing error in ten arrangements of a sphere, sphere spacing
    /// in seven of a bar, flatness in six of a plate. None of a file that does not list them.
    #[must_use]
    pub fn arrangements(&self) -> Option<[Arrangements; 3]> {
        let Figures { plane, sphere, .. } = &self.figures;
        let bars = |seen: &&SphereFigures| seen.sphere_spacing_um.is_some();
        let bars = sphere.iter().filter(bars).count();
        let of = |of, measured, asked| Arrangements {
            of,
            measured,
            asked,
        };
        (!sphere.is_empty()).then(|| {
            [
                of("sphere", sphere.len() + bars, 10),
                of("bar", bars, 7),
                of("plate", plane.len(), 6),
            ]
        })
    }

    /// The figure that uses most of its limit; it decides.
    #[must_use]
    pub fn worst(&self) -> Option<Judged> {
        self.each()
            .flat_map(|(by, figures)| figures.judged(by, &self.limits))
            .max_by(|a, b| a.share().total_cmp(&b.share()))
    }

    /// Whether it permits the use of a head with this number of projectors on a day.
    ///
    /// # Errors
    /// [`Unfit`].
    pub fn allows(
        &self,
        geometry_blake3: &str,
        projectors: usize,
        today: Date,
    ) -> Result<(), Unfit> {
        let Self { date, due, .. } = *self;
        if self.geometry_blake3 != geometry_blake3 {
            return Err(Unfit::Foreign { date });
        }
        if today > due {
            return Err(Unfit::Overdue { date, due, today });
        }
        if projectors > 1 && self.alone.is_none() {
            return Err(Unfit::OnlyTogether { date });
        }
        match self.worst() {
            Some(worst) if !worst.is_within() => Err(Unfit::Failed { date, worst }),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FLAT: PlaneFigures = PlaneFigures {
        plane_points: 1000,
        flatness_um: 20.0,
        flatness_cells_um: Some(4.0),
    };
    const ROUND: SphereFigures = SphereFigures {
        sphere_points: 500,
        probing_form_um: 20.0,
        probing_form_cells_um: Some(4.0),
        probing_size_um: -3.0,
        sphere_spacing_um: Some(1.0),
    };

    fn sound() -> Figures {
        Figures::from_places(vec![FLAT; 2], vec![ROUND; 2])
    }

    fn test_of(together: Figures, alone: Option<Alone>) -> SelfTest {
        let date: Date = "2026-05-04".parse().expect("a day");
        SelfTest {
            date,
            due: date.plus_days(7),
            geometry_blake3: "0".into(),
            places: None,
            figures: together,
            limits: Limits {
                flatness_um: 45.0,
                probing_form_um: 45.0,
                probing_size_um: 8.0,
                flatness_cells_um: Some(8.0),
                probing_form_cells_um: Some(8.0),
                sphere_spacing_um: Some(8.0),
                every_days: 7,
            },
            alone,
            seal: None,
        }
    }

    #[test]
    fn what_one_projector_alone_does_wrong_decides() {
        let bent_plane = PlaneFigures {
            flatness_cells_um: Some(9.3),
            ..FLAT
        };
        let bent_sphere = SphereFigures {
            probing_form_um: 46.0,
            ..ROUND
        };
        let bent = || Figures::from_places(vec![FLAT, bent_plane], vec![bent_sphere, ROUND]);
        let today = test_of(sound(), None).date;
        let alone = |first, second| Some(Alone { first, second });
        let of = |test: &SelfTest| test.allows("0", 2, today);
        assert_eq!(of(&test_of(sound(), alone(sound(), sound()))), Ok(()));
        for (first, second, by) in [
            (bent(), sound(), " by the first projector alone"),
            (sound(), bent(), " by the second projector alone"),
        ] {
            // 9.3 of 8 is farther beyond than 46 of 45.
            let worst = Judged {
                what: "flatness of cells",
                by,
                um: 9.3,
                limit_um: 8.0,
            };
            let refused = of(&test_of(sound(), alone(first, second)));
            assert_eq!(refused, Err(Unfit::Failed { date: today, worst }));
        }
        // Nobody looked at each alone.
        let together = test_of(sound(), None);
        let refused = of(&together);
        assert_eq!(refused, Err(Unfit::OnlyTogether { date: today }));
        assert_eq!(together.allows("0", 1, today), Ok(()));
        // A limited quantity that was not measured or is not a number exceeds its limit.
        let no_spacing = SphereFigures {
            sphere_spacing_um: None,
            ..ROUND
        };
        let no_number = SphereFigures {
            probing_size_um: f64::NAN,
            ..ROUND
        };
        for at in [vec![no_spacing], vec![ROUND, no_number, ROUND]] {
            let figures = Figures::from_places(vec![FLAT], at);
            let refused = test_of(figures, None).allows("0", 1, today);
            assert!(matches!(refused, Err(Unfit::Failed { .. })), "{refused:?}");
        }
    }

    #[test]
    fn every_figure_is_that_of_its_worst_place() {
        let here = SphereFigures {
            sphere_points: 400,
            probing_size_um: 3.5,
            sphere_spacing_um: Some(-2.0),
            ..ROUND
        };
        let figures = Figures::from_places(vec![FLAT], vec![ROUND, here]);
        let worst = SphereFigures {
            sphere_points: 400,
            probing_size_um: 3.5,
            sphere_spacing_um: Some(-2.0),
            ..ROUND
        };
        assert_eq!(figures.of_spheres, worst);
        let one = SphereFigures {
            sphere_spacing_um: None,
            ..ROUND
        };
        let test = test_of(Figures::from_places(vec![FLAT; 6], vec![ROUND, one]), None);
        let measured = test.arrangements().map(|of| of.map(|of| of.measured));
        // Two spheres and one; the one is no bar.
        assert_eq!(measured, Some([3, 1, 6]));
    }

    #[test]
    fn the_file_comes_back_and_a_figure_under_another_name_is_none() {
        let larger = SphereFigures {
            probing_size_um: 2.5,
            ..ROUND
        };
        let second = Figures::from_places(vec![FLAT], vec![larger, ROUND]);
        let first = sound();
        for alone in [None, Some(Alone { first, second })] {
            let test = test_of(sound(), alone);
            let text = test.to_toml().expect("text");
            assert_eq!(toml::from_str::<SelfTest>(&text).expect("its own"), test);
            let misspelt = text.replacen("sphere_spacing_um", "sphere_spacing", 1);
            let read: SelfTest = toml::from_str(&misspelt).expect("a file");
            let refused = read.allows("0", 1, test.date);
            assert!(matches!(refused, Err(Unfit::Failed { .. })), "{misspelt}");
            let without = text.replacen("probing_size_um", "probing_size", 1);
            assert!(toml::from_str::<SelfTest>(&without).is_err(), "{without}");
        }
    }
}
