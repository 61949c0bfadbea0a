//! Combines all views of a check into findings; used by a live check and by a replay.

use std::collections::{BTreeMap, BTreeSet};

use flankscope_metrology::tool::Tool;
use flankscope_metrology::verdict::{Code, Reason, Word};
use flankscope_metrology::wear::PoseEvidence;
use flankscope_metrology::wear::standing::MissingTooth;

use flankscope_metrology::view::PlannedView;
use flankscope_record::document::{
    Evidence, Feature, FlankInView, FlankMap, FurtherEvidence, Phasors, ToothIdentity,
    ViewRegistration,
};

use super::in_view::Neighbourhood;
use super::outcome::ViewOutcome;
use super::verdict::{self, Judged};
use crate::plan::ViewPlan;
use flankscope_record::baseline::{Baseline, Reference, ViewReference};

/// Findings of a check.
#[derive(Debug)]
pub(crate) struct Findings {
    pub verdict: Word,
    pub reason: String,
    pub features: Vec<Feature>,
    pub in_view: Vec<FlankInView>,
    pub missing_teeth: Vec<MissingTooth>,
    pub tooth_identity: Option<ToothIdentity>,
    pub registration: Vec<ViewRegistration>,
    pub evidence: Vec<Evidence>,
    pub phasors: Vec<Phasors>,
    pub fields: Vec<Reference>,
    pub neighbours: Vec<ViewReference>,
    pub poses: Vec<PoseEvidence>,
    pub maps: Vec<FlankMap>,
    pub deviations_um: Vec<f64>,
}

impl Findings {
    /// Combines the outcomes of the views. A view without an outcome has its reason in `problems`, or else the reason for which
    /// the check `stopped`.
    pub fn of(
        tool: &Tool,
        plan: &ViewPlan,
        mut outcomes: BTreeMap<usize, ViewOutcome>,
        problems: &BTreeMap<usize, Reason>,
        stopped: Option<&Reason>,
        baseline: Option<&Baseline>,
    ) -> Self {
        let presumed = verdict::presumptions(tool, baseline.is_some());
        let asked: BTreeSet<u32> = plan.views.iter().map(|view| view.tooth).collect();
        let mut neighbourhood = Neighbourhood::default();
        let mut neighbours = Vec::new();
        let mut judged: Vec<Judged> = Vec::new();
        let mut registration = Vec::new();
        let mut evidence = Vec::new();
        let mut phasors = Vec::new();
        let mut fields = Vec::new();
        let mut poses = Vec::new();
        let mut maps = Vec::new();
        let mut deviations_um = Vec::new();
        for (view, &PlannedView { tooth, .. }) in plan.views.iter().enumerate() {
            if let Some(outcome) = outcomes.remove(&view) {
                let hashes = outcome.phasors.iter().map(|p| p.blake3.clone());
                let further = outcome.further.iter().flat_map(|of| {
                    let view = of.view;
                    let hashes = of.phasors.iter().map(|p| p.blake3.clone());
                    hashes.map(move |phasors| FurtherEvidence { view, phasors })
                });
                evidence.push(Evidence {
                    tooth,
                    phasors: hashes.collect(),
                    further: further.collect(),
                    problem: None,
                });
                judged.extend(outcome.flanks);
                neighbours.extend(outcome.in_view.recorded.clone());
                neighbourhood.add(outcome.in_view);
                registration.extend(outcome.registration);
                phasors.extend(outcome.phasors);
                for further in outcome.further {
                    registration.extend(further.registration);
                    phasors.extend(further.phasors);
                }
                fields.extend(outcome.fields);
                poses.extend(outcome.pose);
                maps.extend(outcome.maps);
                deviations_um.extend(outcome.deviations_um);
            } else {
                let nobody = Reason::instrument(Code::NotCaptured, "the view was not captured");
                let why = problems.get(&view).or(stopped).unwrap_or(&nobody);
                judged.extend(verdict::unmeasured(tooth, tool, why));
                evidence.push(Evidence {
                    tooth,
                    phasors: Vec::new(),
                    further: Vec::new(),
                    problem: Some(why.into()),
                });
            }
        }
        neighbourhood.sort();
        let tooth_identity = ToothIdentity::of(tool, baseline, &poses);
        let turned = tooth_identity
            .as_ref()
            .and_then(ToothIdentity::contradiction);
        if let Some(why) = &turned {
            judged.iter_mut().for_each(|flank| flank.withhold(why));
        }
        let stopped = stopped.or(turned.as_ref());
        let beside = neighbourhood.findings(&asked);
        let (verdict, reason) = verdict::of_tool(&judged, stopped, &presumed, &beside);
        Self {
            verdict,
            reason,
            features: judged.into_iter().map(Feature::from).collect(),
            in_view: neighbourhood.flanks,
            missing_teeth: neighbourhood.missing,
            tooth_identity,
            registration,
            evidence,
            phasors,
            fields,
            neighbours,
            poses,
            maps,
            deviations_um,
        }
    }
}
