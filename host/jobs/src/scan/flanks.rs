//! Wear of every flank from a scan: the same measurand and rules as in a check between strokes.
//!
//! ```text
//!  points of every view by flank (patches) ─► moved to the adjustment's poses ─► zone by zone: wear ─┐
//!  what each view may hide or leave open (pose) ──────────────────────────────────────────────────────┤
//!  medians of all flanks: what a turn of the die may hide ────────────────────────────────────────────┴─► judge
//! ```
//!
//! A die that is placed by hand has an unknown rotation, and a bore that is larger all around looks like a head farther from the
//! wall. So the mean of one side of all teeth, and of all flanks together, is known from the flanks alone. Wear is relative to
//! the CAD: ovality, taper and pitch as built count as wear, as in a check without a baseline.

use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::TAU;
use std::sync::Arc;

use flankscope_foundation::order::{SIGMA_PER_MAD, median_of};
use flankscope_metrology::gear::{Flank, GearData};
use flankscope_metrology::multiview::adjustment::{CameraPose, Local, Solution, Stages};
use flankscope_metrology::multiview::tooth_identity::FlankMean;
use flankscope_metrology::tool::Tool;
use flankscope_metrology::verdict::flank::FlankLimits;
use flankscope_metrology::verdict::{Code, Reason, Verdict, Word};
use flankscope_metrology::wear::sensitivity::{
    HeldView, ScanSensitivity, ScanView, registration_mm,
};
use flankscope_metrology::wear::{
    ANY_POSE_MM, FlankWear, Gathered, PoseEvidence, SeenFlank, WearSettings, Zone,
};
use nalgebra::Matrix6;
use rayon::prelude::*;

use super::coverage::ASKED_PER_FIELD;
use super::job::{ScanError, Scanner};
use super::session::SessionError;
use super::stitch::Stitched;
use super::view::{SAMPLE, coordinates};
use super::view_pipeline::Store;
use crate::inspection::{Judged, calibration_um, unmeasured_flank};
use flankscope_metrology::view::PlannedView;
use flankscope_record::document::Feature;

/// Misplacement of die and head together, mm. A view must cover only the part of an off-centre flank that its round field shows
/// even with this misplacement.
const PUT_DOWN_MM: f64 = 1.0;
/// Width at the end faces that is not judged, in modules, because the edge is blurred there, as at the tip.
const END_PER_MODULE: f64 = 0.1;
/// Smallest measured fraction of a zone for a flank that was not requested.
const LEAST_SEEN: f64 = 0.02;
/// Distance of the lower quartile of a normal distribution from its median, in standard deviations; the standard error of the
/// quartile of n values is this divided by the root of n.
const QUARTILE_SIGMAS: f64 = 0.674_5;
const QUARTILE_ERROR: f64 = 1.362_6;
type Key = (u32, Flank);

#[derive(Default)]
pub(super) struct JudgedFlanks {
    pub features: Vec<Feature>,
    pub verdicts: Vec<Verdict>,
    /// Mean deviation of every measured flank, requested or not.
    pub means: Vec<FlankMean>,
    /// Measured fraction of the heights of the requested flanks.
    pub height_ratio: f64,
}

/// Height above and below its middle that a view must cover of its middle tooth, mm.
fn reach_mm(gear: &GearData, view: &PlannedView, field_mm: f64) -> f64 {
    let radius_mm = 0.5 * field_mm;
    let off_rad = gear.tooth_centre_rad(view.tooth) + view.rotation_rad;
    let off_rad = off_rad - TAU * (off_rad / TAU).round();
    let half_rad =
        gear.half_tooth_rad(gear.pitch_radius_mm()).unwrap_or(0.0) + 0.25 * gear.pitch_rad();
    let across_mm = (off_rad.abs() + half_rad) * gear.pitch_radius_mm() + PUT_DOWN_MM;
    let squared = radius_mm * radius_mm - across_mm * across_mm;
    squared.max(0.0).sqrt().min(ASKED_PER_FIELD * field_mm)
}

/// Heights that a plan requires, tooth by tooth: around every view's middle. In a scan of all teeth they are joined where layers
/// are close to each other or to the end of the toothing.
fn asked(planned: &[PlannedView], gear: &GearData, field_mm: f64) -> BTreeMap<u32, Vec<[f64; 2]>> {
    let mut views: BTreeMap<u32, Vec<[f64; 2]>> = BTreeMap::new();
    for view in planned {
        let of = [view.vertical_mm, reach_mm(gear, view, field_mm)];
        views.entry(view.tooth).or_default().push(of);
    }
    let [bottom, top] = gear.height_mm;
    let all = views.len() >= gear.teeth as usize;
    let of_tooth = |(tooth, mut at): (u32, Vec<[f64; 2]>)| {
        at.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let mut zones: Vec<[f64; 2]> = Vec::new();
        for (i, &[middle, reach]) in at.iter().enumerate() {
            let reach = |to_edge_mm: f64| {
                if all && to_edge_mm <= ASKED_PER_FIELD * field_mm {
                    to_edge_mm
                } else {
                    reach
                }
            };
            let below = i.checked_sub(1).map(|j| 0.5 * (middle - at[j][0]));
            let above = at.get(i + 1).map(|next| 0.5 * (next[0] - middle));
            let low = middle - reach(below.unwrap_or(middle - bottom));
            let high = middle + reach(above.unwrap_or(top - middle));
            match zones.last_mut() {
                Some(last) if low - last[1] < 1e-6 => last[1] = last[1].max(high),
                _ => zones.push([low, high]),
            }
        }
        (tooth, zones)
    };
    views.into_iter().map(of_tooth).collect()
}

/// Fraction of the judged heights of the requested teeth.
fn height_ratio(asked: &BTreeMap<u32, Vec<[f64; 2]>>, [bottom, top]: [f64; 2]) -> f64 {
    let zones = asked.values().flatten();
    let judged: f64 = zones
        .map(|&[low, high]| (high.min(top) - low.max(bottom)).max(0.0))
        .sum();
    judged / ((top - bottom) * asked.len().max(1) as f64)
}

/// Scatter of the flanks' form errors about the median of each side, mm.
fn scatter_mm(flanks: &[SeenFlank]) -> f64 {
    let off = Flank::BOTH.into_iter().flat_map(|side| {
        let of_side = || flanks.iter().filter(move |flank| flank.flank == side);
        let middle = median_of(of_side().map(|flank| flank.median_mm)).unwrap_or(0.0);
        of_side().map(move |flank| (flank.median_mm - middle).abs())
    });
    SIGMA_PER_MAD * median_of(off).unwrap_or(0.0)
}

/// Evidence of all flanks on the rotation of the die, which is otherwise unknown; and the uncertainty of the form of a die with
/// this scatter, from this number of flanks, mm.
///
/// Each side counts by its lower quartile, raised to the expected median of a side without wear: damage of up to three quarters
/// of a side does not affect it, nor does adhering material on less than a quarter.
fn evidence(flanks: &[SeenFlank], scatter_mm: f64) -> (PoseEvidence, f64) {
    let mut fewest = f64::INFINITY;
    let sides = Flank::BOTH.into_iter().filter_map(|side| {
        let of_side = flanks.iter().filter(|flank| flank.flank == side);
        let mut mm: Vec<f64> = of_side.map(|flank| flank.median_mm).collect();
        mm.sort_by(f64::total_cmp);
        fewest = fewest.min(mm.len() as f64);
        Some(SeenFlank {
            tooth: None,
            flank: side,
            median_mm: mm.get(mm.len() / 4)? + QUARTILE_SIGMAS * scatter_mm,
            per_turn: side.sign(),
        })
    });
    let evidence = PoseEvidence {
        tooth: None,
        flanks: sides.collect(),
        stages_mm: 0.0,
        // A die on its table may be turned by any angle.
        approach_sigma_mm: ANY_POSE_MM,
        mount_sigma_mm: 0.0,
        stages_both_mm: 0.0,
        both_sigma_mm: f64::INFINITY,
        mount: None,
        same_mount: None,
    };
    (
        evidence,
        QUARTILE_ERROR * scatter_mm / fewest.max(1.0).sqrt(),
    )
}

/// Data and limits for judging the flanks of a scan.
struct Judging<'a> {
    gear: &'a GearData,
    tool: &'a Tool,
    planned: &'a [PlannedView],
    store: &'a Store,
    nominal: &'a Stages,
    single: Local,
    field_mm: f64,
    /// Standard uncertainty of a flank's deviation due to the head's calibration, mm.
    calibration_mm: f64,
}

impl Scanner {
    /// Wear and verdict of every requested flank, and of others with damage.
    pub(super) fn features(&self, stitched: &Stitched) -> Result<JudgedFlanks, ScanError> {
        let subject = &self.job.subject;
        let judging = Judging {
            gear: &self.gear,
            tool: &subject.tool,
            planned: &self.job.plan.views,
            store: &self.store,
            nominal: &self.nominal,
            single: subject.station.stages.of_single_view(),
            field_mm: self.field.width_mm,
            calibration_mm: 1e-3 * calibration_um(&subject.tool, &subject.head),
        };
        judging.flanks(stitched)
    }
}

impl Judging<'_> {
    /// Wear and verdict of every requested flank, and of others with damage.
    fn flanks(&self, stitched: &Stitched) -> Result<JudgedFlanks, ScanError> {
        let (tool, planned) = (self.tool, self.planned);
        let asked = asked(planned, self.gear, self.field_mm);
        let Some((limits, zone)) = tool.limits().zip(tool.zone()) else {
            let why = "[inspect] is missing in the tool file: there are no limits to judge by";
            let why = Reason::instrument(Code::NoLimits, why);
            let none = |&tooth: &u32| Flank::BOTH.map(|f| unmeasured_flank(tooth, f, tool, &why));
            let judged = asked.keys().flat_map(none).collect::<Vec<_>>();
            return Ok(JudgedFlanks {
                verdicts: judged.iter().map(|of| of.verdict().clone()).collect(),
                features: judged.into_iter().map(Feature::from).collect(),
                ..JudgedFlanks::default()
            });
        };
        let settings = WearSettings {
            calibration_mm: self.calibration_mm,
            ..tool.wear_settings()
        };
        let end_mm = END_PER_MODULE * self.gear.module_mm;
        let [bottom, top] = self.gear.height_mm;
        let judged_mm = [bottom + end_mm, top - end_mm];
        let held = self.held(stitched, &zone)?;
        let zones = self.zones(&asked, zone.radius_mm, judged_mm);
        let measured = self.measured(stitched, &zones, &held, &settings)?;
        let is_asked = |wear: &FlankWear| asked.contains_key(&wear.tooth);
        let seen: Vec<SeenFlank> = measured
            .iter()
            .filter(|(_, wear)| is_asked(wear) && wear.coverage >= limits.least_coverage)
            .filter_map(|(_, wear)| {
                Some(SeenFlank {
                    tooth: Some(wear.tooth),
                    flank: wear.flank,
                    median_mm: median_of(wear.field.wear_mm.iter().copied())?,
                    per_turn: wear.flank.sign(),
                })
            })
            .collect();
        let (evidence, form_scatter_mm) = evidence(&seen, scatter_mm(&seen));
        let evidence = Arc::new(evidence);
        let sensitivity = ScanSensitivity {
            gear: self.gear,
            held: &held,
            evidence: &evidence,
            form_scatter_mm,
            expansion: tool.temperature.map(|of| of.expansion()),
        };
        let judged = measured.into_par_iter().map(|(zone, wear)| {
            let wear = match sensitivity.on((wear.tooth, wear.flank), &zone) {
                Some(sensitivity) => wear.with(sensitivity, &settings),
                None => wear,
            };
            judge(wear, &zone, &limits)
        });
        let judged: Vec<OfZone> = judged.collect();
        Ok(JudgedFlanks {
            height_ratio: height_ratio(&asked, judged_mm),
            ..of_flanks(&judged, |tooth| asked.contains_key(&tooth))
        })
    }

    /// The zones of the requested flanks, and of any other that a view shows, within the judged heights.
    fn zones(
        &self,
        asked: &BTreeMap<u32, Vec<[f64; 2]>>,
        radius_mm: [f64; 2],
        [bottom, top]: [f64; 2],
    ) -> Vec<(Key, Zone)> {
        let mut everywhere: Vec<[f64; 2]> = asked.values().flatten().copied().collect();
        everywhere.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
        everywhere.dedup();
        let asked_for = |&tooth: &u32| Flank::BOTH.map(|flank| (tooth, flank));
        let mut keys: BTreeSet<Key> = self.store.patches.flanks().collect();
        keys.extend(asked.keys().flat_map(asked_for));
        let zone_of = |[low, high]: [f64; 2]| Zone {
            radius_mm,
            height_mm: [low.max(bottom), high.min(top)],
        };
        keys.into_iter()
            .flat_map(|key| {
                let heights = asked.get(&key.0).unwrap_or(&everywhere);
                heights.iter().map(move |height| (key, zone_of(*height)))
            })
            .collect()
    }

    /// Wear of zones from all views that show them.
    fn measured(
        &self,
        stitched: &Stitched,
        zones: &[(Key, Zone)],
        held: &[HeldView],
        settings: &WearSettings,
    ) -> Result<Vec<(Zone, FlankWear)>, SessionError> {
        let poses = &stitched.adjustment.poses;
        let views = stitched.views.iter().zip(poses);
        let views: Vec<(usize, &CameraPose)> =
            views.map(|((view, _), pose)| (*view, pose)).collect();
        let steps = [stitched.steps.around, stitched.steps.up];
        // The step between two views is shared equally between them.
        let steps_mm = steps
            .into_iter()
            .flatten()
            .map(|step| 1e-3 * step.after_um / 2f64.sqrt())
            .fold(0.0, f64::max);
        zones
            .par_iter()
            .map(|&(key, zone)| {
                let mut all = Gathered::new(self.gear, zone, key, settings);
                for &(view, pose) in &views {
                    let Some((seen, motion)) = self.store.patches.flank(view, key, pose)? else {
                        continue;
                    };
                    let back = pose.inverse();
                    all.add(&seen, &motion, |foot| {
                        stitched.quality.variance_mm2(back.apply(foot))
                    });
                }
                let registration_mm = registration_mm(held, key, &zone, steps_mm);
                Ok((zone, all.wear(registration_mm, settings)))
            })
            .collect()
    }

    /// Effect of the views' poses on the flanks that they must cover.
    fn held(&self, stitched: &Stitched, zone: &Zone) -> Result<Vec<HeldView>, ScanError> {
        let nominal = Solution::prior(self.nominal.clone(), self.single);
        let views: Vec<_> = stitched
            .views
            .iter()
            .zip(&stitched.adjustment.poses)
            .collect();
        let held: Result<Vec<Option<HeldView>>, SessionError> = views
            .into_par_iter()
            .map(|((view, info), pose)| {
                let sample = coordinates(&self.store.session.sample(*view, SAMPLE)?, SAMPLE);
                let planned = &self.planned[*view];
                let covariance = stitched.adjustment.pose_covariance(info);
                let prior = nominal.predict(info.at);
                let reach_mm = ASKED_PER_FIELD * self.field_mm;
                let of_covariance = |covariance: Matrix6<f64>| {
                    ScanView {
                        gear: self.gear,
                        surface: &self.tool.surface,
                        tooth: planned.tooth,
                        vertical_mm: planned.vertical_mm,
                        zone: Zone {
                            radius_mm: zone.radius_mm,
                            height_mm: [-reach_mm, reach_mm].map(|mm| planned.vertical_mm + mm),
                        },
                        sample: &sample,
                        tool_from_camera: *pose,
                        centre_mm: info.centre_mm,
                        prior: &prior,
                        covariance: &covariance,
                    }
                    .held()
                };
                Ok(covariance.map(of_covariance))
            })
            .collect();
        Ok(held?.into_iter().flatten().collect())
    }
}

/// One zone of a flank with its verdict.
struct OfZone {
    key: Key,
    /// Mean loss; `None` if no disc could be measured, or the rotation of the die is not known.
    mean_mm: Option<f64>,
    /// Measured area, in cells.
    cells: usize,
    all_cells: usize,
    judged: Judged,
}

fn judge(wear: FlankWear, zone: &Zone, limits: &FlankLimits) -> OfZone {
    OfZone {
        key: (wear.tooth, wear.flank),
        mean_mm: wear
            .judged
            .map(|judged| judged.mean_mm.value)
            .filter(|mm| mm.is_finite()),
        cells: wear.field.measured().count(),
        all_cells: wear.field.wear_mm.len(),
        judged: Judged::of_wear(&wear, wear.wear_mm(), limits).over(zone.height_mm),
    }
}

/// Combines zones to flanks: the zone that decides the verdict represents a flank with several zones.
fn of_flanks(zones: &[OfZone], is_asked: impl Fn(u32) -> bool) -> JudgedFlanks {
    let mut all = JudgedFlanks::default();
    for of_flank in zones.chunk_by(|a, b| a.key == b.key) {
        let [cells, all_cells] = [|z: &OfZone| z.cells, |z: &OfZone| z.all_cells]
            .map(|count| of_flank.iter().map(count).sum::<usize>() as f64);
        let key @ (tooth, flank) = of_flank[0].key;
        let share = cells / all_cells.max(1.0);
        let seen = share >= LEAST_SEEN;
        if !is_asked(tooth) && !seen {
            continue;
        }
        let measured = || {
            let of_zones = of_flank.iter();
            of_zones.filter_map(|z| Some((z.cells as f64, z.mean_mm?)))
        };
        let mean_mm = measured()
            .map(|(cells, mean_mm)| cells * mean_mm)
            .sum::<f64>()
            / measured().map(|(cells, _)| cells).sum::<f64>();
        if mean_mm.is_finite() {
            all.means.push(FlankMean {
                tooth,
                flank,
                deviation_um: -1e3 * mean_mm,
            });
        }
        let worst = of_flank.iter().max_by(|a, b| {
            let rank = |z: &OfZone| z.judged.verdict().word();
            let wear = |z: &OfZone| z.judged.wear_um().unwrap_or(f64::NEG_INFINITY);
            rank(a).cmp(&rank(b)).then(wear(a).total_cmp(&wear(b)))
        });
        let Some(worst) = worst else { continue };
        // It was not requested: missing parts do not matter, damage does.
        let shows = matches!(worst.judged.verdict().word(), Word::NoGo | Word::Warn);
        if !is_asked(key.0) && !shows {
            continue;
        }
        all.verdicts.push(worst.judged.verdict().clone());
        let mut feature = Feature::from(worst.judged.clone());
        feature.coverage_ratio = share;
        feature.mean_um = mean_mm.is_finite().then_some(1e3 * mean_mm);
        all.features.push(feature);
    }
    all
}

#[cfg(test)]
mod tests {
    use super::super::coverage::tests::gear;
    use super::*;

    /// Heights of tooth 7 if a scan of some teeth also covers this distance beside each.
    fn zones(teeth: u32, layers: u32, beside_pitches: f64) -> Vec<[f64; 2]> {
        let gear = gear();
        let mut plan = Vec::new();
        for layer in 0..layers {
            plan.extend((7..7 + teeth).map(|tooth| PlannedView {
                tooth,
                rotation_rad: beside_pitches * gear.pitch_rad() - gear.tooth_centre_rad(tooth),
                vertical_mm: 66.0 * (f64::from(layer) + 0.5) / f64::from(layers),
            }));
        }
        asked(&plan, &gear, 10.0)[&7].clone()
    }

    #[test]
    fn near_layers_of_all_teeth_are_asked_for_whole_flanks_and_others_for_their_fields() {
        let whole = zones(84, 9, 0.0);
        assert_eq!(whole.len(), 1);
        assert!(whole[0][0].abs() < 1e-9 && (whole[0][1] - 66.0).abs() < 1e-9);
        assert_eq!(zones(12, 8, 0.0).len(), 8);
        // Layers 9.43 mm apart: seven bands of 8 mm, 56 of 66 mm.
        let bands = zones(84, 7, 0.0);
        assert_eq!(bands.len(), 7);
        let share = height_ratio(&BTreeMap::from([(7, bands)]), [0.0, 66.0]);
        assert!((share - 56.0 / 66.0).abs() < 1e-9, "{share}");
        assert_eq!(zones(84, 2, 0.0), [[12.5, 20.5], [45.5, 53.5]]);
        assert_eq!(zones(12, 2, 0.0), [[12.5, 20.5], [45.5, 53.5]]);
        // Beside its middle, the round field shows less height.
        let [low, high] = zones(12, 1, 0.5)[0];
        assert!((4.0..7.0).contains(&(high - low)), "{low} {high}");
    }

    fn flank(tooth: u32, flank: Flank, median_mm: f64) -> SeenFlank {
        SeenFlank {
            tooth: Some(tooth),
            flank,
            median_mm,
            per_turn: flank.sign(),
        }
    }

    /// Rotation if all left and all right flanks have these values, each with a scatter of 3 µm.
    fn turn_um(left_um: f64, right_um: f64, proud_um: f64) -> [f64; 2] {
        let own = |tooth: u32| if tooth.is_multiple_of(2) { 2e-3 } else { -2e-3 };
        let mut flanks: Vec<SeenFlank> = (1..=84)
            .flat_map(|tooth| {
                [
                    flank(tooth, Flank::Left, 1e-3 * left_um + own(tooth)),
                    flank(tooth, Flank::Right, 1e-3 * right_um + own(tooth / 2)),
                ]
            })
            .collect();
        flanks[20].median_mm -= 1e-3 * proud_um;
        let (evidence, form_mm) = evidence(&flanks, scatter_mm(&flanks));
        let turn = evidence.turn(None, 2e-3_f64.hypot(form_mm), 2e-3);
        [turn.mean_mm, turn.u_mm].map(|mm| 1e3 * mm)
    }

    #[test]
    fn sound_flanks_pin_the_turn_and_one_sided_wear_of_all_leaves_it_open() {
        let [mean, u] = turn_um(0.0, 0.0, 0.0);
        assert!(mean.abs() < 1.0 && u < 3.0, "{mean} {u}");
        // Adhering material on one flank has no effect.
        let [mean, u] = turn_um(0.0, 0.0, 80.0);
        assert!(mean.abs() < 1.0 && u < 3.0, "{mean} {u}");
        // 55 µm off one side of all teeth, divided between both sides by the rotation: how much either side has lost or gained is unknown.
        let [mean, u] = turn_um(27.5, 27.5, 0.0);
        assert!(mean.abs() < 2.0, "{mean}");
        assert!(1.96 * u > 55.0, "{u}");
    }
}
