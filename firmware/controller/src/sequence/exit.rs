//! The way out: whatever goes wrong ends dark, retracted and waiting.

use super::signals::{Action, Actions, push};
use super::{Sequence, Step, Then};
use flankscope_protocol::{Event, Fault, Micrometres, Microseconds, Timestamp, Why};

impl Sequence {
    /// A fault: all lights and triggers off at once, halt, retract, wait for an acknowledgement.
    pub(super) fn fail(&mut self, now: Timestamp, fault: Fault, detail: u32, out: &mut Actions) {
        let state = self.state();
        push(
            out,
            Action::Report(Event::Fault {
                fault: fault.code(),
                state,
                detail,
                at: now,
            }),
        );
        // The first fault is the cause; what follows from it is only reported.
        self.fault.get_or_insert(fault);
        match self.step {
            Step::Retracting { until, .. } => {
                self.dark(now, out);
                self.step = Step::Retracting {
                    until,
                    then: Then::Faulted,
                };
            }
            _ if self.homed => {
                let why = Why::Fault(fault.code());
                self.withdraw(now, self.capturing(), Then::Faulted, why, out);
            }
            _ => {
                self.dark(now, out);
                self.next_ticket();
                push(out, Action::StopStages);
                self.enter(Step::Faulted, Why::Fault(fault.code()), now, out);
            }
        }
    }

    /// The interlock wants the head out: a retract for a fault, whatever was going on.
    ///
    /// A head that is on its way out or has failed to get there already does what it can.
    pub(super) fn unsafe_press(&mut self, now: Timestamp, fault: Fault, out: &mut Actions) {
        match self.step {
            Step::Retracting {
                then: Then::Faulted,
                ..
            }
            | Step::Faulted => {}
            _ => self.fail(now, fault, 0, out),
        }
    }

    /// The head could not be brought out: where it is, is not known any more.
    pub(super) fn retract_failed(&mut self, now: Timestamp, detail: u32, out: &mut Actions) {
        let fault = Fault::RetractFailed;
        self.homed = false;
        self.next_ticket();
        push(
            out,
            Action::Report(Event::Fault {
                fault: fault.code(),
                state: self.state(),
                detail,
                at: now,
            }),
        );
        self.fault.get_or_insert(fault);
        self.dark(now, out);
        push(out, Action::StopStages);
        self.enter(Step::Faulted, Why::Fault(fault.code()), now, out);
    }

    /// The same retract once more.
    pub(super) fn retry_retract(&mut self, out: &mut Actions) {
        self.retract_again = None;
        if let Step::Retracting { .. } = self.step {
            let ticket = self.next_ticket();
            let vertical = self.retract_position();
            push(out, Action::Retract { ticket, vertical });
        }
    }

    pub(super) fn withdraw(
        &mut self,
        now: Timestamp,
        stop: bool,
        then: Then,
        why: Why,
        out: &mut Actions,
    ) {
        self.dark(now, out);
        if stop {
            push(out, Action::StopStages);
        }
        let ticket = self.next_ticket();
        push(
            out,
            Action::Retract {
                ticket,
                vertical: self.retract_position(),
            },
        );
        let patience = self
            .config
            .retract_timeout
            .max(self.stage.retract_timeout());
        self.enter(
            Step::Retracting {
                until: now.after(patience),
                then,
            },
            why,
            now,
            out,
        );
    }

    /// LEDs and triggers off, whatever was going on.
    pub(super) fn dark(&mut self, now: Timestamp, out: &mut Actions) {
        self.put_out(now, self.config.led_off_timeout, out);
        push(out, Action::CameraTrigger(false));
        push(out, Action::DmdTrigger(None));
    }

    /// LEDs off; their current must be gone within `timeout`.
    pub(super) fn put_out(&mut self, now: Timestamp, timeout: Microseconds, out: &mut Actions) {
        if let Some(projector) = self.lamps.switch_off(now, timeout) {
            push(out, Action::LedOff);
            push(
                out,
                Action::Report(Event::Led {
                    projector,
                    on: false,
                    at: now,
                }),
            );
        }
    }

    pub(super) fn retract_position(&self) -> Micrometres {
        self.plan
            .as_ref()
            .map_or(self.stage.vertical.home, |plan| plan.retract)
    }
}
