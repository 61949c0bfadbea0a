//! Observation model of plates of certified pose on the stages.
//!
//! Unknowns of the head: camera (focal lengths, principal point, k1 k2 p1 p2), projector (focal length, principal column,
//! k1 k2 p1 p2), projector from camera, stage from camera; in a second step the residual fields of both lenses. Besides these the
//! pose of every plate, with its certificate as prior, and the error of the stages in every view, with their data sheet as prior.
//!
//! A second projector has the projector's unknowns once more. A view in its light counts as a view of its own, of the same plate with
//! the stages where they were: first all views by the first projector, then all by the second.
//!
//! Fringes vary along the projector's columns only and do not determine its rows: its focal length there keeps the ratio
//! of the starting values, its principal row stays, and its shift along the rows shows through distortion alone, hence the
//! starting value as a weak prior.

use nalgebra::{DMatrixView, DVector, Isometry3, UnitQuaternion, Vector3};

use super::bundle::{DISTORTION_SIGMA, Observation, ObservationModel, Prior, ViewState};
use super::rig::{Rig, isometry, step_lens, step_pose, transform};
use super::sighting::{Mark, Sighting, StagePose};
use super::target::Target;
use crate::head::residual::{ResidualField, SIDE};
use crate::head::{HeadModel, Pinhole, RigidTransform, SecondProjector};

/// Unknowns shared by all views.
const SHARED: usize = 26;
/// Unknowns of a plate.
const OF_PLATE: usize = 6;
/// Unknowns of a view: errors of the rotary and the vertical stage.
const OF_VIEW: usize = 2;
/// Unknowns of the residual fields, where a scene has them: columns and rows of the camera, columns of the projector.
const FIELD: usize = 3 * SIDE * SIDE;

/// Unknowns of a second projector: lens and place, and what its field adds where a scene has fields.
const OF_PROJECTOR: std::ops::Range<usize> = PROJECTOR_FOCAL..HAND_EYE;
const OF_PROJECTOR_FIELD: std::ops::Range<usize> = 2 * SIDE * SIDE..FIELD;

/// The coefficients of the fields stand behind all other unknowns that a view depends on.
const FIRST_OF_FIELD: usize = STAGES + OF_VIEW;
/// Half side of a field relative to the visible part, so that its border is not visible.
const FIELD_MARGIN: f64 = 1.05;

/// Positions among the shared unknowns.
pub(crate) const CAMERA_FOCAL: usize = 0;
pub(crate) const CAMERA_PRINCIPAL: usize = 2;
const CAMERA_DISTORTION: usize = 4;
pub(crate) const PROJECTOR_FOCAL: usize = 8;
const PROJECTOR_PRINCIPAL: usize = 9;
const PROJECTOR_DISTORTION: usize = 10;
const PROJECTOR_POSE: usize = 14;
const HAND_EYE: usize = 20;

/// In a view's own numbering the unknowns of its plate and of its stages follow the shared ones.
const PLATE: usize = SHARED;
const STAGES: usize = PLATE + OF_PLATE;

/// Standard uncertainty of the starting value of the projector's shift along its rows, mm. Residual fields describe the same sheets of
/// light as that shift, so beside them it is held.
const ROW_SHIFT_SIGMA_MM: f64 = 0.1;
const ROW_SHIFT_BESIDE_FIELDS_MM: f64 = 1e-3;
/// Standard uncertainties by which the projector's coefficients of distortion (k1, k2, p1, p2) are held in any case. Of its columns alone
/// p1 bends the sheets of light as a turn about the rows' direction does: free, the two drift by 0.1 rad, and rows, which tell where the
/// lit circle ends, by 200 px. A lens whose axis misses the projector's by 20 µm of a focal length of 2 mm has p of 1e-3.
const MOST_OF_PROJECTOR: [f64; 4] = [f64::INFINITY, f64::INFINITY, 1e-3, 1e-3];
/// Limits of the estimated size of a field's coefficients.
const FIELD_SIGMA_LIMITS_PX: [f64; 2] = [1e-3, 2.0];
/// Coordinates of an image point that are observed: no projector rows.
pub(super) const COORDINATES: usize = 3;

/// The unknowns that one view depends on: the head's, its plate's and its stages'.
#[derive(Clone, Debug)]
pub(crate) struct Scene {
    pub rig: Rig,
    pub stage_from_camera: Isometry3<f64>,
    pub tool_from_plate: Isometry3<f64>,
    /// Commanded position of the stages.
    pub stage: StagePose,
    /// Rotation (rad) and height (mm) beyond the commanded ones.
    pub stage_error: [f64; 2],
}

impl Scene {
    /// The scene of the starting values.
    pub fn new(head: &HeadModel, stage_from_camera: &RigidTransform) -> Self {
        let mut camera = head.camera.clone();
        let mut projector = head.projector.clone();
        // The field of view of a fibre endoscope is too narrow to determine the sixth-order term.
        for lens in [&mut camera, &mut projector] {
            lens.distortion[4] = 0.0;
            lens.residual = None;
        }
        Self {
            rig: Rig {
                camera,
                projector,
                projector_from_camera: isometry(&head.projector_from_camera),
            },
            stage_from_camera: isometry(stage_from_camera),
            tool_from_plate: Isometry3::identity(),
            stage: StagePose {
                rotation_rad: 0.0,
                vertical_mm: 0.0,
            },
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
        let Rig {
            camera, projector, ..
        } = &mut self.rig;
        camera.residual = over(camera, centre_px, radius_px, true);
        let size = [projector.width_px, projector.height_px].map(f64::from);
        let middle_px = size.map(|px| 0.5 * (px - 1.0));
        projector.residual = over(projector, middle_px, 0.5 * size[0], false);
        self
    }

    /// Whether the lenses have residual fields.
    fn has_fields(&self) -> bool {
        self.rig.camera.residual.is_some()
    }

    /// The coefficients of the residual fields, camera and projector; nothing without them.
    fn field_px(&self) -> [Vec<f64>; 2] {
        [&self.rig.camera, &self.rig.projector].map(|lens| {
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
            &mut self.rig.camera
        } else {
            &mut self.rig.projector
        };
        let coefficients = lens.residual.as_mut().and_then(|field| match direction {
            1 => field.rows_px.as_mut(),
            _ => Some(&mut field.columns_px),
        });
        if let Some(coefficients) = coefficients {
            coefficients[place / SIDE][place % SIDE] += by_px;
        }
    }

    /// Priors of the head's unknowns: the starting values, and zero for the fields' coefficients.
    fn priors(&self, start: &Self, field_sigma_px: [f64; 2]) -> Vec<Prior> {
        let mut priors = Vec::new();
        let mut add = |unknown: usize, off: f64, sigma: f64| {
            priors.push(Prior {
                unknown,
                off,
                sigma,
            });
        };
        for (k, sigma) in DISTORTION_SIGMA.into_iter().enumerate() {
            let off = |now: &Pinhole, then: &Pinhole| now.distortion[k] - then.distortion[k];
            let camera = off(&self.rig.camera, &start.rig.camera);
            add(CAMERA_DISTORTION + k, camera, sigma);
            let projector = off(&self.rig.projector, &start.rig.projector);
            let sigma = sigma.min(MOST_OF_PROJECTOR[k]);
            add(PROJECTOR_DISTORTION + k, projector, sigma);
        }
        let row_shift = |scene: &Self| scene.rig.projector_from_camera.translation.vector.y;
        let moved = row_shift(self) - row_shift(start);
        let sigma_mm = if self.has_fields() {
            ROW_SHIFT_BESIDE_FIELDS_MM
        } else {
            ROW_SHIFT_SIGMA_MM
        };
        add(PROJECTOR_POSE + 4, moved, sigma_mm);
        let fields = self.field_px().into_iter().zip(field_sigma_px);
        let coefficients =
            fields.flat_map(|(field, sigma)| field.into_iter().map(move |px| (px, sigma)));
        for (k, (px, sigma)) in coefficients.enumerate() {
            add(SHARED + k, px, sigma);
        }
        priors
    }

    /// The head of these values; what the adjustment does not touch stays as in `start`.
    pub fn head(&self, start: &HeadModel) -> HeadModel {
        HeadModel {
            camera: self.rig.camera.clone(),
            projector: self.rig.projector.clone(),
            projector_from_camera: transform(&self.rig.projector_from_camera),
            stage_from_camera: Some(transform(&self.stage_from_camera)),
            calibration: None,
            ..start.clone()
        }
    }
}

impl ViewState for Scene {
    fn rig(&self) -> &Rig {
        &self.rig
    }

    fn camera_from_plate(&self) -> Isometry3<f64> {
        let [turn, lift] = self.stage_error;
        let stood = StagePose {
            rotation_rad: self.stage.rotation_rad + turn,
            vertical_mm: self.stage.vertical_mm + lift,
        };
        self.stage_from_camera.inverse() * stood.stage_from_tool() * self.tool_from_plate
    }

    fn stepped(&self) -> usize {
        FIRST_OF_FIELD
    }

    fn step(&mut self, unknown: usize, by: f64) {
        let rig = &mut self.rig;
        match unknown {
            0..PROJECTOR_FOCAL => step_lens(&mut rig.camera, unknown, by),
            PROJECTOR_FOCAL => {
                let [columns, rows] = rig.projector.focal_px;
                rig.projector.focal_px = [columns + by, (columns + by) * rows / columns];
            }
            PROJECTOR_PRINCIPAL => step_lens(&mut rig.projector, 2, by),
            PROJECTOR_DISTORTION..PROJECTOR_POSE => {
                step_lens(&mut rig.projector, unknown - PROJECTOR_DISTORTION + 4, by);
            }
            PROJECTOR_POSE..HAND_EYE => {
                step_pose(&mut rig.projector_from_camera, unknown - PROJECTOR_POSE, by);
            }
            HAND_EYE..PLATE => step_pose(&mut self.stage_from_camera, unknown - HAND_EYE, by),
            PLATE..STAGES => step_pose(&mut self.tool_from_plate, unknown - PLATE, by),
            STAGES..FIRST_OF_FIELD => self.stage_error[unknown - STAGES] += by,
            _ => self.nudge_field(unknown - FIRST_OF_FIELD, by),
        }
    }

    fn small_step(&self, unknown: usize) -> f64 {
        match unknown {
            0..4 | PROJECTOR_FOCAL | PROJECTOR_PRINCIPAL => 1e-2,
            4..8 | 10..14 => 1e-3,
            17..=19 | 23..=25 | 29..=31 | 33 => 1e-4,
            FIRST_OF_FIELD.. => 1e-2,
            _ => 1e-6,
        }
    }
}

/// Constants of an adjustment: target, views, starting values and prior uncertainties.
pub(crate) struct Setting<'a> {
    pub target: &'a Target,
    pub sightings: &'a [Sighting],
    /// Poses of the plates by their certificates.
    certified: Vec<Isometry3<f64>>,
    /// Starting values in the light of each projector.
    starts: Vec<Scene>,
    /// Standard uncertainty of the stages: rad, mm.
    stage_sigma: [f64; 2],
}

impl<'a> Setting<'a> {
    pub fn new(
        head: &HeadModel,
        stage_from_camera: &RigidTransform,
        target: &'a Target,
        sightings: &'a [Sighting],
        stage_sigma: [f64; 2],
    ) -> Self {
        let plates = target.plate.iter();
        let lit = (1..).map_while(|projector| head.with_projector(projector));
        Self {
            target,
            sightings,
            certified: plates
                .map(|plate| isometry(&plate.tool_from_plate))
                .collect(),
            starts: lit
                .map(|head| Scene::new(&head, stage_from_camera))
                .collect(),
            stage_sigma,
        }
    }

    /// The dots, view by view; those in the light of a second projector behind all others.
    pub fn observations(&self) -> Vec<Vec<Observation>> {
        let dots = &self.target.dots;
        let first = self.sightings.iter().map(|sighting| &sighting.marks);
        let second = self.sightings.iter().map(|sighting| &sighting.by_second);
        let second = second.filter(|_| self.starts.len() > 1);
        first
            .chain(second)
            .map(|marks| {
                let observation = |mark: &Mark| Observation {
                    at_mm: mark.place.map(|n| f64::from(n) * dots.pitch_mm),
                    radius_mm: dots.radius_mm(mark.place),
                    seen_px: [mark.pixel[0], mark.pixel[1], mark.column_px, f64::NAN],
                };
                marks.iter().map(observation).collect()
            })
            .collect()
    }
}

/// All unknowns: those of the head, of the plates, of the stages in each view.
#[derive(Clone)]
pub(crate) struct PlateModel<'a> {
    setting: &'a Setting<'a>,
    /// The head's values in the light of each projector. Those of camera and stages are the same in all.
    pub scenes: Vec<Scene>,
    plates: Vec<Isometry3<f64>>,
    stage_errors: Vec<[f64; 2]>,
    /// Standard deviation of the coefficients of the residual fields, camera and projector; without effect where the scene has none.
    field_sigma_px: [f64; 2],
}

impl<'a> PlateModel<'a> {
    /// The starting values.
    pub fn new(setting: &'a Setting<'a>, field_sigma_px: [f64; 2]) -> Self {
        Self {
            setting,
            scenes: setting.starts.clone(),
            plates: setting.certified.clone(),
            stage_errors: vec![[0.0; 2]; setting.sightings.len()],
            field_sigma_px,
        }
    }

    /// The same with residual fields of no shift.
    pub fn with_fields(self, head: &HeadModel) -> Self {
        let scenes = self.scenes.into_iter();
        Self {
            scenes: scenes.map(|scene| scene.with_fields(head)).collect(),
            ..self
        }
    }

    /// The head of these values.
    pub fn head(&self, start: &HeadModel) -> HeadModel {
        let second = self.scenes.get(1).zip(start.second_projector.as_ref());
        HeadModel {
            second_projector: second.map(|(scene, start)| SecondProjector {
                projector: scene.rig.projector.clone(),
                projector_from_camera: transform(&scene.rig.projector_from_camera),
                ..start.clone()
            }),
            ..self.scenes[0].head(start)
        }
    }

    /// Positions, among all unknowns, of the head's unknowns of a scene in the light of a projector: 0 the first, 1 the second.
    pub fn head_positions(&self, projector: usize) -> Vec<usize> {
        let mut positions: Vec<usize> = (0..head_unknowns(&self.scenes[0]).count()).collect();
        if projector > 0 {
            let first = positions.len();
            for (number, position) in projector_positions(&self.scenes[0]).enumerate() {
                positions[position] = first + number;
            }
        }
        positions
    }

    /// Numbers of a view's sighting and of its projector.
    fn sighting(&self, view: usize) -> (usize, usize) {
        let sightings = self.setting.sightings.len();
        (view % sightings, view / sightings)
    }

    /// Position of a plate's first unknown.
    fn plate_position(&self, plate: usize) -> usize {
        self.head_unknowns() + OF_PLATE * plate
    }

    /// Position of a view's first stage error.
    fn stage_position(&self, view: usize) -> usize {
        self.plate_position(self.plates.len()) + OF_VIEW * view
    }
}

impl ObservationModel for PlateModel<'_> {
    type View = Scene;

    fn coordinates(&self) -> usize {
        COORDINATES
    }

    fn unknowns(&self) -> usize {
        self.stage_position(self.stage_errors.len())
    }

    fn head_unknowns(&self) -> usize {
        let first = &self.scenes[0];
        head_unknowns(first).count() + (self.scenes.len() - 1) * projector_positions(first).count()
    }

    fn view(&self, view: usize) -> Scene {
        let (view, projector) = self.sighting(view);
        let sighting = &self.setting.sightings[view];
        Scene {
            tool_from_plate: self.plates[sighting.plate],
            stage: sighting.stage,
            stage_error: self.stage_errors[view],
            ..self.scenes[projector].clone()
        }
    }

    fn positions(&self, view: usize) -> Vec<usize> {
        let (view, projector) = self.sighting(view);
        let plate = self.plate_position(self.setting.sightings[view].plate);
        let stages = self.stage_position(view);
        let own = (plate..plate + OF_PLATE).chain(stages..stages + OF_VIEW);
        let mut positions = self.head_positions(projector);
        positions.splice(SHARED..SHARED, own);
        positions
    }

    fn priors(&self) -> Vec<Prior> {
        let Setting {
            target,
            certified,
            starts,
            stage_sigma,
            ..
        } = self.setting;
        let mut priors = Vec::new();
        for (projector, (now, start)) in self.scenes.iter().zip(starts).enumerate() {
            let positions = self.head_positions(projector);
            for prior in now.priors(start, self.field_sigma_px) {
                let unknown = positions[prior.unknown];
                // Priors of the unknowns shared with the first projector are counted once.
                if projector == 0 || unknown != prior.unknown {
                    priors.push(Prior { unknown, ..prior });
                }
            }
        }
        let mut add = |unknown: usize, off: f64, sigma: f64| {
            priors.push(Prior {
                unknown,
                off,
                sigma,
            });
        };
        for (plate, (now, then)) in self.plates.iter().zip(certified).enumerate() {
            let turn = (now.rotation * then.rotation.inverse()).scaled_axis();
            let shift = now.translation.vector - then.translation.vector;
            for axis in 0..3 {
                let at = self.plate_position(plate) + axis;
                add(at, turn[axis], target.pose_sigma_rad);
                add(at + 3, shift[axis], target.pose_sigma_mm);
            }
        }
        for (view, errors) in self.stage_errors.iter().enumerate() {
            for axis in 0..OF_VIEW {
                add(
                    self.stage_position(view) + axis,
                    errors[axis],
                    stage_sigma[axis],
                );
            }
        }
        priors
    }

    fn step(&mut self, step: &DVector<f64>) {
        for projector in 0..self.scenes.len() {
            let positions = self.head_positions(projector);
            for (unknown, position) in head_unknowns(&self.scenes[projector]).zip(positions) {
                self.scenes[projector].step(unknown, step[position]);
            }
        }
        let (first_plate, first_stage) = (self.plate_position(0), self.stage_position(0));
        for (plate, pose) in self.plates.iter_mut().enumerate() {
            let at = first_plate + OF_PLATE * plate;
            let part = |first: usize| Vector3::new(step[first], step[first + 1], step[first + 2]);
            pose.rotation = UnitQuaternion::from_scaled_axis(part(at)) * pose.rotation;
            pose.translation.vector += part(at + 3);
        }
        for (view, errors) in self.stage_errors.iter_mut().enumerate() {
            for axis in 0..OF_VIEW {
                errors[axis] += step[first_stage + OF_VIEW * view + axis];
            }
        }
    }

    /// Estimates the size of the fields' coefficients: sum of squares over the number of coefficients that the dots determine rather
    /// than the prior (MacKay 1992, Bayesian interpolation). For lenses without irregularities it ends near zero.
    fn update_priors(&mut self, covariance: &DMatrixView<'_, f64>, same: f64) -> bool {
        let [camera, first] = self.scenes[0].field_px();
        let mut positions = SHARED..;
        let mut lenses = [camera, first]
            .map(|px| -> Vec<(f64, usize)> { px.into_iter().zip(positions.by_ref()).collect() });
        for scene in &self.scenes[1..] {
            let [_, second] = scene.field_px();
            let first_of_field = self.head_unknowns() - second.len();
            lenses[1].extend(second.into_iter().zip(first_of_field..));
        }
        let mut is_same = true;
        for (sigma_px, coefficients) in self.field_sigma_px.iter_mut().zip(lenses) {
            let (mut squares, mut determined) = (0.0, 0.0);
            for (px, position) in coefficients {
                squares += px * px;
                determined += 1.0 - covariance[(position, position)] / (*sigma_px * *sigma_px);
            }
            if determined > 0.0 {
                let [least, most] = FIELD_SIGMA_LIMITS_PX;
                let estimate_px = f64::sqrt(squares / determined).clamp(least, most);
                is_same &= (estimate_px / *sigma_px - 1.0).abs() < same;
                *sigma_px = estimate_px;
            }
        }
        is_same
    }
}

/// The unknowns of a scene that are the head's, in the order in which they stand among all: see [`Scene::step`].
pub(crate) fn head_unknowns(scene: &Scene) -> impl Iterator<Item = usize> + use<> {
    let fields = if scene.has_fields() { FIELD } else { 0 };
    (0..SHARED).chain(FIRST_OF_FIELD..FIRST_OF_FIELD + fields)
}

/// Positions among the [`head_unknowns`] that are a projector's own, in the order in which a second one's stand behind them.
fn projector_positions(scene: &Scene) -> impl Iterator<Item = usize> {
    let fields = match scene.has_fields() {
        true => OF_PROJECTOR_FIELD,
        false => 0..0,
    };
    OF_PROJECTOR.chain(fields.map(|coefficient| SHARED + coefficient))
}
