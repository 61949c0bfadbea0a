//! The head's two objectives: projection, sharpness and brightness.

use super::WorldError;
use super::unevenness::Unevenness;
use nalgebra::{Isometry3, Matrix2, Point3, Translation3, UnitQuaternion, Vector2, Vector3};

/// A pinhole with Brown's distortion (radial k1, k2, k3 and tangential p1, p2).
///
/// Pixel centres are at integer coordinates; x to the right, y down, z forward.
#[derive(Clone, Debug, PartialEq)]
pub struct Pinhole {
    /// Focal length in x and y, px.
    pub focal_px: [f64; 2],
    /// Principal point, px.
    pub centre_px: [f64; 2],
    /// k1, k2, p1, p2, k3.
    pub distortion: [f64; 5],
    /// Residual distortion beyond that model.
    pub uneven: Option<Unevenness>,
}

impl Pinhole {
    /// Pixel of a point in front of the pinhole; `None` behind it.
    pub fn project(&self, p: Point3<f64>) -> Option<[f64; 2]> {
        (p.z > 0.0).then(|| self.pixel(self.distort(Vector2::new(p.x / p.z, p.y / p.z))))
    }

    /// Direction (z = 1, not normalised) of the light that reaches pixel `px`.
    pub fn direction(&self, px: [f64; 2]) -> Vector3<f64> {
        let seen = Vector2::new(
            (px[0] - self.centre_px[0]) / self.focal_px[0],
            (px[1] - self.centre_px[1]) / self.focal_px[1],
        );
        // Newton's method: the distortion is a small, smooth deviation from identity; its Jacobian by central differences.
        let mut ideal = seen;
        const STEP: f64 = 1e-6;
        for _ in 0..10 {
            let off = self.distort(ideal) - seen;
            if off.norm() < 1e-15 {
                break;
            }
            let column = |axis: Vector2<f64>| {
                (self.distort(ideal + STEP * axis) - self.distort(ideal - STEP * axis))
                    / (2.0 * STEP)
            };
            let jacobian = Matrix2::from_columns(&[column(Vector2::x()), column(Vector2::y())]);
            let Some(inverse) = jacobian.try_inverse() else {
                break;
            };
            ideal -= inverse * off;
        }
        Vector3::new(ideal.x, ideal.y, 1.0)
    }

    fn pixel(&self, seen: Vector2<f64>) -> [f64; 2] {
        [
            self.centre_px[0] + self.focal_px[0] * seen.x,
            self.centre_px[1] + self.focal_px[1] * seen.y,
        ]
    }

    fn distort(&self, ideal: Vector2<f64>) -> Vector2<f64> {
        let [k1, k2, p1, p2, k3] = self.distortion;
        let (x, y) = (ideal.x, ideal.y);
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let astray = self.uneven.as_ref().map(|uneven| uneven.at(ideal));
        let brown = Vector2::new(
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        );
        brown + astray.unwrap_or_default()
    }
}

/// Sharpness and brightness of one objective over its field and depth.
#[derive(Clone, Debug, PartialEq)]
pub struct Objective {
    /// Distance of best focus on the axis, mm.
    pub focus_mm: f64,
    /// Field curvature: best focus approaches by this much per squared lateral distance, mm/mm².
    pub field_curvature_per_mm: f64,
    /// Radius of the measured field at best focus, mm.
    pub field_radius_mm: f64,
    /// Blur in best focus, standard deviation in core pitches.
    pub focus_sigma_pitch: f64,
    /// Increase of the blur per distance from best focus, core pitches per mm.
    pub defocus_sigma_pitch_per_mm: f64,
    /// Fraction of the light lost at the edge of the field.
    pub edge_loss_ratio: f64,
}

impl Objective {
    /// Standard deviation of the blur at a point in the objective's own frame, core pitches.
    pub fn sigma_pitch(&self, p: Point3<f64>) -> f64 {
        let lateral_mm2 = p.x * p.x + p.y * p.y;
        let defocus_mm = p.z - (self.focus_mm - self.field_curvature_per_mm * lateral_mm2);
        self.focus_sigma_pitch
            .hypot(self.defocus_sigma_pitch_per_mm * defocus_mm)
    }

    /// Squared distance from the axis relative to the field's edge, at most 1.5.
    pub fn field_ratio2(&self, p: Point3<f64>) -> f64 {
        let at_focus = self.focus_mm / p.z;
        ((p.x * p.x + p.y * p.y) * at_focus * at_focus
            / (self.field_radius_mm * self.field_radius_mm))
            .min(1.5)
    }

    /// Brightness relative to the centre of the field.
    pub fn brightness(&self, p: Point3<f64>) -> f64 {
        (1.0 - self.edge_loss_ratio * self.field_ratio2(p)).max(0.0)
    }
}

/// Optics of the measuring head.
#[derive(Clone, Debug, PartialEq)]
pub struct HeadOptics {
    /// Camera through its bundle and objective.
    pub camera: Pinhole,
    /// Columns and rows of the sensor.
    pub camera_size_px: [usize; 2],
    /// Blur and brightness on the camera side.
    pub camera_objective: Objective,
    /// Projector (DMD) through its bundle and objective.
    pub projector: Pinhole,
    /// Columns and rows of the DMD.
    pub projector_size_px: [usize; 2],
    /// Blur and brightness on the projector side.
    pub projector_objective: Objective,
    /// Projector frame from camera frame.
    pub projector_from_camera: Isometry3<f64>,
    /// A second projector, with the same bundle and objective properties as the first.
    pub second_projector: Option<SecondProjector>,
    /// Stage frame from camera frame with both stages at zero.
    pub stage_from_camera: Isometry3<f64>,
    /// Modulation of a coarse pattern at the centre of the field; the remainder is stray light.
    pub contrast_centre: f64,
    /// Modulation of a coarse pattern at the edge of the field.
    pub contrast_edge: f64,
    /// Light of the DMD with all mirrors off, relative to all on.
    pub dmd_leak_ratio: f64,
}

/// Properties of a second projector that differ from the first.
#[derive(Clone, Debug, PartialEq)]
pub struct SecondProjector {
    /// DMD through bundle and objective.
    pub projector: Pinhole,
    /// Its frame from the camera frame.
    pub projector_from_camera: Isometry3<f64>,
}

impl HeadOptics {
    /// The head with its second projector only, if it has one.
    pub fn by_second_projector(&self) -> Option<Self> {
        let second = self.second_projector.clone()?;
        Some(Self {
            projector: second.projector,
            projector_from_camera: second.projector_from_camera,
            second_projector: None,
            ..self.clone()
        })
    }

    /// Gives all lenses a residual distortion of `rms_um` along each axis in best focus, replacing any present one; one seed is one head.
    pub fn make_uneven(&mut self, rms_um: f64, seed: u64) {
        let second = self.second_projector.as_mut();
        let second = second.map(|second| (&mut second.projector, &self.projector_objective));
        let lenses = [
            (&mut self.camera, &self.camera_objective),
            (&mut self.projector, &self.projector_objective),
        ];
        let lenses = lenses.into_iter().chain(second);
        for (number, (lens, objective)) in (0..).zip(lenses) {
            let per_mm = 1.0 / objective.focus_mm;
            let (rms, field) = (1e-3 * rms_um * per_mm, objective.field_radius_mm * per_mm);
            lens.uneven = Some(Unevenness::drawn(seed, number, rms, field));
        }
    }

    /// Tool frame from camera frame with the die turned by `rotation_rad` and the head raised by `vertical_mm`.
    pub fn tool_from_camera(&self, rotation_rad: f64, vertical_mm: f64) -> Isometry3<f64> {
        let tool_from_stage = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -rotation_rad);
        tool_from_stage * Translation3::new(0.0, 0.0, vertical_mm) * self.stage_from_camera
    }

    /// Modulation of a coarse pattern at a point in the camera frame.
    pub fn contrast(&self, p_camera: Point3<f64>) -> f64 {
        let ratio2 = self.camera_objective.field_ratio2(p_camera).min(1.0);
        self.contrast_centre + (self.contrast_edge - self.contrast_centre) * ratio2
    }

    pub(crate) fn validate(&self) -> Result<(), WorldError> {
        let second = self.second_projector.as_ref();
        let pinholes = [&self.camera, &self.projector].into_iter();
        for pinhole in pinholes.chain(second.map(|second| &second.projector)) {
            for focal in pinhole.focal_px {
                WorldError::check("focal_px", focal, 1.0, 1e6)?;
            }
            for centre in pinhole.centre_px {
                WorldError::check("principal point px", centre, -1e5, 1e5)?;
            }
            for k in pinhole.distortion {
                WorldError::check("distortion", k, -10.0, 10.0)?;
            }
        }
        for objective in [&self.camera_objective, &self.projector_objective] {
            WorldError::check("focus_mm", objective.focus_mm, 0.1, 1e4)?;
            WorldError::check(
                "field_curvature_per_mm",
                objective.field_curvature_per_mm,
                -1.0,
                1.0,
            )?;
            WorldError::check("field_radius_mm", objective.field_radius_mm, 0.01, 1e4)?;
            WorldError::check("focus_sigma_pitch", objective.focus_sigma_pitch, 0.05, 10.0)?;
            WorldError::check(
                "defocus_sigma_pitch_per_mm",
                objective.defocus_sigma_pitch_per_mm,
                0.0,
                10.0,
            )?;
            WorldError::check("edge_loss_ratio", objective.edge_loss_ratio, 0.0, 1.0)?;
        }
        for size in self
            .camera_size_px
            .into_iter()
            .chain(self.projector_size_px)
        {
            WorldError::check("image size px", size as f64, 16.0, 16_384.0)?;
        }
        WorldError::check("contrast_centre", self.contrast_centre, 0.0, 1.0)?;
        WorldError::check("contrast_edge", self.contrast_edge, 0.0, 1.0)?;
        WorldError::check("dmd_leak_ratio", self.dmd_leak_ratio, 0.0, 1.0)
    }
}
