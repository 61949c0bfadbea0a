//! Outcome of one view, captured once or more often: judged flanks, pose and evidence.

use std::collections::BTreeMap;
use std::sync::Arc;

use flankscope_metrology::wear::{FlankWear, PoseEvidence};

use super::flank_decision::FlankCriteria;
use super::in_view::InView;
use super::verdict::Judged;
use flankscope_record::baseline::Reference;
use flankscope_record::document::{FlankMap, Phasors, ViewRegistration};

/// Outcome of one view: its flanks judged, its pose, and what both were computed from.
#[derive(Debug)]
pub struct ViewOutcome {
    /// The two flanks of the tooth in the middle.
    pub flanks: Vec<Judged>,
    /// What the view shows beside them.
    pub in_view: InView,
    /// How the points of each capture were laid on the CAD.
    pub registration: Vec<ViewRegistration>,
    /// Their deviation from CAD, cell by cell.
    pub fields: Vec<Reference>,
    /// What the view says of its own pose about the axis, where it was registered.
    pub pose: Option<PoseEvidence>,
    /// Deviation maps of the two flanks.
    pub maps: Vec<FlankMap>,
    /// Deviations in the two zones, µm.
    pub deviations_um: Vec<f64>,
    /// Sums of its frames, one entry for each capture, where they are kept.
    pub phasors: Vec<Phasors>,
    /// Whether the view must be taken again before anything is said of it.
    pub(super) retake: bool,
    pub(super) tooth: u32,
    /// What each capture measured of the flanks; nothing where it could not.
    pub(super) captures: Vec<Vec<FlankWear>>,
    pub(super) criteria: Arc<FlankCriteria>,
}

impl ViewOutcome {
    /// Whether a flank is too near to a limit to be decided, and measuring it again could change that.
    pub(crate) fn is_open(&self) -> bool {
        self.captures.last().is_some_and(|last| {
            let mut own = last.iter().filter(|wear| wear.tooth == self.tooth);
            own.any(|wear| self.criteria.is_open(wear))
        })
    }

    /// Outcomes of all views, those that were captured again judged together with their earlier captures.
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

    /// The outcome of this view and of another capture of it, judged together.
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
