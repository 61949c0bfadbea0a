//! Whether the head is fit today: a plane and a sphere of the target, measured as the acceptance tests of optical 3D systems
//! do (VDI/VDE 2634, parts 2 and 3): flatness, probing form and probing size.

use nalgebra::Point3;

use super::form;
use super::model::isometry;
use super::target::{Sphere, Target};
use crate::cloud::CellColumn;
use crate::head::{HeadModel, RigidTransform, SelfTest};
use crate::triangulate::HeadTriangulator;
use flankscope_foundation::date::Date;

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
        let triangulator = HeadTriangulator::new(head);
        let on_plane = triangulator.points(plane);
        let flat = Some(&on_plane)
            .filter(|cloud| cloud.len() >= LEAST_POINTS)
            .and_then(|cloud| form::plane(cloud))
            .ok_or(few("plane", on_plane.len()))?;
        let hand_eye = head
            .stage_from_camera
            .ok_or(lacks("head with a hand-triangulator"))?;
        let on_sphere = cap(
            &triangulator.points(sphere),
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
            seal: None,
        })
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
