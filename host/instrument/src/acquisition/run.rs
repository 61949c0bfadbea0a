//! What a run has gathered: triggers, captured views, outcomes.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use flankscope_protocol::Trigger;

use super::error::ViewError;
use super::recorder::CapturedView;
use super::timeline::Timeline;
use flankscope_frames::monotonic_ns;
use flankscope_profilometry::Picture;

/// What all captures of a run have gathered so far.
#[derive(Debug)]
pub struct Run<O> {
    /// Every view that was asked for, in the order in which they are visited first.
    pub wanted: Vec<usize>,
    /// The capture that runs.
    pub(super) session: Session,
    /// What became of the views whose frames are whole.
    pub outcomes: BTreeMap<usize, O>,
    /// Why others have none.
    pub problems: BTreeMap<usize, ViewError>,
    /// Triggers and frames counted.
    pub counts: Counts,
    /// Activity of the devices.
    pub timeline: Timeline,
    /// One raw frame for the report.
    pub picture: Option<Picture>,
    /// How long the head may be in the die.
    pub hold_limit: Option<Duration>,
}

/// Bookkeeping of a run.
#[derive(Debug, Default)]
pub struct Counts {
    /// Frames that the controller triggered.
    pub triggered: u64,
    /// Frames of views whose frames and triggers pair.
    pub received: u64,
    /// Time of those from the camera process to here, ns.
    pub handover_ns: Vec<u64>,
    /// The latest of all frames, of captures that were taken again, too, ms.
    pub late_ms: f64,
    /// Views that had to be captured again.
    pub recaptured: u32,
    /// End of the last exposure, by the host's monotonic clock, ns; 0 without any.
    pub last_exposure_ns: u64,
    /// When the last outcome was there, the same way.
    pub last_outcome_ns: u64,
    /// Cycles of the press when the last capture began.
    pub press_cycles: u32,
}

/// One capture: of some views, under one session number.
#[derive(Debug, Default)]
pub(super) struct Session {
    /// View of the program behind each view of the session.
    pub views: Vec<usize>,
    /// Triggers per view of the session.
    pub triggers: Vec<Vec<Trigger>>,
    /// When the controller's word of each came, by the host's monotonic clock, ns.
    pub arrived_ns: Vec<Vec<u64>>,
    /// Captured views that wait for the rest of their triggers.
    pub waiting: Vec<CapturedView>,
    /// Views whose frames cannot be trusted.
    spoiled: BTreeSet<usize>,
    /// Views that are being evaluated.
    pub evaluating: usize,
}

impl Session {
    /// Position among the session's views of the one that is captured now: of the latest with a trigger, the next.
    pub fn begun(&self) -> usize {
        let begun = |triggers: &&Vec<Trigger>| !triggers.is_empty();
        self.triggers.iter().filter(begun).count()
    }

    /// Captured views that need not wait any longer: damaged ones, and those whose triggers have all been reported.
    pub fn take_complete(&mut self, frames_per_view: u16) -> Vec<CapturedView> {
        let triggers = &self.triggers;
        let complete = |view: &mut CapturedView| {
            view.problem.is_some()
                || triggers
                    .get(usize::from(view.view))
                    .is_none_or(|t| t.len() >= usize::from(frames_per_view))
        };
        self.waiting.extract_if(.., complete).collect()
    }
}

impl<O> Run<O> {
    /// A run of these views; with a hold limit the head is out of the die by then.
    #[must_use]
    pub fn new(wanted: Vec<usize>, hold_limit: Option<Duration>) -> Self {
        Self {
            wanted,
            session: Session::default(),
            outcomes: BTreeMap::new(),
            problems: BTreeMap::new(),
            counts: Counts::default(),
            timeline: Timeline::default(),
            picture: None,
            hold_limit,
        }
    }

    pub(super) fn begin_session(&mut self, views: &[usize]) {
        self.session = Session {
            views: views.to_vec(),
            triggers: vec![Vec::new(); views.len()],
            arrived_ns: vec![Vec::new(); views.len()],
            evaluating: self.session.evaluating,
            ..Session::default()
        };
        for view in views {
            self.problems.remove(view);
        }
    }

    /// A view's place in the order in which they were asked for: what everybody calls it by.
    pub fn number(&self, view: usize) -> usize {
        let place = self.wanted.iter().position(|&wanted| wanted == view);
        place.unwrap_or(view)
    }

    /// A view's frames cannot be trusted, whatever was made of them so far or is being made of them.
    pub(super) fn spoil(&mut self, view: usize, why: ViewError) {
        self.outcomes.remove(&view);
        self.session.spoiled.insert(view);
        self.problems.entry(view).or_insert(why);
    }

    /// A frame came that nobody triggered: no view of the session can be trusted.
    pub(super) fn spoil_session(&mut self) {
        for view in self.session.views.clone() {
            self.spoil(view, ViewError::BeyondPlan);
        }
    }

    pub(super) fn triggered(&mut self, trigger: Trigger) {
        self.counts.triggered += 1;
        let view = usize::from(trigger.view);
        if let Some(view) = self.session.triggers.get_mut(view) {
            view.push(trigger);
        }
        if let Some(view) = self.session.arrived_ns.get_mut(view) {
            view.push(monotonic_ns());
        }
    }

    pub(super) fn evaluated(&mut self, view: usize, outcome: O) {
        self.session.evaluating -= 1;
        self.counts.last_outcome_ns = monotonic_ns();
        if !self.session.spoiled.contains(&view) {
            self.outcomes.insert(view, outcome);
        }
    }

    /// Of these views, those without an outcome.
    pub fn without_outcome(&self, views: &[usize]) -> Vec<usize> {
        let without = |view: &usize| !self.outcomes.contains_key(view);
        views.iter().copied().filter(without).collect()
    }
}
