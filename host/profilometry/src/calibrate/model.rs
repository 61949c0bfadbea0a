//! The unknowns of a calibration, and where they put a dot of a plate in the images.
//!
//! Shared by all views: camera (focal lengths, principal point, k1 k2 p1 p2), projector (focal length, principal column,
//! k1 k2 p1 p2), projector from camera, stage from camera; in a second step, what both lenses do beyond that. Beside them the place of every plate, which its certificate
//! gives nearly, and the error of the stages in every view, which their data sheet bounds.
//!
//! A second projector has the unknowns of the first once more; its scene is that of the first but for them.
//!
//! Fringes vary along the projector's columns only, so they say nothing of its rows: its focal length there keeps the ratio
//! of the starting values, its principal row stays, and its shift along the rows shows through distortion alone, hence the
//! starting value as a weak prior.

use flankscope_foundation::rigid::nearest_rotation;
use nalgebra::{Isometry3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::sighting::StagePose;
use super::target::Target;
use crate::head::Pinhole;
use crate::head::residual::{ResidualField, SIDE};
use crate::head::{HeadModel, RigidTransform, SecondProjector};

/// Unknowns shared by all views.
pub(crate) const SHARED: usize = 26;
/// Unknowns of a plate.
pub(crate) const OF_PLATE: usize = 6;
/// Unknowns of a view: errors of the rotary and the vertical stage.
pub(crate) const OF_VIEW: usize = 2;
/// Unknowns of the residual fields, where a scene has them: columns and rows of the camera, columns of the projector.
pub(crate) const FIELD: usize = 3 * SIDE * SIDE;

/// Unknowns of a second projector: lens and place, and what its field adds where a scene has fields.
const OF_PROJECTOR: std::ops::Range<usize> = PROJECTOR_FOCAL..HAND_EYE_TURN;
const OF_PROJECTOR_FIELD: std::ops::Range<usize> = 2 * SIDE * SIDE..FIELD;

/// Where the coefficients of the fields stand among the unknowns that a view depends on.
const FIRST_OF_FIELD: usize = SHARED + OF_PLATE + OF_VIEW;
/// A field reaches this far beyond what is seen, so that its border is not.
const FIELD_MARGIN: f64 = 1.05;

/// Places among the shared unknowns.
pub(crate) const CAMERA_FOCAL: usize = 0;
pub(crate) const CAMERA_PRINCIPAL: usize = 2;
const CAMERA_DISTORTION: usize = 4;
pub(crate) const PROJECTOR_FOCAL: usize = 8;
const PROJECTOR_PRINCIPAL: usize = 9;
const PROJECTOR_DISTORTION: usize = 10;
const PROJECTOR_TURN: usize = 14;
const PROJECTOR_SHIFT: usize = 17;
const HAND_EYE_TURN: usize = 20;
const HAND_EYE_SHIFT: usize = 23;

/// How well the starting values are believed where the views say nothing: coefficients of distortion (k1, k2, p1, p2), and
/// the projector's shift along its rows, mm. With fields that shift is but another name for the same sheets of light: it stays.
pub(crate) const DISTORTION_SIGMA: [f64; 4] = [1.0, 10.0, 0.05, 0.05];
const ROW_SHIFT_SIGMA_MM: f64 = 0.1;
const ROW_SHIFT_BESIDE_FIELDS_MM: f64 = 1e-3;

/// What one view depends on: the shared unknowns, its plate and its stages.
#[derive(Clone, Debug)]
pub(crate) struct Scene {
    pub camera: Pinhole,
    pub projector: Pinhole,
    pub projector_from_camera: Isometry3<f64>,
    pub stage_from_camera: Isometry3<f64>,
    pub tool_from_plate: Isometry3<f64>,
    /// Rotation (rad) and height (mm) beyond what the stages were told.
    pub stage_error: [f64; 2],
}

/// Where a dot appears: pixel column and row, projector column.
pub(crate) type Observation = [f64; 3];

impl Scene {
    /// The scene of the starting values.
    pub fn new(head: &HeadModel, stage_from_camera: &RigidTransform) -> Self {
        let mut camera = head.camera.clone();
        let mut projector = head.projector.clone();
        // The sixth-order term of a fibre endoscope's field is not determined by it.
        for lens in [&mut camera, &mut projector] {
            lens.distortion[4] = 0.0;
            lens.residual = None;
        }
        Self {
            camera,
            projector,
            projector_from_camera: isometry(&head.projector_from_camera),
            stage_from_camera: isometry(stage_from_camera),
            tool_from_plate: Isometry3::identity(),
            stage_error: [0.0; 2],
        }
    }

    /// The same scene with residual fields of no shift, over all that the head can see.
    pub fn with_fields(mut self, head: &HeadModel) -> Self {
        let camera = &head.camera;
        let (centre_px, radius_px) = head.image_circle.map_or_else(
            || {
                let size = [camera.width_px, camera.height_px].map(f64::from);
                (
                    size.map(|px| 0.5 * (px - 1.0)),
                    0.5 * size[0].hypot(size[1]),
                )
            },
            |circle| (circle.centre_px, circle.radius_px),
        );
        let over = |lens: &Pinhole, centre_px: [f64; 2], radius_px: f64, rows: bool| {
            let centre = [0, 1]
                .map(|axis| (centre_px[axis] - lens.principal_px[axis]) / lens.focal_px[axis]);
            let half_side = FIELD_MARGIN * radius_px / lens.focal_px[0];
            Some(ResidualField::zero(centre, half_side, rows))
        };
        self.camera.residual = over(&self.camera, centre_px, radius_px, true);
        let size = [self.projector.width_px, self.projector.height_px].map(f64::from);
        let middle_px = size.map(|px| 0.5 * (px - 1.0));
        self.projector.residual = over(&self.projector, middle_px, 0.5 * size[0], false);
        self
    }

    /// The scene in the light of a second projector, whose lens and place are those of `second`.
    pub fn lit_by(&self, second: &Self) -> Self {
        Self {
            projector: second.projector.clone(),
            projector_from_camera: second.projector_from_camera,
            ..self.clone()
        }
    }

    /// Whether the lenses have residual fields.
    pub fn has_fields(&self) -> bool {
        self.camera.residual.is_some()
    }

    /// The coefficients of the residual fields, camera and projector; nothing without them.
    pub fn field_px(&self) -> [Vec<f64>; 2] {
        [&self.camera, &self.projector].map(|lens| {
            let field = lens.residual.iter();
            field
                .flat_map(|field| [Some(&field.columns_px), field.rows_px.as_ref()])
                .flatten()
                .flatten()
                .flatten()
                .copied()
                .collect()
        })
    }

    /// Moves a coefficient of the fields.
    fn nudge_field(&mut self, coefficient: usize, by_px: f64) {
        let (direction, place) = (coefficient / (SIDE * SIDE), coefficient % (SIDE * SIDE));
        let lens = if direction < 2 {
            &mut self.camera
        } else {
            &mut self.projector
        };
        let coefficients = lens.residual.as_mut().and_then(|field| match direction {
            1 => field.rows_px.as_mut(),
            _ => Some(&mut field.columns_px),
        });
        if let Some(coefficients) = coefficients {
            coefficients[place / SIDE][place % SIDE] += by_px;
        }
    }

    /// Moves one unknown: those shared by all views, the plate's, the stages', then the coefficients of the fields.
    pub fn step(&mut self, unknown: usize, by: f64) {
        let turn = |axis: usize| UnitQuaternion::from_scaled_axis(Vector3::ith(axis, by));
        match unknown {
            0 | 1 => self.camera.focal_px[unknown] += by,
            2 | 3 => self.camera.principal_px[unknown - CAMERA_PRINCIPAL] += by,
            4..8 => self.camera.distortion[unknown - CAMERA_DISTORTION] += by,
            PROJECTOR_FOCAL => {
                let [columns, rows] = self.projector.focal_px;
                self.projector.focal_px = [columns + by, (columns + by) * rows / columns];
            }
            PROJECTOR_PRINCIPAL => self.projector.principal_px[0] += by,
            10..14 => self.projector.distortion[unknown - PROJECTOR_DISTORTION] += by,
            14..17 => turn_about_origin(
                &mut self.projector_from_camera,
                turn(unknown - PROJECTOR_TURN),
            ),
            17..20 => {
                self.projector_from_camera.translation.vector[unknown - PROJECTOR_SHIFT] += by
            }
            20..23 => turn_about_origin(&mut self.stage_from_camera, turn(unknown - HAND_EYE_TURN)),
            23..26 => self.stage_from_camera.translation.vector[unknown - HAND_EYE_SHIFT] += by,
            26..29 => turn_about_origin(&mut self.tool_from_plate, turn(unknown - SHARED)),
            29..32 => self.tool_from_plate.translation.vector[unknown - SHARED - 3] += by,
            32..FIRST_OF_FIELD => self.stage_error[unknown - SHARED - OF_PLATE] += by,
            _ => self.nudge_field(unknown - FIRST_OF_FIELD, by),
        }
    }

    /// A step that moves a dot in the images by about a hundredth of a pixel.
    pub fn small_step(unknown: usize) -> f64 {
        match unknown {
            0..4 | PROJECTOR_FOCAL | PROJECTOR_PRINCIPAL => 1e-2,
            4..8 | 10..14 => 1e-3,
            17..=19 | 23..=25 | 29..=31 | 33 => 1e-4,
            FIRST_OF_FIELD.. => 1e-2,
            _ => 1e-6,
        }
    }

    /// Camera frame from plate frame with the stages at `stage`.
    pub fn camera_from_plate(&self, stage: StagePose) -> Isometry3<f64> {
        let [turn, lift] = self.stage_error;
        let stood = StagePose {
            rotation_rad: stage.rotation_rad + turn,
            vertical_mm: stage.vertical_mm + lift,
        };
        self.stage_from_camera.inverse() * stood.stage_from_tool() * self.tool_from_plate
    }

    /// Where a dot of radius `radius_mm` at `at_mm` of the plate appears; `None` behind camera or projector.
    ///
    /// In perspective the image of a circle is an ellipse whose centre is not the image of the circle's: it is that of
    /// `at - radius² g / depth`, where `g` is the change of depth along the plate (pole of the line at infinity with
    /// respect to the image's conic).
    pub fn observation(
        &self,
        camera_from_plate: &Isometry3<f64>,
        at_mm: [f64; 2],
        radius_mm: f64,
    ) -> Option<Observation> {
        let [seen, lit] = self.directions(camera_from_plate, at_mm, radius_mm)?;
        let [u, v] = self.camera.pixel(seen);
        let [column, _] = self.projector.pixel(lit);
        Some([u, v, column])
    }

    /// How it follows the coefficients of the fields: unknown, which part of the observation, derivative.
    pub fn field_slopes(
        &self,
        camera_from_plate: &Isometry3<f64>,
        at_mm: [f64; 2],
        radius_mm: f64,
    ) -> Vec<(usize, usize, f64)> {
        let directions = self.directions(camera_from_plate, at_mm, radius_mm);
        let (Some([seen, lit]), Some(camera), Some(projector)) =
            (directions, &self.camera.residual, &self.projector.residual)
        else {
            return Vec::new();
        };
        let parts = [(camera, seen), (camera, seen), (projector, lit)];
        let slopes = parts
            .into_iter()
            .enumerate()
            .flat_map(|(part, (field, at))| {
                let first = FIRST_OF_FIELD + part * SIDE * SIDE;
                let weights = field.weights(at).into_iter();
                weights
                    .map(move |([row, column], weight)| (first + row * SIDE + column, part, weight))
            });
        slopes.collect()
    }

    /// Where a dot lies in the image planes `z = 1` of camera and projector.
    fn directions(
        &self,
        camera_from_plate: &Isometry3<f64>,
        at_mm: [f64; 2],
        radius_mm: f64,
    ) -> Option<[[f64; 2]; 2]> {
        let p_camera = middle_of_image(camera_from_plate, at_mm, radius_mm);
        let p_projector = self.projector_from_camera * p_camera;
        if !(p_camera.z > 0.0 && p_projector.z > 0.0) {
            return None;
        }
        Some([p_camera, p_projector].map(|p| [p.x / p.z, p.y / p.z]))
    }

    /// What is believed of the head's unknowns before any view: place, offset from the starting value, its sigma.
    pub fn priors(&self, start: &Self, field_sigma_px: [f64; 2]) -> Vec<(usize, f64, f64)> {
        let mut priors = Vec::new();
        for (k, sigma) in DISTORTION_SIGMA.into_iter().enumerate() {
            let off = |now: &Pinhole, then: &Pinhole| now.distortion[k] - then.distortion[k];
            priors.push((
                CAMERA_DISTORTION + k,
                off(&self.camera, &start.camera),
                sigma,
            ));
            let projector = off(&self.projector, &start.projector);
            priors.push((PROJECTOR_DISTORTION + k, projector, sigma));
        }
        let row_shift = |scene: &Self| scene.projector_from_camera.translation.vector.y;
        let moved = row_shift(self) - row_shift(start);
        let sigma_mm = if self.has_fields() {
            ROW_SHIFT_BESIDE_FIELDS_MM
        } else {
            ROW_SHIFT_SIGMA_MM
        };
        priors.push((PROJECTOR_SHIFT + 1, moved, sigma_mm));
        let fields = self.field_px().into_iter().zip(field_sigma_px);
        let coefficients =
            fields.flat_map(|(field, sigma)| field.into_iter().map(move |px| (px, sigma)));
        priors.extend(
            coefficients
                .enumerate()
                .map(|(k, (px, sigma))| (SHARED + k, px, sigma)),
        );
        priors
    }

    /// The second projector of these values.
    pub fn second_projector(&self, start: &SecondProjector) -> SecondProjector {
        SecondProjector {
            projector: self.projector.clone(),
            projector_from_camera: transform(&self.projector_from_camera),
            ..start.clone()
        }
    }

    /// The head of these values; what the adjustment does not touch stays as in `start`.
    pub fn head(&self, start: &HeadModel) -> HeadModel {
        HeadModel {
            camera: self.camera.clone(),
            projector: self.projector.clone(),
            projector_from_camera: transform(&self.projector_from_camera),
            stage_from_camera: Some(transform(&self.stage_from_camera)),
            calibration: None,
            ..start.clone()
        }
    }
}

/// The unknowns of a scene that are the head's, in the order in which they stand among all: see [`Scene::step`].
pub(crate) fn head_unknowns(scene: &Scene) -> impl Iterator<Item = usize> {
    let fields = if scene.has_fields() { FIELD } else { 0 };
    (0..SHARED).chain(FIRST_OF_FIELD..FIRST_OF_FIELD + fields)
}

/// Which of the places of [`head_unknowns`] are a projector's own, in the order in which a second one's stand behind them.
pub(crate) fn projector_places(scene: &Scene) -> impl Iterator<Item = usize> {
    let fields = match scene.has_fields() {
        true => OF_PROJECTOR_FIELD,
        false => 0..0,
    };
    OF_PROJECTOR.chain(fields.map(|coefficient| SHARED + coefficient))
}

/// Where, in the camera frame, the middle of a circle's elliptic image lies on its plate: see [`Scene::observation`].
pub(crate) fn middle_of_image(
    camera_from_plate: &Isometry3<f64>,
    at_mm: [f64; 2],
    radius_mm: f64,
) -> Point3<f64> {
    let depth_mm = (camera_from_plate * Point3::new(at_mm[0], at_mm[1], 0.0)).z;
    let along = camera_from_plate.rotation * Vector3::x();
    let across = camera_from_plate.rotation * Vector3::y();
    let back = radius_mm * radius_mm / depth_mm;
    camera_from_plate * Point3::new(at_mm[0] - back * along.z, at_mm[1] - back * across.z, 0.0)
}

/// Turns the axes and leaves the origin.
pub(crate) fn turn_about_origin(pose: &mut Isometry3<f64>, turn: UnitQuaternion<f64>) {
    pose.rotation = UnitQuaternion::new_normalize((turn * pose.rotation).into_inner());
}

/// Places of the plates as their certificates give them.
pub(crate) fn certified(target: &Target) -> Vec<Isometry3<f64>> {
    target
        .plate
        .iter()
        .map(|plate| isometry(&plate.tool_from_plate))
        .collect()
}

/// Of a transform whose file has been checked.
pub(crate) fn isometry(file: &RigidTransform) -> Isometry3<f64> {
    Isometry3::from_parts(
        Translation3::from(Vector3::from(file.translation_mm)),
        nearest_rotation(&file.matrix()),
    )
}

pub(crate) fn transform(pose: &Isometry3<f64>) -> RigidTransform {
    let matrix: Rotation3<f64> = pose.rotation.to_rotation_matrix();
    RigidTransform {
        rotation: std::array::from_fn(|row| std::array::from_fn(|column| matrix[(row, column)])),
        translation_mm: pose.translation.vector.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The centre of an ellipse lies midway between its leftmost and rightmost points, whose tangents are parallel.
    #[test]
    fn a_tilted_circle_looks_like_an_ellipse_with_this_centre() {
        let lens = Pinhole {
            width_px: 1920,
            height_px: 1200,
            focal_px: [2530.0, 2530.0],
            principal_px: [960.0, 600.0],
            distortion: [0.0; 5],
            residual: None,
        };
        let scene = Scene {
            camera: lens.clone(),
            projector: lens,
            projector_from_camera: Isometry3::identity(),
            stage_from_camera: Isometry3::identity(),
            tool_from_plate: Isometry3::from_parts(
                Translation3::new(0.7, -0.4, 22.0),
                UnitQuaternion::from_euler_angles(0.4, -0.5, 0.3),
            ),
            stage_error: [0.0; 2],
        };
        let stages = StagePose {
            rotation_rad: 0.0,
            vertical_mm: 0.0,
        };
        let pose = scene.camera_from_plate(stages);
        let (at, radius) = ([1.5, -2.0], 0.5);
        let rim: Vec<[f64; 2]> = (0..2_000_000)
            .map(|i| {
                let (sin, cos) = (f64::from(i) * 1e-6 * std::f64::consts::PI).sin_cos();
                let p = pose * Point3::new(at[0] + radius * cos, at[1] + radius * sin, 0.0);
                scene.camera.pixel([p.x / p.z, p.y / p.z])
            })
            .collect();
        let by = |a: &&[f64; 2], b: &&[f64; 2]| a[0].total_cmp(&b[0]);
        let (left, right) = (
            rim.iter().min_by(by).unwrap(),
            rim.iter().max_by(by).unwrap(),
        );
        let [u, v, _] = scene.observation(&pose, at, radius).unwrap();
        let [centre_u, centre_v, _] = scene.observation(&pose, at, 0.0).unwrap();
        assert!((u - 0.5 * (left[0] + right[0])).abs() < 1e-4);
        assert!((v - 0.5 * (left[1] + right[1])).abs() < 1e-3);
        assert!(
            (u - centre_u).hypot(v - centre_v) > 0.1,
            "the difference matters"
        );
    }
}
