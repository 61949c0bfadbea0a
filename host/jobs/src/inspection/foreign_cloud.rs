//! Wear from a cloud that another scanner measured, judged by the rules of a check.
//!
//! Nothing is known of the scanner but its points and the uncertainty that its certificate states, so two things differ from a
//! check: no stages tell the pose, and no rays tell an opening that hides its floor from a place that was not scanned.

use std::collections::BTreeSet;
use std::sync::Arc;

use flankscope_foundation::normal::COVERAGE_95;
use flankscope_foundation::rigid::{Cloud, Rigid, Tool as ToolFrame};
use flankscope_metrology::feature::Features;
use flankscope_metrology::gear::FlankPlace;
use flankscope_metrology::registration::{Options, Prior, Registration, Status, register};
use flankscope_metrology::tool::Tool;
use flankscope_metrology::verdict::{Reason, Word};
use flankscope_metrology::wear::sensitivity::FittedView;
use flankscope_metrology::wear::{self, ANY_POSE_MM, FlankWear, Measured, WearSettings, Zone};
use flankscope_record::document::{Feature, FlankInView};
use nalgebra::Matrix6;
use serde::Serialize;

use super::flank_decision::FlankCriteria;
use super::in_view::{self, InView, Neighbourhood};
use super::job::InspectError;
use super::verdict::{self, Judged};
use super::views::EvaluatorError;
use super::{datum, die_size};
use crate::plan::{PatchViewError, PlanningError, ViewPlan};

/// A cloud of another scanner.
#[derive(Clone, Copy, Debug)]
pub struct ForeignCloud<'a> {
    /// Points, mm.
    pub points: &'a [[f64; 3]],
    /// Standard uncertainty of each by noise, mm; none: their scatter on the flanks.
    pub sigma_mm: Option<&'a [f32]>,
    /// Expanded uncertainty (95 %) of a deviation by what does not average out, mm.
    pub u95_mm: f64,
    /// Pose from which the registration starts.
    pub start: Rigid<ToolFrame, Cloud>,
    /// Temperature of the tool, °C, if known.
    pub temperature_degc: Option<f64>,
}

/// Wear of a tool by a cloud.
#[derive(Debug, Serialize)]
pub struct CloudVerdict {
    /// The verdict on all requested flanks or patches.
    pub verdict: Word,
    /// One sentence about it.
    pub reason: String,
    /// The requested flanks or patches.
    pub features: Vec<Feature>,
    /// Other flanks that the cloud shows.
    pub in_view: Vec<FlankInView>,
    /// Poses of the cloud: one, or one for each patch.
    pub registration: Vec<CloudPose>,
}

#[derive(Debug, Serialize)]
pub struct CloudPose {
    /// The pose, row by row.
    pub tool_from_cloud: [[f64; 4]; 4],
    /// Why it cannot be used.
    pub reason: Option<String>,
    /// Points that the fit could use.
    pub points: usize,
    /// Those of them that lie on the surface.
    pub inliers: usize,
    /// Root of their mean squared distance, mm; none without inliers.
    pub rms_mm: Option<f64>,
}

/// Judges a cloud by the limits of a tool: its inspected teeth or patches, or `asked`.
///
/// # Errors
/// The tool file lacks what is judged, or `asked` names what it does not have.
pub fn judge_cloud(
    tool: Arc<Tool>,
    cloud: &ForeignCloud<'_>,
    asked: Option<&[u32]>,
) -> Result<CloudVerdict, InspectError> {
    let missing = |what| EvaluatorError::Missing { what };
    let limits = tool.limits().ok_or(missing("[inspect] in the tool file"))?;
    let settings = WearSettings {
        calibration_mm: cloud.u95_mm / COVERAGE_95,
        ..tool.wear_settings()
    };
    let temperature = tool.temperature.as_ref();
    let scale = temperature.map_or(Ok(1.0), |t| t.scale(cloud.temperature_degc));
    let asked = asked.map_or_else(|| tool.inspected(), <[u32]>::to_vec);
    if tool.gear.is_some() {
        ViewPlan::nominal(&tool, &asked)?;
    }
    let zone_of = |&number: &u32| {
        let unknown = || PatchViewError::NoSuchPatch {
            got: number,
            numbers: tool.patches.judged(),
        };
        Ok((number, tool.zone_of(number).ok_or_else(unknown)?))
    };
    let zones: Vec<(u32, Zone)> = asked
        .iter()
        .map(zone_of)
        .collect::<Result<_, PlanningError>>()?;
    let judging = Judging {
        criteria: FlankCriteria {
            tool: Arc::clone(&tool),
            limits,
            settings,
            baseline: None,
        },
        cloud,
        asked: asked.into_iter().collect(),
    };
    let mut found = Found::default();
    // All teeth share a pose, and their zones are alike; each patch rests on a datum of its own.
    match (tool.features(), zones.first()) {
        (Features::Gear(_), Some((_, zone))) => {
            let teeth: Vec<u32> = zones.iter().map(|(tooth, _)| *tooth).collect();
            judging.add(&teeth, zone, &scale, &mut found);
        }
        _ => zones.iter().for_each(|(patch, zone)| {
            judging.add(&[*patch], zone, &scale, &mut found);
        }),
    }
    found.others.sort();
    let beside = found.others.findings(&judging.asked);
    let presumed = verdict::presumptions(&tool, false);
    let (verdict, reason) = verdict::of_tool(&found.judged, None, &presumed, &beside);
    Ok(CloudVerdict {
        verdict,
        reason,
        features: found.judged.into_iter().map(Feature::from).collect(),
        in_view: found.others.flanks,
        registration: found.poses,
    })
}

#[derive(Default)]
struct Found {
    judged: Vec<Judged>,
    others: Neighbourhood,
    poses: Vec<CloudPose>,
}

struct Judging<'a> {
    criteria: FlankCriteria,
    cloud: &'a ForeignCloud<'a>,
    asked: BTreeSet<u32>,
}

impl Judging<'_> {
    /// Judges these teeth, or this patch, by one pose of the cloud.
    fn add(&self, numbers: &[u32], zone: &Zone, scale: &Result<f64, Reason>, found: &mut Found) {
        let tool = &self.criteria.tool;
        let wears = match scale {
            Ok(scale) => {
                // A warm tool shrinks towards axis and seat to match its CAD.
                let cold = self.cloud.points.iter().map(|p| p.map(|x| x / scale));
                self.wears(numbers, zone, &cold.collect::<Vec<_>>(), &mut found.poses)
            }
            Err(why) => Err(why.clone()),
        };
        let captures = match wears {
            Ok(wears) => [wears],
            Err(why) => {
                let unmeasured = numbers.iter();
                let unmeasured = unmeasured.flat_map(|&n| verdict::unmeasured(n, tool, &why));
                return found.judged.extend(unmeasured);
            }
        };
        let sides = tool.features().sides();
        let keys = numbers
            .iter()
            .flat_map(|&n| sides.iter().map(move |&f| (n, f)));
        found
            .judged
            .extend(keys.filter_map(|(n, f)| self.criteria.flank(n, f, &captures, &[])));
        let [mut others] = captures;
        others.retain(|wear| !self.asked.contains(&wear.tooth));
        let of_others = InView::of_view(0, &[others], Vec::new(), &self.criteria);
        found.others.add(of_others);
    }

    /// Wear of these teeth or this patch, and of other teeth that the cloud shows.
    fn wears(
        &self,
        numbers: &[u32],
        zone: &Zone,
        points: &[[f64; 3]],
        poses: &mut Vec<CloudPose>,
    ) -> Result<Vec<FlankWear>, Reason> {
        let tool = &*self.criteria.tool;
        let (features, settings) = (tool.features(), &self.criteria.settings);
        let options = Options {
            initial: self.cloud.start,
            teeth: features.gear().map(|gear| gear.teeth),
            ..Options::default()
        };
        let rough = register(&tool.surface, points, None, &options);
        let (registration, used, options) = match rough.status {
            Status::Registered => {
                let options = Options {
                    initial: rough.tool_from_cloud,
                    ..options
                };
                let used = datum::used(tool, numbers, &tool.surface, &moved(points, &rough));
                let datum = points.iter().zip(&used).filter(|(_, used)| **used);
                let datum: Vec<[f64; 3]> = datum.map(|(point, _)| *point).collect();
                let registration = register(&tool.surface, &datum, None, &options);
                poses.push(CloudPose::new(&registration, datum.len()));
                (registration, used, options)
            }
            Status::Indeterminate(_) => {
                poses.push(CloudPose::new(&rough, points.len()));
                (rough, Vec::new(), options)
            }
        };
        if let Status::Indeterminate(why) = &registration.status {
            return Err(Reason::Registration(why.clone()));
        }
        let points = moved(points, &registration);
        let closest = tool.surface.closest_many(&points);
        let places = wear::places(features, &closest);
        let bands = tool
            .inspect
            .as_ref()
            .map(|of| of.datum_height_mm.as_slice());
        let datum_bands_mm = bands.unwrap_or_default();
        if let Some(why) = datum::unseen(datum_bands_mm, &used, &places) {
            return Err(why);
        }
        let sigma_mm = self.cloud.sigma_mm;
        let measured = Measured {
            points: &points,
            closest: &closest,
            sigma_mm,
            sight: None,
        };
        let anywhere = anywhere(&registration);
        let fitted = FittedView {
            features,
            zone,
            registration: &registration,
            prior: &anywhere,
            stages: &anywhere,
            approach: Matrix6::zeros(),
            same_mount: None,
            options: &options,
            closest: &closest,
            used: &used,
            datum_bands_mm,
            places: &places,
            expansion: tool.temperature.map(|of| of.expansion()),
            form_in_doubt: settings.as_built_mm > 0.0,
        };
        let in_zone = |at: &FlankPlace| zone.holds(at.radius_mm, at.height_mm);
        let mut teeth = numbers.to_vec();
        teeth.extend(in_view::others(features, &places, in_zone, &self.asked));
        let size_mm = numbers
            .iter()
            .map(|&n| die_size::scale_mm(features, (n, zone), &closest, &places, settings))
            .try_fold(0.0, |worst, of| of.map(|mm| f64::max(worst, mm)))?;
        let of = Some(&registration);
        let wears = wear::evaluate_placed(features, zone, &teeth, measured, &places, of, settings);
        let wears = wears.into_iter().zip(fitted.on(&teeth));
        Ok(wears
            .map(|(wear, mut sensitivity)| {
                sensitivity.temperature_mm = sensitivity.temperature_mm.hypot(size_mm);
                wear.with(sensitivity, settings)
            })
            .collect())
    }
}

impl CloudPose {
    fn new(found: &Registration, points: usize) -> Self {
        Self {
            tool_from_cloud: found.tool_from_cloud.to_rows(),
            reason: match &found.status {
                Status::Registered => None,
                Status::Indeterminate(why) => Some(why.to_string()),
            },
            points,
            inliers: found.inliers,
            rms_mm: Some(found.rms_mm).filter(|mm| mm.is_finite()),
        }
    }
}

fn moved(points: &[[f64; 3]], by: &Registration) -> Vec<[f64; 3]> {
    let pose = &by.tool_from_cloud;
    points.iter().map(|&point| pose.apply(point)).collect()
}

/// What is known of the pose before the fit: nearly nothing.
fn anywhere(found: &Registration) -> Prior {
    let turn_rad = ANY_POSE_MM / found.arm_mm;
    Prior::independent(found.tool_from_cloud, [turn_rad; 3], [ANY_POSE_MM; 3])
}
