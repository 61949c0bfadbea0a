//! What a running check has gathered: triggers, captured views, outcomes.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use flankscope_protocol::Trigger;

use super::recorder::{CapturedView, Picture};
use super::timeline::Timeline;
use flankscope_frames::monotonic_ns;

/// What a check has gathered so far.
#[derive(Debug)]
pub(crate) struct Run<O> {
    /// Every view that was asked for.
    pub wanted: Vec<usize>,
    /// View of the itinerary behind each view of the running session.
    pub session: Vec<usize>,
    /// Triggers per view of the session.
    pub triggers: Vec<Vec<Trigger>>,
    /// Captured views of the session that wait for the rest of their triggers.
    pub waiting: Vec<CapturedView>,
    pub outcomes: BTreeMap<usize, O>,
    pub problems: BTreeMap<usize, String>,
    /// Views of the session whose frames cannot be trusted.
    pub spoiled: BTreeSet<usize>,
    pub timeline: Timeline,
    pub picture: Option<Picture>,
    pub evaluating: usize,
    pub triggered: u64,
    pub received: u64,
    pub handover_ns: Vec<u64>,
    pub recaptured: u32,
    pub last_exposure_ns: u64,
    pub verdict_ns: u64,
    pub press_cycles: u32,
    /// How long the head may be in the die.
    pub hold_limit: Option<Duration>,
}

impl<O> Run<O> {
    pub fn new(wanted: Vec<usize>, hold_limit: Option<Duration>) -> Self {
        Self {
            wanted,
            session: Vec::new(),
            triggers: Vec::new(),
            waiting: Vec::new(),
            outcomes: BTreeMap::new(),
            problems: BTreeMap::new(),
            spoiled: BTreeSet::new(),
            timeline: Timeline::default(),
            picture: None,
            evaluating: 0,
            triggered: 0,
            received: 0,
            handover_ns: Vec::new(),
            recaptured: 0,
            last_exposure_ns: 0,
            verdict_ns: 0,
            press_cycles: 0,
            hold_limit,
        }
    }

    pub fn begin_session(&mut self, views: &[usize]) {
        self.session = views.to_vec();
        self.triggers = vec![Vec::new(); views.len()];
        self.waiting.clear();
        self.spoiled.clear();
        for view in views {
            self.problems.remove(view);
        }
    }

    /// A view's frames cannot be trusted, whatever was made of them so far or is being made of them.
    pub fn spoil(&mut self, view: usize, why: &str) {
        self.outcomes.remove(&view);
        self.spoiled.insert(view);
        self.problems.entry(view).or_insert_with(|| why.into());
    }

    /// No view of the session can be trusted.
    pub fn spoil_session(&mut self, why: &str) {
        for view in self.session.clone() {
            self.spoil(view, why);
        }
    }

    pub fn triggered(&mut self, trigger: Trigger) {
        self.triggered += 1;
        if let Some(view) = self.triggers.get_mut(usize::from(trigger.view)) {
            view.push(trigger);
        }
    }

    pub fn views_begun(&self) -> usize {
        self.triggers
            .iter()
            .filter(|triggers| !triggers.is_empty())
            .count()
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

    pub fn evaluated(&mut self, view: usize, outcome: O) {
        self.evaluating -= 1;
        self.verdict_ns = monotonic_ns();
        if !self.spoiled.contains(&view) {
            self.outcomes.insert(view, outcome);
        }
    }

    /// Views that were asked for and have no outcome.
    pub fn missing(&self) -> Vec<usize> {
        self.wanted
            .iter()
            .copied()
            .filter(|view| !self.outcomes.contains_key(view))
            .collect()
    }
}
