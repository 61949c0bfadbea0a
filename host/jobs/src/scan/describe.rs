//! Writes the document of the stitched views: registration, flanks, coverage, form, verdict.

use std::collections::BTreeMap;
use std::time::Instant;

use flankscope_foundation::date;
use flankscope_metrology::gear::GearData;
use flankscope_metrology::multiview::adjustment::{Solution, ViewInformation};
use flankscope_metrology::multiview::cylinder::CylinderMap;
use flankscope_metrology::multiview::spacing::opposite;
use flankscope_metrology::verdict::{Reason, Verdict, Word, combine};

use super::coverage::{LEAST_COVERAGE, coverage};
use super::flanks::JudgedFlanks;
use super::job::{ScanError, Scanner};
use super::stitch::Stitched;
use crate::inspection::calibration_um;
use flankscope_metrology::multiview::form::Form;
use flankscope_metrology::view::PlannedView;
use flankscope_record::document::scan::{
    Adjustment, Coverage, FlankSeen, OppositeTeeth, Scan, ScanRegistration, StageErrors, Stitching,
};
use flankscope_record::document::{Feature, FrameCount, Timing, Toothing, ViewStatus};

/// Smallest fraction of registered views that describes the die.
const LEAST_REGISTERED: f64 = 0.8;
/// Largest number of flanks that a reason lists.
const MOST_NAMED: usize = 5;

impl Scanner {
    /// The document of stitched views; `lost` gives the reasons of lost views.
    pub(super) fn describe(
        &self,
        mut stitched: Stitched,
        lost: &BTreeMap<usize, Reason>,
    ) -> Result<Scan, ScanError> {
        let begun = Instant::now();
        let judged = self.features(&stitched)?;
        let took_ms = begun.elapsed().as_secs_f64() * 1e3;
        stitched.elapsed_ms.insert("wear", took_ms);
        let mut lost = lost.clone();
        lost.extend(std::mem::take(&mut stitched.refused));
        let (tool, planned) = (&self.job.subject.tool, &self.job.plan.views);
        let zone = tool.zone();
        let radius_mm = zone.map_or_else(|| self.gear.active_flank_mm(), |zone| zone.radius_mm);
        let map = &stitched.map;
        let asked = (self.field.width_mm, LEAST_COVERAGE);
        let coverage = coverage(map, &self.gear, radius_mm, planned, asked);
        let views = ViewCount {
            registered: stitched.views.len(),
            planned: planned.len(),
            first_lost: lost.values().next(),
            unsettled_after: (!stitched.settled).then_some(stitched.rounds),
        };
        let JudgedFlanks {
            features,
            verdicts,
            means,
            height_ratio,
        } = judged;
        let looked_at = coverage.looked_at(height_ratio, map.coverage());
        let (verdict, reason) = of_scan(verdicts, &features, &coverage, &looked_at, &views);
        let [low, high] = self.gear.height_mm;
        let form = map
            .form()
            .filter(|_| views.enough())
            .map(|form| Form::with_sigma(form, stitched.adjustment.form_sigma_mm(high - low)));
        let mut versions = BTreeMap::new();
        versions.insert("host", env!("CARGO_PKG_VERSION").to_string());
        versions.insert(
            "protocol",
            flankscope_protocol::PROTOCOL_VERSION.to_string(),
        );
        Ok(Scan {
            origin: self.job.subject.origin(&self.job.setting),
            date: date::now(),
            verdict,
            reason,
            features,
            flank_means: means.into_iter().map(FlankSeen::from).collect(),
            form,
            spacing: self.spacing(map, &stitched.views, &stitched.adjustment),
            timing_ms: Timing::default(),
            last_view_to_result_ms: 0.0,
            frames: FrameCount::default(),
            peak_memory_mb: None,
            views: self.views.clone(),
            resumed_views: self.resumed,
            coverage_ratio: map.coverage(),
            coverage,
            inconsistent_ratio: map.inconsistent(),
            registration: registrations(planned, &stitched, &lost),
            adjustment: Some(shared_by_all(&stitched, &self.gear)),
            stitching: Stitching {
                relaid_views: stitched.relaid,
                elapsed_ms: stitched.elapsed_ms,
            },
            placement: None,
            methods: Vec::new(),
            size_sigma_mm: None,
            teeth_stretch_ratio: None,
            teeth_turned_deg: 0.0,
            metrics: None,
            gear: None,
            truth: None,
            seal: None,
            tool: tool.name.clone(),
            versions,
            hashes: self.job.subject.hashes.clone(),
            toothing: Toothing::of(&self.job.subject.tool),
            map: stitched.map,
            quality: stitched.quality,
        })
    }

    /// Distances of teeth across the bore, where both were measured.
    fn spacing(
        &self,
        map: &CylinderMap,
        views: &[(usize, ViewInformation)],
        adjustment: &Solution,
    ) -> Vec<OppositeTeeth> {
        let calibration_mm = 1e-3 * calibration_um(&self.job.subject.tool, &self.job.subject.head);
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
                let views_mm = adjustment.distance_sigma_mm([here?, there?]);
                Some(OppositeTeeth::new(of, views_mm, calibration_mm))
            })
            .collect()
    }
}

/// Number of planned views that were registered to the CAD, and the quality of the solution.
struct ViewCount<'a> {
    registered: usize,
    planned: usize,
    first_lost: Option<&'a Reason>,
    /// Number of rounds after which they had not converged.
    unsettled_after: Option<usize>,
}

impl ViewCount<'_> {
    fn enough(&self) -> bool {
        self.registered as f64 / self.planned as f64 >= LEAST_REGISTERED
    }
}

/// The verdict of a scan and one sentence about it with its scope. Without enough converged views nothing is judged, not even a no-go.
fn of_scan(
    verdicts: Vec<Verdict>,
    features: &[Feature],
    coverage: &Coverage,
    looked_at: &str,
    views: &ViewCount<'_>,
) -> (Word, String) {
    if !views.enough() {
        let why = format!(
            "only {} of {} views could be laid on the CAD, at least {:.0} % are needed: a die with other teeth than the \
             CAD's, or one put down turned, looks like this; the first lost one: {}",
            views.registered,
            views.planned,
            100.0 * LEAST_REGISTERED,
            views.first_lost.map_or_else(String::new, Reason::to_string),
        );
        return (Word::Indeterminate, why);
    }
    if let Some(rounds) = views.unsettled_after {
        let why = format!("the views still moved against each other after {rounds} rounds");
        return (Word::Indeterminate, why);
    }
    let verdict = combine(verdicts).word();
    let found = if verdict == Word::Go {
        format!(
            "go for {looked_at} looked at: every flank that was asked for is within the warning limit"
        )
    } else {
        let named: Vec<String> = features
            .iter()
            .filter(|f| f.verdict == verdict)
            .take(MOST_NAMED)
            .map(|f| f.id.to_string())
            .collect();
        format!("{verdict}: {}; {looked_at} looked at", named.join(", "))
    };
    let Some(unseen) = coverage.objection() else {
        return (verdict, found);
    };
    let reason = match verdict {
        Word::NoGo => format!("{found}; {unseen}"),
        Word::Go => {
            format!("less was seen than was asked for: {unseen}; {looked_at} looked at")
        }
        Word::Warn | Word::Indeterminate => {
            format!("less was seen than was asked for: {unseen}; what was seen is {found}")
        }
    };
    (verdict.withheld(), reason)
}

/// Registration of every planned view, or why it was lost.
fn registrations(
    planned: &[PlannedView],
    stitched: &Stitched,
    lost: &BTreeMap<usize, Reason>,
) -> Vec<ScanRegistration> {
    let adjustment = &stitched.adjustment;
    let laid: BTreeMap<usize, _> = stitched
        .views
        .iter()
        .zip(adjustment.pose_residuals.iter().zip(&adjustment.poses))
        .zip(&stitched.rms_about_form_mm)
        .map(|(((view, info), (residual, pose)), about_form)| {
            (*view, (info.rms_mm, residual, pose, about_form))
        })
        .collect();
    let of_view = |(view, at): (usize, &PlannedView)| {
        let found = laid.get(&view);
        ScanRegistration {
            view,
            rotation_deg: at.rotation_rad.to_degrees(),
            vertical_mm: at.vertical_mm,
            status: if found.is_some() {
                ViewStatus::Registered
            } else {
                ViewStatus::Lost
            },
            reason: lost.get(&view).map(Reason::to_string),
            rms_um: found.map(|(rms_mm, ..)| rms_mm * 1e3),
            rms_about_form_um: found.and_then(|(.., mm)| mm.map(|mm| mm * 1e3)),
            residual_um: found.map(|(_, residual, ..)| residual.fixed_rows::<3>(3).norm() * 1e3),
            residual_turn_mdeg: found.map(|(_, residual, ..)| residual[2].to_degrees() * 1e3),
            tool_from_camera: found.map(|(_, _, pose, _)| pose.to_rows()),
        }
    };
    planned.iter().enumerate().map(of_view).collect()
}

/// Common parameters of all views: errors of die, head and stages.
fn shared_by_all(stitched: &Stitched, gear: &GearData) -> Adjustment {
    let adjustment = &stitched.adjustment;
    let stages = &adjustment.stages;
    let (turn, shift) = stages.head_error();
    Adjustment {
        rounds: stitched.rounds,
        settled: stitched.settled,
        condition: adjustment.condition,
        weak: adjustment
            .weak
            .iter()
            .map(|w| (w.name, w.prior_share))
            .collect(),
        steps: stitched.steps,
        found: StageErrors {
            eccentricity_mm: stages.eccentricity_mm(),
            axis_mm: gear.height_mm.map(|z| stages.axis_at_mm(z)),
            tilt_deg: stages.tilt_rad().to_degrees(),
            head_turn_deg: turn.map(f64::to_degrees),
            head_shift_mm: shift,
            vertical_lean_mrad: stages.vertical_lean_rad().map(|rad| rad * 1e3),
            harmonics_mdeg: stages
                .harmonics_rad()
                .map(|pair| pair.map(|rad| rad.to_degrees() * 1e3)),
            u95: adjustment.stage_sigma().into(),
        },
    }
}
