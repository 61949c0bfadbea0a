//! One view: move, settle, and for each projector light, its frames, darken.

use super::signals::{Action, Actions, push};
use super::{Dark, LOADING_POLL, Sequence, Step, Then};
use crate::lens::LensFault;
use flankscope_protocol::{
    Event, Fault, Focus, FrameSpec, Microseconds, Projector, Timestamp, Trigger, View, Why,
};

impl Sequence {
    pub(super) fn move_to_view(&mut self, now: Timestamp, why: Why, out: &mut Actions) {
        let Some((view, _)) = self.target() else {
            return self.fail(now, Fault::OutOfStep, 0, out);
        };
        let motion = self
            .plan
            .as_ref()
            .map_or(self.config.retract_timeout, |plan| plan.timeouts.motion);
        self.parked = false;
        let ticket = self.next_ticket();
        push(out, Action::Move { ticket, view });
        self.enter(
            Step::Moving {
                until: now.after(motion),
            },
            why,
            now,
            out,
        );
    }

    /// Settled: light the LED, once the lens has been asked, where one is driven.
    pub(super) fn settled(&mut self, now: Timestamp, out: &mut Actions) {
        let patience = self.plan.as_ref().map(|plan| plan.timeouts.led);
        match self.focus().zip(patience) {
            None => self.light(now, out),
            Some((focus, patience)) => {
                push(out, Action::CheckLens(focus.counts));
                self.step = Step::Checking {
                    until: now.after(patience),
                };
            }
        }
    }

    /// The lens was told its voltage, before the head moved, or was asked for it, before a view.
    pub(super) fn lens(
        &mut self,
        now: Timestamp,
        outcome: Result<(), LensFault>,
        out: &mut Actions,
    ) {
        match (outcome, self.step) {
            (Ok(()), Step::Checking { .. }) => self.light(now, out),
            (Ok(()), _) => {
                let settle = self.focus().map_or(Microseconds(0), |focus| focus.settle);
                self.lens_rests_at = now.after(settle);
            }
            (Err(LensFault { fault, detail }), _) if self.lens_on => {
                self.fail(now, fault, detail, out);
            }
            // The capture ended meanwhile.
            (Err(_), _) => {}
        }
    }

    pub(super) fn focus(&self) -> Option<Focus> {
        self.plan.as_ref()?.focus
    }

    /// Light the LED, once all have cooled enough to last the whole view.
    pub(super) fn light(&mut self, now: Timestamp, out: &mut Actions) {
        let Some(need) = self.plan.as_ref().map(|plan| plan.led_on_per_view()) else {
            return self.fail(now, Fault::OutOfStep, 0, out);
        };
        match self.lamps.ready_at(now, need) {
            None => self.fail(now, Fault::LedBudget, 0, out),
            Some(until) if until > now => {
                let fault = Fault::LedCooling.code();
                push(
                    out,
                    Action::Report(Event::Fault {
                        fault,
                        state: self.state(),
                        detail: 0,
                        at: now,
                    }),
                );
                self.enter(Step::Cooling { until }, Why::Fault(fault), now, out);
            }
            Some(_) => {
                self.frame = 0;
                self.switch_on(now, out);
            }
        }
    }

    /// Enables the LED of the projector whose frame is next, once no other shines.
    fn switch_on(&mut self, now: Timestamp, out: &mut Actions) {
        let projector = self.shows();
        let Some((led, timeout)) = self.plan.as_ref().map(|plan| (plan.led, plan.timeouts.led))
        else {
            return self.fail(now, Fault::OutOfStep, 0, out);
        };
        if !self.lamps.switch_on(projector, now, timeout) {
            let then = Dark::NextProjector;
            return self.enter(Step::Darkening { then }, Why::Sequence, now, out);
        }
        push(out, Action::LedOn(projector, led));
        push(
            out,
            Action::Report(Event::Led {
                projector,
                on: true,
                at: now,
            }),
        );
        self.enter(Step::Lighting, Why::Sequence, now, out);
    }

    pub(super) fn select(&mut self, now: Timestamp, out: &mut Actions) {
        let Some((frame, timeout)) = self
            .frame_spec()
            .zip(self.plan.as_ref().map(|plan| plan.timeouts.dmd))
        else {
            return self.fail(now, Fault::OutOfStep, 0, out);
        };
        push(out, Action::SelectPattern(frame.projector, frame.pattern));
        self.enter(
            Step::Selecting {
                until: now.after(timeout),
            },
            Why::Sequence,
            now,
            out,
        );
    }

    pub(super) fn pattern_selected(&mut self, now: Timestamp, taken: bool, out: &mut Actions) {
        let Step::Selecting { .. } = self.step else {
            return;
        };
        match self.plan.as_ref().map(|plan| plan.timeouts.dmd) {
            Some(timeout) if taken => {
                let until = now.after(timeout);
                self.step = Step::Loading { ask: until, until };
                push(out, Action::AskPattern(self.shows()));
            }
            _ => self.fail(now, Fault::DmdSelect, self.shows().detail(), out),
        }
    }

    /// Triggers the pattern once the DMD has it: an edge that comes before is missed.
    pub(super) fn pattern_loaded(
        &mut self,
        now: Timestamp,
        loaded: Option<bool>,
        out: &mut Actions,
    ) {
        let Step::Loading { until, .. } = self.step else {
            return;
        };
        match (loaded, self.plan.as_ref().map(|plan| plan.timeouts.dmd)) {
            (Some(true), Some(timeout)) => {
                self.dmd_at = now;
                push(out, Action::DmdTrigger(Some(self.shows())));
                self.step = Step::Switching {
                    until: now.after(timeout),
                };
            }
            (Some(false), _) => {
                self.step = Step::Loading {
                    ask: now.after(LOADING_POLL),
                    until,
                };
            }
            _ => self.fail(now, Fault::DmdSelect, self.shows().detail(), out),
        }
    }

    pub(super) fn dmd_ready(&mut self, now: Timestamp, out: &mut Actions) {
        let Step::Switching { .. } = self.step else {
            return;
        };
        push(out, Action::DmdTrigger(None));
        let settle = self
            .plan
            .as_ref()
            .map_or(Microseconds(0), |plan| plan.dmd_settle);
        self.step = Step::Standing {
            until: now.after(settle),
        };
    }

    pub(super) fn hold(&mut self, now: Timestamp, out: &mut Actions) {
        let Some(frame) = self.frame_spec() else {
            return self.fail(now, Fault::OutOfStep, 0, out);
        };
        let until = earliest_trigger(now, self.readout_end, frame.exposure);
        if until > now {
            self.step = Step::Holding { until };
        } else {
            self.arm(now);
        }
    }

    pub(super) fn arm(&mut self, now: Timestamp) {
        let timeout = self
            .plan
            .as_ref()
            .map_or(Microseconds(0), |plan| plan.timeouts.camera);
        self.step = Step::Arming {
            until: now.after(timeout),
        };
    }

    pub(super) fn camera_ready(&mut self, now: Timestamp, out: &mut Actions) {
        let Step::Arming { .. } = self.step else {
            return;
        };
        let Some((frame, timeout)) = self
            .frame_spec()
            .zip(self.plan.as_ref().map(|plan| plan.timeouts.camera))
        else {
            return self.fail(now, Fault::OutOfStep, 0, out);
        };
        self.camera_at = now;
        push(out, Action::CameraTrigger(true));
        self.step = Step::Exposing {
            end: now.after(frame.exposure),
            begin_by: Some(now.after(timeout)),
        };
    }

    pub(super) fn camera_exposing(&mut self, now: Timestamp, level: bool, out: &mut Actions) {
        match self.step {
            Step::Exposing {
                end,
                begin_by: Some(_),
            } if level => {
                self.step = Step::Exposing {
                    end,
                    begin_by: None,
                }
            }
            Step::Closing { .. } if !level => self.frame_done(now, out),
            _ => {}
        }
    }

    /// The exposure's time is over: release the trigger, report the frame.
    pub(super) fn close(&mut self, now: Timestamp, end: Timestamp, out: &mut Actions) {
        push(out, Action::CameraTrigger(false));
        let plan = self.plan.as_ref();
        let shown = plan.and_then(|plan| plan.order().place(self.frame));
        let Some(((plan, shown), frame)) = plan.zip(shown).zip(self.frame_spec()) else {
            return self.fail(now, Fault::OutOfStep, 0, out);
        };
        let trigger = Trigger {
            session: plan.session,
            view: self.view,
            frame: self.frame,
            pattern: shown.pattern,
            exposure: frame.exposure,
            dmd_at: self.dmd_at,
            camera_at: self.camera_at,
            end_at: now,
        };
        self.readout_end = now.after(plan.camera_readout);
        self.step = Step::Closing {
            until: now.after(plan.timeouts.camera),
        };
        push(out, Action::Report(Event::Triggered(trigger)));
        let late_us = now.since_us(end);
        if late_us > u64::from(self.config.exposure_tolerance.get()) {
            self.fail(
                now,
                Fault::ExposureWidth,
                u32::try_from(late_us).unwrap_or(u32::MAX),
                out,
            );
        }
    }

    pub(super) fn frame_done(&mut self, now: Timestamp, out: &mut Actions) {
        let Some((session, frames, views, led_timeout)) = self.plan.as_ref().map(|plan| {
            (
                plan.session,
                plan.frames_per_view(),
                plan.views.len(),
                plan.timeouts.led,
            )
        }) else {
            return self.fail(now, Fault::OutOfStep, 0, out);
        };
        self.frames_total = self.frames_total.saturating_add(1);
        self.frame = self.frame.saturating_add(1);
        if self.frame < frames && self.lamps.enabled() == Some(self.shows()) {
            return self.select(now, out);
        }
        self.put_out(now, led_timeout, out);
        if self.frame < frames {
            let then = Dark::NextProjector;
            return self.enter(Step::Darkening { then }, Why::Sequence, now, out);
        }
        push(
            out,
            Action::Report(Event::ViewDone {
                session,
                view: self.view,
                frames,
                at: now,
            }),
        );
        let then = match usize::from(self.view).saturating_add(1) < views {
            true => Dark::NextView,
            false => Dark::Leave,
        };
        self.enter(Step::Darkening { then }, Why::Sequence, now, out);
    }

    /// No LED shines any more.
    pub(super) fn darkened(&mut self, now: Timestamp, then: Dark, out: &mut Actions) {
        match then {
            Dark::NextProjector => self.switch_on(now, out),
            Dark::NextView => {
                self.view = self.view.saturating_add(1);
                self.frame = 0;
                self.move_to_view(now, Why::Sequence, out);
            }
            Dark::Leave => self.withdraw(now, false, Then::Complete, Why::Complete, out),
        }
    }

    /// The projector whose frame this is.
    pub(super) fn shows(&self) -> Projector {
        let frame = self.frame_spec();
        frame.map_or(Projector::First, |frame| frame.projector)
    }

    pub(super) fn frame_spec(&self) -> Option<FrameSpec> {
        self.plan.as_ref()?.frame(self.frame)
    }

    pub(super) fn target(&self) -> Option<(View, Microseconds)> {
        let plan = self.plan.as_ref()?;
        Some((*plan.views.get(usize::from(self.view))?, plan.settle))
    }

    pub(super) fn stands_at(&self, view: View) -> bool {
        self.rotation.get().abs_diff(view.rotation.get())
            <= self.config.rotation_tolerance.get().unsigned_abs()
            && self.vertical.get().abs_diff(view.vertical.get())
                <= self.config.vertical_tolerance.get().unsigned_abs()
    }
}

/// Earliest trigger at or after `now` whose exposure does not end before the last readout has.
#[must_use]
pub fn earliest_trigger(
    now: Timestamp,
    readout_end: Timestamp,
    exposure: Microseconds,
) -> Timestamp {
    now.max(Timestamp(
        readout_end.get().saturating_sub(u64::from(exposure.get())),
    ))
}
