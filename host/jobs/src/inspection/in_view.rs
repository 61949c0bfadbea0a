//! Neighbours in a view: the flanks of other teeth than the requested one, and missing teeth.
//!
//! A flank that was not requested affects the verdict by its visible part: an estimate above the warning limit warns; wear that
//! is proven to exceed the stop limit is a no-go. Unmeasured parts do not count, because a view shows its neighbours only in
//! part.

use std::collections::{BTreeMap, BTreeSet};

use flankscope_metrology::feature::Features;
use flankscope_metrology::gear::FlankPlace;
use flankscope_metrology::verdict::flank::{Decision, judge_in_view};
use flankscope_metrology::verdict::{Code, Reason, Verdict, Word};
use flankscope_metrology::wear::standing::MissingTooth;
use flankscope_metrology::wear::{Figure, FlankWear, PoseEvidence};

use super::flank_decision::FlankCriteria;
use flankscope_record::baseline::{Reference, ViewReference};
use flankscope_record::document::{FeatureId, FlankInView};

/// A tooth with fewer points in the judged zone is not in view.
const LEAST_POINTS: usize = 100;

/// Contribution of a flank that was not requested to the verdict, if any.
fn finding(flank: &FlankInView) -> Option<Finding> {
    let verdict = match flank.verdict {
        Word::NoGo => Verdict::NoGo,
        Word::Warn => Verdict::Warn,
        Word::Go | Word::Indeterminate => return None,
    };
    let why = flank.reason.as_deref().unwrap_or_default();
    Some(Finding {
        verdict,
        sentence: format!("{}, not asked for ({why})", flank.id),
    })
}

/// A finding besides the requested flanks.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Finding {
    pub verdict: Verdict,
    pub sentence: String,
}

/// Neighbours in one view.
#[derive(Clone, Debug, Default)]
pub struct InView {
    pub(super) flanks: Vec<FlankInView>,
    pub(super) missing: Vec<MissingTooth>,
    pub(super) recorded: Option<ViewReference>,
}

impl InView {
    /// The worst verdict of its findings: worn flanks that were not requested, missing teeth. `None` without findings.
    pub fn word(&self) -> Option<Word> {
        let missing = (!self.missing.is_empty()).then_some(Word::NoGo);
        let flanks = self.flanks.iter().filter_map(finding);
        missing
            .into_iter()
            .chain(flanks.map(|of| of.verdict.word()))
            .max()
    }

    /// From a view of `tooth` and all measurements in its captures.
    pub(super) fn of_view(
        tooth: u32,
        captures: &[Vec<FlankWear>],
        missing: Vec<MissingTooth>,
        criteria: &FlankCriteria,
    ) -> Self {
        let first = captures.first().map_or(&[][..], Vec::as_slice);
        let beside = || {
            let others = first.iter().filter(|wear| wear.tooth != tooth);
            others.filter(|wear| wear.judged.is_some())
        };
        let mut poses: Vec<PoseEvidence> = Vec::new();
        for evidence in beside().filter_map(|wear| wear.sensitivity.as_ref()?.evidence.as_deref()) {
            if poses.iter().all(|pose| pose.tooth != evidence.tooth) {
                poses.push(evidence.clone());
            }
        }
        let recorded = ViewReference {
            view: tooth,
            flanks: beside().map(Reference::of_flank).collect(),
            poses,
        };
        let flanks = beside().filter_map(|wear| criteria.in_view(tooth, wear, captures));
        Self {
            flanks: flanks.collect(),
            missing,
            recorded: (!recorded.flanks.is_empty()).then_some(recorded),
        }
    }

    /// Adds the neighbours of another capture of the view; `captures` are all of them.
    pub(super) fn with(
        mut self,
        tooth: u32,
        again: Self,
        captures: &[Vec<FlankWear>],
        criteria: &FlankCriteria,
    ) -> Self {
        add_missing(&mut self.missing, again.missing);
        Self {
            recorded: self.recorded,
            ..Self::of_view(tooth, captures, self.missing, criteria)
        }
    }
}

/// Adds missing teeth that are not listed yet.
fn add_missing(all: &mut Vec<MissingTooth>, more: Vec<MissingTooth>) {
    for missing in more {
        if all.iter().all(|there| there.tooth != missing.tooth) {
            all.push(missing);
        }
    }
}

/// Teeth in view of a tooth that were not requested.
pub(super) fn others(
    features: Features<'_>,
    places: &[Option<FlankPlace>],
    in_zone: impl Fn(&FlankPlace) -> bool,
    asked: &BTreeSet<u32>,
) -> Vec<u32> {
    let Features::Gear(_) = features else {
        // A patch is registered to its own datum, so the view tells nothing about others.
        return Vec::new();
    };
    let mut counts: BTreeMap<u32, usize> = BTreeMap::new();
    for place in places.iter().flatten().filter(|place| in_zone(place)) {
        *counts.entry(place.tooth).or_default() += 1;
    }
    let seen = counts
        .into_iter()
        .filter(|&(tooth, count)| count >= LEAST_POINTS && !asked.contains(&tooth));
    seen.map(|(tooth, _)| tooth).collect()
}

impl FlankCriteria {
    /// Judges a flank in the view of `view` that belongs to another tooth, by all captures of the view.
    fn in_view(
        &self,
        view: u32,
        first: &FlankWear,
        captures: &[Vec<FlankWear>],
    ) -> Option<FlankInView> {
        let key = (first.tooth, first.flank);
        let of_flank = captures.iter().flatten();
        let measured: Vec<&FlankWear> = of_flank
            .filter(|wear| (wear.tooth, wear.flank) == key)
            .collect();
        let together = FlankWear::together(&measured, &self.settings)?;
        let coverage_ratio = together.coverage;
        let (wear, Decision { verdict, cause }) = match self.neighbours_wear(view, together) {
            Ok(wear) => {
                let decision = judge_in_view(&wear, &self.limits);
                (Some(wear), decision)
            }
            Err(reason) => {
                let verdict = Verdict::Indeterminate { reason };
                (
                    None,
                    Decision {
                        verdict,
                        cause: None,
                    },
                )
            }
        };
        let depth_mm = wear.as_ref().and_then(FlankWear::wear_mm);
        let um = |of: fn(Figure) -> f64| {
            let mm = depth_mm.map(of)?;
            mm.is_finite().then_some(1e3 * mm)
        };
        let reason = verdict.reason().map(Reason::to_string);
        Some(FlankInView {
            id: FeatureId {
                tooth: key.0,
                flank: key.1,
                patch: None,
            },
            view,
            wear_um: um(|depth| depth.value),
            u95_um: um(|depth| depth.u95()),
            coverage_ratio,
            verdict: verdict.word(),
            reason: reason.or_else(|| cause.map(|cause| cause.sentence(&verdict))),
        })
    }

    /// Its loss since the baseline of the same view if there is one, else its deviation from CAD.
    fn neighbours_wear(&self, view: u32, wear: FlankWear) -> Result<FlankWear, Reason> {
        let Some(baseline) = &self.baseline else {
            return Ok(wear);
        };
        let lacks = || {
            let sentence = "the baseline does not show this flank in this view; record it again";
            Reason::instrument(Code::BaselineLacks, sentence)
        };
        let then = baseline.in_view.iter().find(|of| of.view == view);
        let then = then.ok_or_else(lacks)?;
        let is_it = |of: &&Reference| (of.tooth, of.flank) == (wear.tooth, wear.flank);
        let reference = then.flanks.iter().find(is_it).ok_or_else(lacks)?;
        let before = then
            .poses
            .iter()
            .find(|pose| pose.tooth == Some(wear.tooth));
        let since = wear.since(&reference.field, before, &self.settings);
        since.map_err(|mismatch| Reason::instrument(Code::BaselineMismatch, mismatch))
    }
}

/// Neighbours in all views of a check.
#[derive(Clone, Debug, Default)]
pub(crate) struct Neighbourhood {
    pub flanks: Vec<FlankInView>,
    pub missing: Vec<MissingTooth>,
}

impl Neighbourhood {
    /// Adds the neighbours of a view. For a flank in several views, the view with the worst verdict counts, else the one with the
    /// largest coverage.
    pub fn add(&mut self, of_view: InView) {
        for flank in of_view.flanks {
            let weight = |of: &FlankInView| {
                let shown = match of.verdict {
                    Word::NoGo => 2,
                    Word::Warn => 1,
                    Word::Go | Word::Indeterminate => 0,
                };
                (shown, of.coverage_ratio)
            };
            match self.flanks.iter_mut().find(|of| of.id == flank.id) {
                Some(there) if weight(there) < weight(&flank) => *there = flank,
                Some(_) => {}
                None => self.flanks.push(flank),
            }
        }
        add_missing(&mut self.missing, of_view.missing);
    }

    /// Sorts by tooth.
    pub fn sort(&mut self) {
        let key = |id: &FeatureId| (id.tooth, id.flank);
        self.flanks.sort_by_key(|of| key(&of.id));
        self.missing.sort_by_key(|of| of.tooth);
    }

    /// Findings that affect the verdict.
    pub fn findings(&self, asked: &BTreeSet<u32>) -> Vec<Finding> {
        let missing = self.missing.iter().map(|missing| {
            let asked = asked.contains(&missing.tooth);
            let MissingTooth {
                tooth,
                height_mm: [from_mm, to_mm],
                seen_through,
            } = missing;
            let what = match seen_through {
                true => "points lie far behind where its tip should stand",
                false => "nothing is seen where its tip and flanks should stand",
            };
            let beside = if asked { "" } else { ", not asked for," };
            Finding {
                verdict: Verdict::NoGo,
                sentence: format!(
                    "tooth {tooth}{beside} is missing or broken off between heights {from_mm:.1} and {to_mm:.1} mm, as far as it \
                     is in view ({what})"
                ),
            }
        });
        let flanks = self.flanks.iter().filter_map(finding);
        missing.chain(flanks).collect()
    }
}
