//! What was stitched, to the document: registration, flanks, coverage, form, verdict.

use std::collections::BTreeMap;
use std::time::Instant;

use flankscope_metrology::multiview::adjustment::{Solution, ViewInformation};
use flankscope_metrology::multiview::cylinder::CylinderMap;
use flankscope_metrology::multiview::spacing::opposite;
use flankscope_metrology::space::frames::{Camera, Rigid, Tool as ToolFrame};
use flankscope_metrology::verdict::combine;

use super::coverage::{Coverage, LEAST_COVERAGE};
use super::flanks::JudgedFlanks;
use super::job::{ScanError, Scanner};
use super::result::{
    FlankSeen, Form, Joint, OppositeTeeth, Scan, ScanRegistration, StageErrors, Stitching,
};
use super::stitch::Stitched;
use crate::inspection::{FrameCount, Timing, calibration_um};
use crate::origin;

/// Fewer registered views than this share do not describe the die.
const LEAST_REGISTERED: f64 = 0.8;

impl Scanner {
    /// The document of what was stitched; `lost` says why views stayed lost.
    pub(super) fn describe(
        &self,
        stitched: Stitched,
        lost: &BTreeMap<usize, String>,
    ) -> Result<Scan, ScanError> {
        let begun = Instant::now();
        let JudgedFlanks {
            features,
            verdicts,
            means,
            height_ratio,
        } = self.features(&stitched)?;
        let took_ms = begun.elapsed().as_secs_f64() * 1e3;
        let Stitched {
            views,
            refused,
            joint,
            rounds,
            settled,
            steps,
            relaid,
            map,
            rms_about_form_mm,
            quality,
            mut elapsed_ms,
        } = stitched;
        elapsed_ms.insert("wear", took_ms);
        let mut lost = lost.clone();
        lost.extend(refused);
        let laid: BTreeMap<usize, _> = views
            .iter()
            .zip(joint.strays.iter().zip(&joint.poses))
            .map(|((view, info), (stray, pose))| (*view, (info.rms_mm, stray, pose)))
            .collect();
        let about_form: BTreeMap<usize, f64> = views
            .iter()
            .zip(&rms_about_form_mm)
            .filter_map(|((view, _), mm)| Some((*view, (*mm)?)))
            .collect();
        let planned = &self.station.itinerary.views;
        let registration = planned.iter().enumerate().map(|(view, at)| {
            let found = laid.get(&view);
            ScanRegistration {
                view,
                rotation_deg: at.rotation_rad.to_degrees(),
                vertical_mm: at.vertical_mm,
                status: if found.is_some() {
                    "registered"
                } else {
                    "lost"
                },
                reason: lost.get(&view).cloned(),
                rms_um: found.map(|(rms_mm, ..)| rms_mm * 1e3),
                rms_about_form_um: about_form.get(&view).map(|mm| mm * 1e3),
                stray_um: found.map(|(_, stray, _)| stray.fixed_rows::<3>(3).norm() * 1e3),
                stray_turn_mdeg: found.map(|(_, stray, _)| stray[2].to_degrees() * 1e3),
                tool_from_camera: found
                    .map(|(.., pose)| Rigid::<ToolFrame, Camera>::from_isometry(**pose).to_rows()),
            }
        });
        let registration: Vec<_> = registration.collect();
        let spacing = self.spacing(&map, &views, &joint);
        let mut verdict = combine(verdicts).to_string();
        let zone = self.station.subject.tool.zone();
        let radius_mm = zone.map_or_else(|| self.gear.active_flank_mm(), |zone| zone.radius_mm);
        let coverage = Coverage::of(&map, &self.gear, radius_mm, planned, LEAST_COVERAGE);
        // A verdict is for what was looked at, and says so.
        let looked_at = coverage.looked_at(height_ratio, map.coverage());
        let mut reason = match verdict.as_str() {
            "go" => format!(
                "go for {looked_at} looked at: every flank that was asked for is within the warning limit"
            ),
            other => {
                let named: Vec<String> = features
                    .iter()
                    .filter(|f| f.verdict == other)
                    .take(5)
                    .map(|f| format!("tooth {} {}", f.tooth, f.flank))
                    .collect();
                format!("{other}: {}; {looked_at} looked at", named.join(", "))
            }
        };
        match coverage.objection() {
            // What is missing takes nothing from a wear that was found.
            Some(why) if verdict == "no-go" => reason += &format!("; {why}"),
            Some(why) if verdict == "go" => {
                (verdict, reason) = (
                    "indeterminate".into(),
                    format!("less was seen than was asked for: {why}; {looked_at} looked at"),
                );
            }
            Some(why) => {
                verdict = "indeterminate".into();
                reason =
                    format!("less was seen than was asked for: {why}; what was seen is {reason}");
            }
            None => {}
        }
        let registered = laid.len() as f64 / planned.len() as f64;
        if registered < LEAST_REGISTERED {
            verdict = "indeterminate".into();
            let first = lost.values().next().cloned().unwrap_or_default();
            reason = format!(
                "only {} of {} views could be laid on the CAD, at least {:.0} % are needed: a die with other teeth than the \
                 CAD's, or one put down turned, looks like this; the first lost one: {first}",
                laid.len(),
                planned.len(),
                100.0 * LEAST_REGISTERED
            );
        } else if !settled {
            verdict = "indeterminate".into();
            reason = format!("the views still moved against each other after {rounds} rounds");
        }
        let [low, high] = self.gear.height_mm;
        let form = map
            .form()
            .map(|form| Form::with_sigma(form, joint.form_sigma_mm(high - low)));
        let (turn, shift) = joint.stages.head_error();
        let mut versions = BTreeMap::new();
        versions.insert("host", env!("CARGO_PKG_VERSION").to_string());
        versions.insert(
            "protocol",
            flankscope_protocol::PROTOCOL_VERSION.to_string(),
        );
        Ok(Scan {
            origin: self.station.subject.origin(self.station.setting.as_ref()),
            date: origin::now(),
            verdict,
            reason,
            features,
            flank_means: means.into_iter().map(FlankSeen::from).collect(),
            form: form.filter(|_| registered >= LEAST_REGISTERED),
            spacing,
            timing_ms: Timing::default(),
            last_view_to_result_ms: 0.0,
            frames: FrameCount::default(),
            peak_memory_mb: None,
            views: self.grid.to_string(),
            resumed_views: self.resumed,
            coverage_ratio: map.coverage(),
            coverage,
            inconsistent_ratio: map.inconsistent(),
            registration,
            stitching: Stitching {
                relaid_views: relaid,
                elapsed_ms,
            },
            joint: Joint {
                rounds,
                settled,
                condition: joint.condition,
                weak: joint.weak.iter().map(|w| (w.name, w.prior_share)).collect(),
                steps,
                found: StageErrors {
                    eccentricity_mm: joint.stages.eccentricity_mm(),
                    axis_mm: self.gear.height_mm.map(|z| joint.stages.axis_at_mm(z)),
                    tilt_deg: joint.stages.tilt_rad().to_degrees(),
                    head_turn_deg: turn.map(f64::to_degrees),
                    head_shift_mm: shift,
                    vertical_lean_mrad: joint.stages.vertical_lean_rad().map(|rad| rad * 1e3),
                    harmonics_mdeg: joint
                        .stages
                        .harmonics_rad()
                        .map(|pair| pair.map(|rad| rad.to_degrees() * 1e3)),
                },
            },
            placement: None,
            methods: Vec::new(),
            teeth_stretch_ratio: None,
            teeth_turned_deg: 0.0,
            metrics: None,
            tool: self.station.subject.tool.name.clone(),
            versions,
            hashes: self.station.subject.hashes.clone(),
            map,
            quality,
        })
    }

    /// Distances of teeth across the bore, where both were seen.
    fn spacing(
        &self,
        map: &CylinderMap,
        views: &[(usize, ViewInformation)],
        joint: &Solution,
    ) -> Vec<OppositeTeeth> {
        let subject = &self.station.subject;
        let calibration_mm = 1e-3 * calibration_um(&subject.tool, &subject.head);
        let nearest = |tooth: u32| {
            let (sin, cos) = self.gear.tooth_centre_rad(tooth).sin_cos();
            let along = |view: &ViewInformation| view.centre_mm[0] * cos + view.centre_mm[1] * sin;
            let views = views.iter().map(|(_, view)| view);
            views.max_by(|a, b| along(a).total_cmp(&along(b)))
        };
        opposite(&self.gear, map.cells())
            .into_iter()
            .filter_map(|of| {
                let [here, there] = of.teeth.map(nearest);
                let views_mm = joint.distance_sigma_mm([here?, there?]);
                Some(OppositeTeeth::new(of, views_mm, calibration_mm))
            })
            .collect()
    }
}
