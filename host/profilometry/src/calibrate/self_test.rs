//! Whether the head is fit today: a plane and a sphere of the target, measured as the acceptance tests of optical 3D systems
//! do (VDI/VDE 2634, parts 2 and 3): flatness, probing form, probing size, and sphere spacing where the target has a pair. The
//! figures are those of the worst place.

use nalgebra::{Isometry3, Point3};

use super::form;
use super::model::isometry;
use super::sighting::StagePose;
use super::target::{Sphere, Target};
use crate::cloud::CellColumn;
use crate::head::{HeadModel, SelfTest};
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
    /// Measures the blank plate and the spheres of a target with a calibrated head: at every place that the target names, or the
    /// plate alone facing the head. Each place is seen by every projector; a point is what a check makes of both.
    ///
    /// # Errors
    /// [`SelfTestError`].
    pub fn of(
        head: &HeadModel,
        target: &Target,
        planes: &[Vec<Vec<CellColumn>>],
        spheres: &[Vec<Vec<CellColumn>>],
        date: Date,
    ) -> Result<Self, SelfTestError> {
        let lacks = |what| SelfTestError::Lacks { what };
        let limits = target.limits.ok_or(lacks("[limits] in the target"))?;
        let artefact = target.sphere.ok_or(lacks("[sphere] in the target"))?;
        let record = head.calibration.as_ref();
        let record = record.ok_or(SelfTestError::NotCalibrated)?;
        let hand_eye = head.stage_from_camera;
        let hand_eye = hand_eye.ok_or(lacks("head with a hand-eye transform"))?;
        let camera_from_stage = isometry(&hand_eye).inverse();
        let places = target.test_places();
        let all = |what, got: usize| match got == places.len() {
            true => Ok(()),
            false => Err(SelfTestError::Places {
                what,
                got,
                expected: places.len(),
            }),
        };
        all("sphere", spheres.len())?;
        if planes.len() != 1 {
            all("plane", planes.len())?;
        }
        let triangulator = HeadTriangulator::new(head);
        let mut worst = Worst::default();
        for plane in planes {
            worst.take_plane(&triangulator.points_of_each(plane))?;
        }
        for (sphere, &place) in spheres.iter().zip(&places) {
            let stood = StagePose::before(artefact.middle_mm()).beside(place);
            let camera_from_tool = camera_from_stage * stood.stage_from_tool();
            let points = triangulator.points_of_each(sphere);
            worst.take_spheres(&points, &artefact, camera_from_tool)?;
        }
        Ok(Self {
            date,
            due: date.plus_days(limits.every_days),
            geometry_blake3: record.blake3.clone(),
            places: (places.len() > 1).then_some(places.len() as u32),
            plane_points: worst.plane_points,
            flatness_um: worst.flatness_um,
            flatness_cells_um: Some(worst.flatness_cells_um),
            sphere_points: worst.sphere_points,
            probing_form_um: worst.probing_form_um,
            probing_form_cells_um: Some(worst.probing_form_cells_um),
            probing_size_um: worst.probing_size_um,
            sphere_spacing_um: worst.sphere_spacing_um,
            limits,
            seal: None,
        })
    }
}

/// The worst figures so far.
#[derive(Default)]
struct Worst {
    plane_points: u32,
    flatness_um: f64,
    flatness_cells_um: f64,
    sphere_points: u32,
    probing_form_um: f64,
    probing_form_cells_um: f64,
    probing_size_um: f64,
    sphere_spacing_um: Option<f64>,
}

/// Fewest points so far; zero is none yet.
fn fewest(so_far: u32, got: usize) -> u32 {
    match so_far {
        0 => got as u32,
        _ => so_far.min(got as u32),
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

fn few(what: &'static str, got: usize) -> SelfTestError {
    SelfTestError::FewPoints {
        what,
        got,
        limit: LEAST_POINTS,
    }
}

impl Worst {
    fn take_plane(&mut self, cloud: &[[f64; 3]]) -> Result<(), SelfTestError> {
        let enough = Some(cloud).filter(|cloud| cloud.len() >= LEAST_POINTS);
        let flat = enough.and_then(form::plane);
        let flat = flat.ok_or(few("plane", cloud.len()))?;
        let of_cells = flat.of_squares(cloud, CELL_MM);
        self.plane_points = fewest(self.plane_points, cloud.len());
        self.flatness_um = worse(self.flatness_um, 1e3 * flat.range_mm());
        self.flatness_cells_um = worse(self.flatness_cells_um, 1e3 * of_cells.range_mm());
        Ok(())
    }

    /// The spheres of one view.
    fn take_spheres(
        &mut self,
        cloud: &[[f64; 3]],
        artefact: &Sphere,
        camera_from_tool: Isometry3<f64>,
    ) -> Result<(), SelfTestError> {
        let mut centres = Vec::new();
        for (centre_mm, diameter_mm) in artefact.each() {
            let expected = camera_from_tool * Point3::from(centre_mm);
            let on_sphere = cap(cloud, diameter_mm, expected);
            let enough = Some(&on_sphere[..]).filter(|cloud| cloud.len() >= LEAST_POINTS);
            let round = enough.and_then(form::sphere);
            let round = round.ok_or(few("sphere", on_sphere.len()))?;
            let of_cells = round.residuals.of_squares(&on_sphere, CELL_MM);
            let form_um = 1e3 * round.residuals.range_mm();
            let size_um = 1e3 * (2.0 * round.radius_mm - diameter_mm);
            self.sphere_points = fewest(self.sphere_points, on_sphere.len());
            self.probing_form_um = worse(self.probing_form_um, form_um);
            let of_cells_um = 1e3 * of_cells.range_mm();
            self.probing_form_cells_um = worse(self.probing_form_cells_um, of_cells_um);
            self.probing_size_um = worse(self.probing_size_um, size_um);
            centres.push(round.centre_mm);
        }
        if let (Some(partner), [first, second]) = (artefact.partner, &centres[..]) {
            let off_um = 1e3 * ((second - first).norm() - partner.spacing_mm);
            let so_far = self.sphere_spacing_um.unwrap_or(off_um);
            self.sphere_spacing_um = Some(worse(so_far, off_um));
        }
        Ok(())
    }
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
