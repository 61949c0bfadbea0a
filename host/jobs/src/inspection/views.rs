//! Evaluates one captured view: points, pose, deviation, and wear of its flanks or patch.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Instant;

use flankscope_foundation::rigid::{Camera, Rigid, RigidError, Stage};
use flankscope_metrology::cloud::outlier;
use flankscope_metrology::feature::Features;
use flankscope_metrology::gear::{Flank, FlankPlace};
use flankscope_metrology::registration::{Registration, Status};
use flankscope_metrology::surface::Closest;
use flankscope_metrology::verdict::{Code, Reason};
use flankscope_metrology::wear::leakage::Leakage;
use flankscope_metrology::wear::standing::{Brought, MissingTooth, Ray, missing_teeth};
use flankscope_metrology::wear::{
    self, FlankWear, Measured, MountPose, PoseEvidence, Sight, WearSettings,
};
use flankscope_profilometry::{Accumulator, Decoded, Decoder};
use nalgebra::{Isometry3, Vector3};
use rayon::prelude::*;

use super::exposures::exposures_disagree;
use super::fit::{Fit, View};
use super::flank_decision::FlankCriteria;
use super::head_error::calibration_um;
use super::in_view::{self, InView};
use super::outcome::ViewOutcome;
use super::place::Place;
use super::verdict::Judged;
use super::{datum, die_size, maps, mount};
use crate::plan::ViewPlan;
use crate::plan::{FieldOfView, NoVolume};
use crate::subject::Subject;
use flankscope_instrument::poses::StatedPoses;
use flankscope_instrument::settings::Stages;
use flankscope_metrology::wear::sensitivity::FittedView;
use flankscope_record::baseline::Reference;
use flankscope_record::document::{Light, ViewRegistration, ViewStatus, WeakDirection};

/// Number of neighbours of the outlier filter: a point is an outlier if its mean distance to its neighbours exceeds the mean by
/// three standard deviations.
pub(crate) const OUTLIER_NEIGHBOURS: usize = 8;
pub(crate) const OUTLIER_RATIO: f64 = 3.0;
/// Distance by which the registered surface extends beyond the field of view, mm: then no point's closest point lies on the cut.
const MARGIN_MM: f64 = 2.0;
/// Largest fraction of inconsistent cells: noise gives one in a thousand, edges and highlights a few more, vibration nearly all.
const MOST_INCONSISTENT: f64 = 0.1;
/// A ray with a smaller cosine to the normal is grazing.
const GRAZING: f64 = 0.05;
/// Missing teeth are searched within this fraction of the field's radius: at the rim, light and optics end.
const NOT_THE_RIM: f64 = 0.85;

/// Why a subject cannot be evaluated.
#[derive(Debug, thiserror::Error)]
pub enum EvaluatorError {
    /// Tool or head lack an entry: gear, teeth to inspect or hand-eye.
    #[error("{what} is missing; a check needs it (see docs/formats)")]
    Missing {
        /// The missing entry.
        what: &'static str,
    },
    /// No measuring volume.
    #[error(transparent)]
    Volume(#[from] NoVolume),
    /// The hand-eye transform is not a rigid motion.
    #[error("the head's stage_from_camera: {0}")]
    HandEye(#[from] RigidError),
    /// The view would not see the die.
    #[error("the CAD has no surface where the head looks at tooth {tooth}")]
    NothingThere {
        /// Tooth of the view.
        tooth: u32,
    },
    #[error(
        "inspect.datum_height_mm of the tool file: the view of tooth {tooth} shows its flanks from {:.1} to {:.1} mm of height, not all \
         of the band {} to {} mm; name a band within, and judge a zone that leaves room for it (inspect.zone_height_mm)",
        seen_mm[0], seen_mm[1], band_mm[0], band_mm[1]
    )]
    DatumOutsideField {
        /// Tooth of the view.
        tooth: u32,
        band_mm: [f64; 2],
        /// Visible heights, mm.
        seen_mm: [f64; 2],
    },
}

/// Data of the evaluation that are the same for every check.
pub struct Evaluator {
    criteria: Arc<FlankCriteria>,
    /// Bands of height that determine the pose, mm; empty if the lands do.
    datum_bands_mm: Vec<[f64; 2]>,
    decoder: Arc<Decoder>,
    places: Vec<Place>,
    /// Teeth that have their own view.
    asked: BTreeSet<u32>,
    /// Stated poses of the camera, used instead of the stages' if given.
    stated: StatedPoses,
    field: FieldOfView,
    stages: Stages,
    /// Size of the tool relative to its CAD, or why the tool cannot be judged.
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
        plan: &ViewPlan,
    ) -> Result<Self, EvaluatorError> {
        let missing = |what| EvaluatorError::Missing { what };
        let tool = Arc::clone(&subject.tool);
        if tool.gear.is_none() && tool.patches.is_empty() {
            return Err(missing("[gear] or [[patch]] in the tool file"));
        }
        let limits = tool.limits().ok_or(missing("[inspect] in the tool file"))?;
        let inspect = tool.inspect.as_ref();
        let datum_bands_mm = inspect.map(|inspect| inspect.datum_height_mm.clone());
        let datum_bands_mm = datum_bands_mm.unwrap_or_default();
        let stage_from_camera = hand_eye(subject)?;
        let field = FieldOfView::of(&subject.head)?;
        let volume = subject
            .head
            .volume
            .ok_or(missing("[volume] in the head file"))?;
        let field_mm = volume.far_mm * field.slope;
        let places = plan
            .all_views()
            .map(|view| {
                let tool_from_camera = view.tool_from_camera(stage_from_camera);
                if let Some(gear) = &tool.gear {
                    let bands = &datum_bands_mm;
                    datum::check_in_field(bands, gear, view.tooth, tool_from_camera, &field)?;
                }
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
                let zone = tool.zone_of(view.tooth);
                Ok(Place {
                    tooth: view.tooth,
                    zone: zone.ok_or(missing("[inspect] in the tool file"))?,
                    tool_from_camera,
                    surface: Arc::new(surface),
                    stated: None,
                })
            })
            .collect::<Result<_, EvaluatorError>>()?;
        // Prepared now, so that the first verdict need not wait for it.
        wear::prepare();
        let settings = WearSettings {
            calibration_mm: 1e-3 * calibration_um(&tool, &subject.head),
            ..tool.wear_settings()
        };
        let temperature = tool.temperature.as_ref();
        let scale = temperature.map_or(Ok(1.0), |t| t.scale(subject.temperature_degc));
        let criteria = FlankCriteria {
            tool,
            limits,
            settings,
            baseline: subject.baseline.clone(),
        };
        Ok(Self {
            criteria: Arc::new(criteria),
            datum_bands_mm,
            decoder,
            places,
            asked: plan.views.iter().map(|view| view.tooth).collect(),
            stated: plan.stated.clone(),
            field,
            stages: subject.station.stages.clone(),
            scale,
        })
    }

    /// The judged flanks or patches of the tool.
    fn features(&self) -> Features<'_> {
        self.criteria.tool.features()
    }

    /// Pose of the camera for a view: as planned, or as stated by a pose table or pose program.
    fn place(&self, view: usize) -> Place {
        let planned = self.places[view].clone();
        let stated = self.stated.of(view);
        // It was checked when it was stated.
        let pose = stated.and_then(|of| Some((of.rigid().ok()?, [of.u_mm, of.u_mrad])));
        match pose {
            Some((tool_from_camera, u)) => Place {
                tool_from_camera,
                stated: Some(u),
                ..planned
            },
            None => planned,
        }
    }

    /// Evaluates one view's sums.
    #[must_use]
    pub fn evaluate(&self, view: usize, accumulator: &Accumulator) -> ViewOutcome {
        let place = &self.place(view);
        let mut laps = Laps::begin();
        let decoded = match self.decoder.finish(accumulator) {
            Ok(decoded) => decoded,
            Err(error) => {
                let why = Reason::instrument(Code::Decoding, error);
                return self.unmeasured(place, &why, 0.0, laps.elapsed_ms);
            }
        };
        laps.lap("decode");
        let inconsistent_ratio = inconsistent_ratio(&decoded);
        if let Some(why) = shaken(inconsistent_ratio) {
            return self.unmeasured(place, &why, inconsistent_ratio, laps.elapsed_ms);
        }
        if let Some(why) = exposures_disagree(&decoded) {
            return ViewOutcome {
                retake: true,
                ..self.unmeasured(place, &why, inconsistent_ratio, laps.elapsed_ms)
            };
        }
        let cold = self.cold(&decoded);
        laps.lap("outliers");
        let view = self.view(place, &cold.points);
        let fit = self.fit(&view);
        laps.lap("registration");
        let located: Vec<[f64; 3]> = cold
            .points
            .par_iter()
            .map(|&p| fit.registration.tool_from_cloud.apply(p))
            .collect();
        let closest = place.surface.closest_many(&located);
        laps.lap("deviation");
        // A check without a baseline may become one.
        let to_record = mount::seat(&view).filter(|_| self.criteria.baseline.is_none());
        let mount = || {
            let stages = &view.stages.tool_from_cloud;
            MountPose::new(
                to_record.as_ref()?,
                stages,
                &fit.registration.tool_from_cloud,
                &closest,
            )
        };
        let places = wear::places(self.features(), &closest);
        let tool_from_cloud = fit.registration.tool_from_cloud.isometry();
        // Outliers come last: light did reach them.
        let is_dark = decoded.is_dark.iter().copied();
        let is_dark = is_dark.chain(std::iter::repeat(false));
        let (mut dark, mut undecoded) = (Vec::new(), Vec::new());
        let directions = rays_without_point(&self.decoder, &decoded, &cold.dropped);
        for (direction, is_dark) in directions.zip(is_dark) {
            let along = tool_from_cloud * Vector3::from(direction).normalize();
            let rays = if is_dark { &mut dark } else { &mut undecoded };
            rays.push(along.into());
        }
        let measured = Measured {
            points: &located,
            closest: &closest,
            sigma_mm: Some(&cold.sigma),
            sight: Some(Sight {
                surface: &place.surface,
                camera_mm: tool_from_cloud.translation.vector.into(),
                dark: &dark,
                undecoded: &undecoded,
                range_mm: self.field.range_mm,
                light: &cold.light,
            }),
        };
        let assess = || match (&fit.registration.status, &self.scale) {
            (_, Err(reason)) => self.not_assessed(place, reason),
            (Status::Registered, Ok(_)) => self.assess(&view, &fit, measured, &places),
            (Status::Indeterminate(reason), Ok(_)) => {
                self.not_assessed(place, &Reason::Registration(reason.clone()))
            }
        };
        // Of the view as a whole: none of them needs another's result.
        let (assessed, ((other_order_ratio, missing), ((maps, deviations_um), mount))) =
            rayon::join(assess, || {
                rayon::join(
                    || {
                        (
                            self.other_order_ratio(&cold.points, tool_from_cloud, &closest),
                            self.missing_teeth(&fit, measured, &places, &cold.points),
                        )
                    },
                    || {
                        let draw = || {
                            maps::draw(self.features(), place.tooth, &place.zone, &closest, &places)
                        };
                        rayon::join(draw, mount)
                    },
                )
            });
        let light = Light {
            rejected: decoded.rejected,
            contrast: decoded.contrast.clone(),
            medians: decoded.light,
            projectors: decoded.projectors,
            other_order_ratio,
        };
        let fields = assessed
            .wears
            .iter()
            .filter(|wear| wear.tooth == place.tooth && wear.judged.is_some())
            .map(Reference::of_flank)
            .collect();
        laps.lap("wear");
        let points = cold.points.len();
        let captures = vec![assessed.wears];
        ViewOutcome {
            flanks: assessed.flanks,
            in_view: InView::of_view(place.tooth, &captures, missing, &self.criteria),
            registration: vec![ViewRegistration {
                leakage: assessed.leakage,
                inconsistent_ratio,
                light: Some(light),
                ..summary(place, points, &fit.registration, laps.elapsed_ms)
            }],
            fields,
            pose: assessed.pose.map(|pose| PoseEvidence { mount, ..pose }),
            maps,
            deviations_um,
            phasors: Vec::new(),
            retake: false,
            tooth: place.tooth,
            captures,
            further: Vec::new(),
            criteria: Arc::clone(&self.criteria),
        }
    }

    /// The points without outliers, scaled to a cold die: a warm die shrinks towards axis and seat to match its CAD, poses included.
    fn cold(&self, decoded: &Decoded) -> ColdPoints {
        let cloud = &decoded.cloud;
        let kept = outlier::statistical(&cloud.points_mm, OUTLIER_NEIGHBOURS, OUTLIER_RATIO);
        let of_kept = |i: &usize| kept.get(*i).copied().unwrap_or(false);
        let (chosen, dropped): (Vec<usize>, Vec<usize>) = (0..cloud.len()).partition(of_kept);
        let scale = self.scale_or_one();
        let cold = |&i: &usize| cloud.points_mm[i].map(|x| x / scale);
        ColdPoints {
            points: chosen.iter().map(cold).collect(),
            sigma: chosen.iter().map(|&i| cloud.sigma_z_mm[i]).collect(),
            light: chosen.iter().map(|&i| cloud.fringes_e_per_ms[i]).collect(),
            dropped,
        }
    }

    fn scale_or_one(&self) -> f64 {
        self.scale.as_ref().copied().unwrap_or(1.0)
    }

    /// Fraction of the points whose fringe order differs from that of the drawing along their ray.
    fn other_order_ratio(
        &self,
        points: &[[f64; 3]],
        tool_from_cloud: &Isometry3<f64>,
        closest: &[Closest],
    ) -> f64 {
        let is_other = |(point, closest): (&[f64; 3], &Closest)| {
            let ray = Vector3::from(*point);
            let along = tool_from_cloud.rotation * ray.normalize();
            let cosine = along.dot(&Vector3::from(closest.normal));
            let drawn = ray - ray.normalize() * (closest.signed_distance_mm / cosine);
            let apart = self.decoder.orders_between(*point, drawn.into());
            // Grazing rays are not compared.
            cosine.abs() > GRAZING && apart.is_some_and(|orders| orders.abs() > 0.5)
        };
        let others = points
            .par_iter()
            .zip(closest)
            .filter(|pair| is_other(*pair));
        others.count() as f64 / points.len().max(1) as f64
    }

    /// A view of these points, with what is known of its pose.
    fn view<'a>(&'a self, place: &'a Place, points: &'a [[f64; 3]]) -> View<'a> {
        let tool_from_camera = place.tool_from_cold_camera(self.scale_or_one());
        let baseline = self.criteria.baseline.as_ref();
        let measured = baseline.and_then(|baseline| baseline.approaches.as_ref());
        View {
            place,
            tool: &self.criteria.tool,
            points,
            stages: place.prior(tool_from_camera, &self.stages),
            approach: place.approach(&self.stages, measured),
            approached: measured.map_or(1.0, |measured| f64::from(measured.count)),
            form_mm: self.criteria.settings.form_mm(true),
            mount_drift_mm: self.stages.mount_drift_mm(),
            mount_mm: self.stages.mount_sigma().0,
        }
    }

    /// Lays the points on the CAD: where the baseline's mounting puts them, or else by a fit on the tool's datum.
    fn fit(&self, view: &View<'_>) -> Fit {
        let baseline = self.criteria.baseline.as_ref();
        let mount = baseline.and_then(|baseline| baseline.pose(view.place.tooth)?.mount);
        let in_mount = mount.and_then(|recorded| mount::fit_in(view, recorded));
        in_mount.unwrap_or_else(|| view.fit_on_datum())
    }

    /// Wear and decision of both flanks of the middle tooth, and wear of its neighbours in view.
    fn assess(
        &self,
        view: &View<'_>,
        fit: &Fit,
        measured: Measured<'_>,
        places: &[Option<FlankPlace>],
    ) -> Assessed {
        let (place, features, settings) = (view.place, self.features(), &self.criteria.settings);
        if let Some(why) = datum::unseen(&self.datum_bands_mm, &fit.used, places) {
            return self.not_assessed(place, &why);
        }
        let fitted = FittedView {
            features,
            zone: &place.zone,
            registration: &fit.registration,
            prior: &fit.prior,
            stages: &view.stages,
            approach: view.approach,
            same_mount: fit.same_mount.as_ref(),
            options: &fit.options,
            closest: measured.closest,
            used: &fit.used,
            datum_bands_mm: &self.datum_bands_mm,
            places,
            expansion: self.criteria.tool.temperature.map(|of| of.expansion()),
            form_in_doubt: settings.as_built_mm > 0.0,
        };
        let in_zone = |at: &FlankPlace| place.zone.holds(at.radius_mm, at.height_mm);
        let mut teeth = vec![place.tooth];
        teeth.extend(in_view::others(features, places, in_zone, &self.asked));
        let judged_zone = (place.tooth, &place.zone);
        let ((mut sensitivities, scale_mm), measured) = rayon::join(
            || {
                rayon::join(
                    || fitted.on(&teeth),
                    || {
                        die_size::scale_mm(
                            features,
                            judged_zone,
                            measured.closest,
                            places,
                            settings,
                        )
                    },
                )
            },
            || {
                let (zone, of) = (&place.zone, Some(&fit.registration));
                wear::evaluate_placed(features, zone, &teeth, measured, places, of, settings)
            },
        );
        let scale_mm = match scale_mm {
            Ok(scale_mm) => scale_mm,
            Err(why) => return self.not_assessed(place, &why),
        };
        for of in &mut sensitivities {
            of.temperature_mm = of.temperature_mm.hypot(scale_mm);
        }
        let leakage = features.sides().iter().zip(&sensitivities);
        let leakage = leakage
            .map(|(side, of)| (side.word(), of.leakage))
            .collect();
        // All sides of a tooth share the evidence.
        let evidence = sensitivities.first().and_then(|of| of.evidence.as_deref());
        let pose = evidence.cloned();
        let wears: Vec<FlankWear> = measured
            .into_par_iter()
            .zip(sensitivities)
            .map(|(wear, sensitivity)| wear.with(sensitivity, settings))
            .collect();
        let captures = std::slice::from_ref(&wears);
        let judged = |&flank: &Flank| self.criteria.flank(place.tooth, flank, captures, &[]);
        Assessed {
            flanks: features.sides().iter().filter_map(judged).collect(),
            leakage,
            pose,
            wears,
        }
    }

    /// Missing teeth in a view that could be registered, except at the rim of the field. `points` are in the camera frame.
    fn missing_teeth(
        &self,
        fit: &Fit,
        measured: Measured<'_>,
        places: &[Option<FlankPlace>],
        points: &[[f64; 3]],
    ) -> Vec<MissingTooth> {
        let (Features::Gear(gear), Status::Registered, Some(sight)) =
            (self.features(), &fit.registration.status, measured.sight)
        else {
            return Vec::new();
        };
        let tool_from_cloud = fit.registration.tool_from_cloud.isometry();
        let axis = tool_from_cloud.rotation * Vector3::z();
        let of_points = points.iter().map(|&point| {
            let point = Vector3::from(point);
            Ray {
                direction: (tool_from_cloud.rotation * point.normalize()).into(),
                brought: Brought::Point(point.norm()),
            }
        });
        let without = |directions: &'_ [[f64; 3]], brought| {
            let ray = move |&direction| Ray { direction, brought };
            directions.iter().map(ray).collect::<Vec<_>>()
        };
        let dark = without(sight.dark, Brought::Nothing);
        let undecoded = without(sight.undecoded, Brought::Light);
        let least_cos = 1.0 / 1f64.hypot(NOT_THE_RIM * self.field.slope);
        let rays = of_points.chain(dark).chain(undecoded);
        let rays = rays.filter(|ray| Vector3::from(ray.direction).dot(&axis) >= least_cos);
        missing_teeth(gear, sight.camera_mm, rays, measured.closest, places)
    }

    /// The result if the view cannot be assessed, with its reason.
    fn not_assessed(&self, place: &Place, why: &Reason) -> Assessed {
        Assessed {
            flanks: super::verdict::unmeasured(place.tooth, &self.criteria.tool, why),
            leakage: BTreeMap::new(),
            pose: None,
            wears: Vec::new(),
        }
    }

    fn unmeasured(
        &self,
        place: &Place,
        why: &Reason,
        inconsistent_ratio: f64,
        elapsed_ms: BTreeMap<&'static str, f64>,
    ) -> ViewOutcome {
        ViewOutcome {
            flanks: super::verdict::unmeasured(place.tooth, &self.criteria.tool, why),
            in_view: InView::default(),
            registration: vec![ViewRegistration {
                tooth: place.tooth,
                status: ViewStatus::Indeterminate,
                reason: Some(why.to_string()),
                points: 0,
                inconsistent_ratio,
                light: None,
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
            retake: false,
            tooth: place.tooth,
            captures: vec![Vec::new()],
            further: Vec::new(),
            criteria: Arc::clone(&self.criteria),
        }
    }
}

/// Points of a view scaled to a cold die, camera frame (mm), each with its standard uncertainty (mm).
struct ColdPoints {
    points: Vec<[f64; 3]>,
    sigma: Vec<f32>,
    /// Direct light of each: amplitude of the finest fringes, electrons per millisecond.
    light: Vec<f32>,
    /// Indices of the cloud's outliers.
    dropped: Vec<usize>,
}

/// Result for both flanks of a view's middle tooth.
struct Assessed {
    flanks: Vec<Judged>,
    leakage: BTreeMap<&'static str, Leakage>,
    pose: Option<PoseEvidence>,
    wears: Vec<FlankWear>,
}

/// Duration of each step.
struct Laps {
    clock: Instant,
    elapsed_ms: BTreeMap<&'static str, f64>,
}

impl Laps {
    fn begin() -> Self {
        Self {
            clock: Instant::now(),
            elapsed_ms: BTreeMap::new(),
        }
    }

    fn lap(&mut self, what: &'static str) {
        let elapsed_ms = self.clock.elapsed().as_secs_f64() * 1e3;
        self.elapsed_ms.insert(what, elapsed_ms);
        self.clock = Instant::now();
    }
}

/// Why a view is not used if the frames of too many cells are inconsistent.
fn shaken(inconsistent_ratio: f64) -> Option<Reason> {
    let why = format_args!(
        "the frames of {:.0} % of the points do not follow one fringe, at most {:.0} % may: the head or the press vibrates, \
         or the light flickers",
        100.0 * inconsistent_ratio,
        100.0 * MOST_INCONSISTENT
    );
    (inconsistent_ratio > MOST_INCONSISTENT).then(|| Reason::instrument(Code::Inconsistent, why))
}

/// Rays of the cells without a point, and of those whose point was `dropped`: camera frame, not normalised.
pub(crate) fn rays_without_point<'a>(
    decoder: &'a Decoder,
    decoded: &'a Decoded,
    dropped: &'a [usize],
) -> impl Iterator<Item = [f64; 3]> + 'a {
    let cells = decoded.without_point.iter();
    let directions = cells.filter_map(|&cell| decoder.direction(cell).map(|[x, y]| [x, y, 1.0]));
    directions.chain(dropped.iter().map(|&i| decoded.cloud.points_mm[i]))
}

/// Fraction of the cells with fringes whose frames are inconsistent. Cells whose frequencies disagree are not tested for it, and
/// the few remaining cells of such a view are not representative.
fn inconsistent_ratio(decoded: &Decoded) -> f64 {
    let [lost, disagreeing] = [decoded.rejected.inconsistent, decoded.rejected.disagreeing];
    lost as f64 / (lost + disagreeing + decoded.cloud.len()).max(1) as f64
}

fn summary(
    place: &Place,
    points: usize,
    registration: &Registration,
    elapsed_ms: BTreeMap<&'static str, f64>,
) -> ViewRegistration {
    let moved =
        registration.tool_from_cloud.isometry() * place.tool_from_camera.isometry().inverse();
    // Shift of the cloud's centre; the shift of the origin would include the rotation times 40 mm.
    let centre = nalgebra::Point3::from(registration.centre_mm);
    let shift = centre - moved.inverse() * centre;
    let (status, reason) = match &registration.status {
        Status::Registered => (ViewStatus::Registered, None),
        Status::Indeterminate(reason) => (ViewStatus::Indeterminate, Some(reason.to_string())),
    };
    let finite = |value: f64| if value.is_finite() { value } else { 0.0 };
    ViewRegistration {
        tooth: place.tooth,
        status,
        reason,
        points,
        inconsistent_ratio: 0.0,
        light: None,
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

/// The hand-eye of the head file.
pub(crate) fn hand_eye(subject: &Subject) -> Result<Rigid<Stage, Camera>, EvaluatorError> {
    let hand_eye = subject.head.stage_from_camera;
    let what = "stage_from_camera in the head file";
    Ok(hand_eye.ok_or(EvaluatorError::Missing { what })?.rigid()?)
}
