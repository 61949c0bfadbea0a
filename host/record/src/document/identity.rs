//! How the teeth were numbered: to the CAD all teeth look alike.

use flankscope_metrology::gear::GearData;
use flankscope_metrology::multiview::seen_before::{self, Seen};
use flankscope_metrology::tool::Tool;
use flankscope_metrology::verdict::{Code, Reason};
use flankscope_metrology::wear::PoseEvidence;
use serde::Serialize;

use crate::baseline::Baseline;

/// Source of the numbering of the teeth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum IdentifiedBy {
    /// The shapes of the flanks in view agree with those in the baseline.
    Baseline,
    /// The operator who placed the die and named the teeth.
    Operator,
}

/// How the teeth were numbered.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ToothIdentity {
    /// Source of the numbering.
    pub by: IdentifiedBy,
    /// In one sentence.
    pub reason: String,
    /// `turned_die` if the shapes contradict the operator.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub code: Option<Code>,
}

impl ToothIdentity {
    /// Numbering of the teeth in a check with this evidence; `None` if the tool has no teeth.
    pub fn of(tool: &Tool, baseline: Option<&Baseline>, views: &[PoseEvidence]) -> Option<Self> {
        let gear = tool.gear.as_ref()?;
        let by_operator = |why: &str| Self {
            by: IdentifiedBy::Operator,
            reason: format!("the teeth are numbered as the operator put the die down: {why}"),
            code: None,
        };
        let Some(baseline) = baseline else {
            return Some(by_operator("no baseline is there to compare with"));
        };
        Some(match told(gear, tool, baseline, views) {
            Seen::Same => Self {
                by: IdentifiedBy::Baseline,
                reason: "the forms of the flanks in view are those that the baseline recorded of these teeth".into(),
                code: None,
            },
            Seen::Turned(teeth) => Self {
                by: IdentifiedBy::Baseline,
                reason: turned(teeth),
                code: Some(Code::TurnedDie),
            },
            Seen::NotTold => by_operator(
                "the forms of the flanks in view neither confirm nor contradict the baseline's",
            ),
        })
    }

    /// Why the teeth are not the requested ones, if so.
    pub fn contradiction(&self) -> Option<Reason> {
        self.code.map(|code| Reason::instrument(code, &self.reason))
    }
}

fn told(gear: &GearData, tool: &Tool, baseline: &Baseline, views: &[PoseEvidence]) -> Seen {
    let settings = tool.wear_settings();
    // Two captures by one head: at another place of the field, its calibration does not cancel.
    let same_mm = settings.drift_mm * 2f64.sqrt();
    let sigma_mm = [same_mm, same_mm.hypot(settings.calibration_mm)];
    seen_before::compare(gear.teeth, &baseline.poses, views, sigma_mm)
}

fn turned(teeth: i64) -> String {
    let count = teeth.unsigned_abs();
    let s = if count == 1 { "tooth" } else { "teeth" };
    let way = if teeth > 0 { "higher" } else { "lower" };
    format!(
        "these are other teeth than asked for: the flanks in view have the forms that the baseline recorded of the teeth numbered \
         {count} {s} {way}; the die was put down turned"
    )
}
