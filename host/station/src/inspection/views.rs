//! One captured view to its flanks: points, pose, deviation, wear.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

use flankscope_metrology::cloud::outlier;
use flankscope_metrology::gear::{Flank, GearData};
use flankscope_metrology::registration::{Options, Prior, Registration, Status, register};
use flankscope_metrology::space::frames::{Camera, Cloud, Rigid, Stage, Tool as ToolFrame};
use flankscope_metrology::surface::{Closest, Surface};
use flankscope_metrology::tool::Datum;
use flankscope_metrology::verdict::Reason;
use flankscope_metrology::wear::{self, FlankWear, Measured, PoseEvidence, Settings, Sight, Zone};
use flankscope_profilometry::calibration::RigidTransform;
use flankscope_profilometry::{Accumulator, Decoded, Decoder, HeadModel};
use nalgebra::{Isometry3, Matrix3, Matrix6, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::evidence::Phasors;
use super::head_error::calibration_um;
use super::influence::Fitted;
use super::job::Subject;
use super::judge::Judge;
use super::plan::Itinerary;
use super::result::{FlankMap, ViewRegistration, WeakDirection};
use super::verdict::Judged;
use crate::baseline::Reference;

/// Uniform error of ±15 mdeg of the rotary stage as a standard uncertainty (data sheet, rectangular distribution), rad.
pub(crate) const ROTATION_SIGMA_RAD: f64 = 15e-3 * std::f64::consts::PI / 180.0 / SQRT_3;
/// Uniform error of ±5 µm of the vertical stage as a standard uncertainty, mm.
pub(crate) const VERTICAL_SIGMA_MM: f64 = 5e-3 / SQRT_3;
/// What remains of hand-eye and axis after their calibration: position and tilt. An estimate, stated in the report.
const MOUNT_SIGMA_MM: f64 = 10e-3;
const MOUNT_SIGMA_RAD: f64 = 0.2e-3;
const SQRT_3: f64 = 1.732_050_807_568_877_2;

/// Neighbours and width of the outlier filter: a point whose mean distance to its neighbours exceeds the mean by three
/// standard deviations stands alone.
pub(crate) const OUTLIER_NEIGHBOURS: usize = 8;
pub(crate) const OUTLIER_RATIO: f64 = 3.0;
/// The registered surface reaches this far beyond the field of view, mm: no point then has its foot on the cut.
const MARGIN_MM: f64 = 2.0;
/// Noise alone makes one cell in a thousand inconsistent, edges and highlights a few more; vibration nearly all.
const MOST_INCONSISTENT: f64 = 0.1;
/// Cell of the report's deviation maps, mm.
const MAP_CELL_MM: f64 = 0.1;

/// Why a subject cannot be evaluated.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EvaluatorError {
    /// No gear, nothing to inspect, or no hand-eye.
    #[error("{what} is missing; a check needs it (see docs/formats.md)")]
    Missing {
        /// What.
        what: &'static str,
    },
    /// The hand-eye is no rigid motion.
    #[error(
        "the head's stage_from_camera is no rotation: its rows differ from an orthonormal matrix by {error:.1e}, allowed are 1e-6"
    )]
    HandEye {
        /// Largest entry of R Rᵀ − 1.
        error: f64,
    },
    /// The camera would look past the die.
    #[error("the CAD has no surface where the head looks at tooth {tooth}")]
    NothingThere {
        /// Tooth of the view.
        tooth: u32,
    },
}

/// What became of one view.
#[derive(Debug)]
pub struct ViewOutcome {
    /// The two flanks of the tooth in the middle.
    pub flanks: Vec<Judged>,
    /// How the points of each capture were laid on the CAD.
    pub registration: Vec<ViewRegistration>,
    /// Their deviation from CAD, cell by cell.
    pub fields: Vec<Reference>,
    /// What the view says of its own pose about the axis, where it was registered.
    pub pose: Option<PoseEvidence>,
    /// Deviation maps of the two flanks.
    pub maps: Vec<FlankMap>,
    /// Deviations in the two zones, µm.
    pub deviations_um: Vec<f64>,
    /// What it was computed from, where that is kept.
    pub phasors: Vec<Phasors>,
    tooth: u32,
    /// What each capture measured of the flanks; nothing where it could not.
    captures: Vec<Vec<FlankWear>>,
    judge: Arc<Judge>,
}

impl ViewOutcome {
    /// Whether a flank is too near to a limit to be decided, and measuring it again could change that.
    pub(crate) fn is_open(&self) -> bool {
        self.captures
            .last()
            .is_some_and(|last| last.iter().any(|wear| self.judge.is_open(wear)))
    }

    /// The outcome of this view and of another capture of it, judged together.
    #[must_use]
    pub(crate) fn with(mut self, again: Self) -> Self {
        self.registration.extend(again.registration);
        self.phasors.extend(again.phasors);
        self.captures.extend(again.captures);
        for (judged, flank) in self.flanks.iter_mut().zip(Flank::BOTH) {
            if let Some(together) = self.judge.flank(self.tooth, flank, &self.captures) {
                *judged = together;
            }
        }
        self
    }
}

/// Where a view is taken from, and the surface it can see.
struct Place {
    tooth: u32,
    tool_from_camera: Rigid<ToolFrame, Camera>,
    surface: Surface,
}

impl Place {
    /// The expected pose against a tool that is `scale` times as large as its CAD.
    fn tool_from_cold_camera(&self, scale: f64) -> Rigid<ToolFrame, Cloud> {
        let mut pose = *self.tool_from_camera.isometry();
        pose.translation.vector /= scale;
        Rigid::from_isometry(pose)
    }
}

/// What the stages say of a view's pose.
fn stage_prior(expected: Rigid<ToolFrame, Cloud>) -> Prior {
    Prior::independent(
        expected,
        [
            MOUNT_SIGMA_RAD,
            MOUNT_SIGMA_RAD,
            ROTATION_SIGMA_RAD.hypot(MOUNT_SIGMA_RAD),
        ],
        [
            MOUNT_SIGMA_MM,
            MOUNT_SIGMA_MM,
            VERTICAL_SIGMA_MM.hypot(MOUNT_SIGMA_MM),
        ],
    )
}

/// Of its covariance, what the stages draw anew with every approach; the rest is how head and die are mounted.
fn approach_covariance() -> Matrix6<f64> {
    let mut covariance = Matrix6::zeros();
    covariance[(2, 2)] = ROTATION_SIGMA_RAD * ROTATION_SIGMA_RAD;
    covariance[(5, 5)] = VERTICAL_SIGMA_MM * VERTICAL_SIGMA_MM;
    covariance
}

/// Everything that does not change from check to check.
pub struct Evaluator {
    judge: Arc<Judge>,
    gear: GearData,
    zone: Zone,
    datum: Datum,
    decoder: Arc<Decoder>,
    places: Vec<Place>,
    /// Nearest and farthest distance at which the head measures, mm.
    reach_mm: [f64; 2],
    /// Size of the tool relative to its CAD, or why it cannot be judged.
    scale: Result<f64, Reason>,
}

impl Evaluator {
    /// Prepares the surface and the expected pose of every view.
    ///
    /// # Errors
    /// The tool or the head lacks what a check needs.
    pub fn new(
        subject: &Subject,
        decoder: Arc<Decoder>,
        itinerary: Arc<Itinerary>,
    ) -> Result<Self, EvaluatorError> {
        let missing = |what| EvaluatorError::Missing { what };
        let tool = Arc::clone(&subject.tool);
        let gear = tool
            .gear
            .clone()
            .ok_or(missing("[gear] in the tool file"))?;
        let limits = tool.limits().ok_or(missing("[inspect] in the tool file"))?;
        let datum = tool
            .inspect
            .as_ref()
            .map(|inspect| inspect.datum)
            .unwrap_or_default();
        let zone = tool.zone().ok_or(missing("[inspect] in the tool file"))?;
        let stage_from_camera = hand_eye(subject)?;
        let volume = subject
            .head
            .volume
            .ok_or(missing("[volume] in the head file"))?;
        let field_mm = volume.far_mm * field_slope(&subject.head);
        let places = itinerary
            .views
            .iter()
            .map(|view| {
                let tool_from_camera = tool_from_stage(view.rotation_rad)
                    * lifted(view.vertical_mm, stage_from_camera);
                let corners = [volume.near_mm, volume.far_mm].map(|depth| {
                    [-1.0, 1.0].map(|x| {
                        [-1.0, 1.0]
                            .map(|y| tool_from_camera.apply([x * field_mm, y * field_mm, depth]))
                    })
                });
                let corners = corners.as_flattened().as_flattened();
                let low: [f64; 3] = std::array::from_fn(|axis| {
                    corners
                        .iter()
                        .map(|corner| corner[axis])
                        .fold(f64::INFINITY, f64::min)
                        - MARGIN_MM
                });
                let high: [f64; 3] = std::array::from_fn(|axis| {
                    corners
                        .iter()
                        .map(|corner| corner[axis])
                        .fold(f64::NEG_INFINITY, f64::max)
                        + MARGIN_MM
                });
                let seen = tool.surface.restrict(|facet| {
                    (0..3)
                        .all(|axis| facet.low[axis] <= high[axis] && facet.high[axis] >= low[axis])
                });
                let surface = seen.ok_or(EvaluatorError::NothingThere { tooth: view.tooth })?;
                Ok(Place {
                    tooth: view.tooth,
                    tool_from_camera,
                    surface,
                })
            })
            .collect::<Result<_, EvaluatorError>>()?;
        // What the first verdict need not wait for.
        wear::prepare();
        let settings = Settings {
            calibration_mm: 1e-3 * calibration_um(&tool, &subject.head),
            ..tool.wear_settings()
        };
        let temperature = tool.temperature.as_ref();
        let scale = temperature.map_or(Ok(1.0), |t| t.scale(subject.temperature_degc));
        let judge = Judge {
            tool,
            limits,
            settings,
            baseline: subject.baseline.clone(),
        };
        Ok(Self {
            judge: Arc::new(judge),
            gear,
            zone,
            datum,
            decoder,
            places,
            reach_mm: reach_mm(&subject.head)?,
            scale,
        })
    }

    /// Evaluates one view's sums.
    #[must_use]
    pub fn evaluate(&self, view: usize, accumulator: &Accumulator) -> ViewOutcome {
        let place = &self.places[view];
        let mut elapsed_ms = BTreeMap::new();
        let mut clock = Instant::now();
        let mut lap = |what, elapsed_ms: &mut BTreeMap<&'static str, f64>| {
            elapsed_ms.insert(what, clock.elapsed().as_secs_f64() * 1e3);
            clock = Instant::now();
        };
        let decoded = match self.decoder.finish(accumulator) {
            Ok(decoded) => decoded,
            Err(error) => return self.unmeasured(place, &error.to_string(), elapsed_ms),
        };
        lap("decode", &mut elapsed_ms);
        let inconsistent_ratio = inconsistent_ratio(&decoded);
        if inconsistent_ratio > MOST_INCONSISTENT {
            let why = format!(
                "the frames of {:.0} % of the points do not follow one fringe, at most {:.0} % may: the head or the press \
                 vibrates, or the light flickers",
                100.0 * inconsistent_ratio,
                100.0 * MOST_INCONSISTENT
            );
            let mut outcome = self.unmeasured(place, &why, elapsed_ms);
            for registration in &mut outcome.registration {
                registration.inconsistent_ratio = inconsistent_ratio;
            }
            return outcome;
        }
        let kept =
            outlier::statistical(&decoded.cloud.points_mm, OUTLIER_NEIGHBOURS, OUTLIER_RATIO);
        let of_kept = |i: &usize| kept.get(*i).copied().unwrap_or(false);
        let (chosen, dropped): (Vec<usize>, Vec<usize>) =
            (0..decoded.cloud.len()).partition(of_kept);
        // A warm die is laid on its CAD as it is when cold: everything shrinks towards axis and seat, poses included.
        let scale = self.scale.as_ref().copied().unwrap_or(1.0);
        let cold = |i: &usize| decoded.cloud.points_mm[*i].map(|x| x / scale);
        let points: Vec<[f64; 3]> = chosen.iter().map(cold).collect();
        let sigma: Vec<f32> = chosen
            .iter()
            .map(|&i| decoded.cloud.sigma_z_mm[i])
            .collect();
        lap("outliers", &mut elapsed_ms);
        let tool_from_camera = place.tool_from_cold_camera(scale);
        let used: Vec<bool> = points
            .iter()
            .map(|&p| self.is_datum(place, tool_from_camera.apply(p)))
            .collect();
        let datum: Vec<[f64; 3]> = points
            .iter()
            .zip(&used)
            .filter(|(_, used)| **used)
            .map(|(p, _)| *p)
            .collect();
        let prior = stage_prior(tool_from_camera);
        let options = Options {
            initial: prior.tool_from_cloud,
            prior: Some(prior.clone()),
            teeth: Some(self.gear.teeth),
            ..Options::default()
        };
        let registration = register(&place.surface, &datum, None, &options);
        lap("registration", &mut elapsed_ms);
        let located: Vec<[f64; 3]> = points
            .iter()
            .map(|&p| registration.tool_from_cloud.apply(p))
            .collect();
        let closest = place.surface.closest_many(&located);
        lap("deviation", &mut elapsed_ms);
        let mut leakage = BTreeMap::new();
        let mut wears: Vec<FlankWear> = Vec::new();
        let mut pose = None;
        let unmeasured = |why: &str| super::verdict::unmeasured(place.tooth, &self.judge.tool, why);
        let flanks = match (&registration.status, &self.scale) {
            (_, Err(reason)) => unmeasured(&reason.to_string()),
            (Status::Registered, Ok(_)) => {
                let (gear, settings) = (&self.gear, &self.judge.settings);
                let places = wear::places(gear, &closest);
                let fitted = Fitted {
                    gear: &self.gear,
                    zone: &self.zone,
                    registration: &registration,
                    prior: &prior,
                    approach: approach_covariance(),
                    options: &options,
                    closest: &closest,
                    used: &used,
                    places: &places,
                    temperature: self.judge.tool.temperature.as_ref(),
                    form_in_doubt: self.judge.settings.as_built_mm > 0.0,
                };
                let tool_from_cloud = registration.tool_from_cloud.isometry();
                let without_point: Vec<[f64; 3]> =
                    rays_without_point(&self.decoder, &decoded, &dropped)
                        .map(|direction| {
                            (tool_from_cloud * Vector3::from(direction).normalize()).into()
                        })
                        .collect();
                let measured = Measured {
                    points: &located,
                    closest: &closest,
                    sigma_mm: Some(&sigma),
                    sight: Some(Sight {
                        surface: &place.surface,
                        camera_mm: tool_from_cloud.translation.vector.into(),
                        without_point: &without_point,
                        reach_mm: self.reach_mm,
                    }),
                };
                let (influences, measured) = rayon::join(
                    || fitted.on(place.tooth),
                    || {
                        let (zone, teeth) = (&self.zone, &[place.tooth]);
                        let of = Some(&registration);
                        wear::evaluate_placed(gear, zone, teeth, measured, &places, of, settings)
                    },
                );
                leakage.insert("left", influences[0].leakage);
                leakage.insert("right", influences[1].leakage);
                pose = Some(PoseEvidence::clone(&influences[0].evidence));
                wears = measured
                    .into_iter()
                    .zip(influences)
                    .map(|(wear, influence)| wear.with(influence, settings))
                    .collect();
                let captures = std::slice::from_ref(&wears);
                let judged = |flank| self.judge.flank(place.tooth, flank, captures);
                Flank::BOTH.into_iter().filter_map(judged).collect()
            }
            (Status::Indeterminate(reason), Ok(_)) => {
                unmeasured(&Reason::Registration(reason.clone()).to_string())
            }
        };
        let fields = wears
            .iter()
            .filter(|wear| wear.figures.is_some())
            .map(|wear| Reference {
                tooth: wear.tooth,
                flank: wear.flank,
                field: wear.field.clone(),
            })
            .collect();
        lap("wear", &mut elapsed_ms);
        let (maps, deviations_um) = self.draw(place.tooth, &closest);
        lap("maps", &mut elapsed_ms);
        ViewOutcome {
            flanks,
            registration: vec![ViewRegistration {
                leakage,
                inconsistent_ratio,
                ..summary(place, points.len(), &registration, elapsed_ms)
            }],
            fields,
            pose,
            maps,
            deviations_um,
            phasors: Vec::new(),
            tooth: place.tooth,
            captures: vec![wears],
            judge: Arc::clone(&self.judge),
        }
    }

    /// Whether the fit may use a point. Judged flanks must stay out: their wear would pull the pose towards it and hide
    /// itself (by a fifth, for 10 µm on one flank of the seven in view). Their tooth stays out as a whole: at the ends of a
    /// flank its wear reaches into what would count as a land.
    ///
    /// Where a point lies is taken from the stages' pose, which is off by hundredths of a millimetre.
    fn is_datum(&self, place: &Place, [x, y, _]: [f64; 3]) -> bool {
        let margin_mm = 0.05 * self.gear.module_mm;
        let (low_mm, high_mm) = (
            self.gear.tip_radius_mm.min(self.gear.root_radius_mm) + margin_mm,
            self.gear.tip_radius_mm.max(self.gear.root_radius_mm) - margin_mm,
        );
        let on_flank = (low_mm..high_mm).contains(&x.hypot(y));
        match self.datum {
            Datum::Neighbours => self.gear.tooth_at(y.atan2(x)) != place.tooth,
            Datum::Lands => !on_flank,
            Datum::All => true,
        }
    }

    /// The deviation maps of a tooth's two flanks, and the deviations in them.
    fn draw(&self, tooth: u32, closest: &[Closest]) -> (Vec<FlankMap>, Vec<f64>) {
        let [from, to] = self
            .zone
            .radius_mm
            .map(|radius| self.gear.profile_mm(radius));
        let [low, high] = self.zone.height_mm;
        let size_mm = [to - from, high - low];
        let [columns, rows] =
            size_mm.map(|length| ((length / MAP_CELL_MM).ceil() as usize).clamp(1, 4096));
        let mut sums = [Flank::Left, Flank::Right].map(|_| vec![(0.0_f64, 0_u32); columns * rows]);
        let mut deviations_um = Vec::new();
        for hit in closest {
            let Some(at) = self
                .gear
                .place(hit.point, hit.normal)
                .filter(|at| at.tooth == tooth)
            else {
                continue;
            };
            let along = (at.profile_mm - from) / size_mm[0];
            let down = (high - at.height_mm) / size_mm[1];
            if !(0.0..1.0).contains(&along) || !(0.0..1.0).contains(&down) {
                continue;
            }
            let cell = (down * rows as f64) as usize * columns + (along * columns as f64) as usize;
            let um = hit.signed_distance_mm * 1e3;
            let sum = &mut sums[usize::from(at.flank == Flank::Right)][cell];
            *sum = (sum.0 + um, sum.1 + 1);
            deviations_um.push(um);
        }
        let maps = Flank::BOTH.iter().zip(sums).map(|(flank, sums)| FlankMap {
            tooth,
            flank: flank.to_string(),
            columns,
            rows,
            size_mm,
            deviation_um: sums
                .iter()
                .map(|&(sum, count)| sum / f64::from(count))
                .collect(),
        });
        (maps.collect(), deviations_um)
    }

    fn unmeasured(
        &self,
        place: &Place,
        why: &str,
        elapsed_ms: BTreeMap<&'static str, f64>,
    ) -> ViewOutcome {
        ViewOutcome {
            flanks: super::verdict::unmeasured(place.tooth, &self.judge.tool, why),
            registration: vec![ViewRegistration {
                tooth: place.tooth,
                status: "indeterminate".into(),
                reason: Some(why.into()),
                points: 0,
                inconsistent_ratio: 0.0,
                inliers: 0,
                rms_mm: 0.0,
                iterations: 0,
                shift_mm: [0.0; 3],
                turn_rad: [0.0; 3],
                leakage: BTreeMap::new(),
                weak_directions: Vec::new(),
                elapsed_ms,
            }],
            fields: Vec::new(),
            pose: None,
            maps: Vec::new(),
            deviations_um: Vec::new(),
            phasors: Vec::new(),
            tooth: place.tooth,
            captures: vec![Vec::new()],
            judge: Arc::clone(&self.judge),
        }
    }
}

/// Where the cells without a point look, and those whose point was `dropped`: camera frame, at any length.
pub(crate) fn rays_without_point<'a>(
    decoder: &'a Decoder,
    decoded: &'a Decoded,
    dropped: &'a [usize],
) -> impl Iterator<Item = [f64; 3]> + 'a {
    let cells = decoded.without_point.iter();
    let directions = cells.filter_map(|&cell| decoder.direction(cell).map(|[x, y]| [x, y, 1.0]));
    directions.chain(dropped.iter().map(|&i| decoded.cloud.points_mm[i]))
}

/// Nearest and farthest distance from the camera at which a point can be measured, mm: depths along the axis, the farthest at
/// the edge of the field.
///
/// # Errors
/// The head file has no volume.
pub(crate) fn reach_mm(head: &HeadModel) -> Result<[f64; 2], EvaluatorError> {
    let what = "[volume] in the head file";
    let volume = head.volume.ok_or(EvaluatorError::Missing { what })?;
    let slope = 2f64.sqrt() * field_slope(head);
    Ok([volume.near_mm, volume.far_mm * 1f64.hypot(slope)])
}

/// Part of the cells with a fringe and an order whose frames contradict each other.
fn inconsistent_ratio(decoded: &Decoded) -> f64 {
    let lost = decoded.rejected.inconsistent as f64;
    lost / (lost + decoded.cloud.len() as f64).max(1.0)
}

fn summary(
    place: &Place,
    points: usize,
    registration: &Registration,
    elapsed_ms: BTreeMap<&'static str, f64>,
) -> ViewRegistration {
    let moved =
        registration.tool_from_cloud.isometry() * place.tool_from_camera.isometry().inverse();
    // How far the middle of the cloud moved: the motion of the origin would show the turn times 40 mm.
    let centre = nalgebra::Point3::from(registration.centre_mm);
    let shift = centre - moved.inverse() * centre;
    let (status, reason) = match &registration.status {
        Status::Registered => ("registered", None),
        Status::Indeterminate(reason) => ("indeterminate", Some(reason.to_string())),
    };
    let finite = |value: f64| if value.is_finite() { value } else { 0.0 };
    ViewRegistration {
        tooth: place.tooth,
        status: status.into(),
        reason,
        points,
        inconsistent_ratio: 0.0,
        inliers: registration.inliers,
        rms_mm: finite(registration.rms_mm),
        iterations: registration.iterations,
        shift_mm: [shift.x, shift.y, shift.z],
        turn_rad: moved.rotation.scaled_axis().into(),
        leakage: BTreeMap::new(),
        weak_directions: registration
            .weak_directions
            .iter()
            .map(|weak| WeakDirection {
                direction: weak.vector,
                prior_share: weak.prior_share,
            })
            .collect(),
        elapsed_ms,
    }
}

/// Half the field's width per distance, from the camera's image circle or its sensor.
pub(crate) fn field_slope(head: &HeadModel) -> f64 {
    let camera = &head.camera;
    let radius_px = head.image_circle.map_or(
        0.5 * f64::from(camera.width_px.max(camera.height_px)),
        |circle| circle.radius_px,
    );
    radius_px / camera.focal_px[0].min(camera.focal_px[1])
}

/// The die turns by the commanded angle; seen from the die, the stage turns the other way.
fn tool_from_stage(rotation_rad: f64) -> Rigid<ToolFrame, Stage> {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -rotation_rad);
    Rigid::from_isometry(Isometry3::from_parts(Translation3::identity(), turn))
}

/// The vertical stage raises the head.
fn lifted(vertical_mm: f64, stage_from_camera: Rigid<Stage, Camera>) -> Rigid<Stage, Camera> {
    Rigid::from_isometry(Translation3::new(0.0, 0.0, vertical_mm) * stage_from_camera.isometry())
}

/// The hand-eye of the head file.
pub(crate) fn hand_eye(subject: &Subject) -> Result<Rigid<Stage, Camera>, EvaluatorError> {
    let hand_eye = subject.head.stage_from_camera;
    let what = "stage_from_camera in the head file";
    rigid(&hand_eye.ok_or(EvaluatorError::Missing { what })?)
}

fn rigid(hand_eye: &RigidTransform) -> Result<Rigid<Stage, Camera>, EvaluatorError> {
    let rows = hand_eye.rotation;
    let matrix = Matrix3::from_fn(|row, column| rows[row][column]);
    let error = (matrix * matrix.transpose() - Matrix3::identity()).amax();
    if !(error <= 1e-6 && matrix.determinant() > 0.0) {
        return Err(EvaluatorError::HandEye { error });
    }
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
    let translation = Translation3::from(Vector3::from(hand_eye.translation_mm));
    Ok(Rigid::from_isometry(Isometry3::from_parts(
        translation,
        rotation,
    )))
}
