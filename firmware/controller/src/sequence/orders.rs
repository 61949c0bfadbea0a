//! The host's orders, already judged by the command handler.

use super::signals::{Action, Actions, push};
use super::{IDENTITY_TIMEOUT, Sequence, Step, Then};
use flankscope_protocol::{CapturePlan, StageConfig, Timestamp, Why};

impl Sequence {
    pub(crate) fn store(&mut self, plan: CapturePlan) {
        self.plan = Some(plan);
    }

    /// Other stages than before need a reference run, which puts them in force; what moves until then moves as before. A plan that
    /// was judged by the travel of the old ones is none.
    pub(crate) fn configure(&mut self, stage: &StageConfig) {
        self.next_stage = (*stage != self.stage).then_some(*stage);
        if self.next_stage.is_some() {
            self.plan = None;
        }
    }

    pub(crate) fn start(&mut self, now: Timestamp, out: &mut Actions) {
        (self.view, self.frame, self.frames_total) = (0, 0, 0);
        self.host_heard = now;
        self.readout_end = now;
        // First of all: what comes to nothing by the lens has moved nothing.
        self.lens_rests_at = now;
        if let Some(focus) = self.focus() {
            self.lens_on = true;
            push(out, Action::SetLens(focus.counts));
        }
        // Whoever changes a stage may leave the controller running: asked before every capture.
        (self.may_enter, self.stages_known) = (false, !self.stage.names_a_model());
        if !self.stages_known {
            self.identify(out);
        }
        self.enter(
            Step::Claiming {
                until: now.after(self.config.claim_timeout),
            },
            Why::Start,
            now,
            out,
        );
    }

    pub(crate) fn home(&mut self, now: Timestamp, out: &mut Actions) {
        (self.homed, self.parked) = (false, false);
        self.stage = self.next_stage.take().unwrap_or(self.stage);
        if !self.stage.names_a_model() {
            return self.search_home(now, Why::Home, out);
        }
        self.identify(out);
        let until = now.after(IDENTITY_TIMEOUT);
        self.enter(Step::Identifying { until }, Why::Home, now, out);
    }

    pub(super) fn search_home(&mut self, now: Timestamp, why: Why, out: &mut Actions) {
        let ticket = self.next_ticket();
        push(out, Action::Home { ticket });
        let patience = self.config.home_timeout.max(self.stage.home_timeout());
        let until = now.after(patience);
        self.enter(Step::Homing { until }, why, now, out);
    }

    /// Asks the stages what they are.
    pub(crate) fn identify(&mut self, out: &mut Actions) {
        let ticket = self.next_ticket();
        push(out, Action::Identify { ticket });
    }

    /// LED off, halt, retract. Halting a retract that is under way would be less safe, so that goes on.
    pub(crate) fn abort(&mut self, now: Timestamp, out: &mut Actions) {
        if self.capturing() {
            self.withdraw(now, true, Then::Ready(Why::Abort), Why::Abort, out);
        } else if matches!(self.step, Step::Identifying { .. } | Step::Homing { .. }) {
            self.next_ticket();
            push(out, Action::StopStages);
            self.enter(Step::Unhomed, Why::Abort, now, out);
        }
    }

    /// LED off, retract; also from a fault, which stays.
    pub(crate) fn retract(&mut self, now: Timestamp, out: &mut Actions) {
        if self.capturing() || self.step == Step::Ready {
            self.withdraw(now, false, Then::Ready(Why::Retract), Why::Retract, out);
        } else if self.step == Step::Faulted && self.homed {
            self.withdraw(now, false, Then::Faulted, Why::Retract, out);
        }
    }

    pub(crate) fn acknowledge(&mut self, now: Timestamp, out: &mut Actions) {
        if self.step == Step::Faulted {
            self.fault = None;
            self.lamps.acknowledge();
            let next = if self.homed {
                Step::Ready
            } else {
                Step::Unhomed
            };
            self.enter(next, Why::Acknowledged, now, out);
        }
    }
}
