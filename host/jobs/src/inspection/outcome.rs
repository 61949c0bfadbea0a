//! Outcome of one view, captured once or more often: judged flanks, pose and evidence.

use std::collections::BTreeMap;
use std::sync::Arc;

use flankscope_metrology::gear::Flank;
use flankscope_metrology::verdict::{Code, Reason};
use flankscope_metrology::wear::{FlankWear, PoseEvidence};

use super::flank_decision::FlankCriteria;
use super::in_view::InView;
use super::verdict::Judged;
use crate::plan::ViewPlan;
use flankscope_record::baseline::Reference;
use flankscope_record::document::{FlankMap, Phasors, ViewRegistration};

/// Outcome of one view: judged flanks, pose, and the data of both.
#[derive(Debug)]
pub struct ViewOutcome {
    /// The two flanks of the tooth in the middle.
    pub flanks: Vec<Judged>,
    /// Neighbours in the view.
    pub in_view: InView,
    /// Registration of each capture's points to the CAD.
    pub registration: Vec<ViewRegistration>,
    /// Their deviation from CAD, cell by cell.
    pub fields: Vec<Reference>,
    /// Evidence of the view's rotation about the axis, if it was registered.
    pub pose: Option<PoseEvidence>,
    /// Deviation maps of the two flanks.
    pub maps: Vec<FlankMap>,
    /// Deviations in the two zones, µm.
    pub deviations_um: Vec<f64>,
    /// Sums of its frames, one entry for each capture, if they are kept.
    pub phasors: Vec<Phasors>,
    /// Whether the view must be captured again before it is judged.
    pub(super) retake: bool,
    pub(super) tooth: u32,
    /// Wear of the flanks by each capture; empty if it could not be measured.
    pub(super) captures: Vec<Vec<FlankWear>>,
    /// Captures of further views of its tooth.
    pub(super) further: Vec<FurtherCapture>,
    pub(super) criteria: Arc<FlankCriteria>,
}

/// A capture of a view's tooth from another place.
#[derive(Debug)]
pub(crate) struct FurtherCapture {
    /// Number of the further view in the plan.
    pub view: usize,
    /// Wear of the flanks; empty if it could not be measured.
    pub wears: Vec<FlankWear>,
    pub registration: Vec<ViewRegistration>,
    pub phasors: Vec<Phasors>,
}

impl ViewOutcome {
    /// Whether a flank is too near to a limit to be decided, and repeating the measurement could change that.
    pub(crate) fn is_open(&self) -> bool {
        self.captures.last().is_some_and(|last| {
            let mut own = last.iter().filter(|wear| wear.tooth == self.tooth);
            own.any(|wear| self.criteria.is_open(wear))
        })
    }

    /// Numbers of the further views that could decide a flank of which this view does not show enough.
    #[must_use]
    pub fn further_wanted(&self, plan: &ViewPlan) -> Vec<usize> {
        let sides = self.criteria.tool.features().sides();
        let unseen = |judged: &Judged| {
            let code = judged.verdict().reason().map(Reason::code);
            matches!(
                code,
                Some(Code::Hidden | Code::Coverage | Code::NoDisc | Code::TipUnseen)
            )
        };
        let flanks = self.flanks.iter().zip(sides);
        let flanks = flanks.filter(|(judged, _)| unseen(judged));
        let flanks: Vec<Flank> = flanks.map(|(_, &flank)| flank).collect();
        let mut views = plan.further_of(self.tooth, &flanks);
        views.retain(|&view| self.further.iter().all(|of| of.view != view));
        views
    }

    /// Outcomes of all planned views; a view with several captures, or with further views of its tooth, is judged by all of them.
    pub(crate) fn joined(
        mut first: BTreeMap<usize, Self>,
        again: BTreeMap<usize, Self>,
        plan: &ViewPlan,
    ) -> BTreeMap<usize, Self> {
        for (view, again) in again {
            let is_further = view >= plan.views.len();
            let planned = plan.views.iter().position(|of| of.tooth == again.tooth);
            let view_of_tooth = planned.filter(|_| is_further).unwrap_or(view);
            let outcome = match first.remove(&view_of_tooth) {
                Some(first) if is_further => first.with_further(view, again),
                Some(first) => first.with(again),
                None if is_further => continue,
                None => again,
            };
            first.insert(view_of_tooth, outcome);
        }
        first
    }

    /// The outcome by this and a capture of further view number `view` of its tooth.
    #[must_use]
    pub fn with_further(mut self, view: usize, further: Self) -> Self {
        self.further.push(FurtherCapture {
            view,
            wears: further.captures.into_iter().flatten().collect(),
            registration: further.registration,
            phasors: further.phasors,
        });
        self.judge_again();
        self
    }

    /// The outcome by this and another capture of the view together.
    #[must_use]
    pub(crate) fn with(mut self, again: Self) -> Self {
        self.registration.extend(again.registration);
        self.phasors.extend(again.phasors);
        self.captures.extend(again.captures);
        let criteria = Arc::clone(&self.criteria);
        let in_view = std::mem::take(&mut self.in_view);
        self.in_view = in_view.with(self.tooth, again.in_view, &self.captures, &criteria);
        self.judge_again();
        self
    }

    /// Judges both flanks by all captures.
    fn judge_again(&mut self) {
        let (criteria, captures, further) = (&self.criteria, &self.captures, &self.further);
        let sides = criteria.tool.features().sides();
        for (judged, &flank) in self.flanks.iter_mut().zip(sides) {
            if let Some(together) = criteria.flank(self.tooth, flank, captures, further) {
                *judged = together;
            }
        }
    }
}
