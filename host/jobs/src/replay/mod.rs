//! Computes a stored verdict again from its phasors and lists every difference.
//!
//! | file | holds |
//! |---|---|
//! | `comparison` | what changed between two stored checks |

mod comparison;

use std::collections::BTreeMap;
use std::sync::Arc;

use flankscope_metrology::verdict::{Code, Reason, Word};
use flankscope_profilometry::decode::GridKind;
use flankscope_profilometry::{DecodeError, PhasorsError};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

pub use comparison::compare_checks;

use crate::inspection::{Evaluator, EvaluatorError, Findings, ViewOutcome, recipe};
use crate::plan::{PlanningError, ViewPlan};
use crate::subject::Subject;
use flankscope_record::baseline::Baseline;
use flankscope_record::document::{Evidence, FurtherEvidence, Recipe};
use flankscope_record::history::{Difference, History, HistoryError, row_differences};

/// Why a check cannot be computed again.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// Its row, document, phasors or baseline are missing, or differ from what was stored.
    #[error(transparent)]
    History(#[from] HistoryError),
    /// The two checks to be compared were made with other files.
    #[error(
        "checks {} and {} were made with other {what} files (BLAKE3 {}, {}), so that their difference is not the die's; compare checks \
         between which tool, CAD and head file stayed as they are", checks[0], checks[1], hashes[0], hashes[1]
    )]
    OtherFiles {
        /// Numbers of the checks.
        checks: [i64; 2],
        /// Which file.
        what: &'static str,
        /// Its hash in either check.
        hashes: [String; 2],
    },
    /// A file at hand is not the one that the check was made with.
    #[error(
        "check {id} was made with another {what} file (BLAKE3 {stored}) than the one given ({given}): name that check's files by --tool and \
         --head"
    )]
    NotItsFile {
        /// Number of the check.
        id: i64,
        /// Which file.
        what: &'static str,
        /// Hash of the check's file.
        stored: String,
        /// Hash of the given file.
        given: String,
    },
    /// The baseline is not the stored one.
    #[error("the baseline {expected} of check {id} is not in the history, or damaged")]
    Baseline {
        /// Number of the check.
        id: i64,
        /// Its BLAKE3.
        expected: String,
    },
    /// The phasors do not fit head and patterns.
    #[error("phasors {blake3} of tooth {tooth}: {source}")]
    Phasors {
        /// Hash of the phasors.
        blake3: String,
        /// Tooth of the view.
        tooth: u32,
        /// Cause.
        source: PhasorsError,
    },
    #[error("the evidence of tooth {tooth} names view {view}; the plan has {views}")]
    NoSuchView {
        tooth: u32,
        /// Its number, from 0.
        view: usize,
        /// Views of the plan, further ones included.
        views: usize,
    },
    /// No plan of views follows from this tool and head.
    #[error(transparent)]
    Planning(#[from] PlanningError),
    /// The head model cannot decode.
    #[error(transparent)]
    Decode(#[from] DecodeError),
    /// The tool or head lacks data for the evaluation.
    #[error(transparent)]
    Evaluator(#[from] EvaluatorError),
}

/// Result of a replay.
#[derive(Clone, Debug, Serialize)]
pub struct Replay {
    /// Its number.
    pub id: i64,
    /// Origin of the check, by its document.
    #[serde(flatten)]
    pub origin: BTreeMap<&'static str, Value>,
    pub stored_verdict: Word,
    /// The verdict as computed now.
    pub verdict: Word,
    pub reason: String,
    /// Captures that it was computed from.
    pub captures: usize,
    /// Software versions that differ from those of the check; they may explain a difference, but do not count as one.
    pub versions: Vec<Difference>,
    /// All differences; empty if every value is equal to the last bit.
    pub differences: Vec<Difference>,
}

/// Keys of a document that state the origin of its check.
const ORIGIN: [&str; 8] = [
    "link",
    "simulated",
    "recording",
    "head",
    "tool",
    "station",
    "operator",
    "date",
];

/// Entries of the stored document that a replay reads.
#[derive(Deserialize)]
struct Stored {
    verdict: Word,
    recipe: Recipe,
    evidence: Vec<Evidence>,
    stopped: Option<String>,
    stopped_code: Option<Code>,
    hashes: BTreeMap<String, String>,
    date: String,
    press_cycles: i64,
    link: String,
    simulated: bool,
    station: String,
}

impl Stored {
    fn read(history: &History, id: i64) -> Result<(Self, Value), HistoryError> {
        let in_document = |source| HistoryError::Stored { id, source };
        let document: Value = serde_json::from_str(&history.document(id)?).map_err(in_document)?;
        let stored = serde_json::from_value(document.clone()).map_err(in_document)?;
        Ok((stored, document))
    }

    /// The subject with temperature and grid of the check.
    fn subject(&self, subject: &Subject) -> Subject {
        let mut subject = subject.clone();
        subject.temperature_degc = self.recipe.temperature_degc;
        if self.recipe.grid == GridKind::Pixel {
            Arc::make_mut(&mut subject.head).core_map = None;
        }
        subject
    }
}

/// A check computed again from its phasors.
struct Computed {
    plan: ViewPlan,
    found: Findings,
    captures: usize,
}

/// Computes a check again, for the tool, head and baseline of `subject`.
fn compute(history: &History, stored: &Stored, subject: &Subject) -> Result<Computed, ReplayError> {
    let plan = ViewPlan::of_recipe(&subject.tool, &subject.head, &stored.recipe)?;
    let decoder = Arc::new(plan.decoder(&subject.head, None)?);
    let evaluator = Evaluator::new(subject, Arc::clone(&decoder), &plan)?;
    let views = plan.all_views().count();
    let mut outcomes = BTreeMap::new();
    let mut problems = BTreeMap::new();
    let mut captures = 0;
    let mut sums = decoder.begin();
    for (view, evidence) in stored.evidence.iter().enumerate() {
        if let Some(problem) = &evidence.problem {
            problems.insert(view, Reason::from(problem));
        }
        let tooth = evidence.tooth;
        let mut evaluated = |view: usize, blake3: &String| {
            if view >= views {
                return Err(ReplayError::NoSuchView { tooth, view, views });
            }
            let phasors = history.phasors(blake3, sums.byte_count())?;
            let restored = sums.restore(&phasors.bytes);
            restored.map_err(|source| ReplayError::Phasors {
                blake3: blake3.clone(),
                tooth,
                source,
            })?;
            captures += 1;
            let mut outcome = evaluator.evaluate(view, &sums);
            outcome.phasors.push(phasors);
            Ok(outcome)
        };
        let mut of_view: Option<ViewOutcome> = None;
        for blake3 in &evidence.phasors {
            let outcome = evaluated(view, blake3)?;
            of_view = Some(match of_view {
                Some(first) => first.with(outcome),
                None => outcome,
            });
        }
        for FurtherEvidence { view, phasors } in &evidence.further {
            let outcome = evaluated(*view, phasors)?;
            of_view = of_view.map(|first| first.with_further(*view, outcome));
        }
        outcomes.extend(of_view.map(|outcome| (view, outcome)));
    }
    let stopped = stored.stopped.as_ref().zip(stored.stopped_code);
    let stopped = stopped.map(|(why, code)| Reason::instrument(code, why));
    let found = Findings::of(
        &subject.tool,
        &plan,
        outcomes,
        &problems,
        stopped.as_ref(),
        subject.baseline.as_deref(),
    );
    Ok(Computed {
        plan,
        found,
        captures,
    })
}

impl Replay {
    /// Computes check `id` of a history again, for the tool and head of `subject`. Temperature, grid, teeth and baseline are
    /// those of the check.
    ///
    /// # Errors
    /// Data of the verdict are missing or damaged.
    pub fn of(history: &History, id: i64, subject: &Subject) -> Result<Self, ReplayError> {
        let (stored, document) = Stored::read(history, id)?;
        let mut subject = stored.subject(subject);
        if let Some(expected) = stored.hashes.get("baseline") {
            let baseline = baseline(history, expected)?.ok_or_else(|| ReplayError::Baseline {
                id,
                expected: expected.clone(),
            })?;
            subject.hashes.insert("baseline", baseline.hash());
            subject.baseline = Some(Arc::new(baseline));
        }
        let Computed {
            plan,
            found,
            captures,
        } = compute(history, &stored, &subject)?;
        let recipe = recipe(&subject, &plan);
        subject.hashes.insert("recipe", recipe.hash());
        let mut now = json!({
            "verdict": found.verdict,
            "reason": found.reason,
            "features": found.features,
            "registration": found.registration,
            "evidence": found.evidence,
            "recipe": recipe,
            "hashes": subject.hashes,
        });
        for (key, said) in [
            ("in_view", json!(found.in_view)),
            ("missing_teeth", json!(found.missing_teeth)),
            ("tooth_identity", json!(found.tooth_identity)),
        ] {
            // An absent entry means the same as null or an empty list.
            let is_nothing = said.is_null() || said.as_array().is_some_and(Vec::is_empty);
            if !is_nothing || document.get(key).is_some() {
                now[key] = said;
            }
        }
        let mut differences = Vec::new();
        if let Some(now) = now.as_object() {
            for (key, now) in now {
                compare(key, &document[key], now, &mut differences);
            }
        }
        differences.extend(row_differences(&history.check(id)?, &document));
        let mut versions = Vec::new();
        let host = json!(env!("CARGO_PKG_VERSION"));
        compare(
            "versions.host",
            &document["versions"]["host"],
            &host,
            &mut versions,
        );
        let origin = ORIGIN.into_iter().filter_map(|key| {
            let said = document.get(key)?;
            Some((key, said.clone()))
        });
        Ok(Self {
            id,
            origin: origin.collect(),
            stored_verdict: stored.verdict,
            verdict: found.verdict,
            reason: found.reason,
            captures,
            versions,
            differences,
        })
    }
}

/// The baseline with this hash, if it is in the history as it was stored.
fn baseline(history: &History, blake3: &str) -> Result<Option<Baseline>, HistoryError> {
    let text = history.baseline(blake3)?;
    let read = |text: String| serde_json::from_str::<Baseline>(&text).ok();
    Ok(text.and_then(read).filter(|b| b.hash() == blake3))
}

/// Lists every leaf that differs, except durations.
fn compare(what: &str, stored: &Value, now: &Value, differences: &mut Vec<Difference>) {
    match (stored, now) {
        (Value::Object(a), Value::Object(b)) => {
            let keys: std::collections::BTreeSet<&String> = a.keys().chain(b.keys()).collect();
            for key in keys.into_iter().filter(|key| *key != "elapsed_ms") {
                let at = |map: &serde_json::Map<String, Value>| {
                    map.get(key).cloned().unwrap_or(Value::Null)
                };
                compare(&format!("{what}.{key}"), &at(a), &at(b), differences);
            }
        }
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => {
            for (i, (a, b)) in a.iter().zip(b).enumerate() {
                compare(&format!("{what}.{i}"), a, b, differences);
            }
        }
        _ if same(stored, now) => {}
        _ => differences.push(Difference {
            what: what.to_owned(),
            stored: stored.clone(),
            now: now.clone(),
        }),
    }
}

/// Numbers must be equal to the last bit.
fn same(a: &Value, b: &Value) -> bool {
    match (a.as_f64(), b.as_f64()) {
        (Some(a), Some(b)) => a.to_bits() == b.to_bits(),
        _ => a == b,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_difference_is_named_and_times_are_none() {
        let stored =
            json!({ "a": [1.0, { "b": 2.5, "elapsed_ms": 7 }], "gone": "x", "same": null });
        let now = json!({ "a": [1.0, { "b": f64::from_bits(2.5_f64.to_bits() + 1), "elapsed_ms": 9 }], "new": 1 });
        let mut differences = Vec::new();
        compare("r", &stored, &now, &mut differences);
        let names: Vec<&str> = differences.iter().map(|d| d.what.as_str()).collect();
        assert_eq!(names, ["r.a.1.b", "r.gone", "r.new"]);
        differences.clear();
        compare("r", &json!([1, 2]), &json!([1]), &mut differences);
        compare("r", &json!(0.0), &json!(-0.0), &mut differences);
        assert_eq!(differences.len(), 2);
    }
}
