//! Whether the head is fit today: a plane and a sphere of the target, measured as the acceptance tests of optical 3D systems
//! do (VDI/VDE 2634, parts 2 and 3): flatness, probing form, probing size, and sphere spacing where the target has a pair. The
//! figures are those of the worst place.

use nalgebra::{Isometry3, Point3};

use super::form;
use super::rig::isometry;
use super::target::{Sphere, Target};
use crate::cloud::CellColumn;
use crate::head::{Alone, Figures, HeadModel, PlaneFigures, SelfTest, SphereFigures};
use crate::triangulate::HeadTriangulator;
use flankscope_foundation::date::Date;

/// Why a self-test has no result.
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
    /// Captures of more or fewer places than the target names.
    #[error(
        "{got} captures of the {what}, the target names {expected} places: one for each is needed"
    )]
    Places {
        /// Plane or sphere.
        what: &'static str,
        /// Captures.
        got: usize,
        /// Places.
        expected: usize,
    },
    /// Nothing to be seen.
    #[error(
        "{got} points on the {what}{by}, at least {limit} are needed: is it there, clean and lit?"
    )]
    FewPoints {
        /// Plane or sphere.
        what: &'static str,
        /// In whose light, of two projectors.
        by: &'static str,
        /// Points.
        got: usize,
        /// Least.
        limit: usize,
    },
}

const LEAST_POINTS: usize = 200;
/// Cell of the wear figures. Single points ripple with the cores of the projector's bundle, the same in every capture of a
/// place; in means of some seventy points the ripple averages out.
const CELL_MM: f64 = 0.25;
/// Cosine of the largest angle between a sphere's normal and the direction to the camera. Beyond, light is grazing.
const CAP_COS: f64 = 0.77;
/// Points farther off the certified radius than this are something else's, mm.
const BELONGS_MM: f64 = 0.15;
/// The same before the sphere was fitted, when only the stages say where it is, mm.
const EXPECTED_MM: f64 = 0.4;

impl SelfTest {
    /// Measures the blank plate and the spheres of a target with a calibrated head: at every place that the target names, or the
    /// plate alone facing the head. Each place is seen by every projector: a point is what a check makes of both, and then what
    /// each of them makes alone.
    ///
    /// # Errors
    /// [`SelfTestError`].
    pub fn measure(
        head: &HeadModel,
        target: &Target,
        planes: &[Vec<Vec<CellColumn>>],
        spheres: &[Vec<Vec<CellColumn>>],
        date: Date,
    ) -> Result<Self, SelfTestError> {
        let lacks = |what| SelfTestError::Lacks { what };
        let limits = target.limits.ok_or(lacks("[limits] in the target"))?;
        let spheres_at = target.spheres();
        if spheres_at.is_empty() {
            return Err(lacks("[sphere] in the target"));
        }
        let record = head.calibration.as_ref();
        let record = record.ok_or(SelfTestError::NotCalibrated)?;
        let hand_eye = head.stage_from_camera;
        let hand_eye = hand_eye.ok_or(lacks("head with a hand-eye transform"))?;
        let camera_from_stage = isometry(&hand_eye).inverse();
        let places = spheres_at.len();
        let all = |what, got: usize| match got == places {
            true => Ok(()),
            false => Err(SelfTestError::Places {
                what,
                got,
                expected: places,
            }),
        };
        all("sphere", spheres.len())?;
        if planes.len() != 1 {
            all("plane", planes.len())?;
        }
        let figures = |by: &'static str, points: &Points<'_>| {
            let plane = planes.iter().map(|seen| flatness(&points(seen), by));
            let sphere = spheres.iter().zip(&spheres_at).map(|(seen, at)| {
                let camera_from_tool = camera_from_stage * at.stood.stage_from_tool();
                probing(&points(seen), &at.sphere, camera_from_tool, by)
            });
            Ok(Figures::from_places(
                plane.collect::<Result<_, _>>()?,
                sphere.collect::<Result<_, _>>()?,
            ))
        };
        let triangulator = HeadTriangulator::new(head);
        let together = figures("", &|cells| triangulator.points_of_each(cells))?;
        let second = head.with_projector(2);
        let alone = second.as_ref().map(|second| {
            let second = HeadTriangulator::new(second);
            let lit_by = |of: &HeadTriangulator<'_>, number: usize, cells: &[Vec<CellColumn>]| {
                cells
                    .get(number)
                    .map_or(Vec::new(), |cells| of.points(cells))
            };
            Ok(Alone {
                first: figures(" in the light of the first projector", &|cells| {
                    lit_by(&triangulator, 0, cells)
                })?,
                second: figures(" in the light of the second projector", &|cells| {
                    lit_by(&second, 1, cells)
                })?,
            })
        });
        Ok(Self {
            date,
            due: date.plus_days(limits.every_days),
            geometry_blake3: record.blake3.clone(),
            places: (places > 1).then_some(places as u32),
            figures: together,
            alone: alone.transpose()?,
            limits,
            seal: None,
        })
    }
}

/// Triangulates the cells of one place, separately for each projector, to points in the camera frame.
type Points<'a> = dyn Fn(&[Vec<CellColumn>]) -> Vec<[f64; 3]> + 'a;

fn few(what: &'static str, by: &'static str, got: usize) -> SelfTestError {
    SelfTestError::FewPoints {
        what,
        by,
        got,
        limit: LEAST_POINTS,
    }
}

fn flatness(cloud: &[[f64; 3]], by: &'static str) -> Result<PlaneFigures, SelfTestError> {
    let enough = Some(cloud).filter(|cloud| cloud.len() >= LEAST_POINTS);
    let flat = enough.and_then(form::plane);
    let flat = flat.ok_or(few("plane", by, cloud.len()))?;
    let of_cells = flat.averaged_over_squares(cloud, CELL_MM);
    Ok(PlaneFigures {
        plane_points: cloud.len() as u32,
        flatness_um: 1e3 * flat.range_mm(),
        flatness_cells_um: Some(1e3 * of_cells.range_mm()),
    })
}

/// The sphere or the pair of one view.
fn probing(
    cloud: &[[f64; 3]],
    artefact: &Sphere,
    camera_from_tool: Isometry3<f64>,
    by: &'static str,
) -> Result<SphereFigures, SelfTestError> {
    let each = artefact.each().map(|(centre_mm, diameter_mm)| {
        let expected = camera_from_tool * Point3::from(centre_mm);
        let on_sphere = cap(cloud, diameter_mm, expected);
        let enough = Some(&on_sphere[..]).filter(|cloud| cloud.len() >= LEAST_POINTS);
        let round = enough.and_then(form::sphere);
        let round = round.ok_or(few("sphere", by, on_sphere.len()))?;
        let of_cells = round.residuals.averaged_over_squares(&on_sphere, CELL_MM);
        let figures = SphereFigures {
            sphere_points: on_sphere.len() as u32,
            probing_form_um: 1e3 * round.residuals.range_mm(),
            probing_form_cells_um: Some(1e3 * of_cells.range_mm()),
            probing_size_um: 1e3 * (2.0 * round.radius_mm - diameter_mm),
            sphere_spacing_um: None,
        };
        Ok((figures, round.centre_mm))
    });
    let each: Vec<_> = each.collect::<Result<_, SelfTestError>>()?;
    Ok(match (artefact.partner, &each[..]) {
        (Some(partner), [(one, first), (other, second)]) => {
            let off_um = 1e3 * ((second - first).norm() - partner.spacing_mm);
            SphereFigures {
                sphere_spacing_um: Some(off_um),
                ..one.worse(*other)
            }
        }
        _ => each.first().map_or_else(SphereFigures::default, |of| of.0),
    })
}

/// The points of the sphere's cap that faces the camera. The stages say where the sphere is, a first fit says it better; the
/// ground behind it and its rim are left out.
fn cap(cloud: &[[f64; 3]], diameter_mm: f64, expected: Point3<f64>) -> Vec<[f64; 3]> {
    let radius_mm = 0.5 * diameter_mm;
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
