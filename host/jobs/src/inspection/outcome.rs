//! Outcome of one view, captured once or more often: judged flanks, pose and evidence.

use std::collections::BTreeMap;
use std::sync::Arc;

use flankscope_metrology::wear::{FlankWear, PoseEvidence};

use super::flank_decision::FlankCriteria;
use super::in_view::InView;
use super::verdict::Judged;
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
    pub(super) criteria: Arc<FlankCriteria>,
}

impl ViewOutcome {
    /// Whether a flank is too near to a limit to be decided, and repeating the measurement could change that.
    pub(crate) fn is_open(&self) -> bool {
        self.captures.last().is_some_and(|last| {
            let mut own = last.iter().filter(|wear| wear.tooth == self.tooth);
            own.any(|wear| self.criteria.is_open(wear))
        })
    }

    /// Outcomes of all views; views with several captures are judged by all of them.
    pub(crate) fn joined(
        mut first: BTreeMap<usize, Self>,
        again: BTreeMap<usize, Self>,
    ) -> BTreeMap<usize, Self> {
        for (view, again) in again {
            let outcome = match first.remove(&view) {
                Some(first) => first.with(again),
                None => again,
            };
            first.insert(view, outcome);
        }
        first
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
        let sides = criteria.tool.features().sides();
        for (judged, &flank) in self.flanks.iter_mut().zip(sides) {
            if let Some(together) = self.criteria.flank(self.tooth, flank, &self.captures) {
                *judged = together;
            }
        }
        self
    }
}
