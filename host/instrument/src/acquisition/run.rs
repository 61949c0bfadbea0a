//! State of a run: triggers, captured views, outcomes.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use flankscope_protocol::Trigger;

use super::error::ViewError;
use super::levels::ViewLevels;
use super::recorder::CapturedView;
use super::timeline::Timeline;
use flankscope_frames::monotonic_ns;
use flankscope_profilometry::Picture;

/// What all captures of a run have gathered so far.
#[derive(Debug)]
pub struct Run<O> {
    /// Every requested view, in the order of the first visits.
    pub wanted: Vec<usize>,
    /// The present capture.
    pub(super) session: Session,
    /// Outcome of each view with complete frames, by view index.
    pub outcomes: BTreeMap<usize, O>,
    /// Why the other views have no outcome.
    pub problems: BTreeMap<usize, ViewError>,
    /// Triggers and frames counted.
    pub counts: Counts,
    /// Activity of the devices over time.
    pub timeline: Timeline,
    /// A raw frame of each view for the report, by view index.
    pub pictures: BTreeMap<usize, Picture>,
    /// Pixel levels of each view whose frames and triggers pair, by view index, if they are counted.
    pub levels: BTreeMap<usize, ViewLevels>,
    /// Longest time that the head may be in the die.
    pub hold_limit: Option<Duration>,
}

/// Counters and times of a run.
#[derive(Debug, Default)]
pub struct Counts {
    /// Frames that the controller triggered.
    pub triggered: u64,
    /// Frames of views whose frames and triggers pair.
    pub received: u64,
    /// Time of those frames from the camera process to the host, ns.
    pub handover_ns: Vec<u64>,
    /// Largest delay of any frame, including captures that were repeated, ms.
    pub late_ms: f64,
    /// Views that had to be captured again.
    pub recaptured: u32,
    /// End of the last exposure, by the host's monotonic clock, ns; 0 without any.
    pub last_exposure_ns: u64,
    /// Time of the last outcome, by the same clock, ns.
    pub last_outcome_ns: u64,
    /// Cycles of the press when the last capture began.
    pub press_cycles: u32,
}

/// One capture of some views, under one session number.
#[derive(Debug, Default)]
pub(super) struct Session {
    /// Index in the program of each view of the session.
    pub views: Vec<usize>,
    /// Triggers per view of the session.
    pub triggers: Vec<Vec<Trigger>>,
    /// When the controller's report of each trigger arrived, by the host's monotonic clock, ns.
    pub arrived_ns: Vec<Vec<u64>>,
    /// Captured views that wait for the reports of their remaining triggers.
    pub waiting: Vec<CapturedView>,
    /// Views whose frames cannot be trusted.
    spoiled: BTreeSet<usize>,
    /// Views that are being evaluated.
    pub evaluating: usize,
}

impl Session {
    /// Number of the session's views that have a trigger, which is the index of the next view.
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
    /// A run of these views; with a hold limit, the head leaves the die before it ends.
    #[must_use]
    pub fn new(wanted: Vec<usize>, hold_limit: Option<Duration>) -> Self {
        Self {
            wanted,
            session: Session::default(),
            outcomes: BTreeMap::new(),
            problems: BTreeMap::new(),
            counts: Counts::default(),
            timeline: Timeline::default(),
            pictures: BTreeMap::new(),
            levels: BTreeMap::new(),
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

    /// A view's position among the requested ones, by which messages and files refer to it.
    pub fn number(&self, view: usize) -> usize {
        let place = self.wanted.iter().position(|&wanted| wanted == view);
        place.unwrap_or(view)
    }

    /// Marks a view's frames as unusable, including outcomes that exist or are being computed.
    pub(super) fn spoil(&mut self, view: usize, why: ViewError) {
        self.outcomes.remove(&view);
        self.session.spoiled.insert(view);
        self.problems.entry(view).or_insert(why);
    }

    /// Marks every view of the session as unusable, because a frame arrived that was not triggered.
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

    /// Keeps the picture of a view of the session.
    pub(super) fn pictured(&mut self, view: u16, picture: Picture) {
        if let Some(&view) = self.session.views.get(usize::from(view)) {
            self.pictures.insert(view, picture);
        }
    }

    /// Those of `views` without an outcome.
    pub fn without_outcome(&self, views: &[usize]) -> Vec<usize> {
        let without = |view: &usize| !self.outcomes.contains_key(view);
        views.iter().copied().filter(without).collect()
    }
}
