//! All views of a check to what is said of the tool: the same for a check that runs and for one that is computed again.

use std::collections::BTreeMap;

use flankscope_metrology::tool::Tool;
use flankscope_metrology::verdict::{Code, Reason, Word};
use flankscope_metrology::wear::PoseEvidence;

use super::evidence::{Evidence, Phasors};
use super::outcome::ViewOutcome;
use super::plan::ViewPlan;
use super::result::{Feature, FlankMap, ViewRegistration};
use super::verdict::{self, Judged};
use crate::baseline::Reference;

/// What a check found.
#[derive(Debug)]
pub(crate) struct Findings {
    pub verdict: Word,
    pub reason: String,
    pub features: Vec<Feature>,
    pub registration: Vec<ViewRegistration>,
    pub evidence: Vec<Evidence>,
    pub phasors: Vec<Phasors>,
    pub fields: Vec<Reference>,
    pub poses: Vec<PoseEvidence>,
    pub maps: Vec<FlankMap>,
    pub deviations_um: Vec<f64>,
}

impl Findings {
    /// Joins the outcomes of the views. A view without one has its reason among `problems`, or shares that for which the
    /// check `stopped`.
    pub fn of(
        tool: &Tool,
        plan: &ViewPlan,
        mut outcomes: BTreeMap<usize, ViewOutcome>,
        problems: &BTreeMap<usize, Reason>,
        stopped: Option<&Reason>,
        since_baseline: bool,
    ) -> Self {
        let cad_taken_as_true = tool.as_built_um.is_none() && !since_baseline;
        let mut judged: Vec<Judged> = Vec::new();
        let mut registration = Vec::new();
        let mut evidence = Vec::new();
        let mut phasors = Vec::new();
        let mut fields = Vec::new();
        let mut poses = Vec::new();
        let mut maps = Vec::new();
        let mut deviations_um = Vec::new();
        for (view, &super::PlannedView { tooth, .. }) in plan.views.iter().enumerate() {
            if let Some(outcome) = outcomes.remove(&view) {
                let hashes = outcome.phasors.iter().map(|p| p.blake3.clone());
                evidence.push(Evidence {
                    tooth,
                    phasors: hashes.collect(),
                    problem: None,
                });
                judged.extend(outcome.flanks);
                registration.extend(outcome.registration);
                phasors.extend(outcome.phasors);
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
                    problem: Some(why.into()),
                });
            }
        }
        let (verdict, reason) = verdict::of_tool(&judged, stopped, cad_taken_as_true);
        Self {
            verdict,
            reason,
            features: judged.into_iter().map(Feature::from).collect(),
            registration,
            evidence,
            phasors,
            fields,
            poses,
            maps,
            deviations_um,
        }
    }
}
