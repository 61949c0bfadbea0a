//! The capture sequence as a pure state machine: inputs with their time go in, actions come out.
//!
//! ```text
//! Unhomed ─► Homing ─► Ready ─► Moving ─► Settling ─► (Cooling) ─► Lighting ─┐
//!              ▲         ▲        ▲                                          ▼
//!              │         │        └── next view ── Darkening ◄── Capturing, per frame:
//!              │         │                             │            select ► trigger DMD ► ready ► settle
//!              │         └──────── Retracting ◄────────┘            ► earliest start ► camera ready
//!              │                    │    ▲ abort, retract,          ► expose ► exposure over
//!              └── Unhomed ◄── Faulted   └ any fault: from every state, LED off first
//! ```
//! Rules that hold in every state, and that the tests check by brute force:
//! * the LED is enabled only between the settle of a view and its last frame: never while a stage moves;
//! * a fault, an abort or a retract switches the LED and the camera trigger off in the same step that it arrives in;
//! * after a fault nothing starts until it is acknowledged, after power-up nothing until homed;
//! * every wait has a deadline.
//!
//! **Readout overlap.** The camera reads frame n out while frame n+1 is exposed. If the readout of frame n ends at r
//! and frame n+1 is exposed for e, it is triggered no earlier than r - e, so that it never ends inside that readout.

use crate::lamp::{Confirmed, Lamp};
use flankscope_protocol::{
    CapturePlan, Event, Fault, FrameSpec, Limits, Micrometres, Microradians, Microseconds,
    Milliamps, State, Status, Timestamp, Trigger, View, Why,
};

/// Most actions of one step: the longest chain is a fault (event, LED, event, camera, DMD, stop, retract, event).
pub const MAX_ACTIONS: usize = 16;

/// What one step wants done, in this order.
pub type Actions = heapless::Vec<Action, MAX_ACTIONS>;

/// What is true of the instrument, not of a plan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Config {
    /// Plans are judged by these.
    pub limits: Limits,
    /// Position of the vertical stage at its home switch: the head is clear of the die there.
    pub home_vertical: Micrometres,
    /// For a whole reference run.
    pub home_timeout: Microseconds,
    /// For a retract.
    pub retract_timeout: Microseconds,
    /// How long the host may say nothing during a capture.
    pub host_silence: Microseconds,
    /// For the LED current to be gone when no plan says otherwise.
    pub led_off_timeout: Microseconds,
    /// How far from its target the rotary stage may report itself in position.
    pub rotation_tolerance: Microradians,
    /// How far from its target the vertical stage may report itself in position.
    pub vertical_tolerance: Micrometres,
    /// How much longer than commanded a trigger pulse may come out.
    pub exposure_tolerance: Microseconds,
}

impl Config {
    /// The instrument with the 20 mm head; the home switch sits 100 mm above the working zero, clear of a 66 mm die.
    ///
    /// Tolerances are three times the stages' own errors (±15 mdeg = 262 urad, ±5 um). A pulse 100 us too long would
    /// brighten a 10 ms frame by 1 %.
    pub const DEFAULT: Self = Self {
        limits: Limits::DEFAULT,
        home_vertical: Micrometres(100_000),
        home_timeout: Microseconds::from_millis(30_000),
        retract_timeout: Microseconds::from_millis(5_000),
        host_silence: Microseconds::from_millis(100),
        led_off_timeout: Microseconds::from_millis(50),
        rotation_tolerance: Microradians(786),
        vertical_tolerance: Micrometres(15),
        exposure_tolerance: Microseconds(100),
    };
}

/// Something the outside did, or found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Input {
    /// A valid command arrived: the host is alive.
    HostAlive,
    /// The stages stand where request `ticket` sent them.
    InPosition {
        /// Which request.
        ticket: u16,
        /// Reported angle.
        rotation: Microradians,
        /// Reported position.
        vertical: Micrometres,
    },
    /// The stages failed at request `ticket`.
    StageFailed {
        /// Which request.
        ticket: u16,
        /// How.
        fault: Fault,
        /// The stage controller's own error number, 0 if none.
        detail: u32,
    },
    /// Level of the LED's current sense.
    LedSense(bool),
    /// The DMD took the pattern selection, or did not.
    PatternSelected(bool),
    /// The DMD says that the selected pattern stands.
    DmdReady,
    /// The camera can be triggered.
    CameraReady,
    /// Level of the camera's exposure-active line.
    CameraExposing(bool),
    /// Events for the host were lost.
    EventsLost,
    /// Only time has passed.
    Tick,
}

/// Something to be done now.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Action {
    /// Reference both axes, vertical first.
    Home {
        /// To be repeated in the answer.
        ticket: u16,
    },
    /// Move both axes to a view.
    Move {
        /// To be repeated in the answer.
        ticket: u16,
        /// Where to.
        view: View,
    },
    /// Move the vertical axis alone.
    Retract {
        /// To be repeated in the answer.
        ticket: u16,
        /// Where to.
        vertical: Micrometres,
    },
    /// Halt both axes.
    StopStages,
    /// Enable the LED at this current.
    LedOn(Milliamps),
    /// Disable the LED.
    LedOff,
    /// Select a pattern; answer with [`Input::PatternSelected`] before anything else.
    SelectPattern(u16),
    /// Level of the DMD trigger: the rising edge shows the selected pattern.
    DmdTrigger(bool),
    /// Level of the camera trigger: exposed while high.
    CameraTrigger(bool),
    /// Tell the host.
    Report(Event),
}

/// Which pins to watch; anything they say is passed to [`Sequence::step`].
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Awaiting {
    /// Level of the LED's current sense that would be news.
    pub led_sense: Option<bool>,
    /// Watch the DMD's ready line.
    pub dmd_ready: bool,
    /// Watch the camera.
    pub camera: Option<crate::devices::CameraWait>,
}

/// What happens once the head is retracted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Then {
    Ready(Why),
    Complete,
    Faulted,
}

/// Inner state; [`Sequence::state`] is the coarser one that the host sees.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Step {
    Unhomed,
    Homing {
        until: Timestamp,
    },
    Ready,
    Moving {
        until: Timestamp,
    },
    Settling {
        until: Timestamp,
    },
    Cooling {
        until: Timestamp,
    },
    Lighting,
    /// A pattern selection is on the bus.
    Selecting {
        until: Timestamp,
    },
    /// DMD triggered, waiting for ready.
    Switching {
        until: Timestamp,
    },
    /// Pattern stands, mirrors settle.
    Standing {
        until: Timestamp,
    },
    /// Waiting until the exposure cannot end inside the last readout.
    Holding {
        until: Timestamp,
    },
    /// Waiting for the camera to be ready.
    Arming {
        until: Timestamp,
    },
    /// Trigger high; `begin_by` is set until the camera has said that it exposes.
    Exposing {
        end: Timestamp,
        begin_by: Option<Timestamp>,
    },
    /// Trigger low, waiting for the camera to say that the exposure is over.
    Closing {
        until: Timestamp,
    },
    /// LED off, waiting for it to be dark.
    Darkening {
        after_last: bool,
    },
    Retracting {
        until: Timestamp,
        then: Then,
    },
    Faulted,
}

/// The sequence. See the module for its rules.
#[derive(Debug, Clone)]
pub struct Sequence {
    config: Config,
    plan: Option<CapturePlan>,
    step: Step,
    lamp: Lamp,
    fault: Option<Fault>,
    homed: bool,
    rotation: Microradians,
    vertical: Micrometres,
    /// Request to the stages that is still open; answers to older ones are stale.
    ticket: u16,
    view: u8,
    frame: u16,
    frames_total: u32,
    dmd_at: Timestamp,
    camera_at: Timestamp,
    readout_end: Timestamp,
    host_heard: Timestamp,
}

impl Sequence {
    /// After power-up: nothing known, nothing moving.
    #[must_use]
    pub fn new(config: Config) -> Self {
        Self {
            config,
            plan: None,
            step: Step::Unhomed,
            lamp: Lamp::new(&config.limits),
            fault: None,
            homed: false,
            rotation: Microradians(0),
            vertical: config.home_vertical,
            ticket: 0,
            view: 0,
            frame: 0,
            frames_total: 0,
            dmd_at: Timestamp(0),
            camera_at: Timestamp(0),
            readout_end: Timestamp(0),
            host_heard: Timestamp(0),
        }
    }

    /// What is true of the instrument.
    #[must_use]
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The stored plan.
    #[must_use]
    pub fn plan(&self) -> Option<&CapturePlan> {
        self.plan.as_ref()
    }

    /// The fault that waits for its acknowledgement.
    #[must_use]
    pub fn fault(&self) -> Option<Fault> {
        self.fault
    }

    /// Both axes are referenced.
    #[must_use]
    pub fn homed(&self) -> bool {
        self.homed
    }

    /// What the host is told.
    #[must_use]
    pub fn state(&self) -> State {
        match self.step {
            Step::Unhomed => State::Unhomed,
            Step::Homing { .. } => State::Homing,
            Step::Ready => State::Ready,
            Step::Moving { .. } => State::Moving,
            Step::Settling { .. } => State::Settling,
            Step::Cooling { .. } => State::Cooling,
            Step::Lighting => State::Lighting,
            Step::Selecting { .. }
            | Step::Switching { .. }
            | Step::Standing { .. }
            | Step::Holding { .. }
            | Step::Arming { .. }
            | Step::Exposing { .. }
            | Step::Closing { .. } => State::Capturing,
            Step::Darkening { .. } => State::Darkening,
            Step::Retracting { .. } => State::Retracting,
            Step::Faulted => State::Faulted,
        }
    }

    /// A capture is under way: the host must be alive, the head may be in the die.
    #[must_use]
    pub fn capturing(&self) -> bool {
        matches!(
            self.state(),
            State::Moving
                | State::Settling
                | State::Cooling
                | State::Lighting
                | State::Capturing
                | State::Darkening
        )
    }

    /// Everything the host may ask for; the caller fills in what only the link knows.
    #[must_use]
    pub fn status(&self, now: Timestamp) -> Status {
        Status {
            state: self.state(),
            fault: self.fault.map(Fault::code),
            plan: self.plan.as_ref().map(|plan| plan.session),
            view: self.view,
            frame: self.frame,
            led_on: self.lamp.enabled(),
            homed: self.homed,
            rotation: self.rotation,
            vertical: self.vertical,
            at: now,
            frames_dropped: 0,
            events_lost: 0,
        }
    }

    /// Which pins to watch.
    #[must_use]
    pub fn awaiting(&self) -> Awaiting {
        use crate::devices::CameraWait;
        Awaiting {
            led_sense: self.lamp.awaits(),
            dmd_ready: matches!(self.step, Step::Switching { .. }),
            camera: match self.step {
                Step::Arming { .. } => Some(CameraWait::Ready),
                Step::Exposing {
                    begin_by: Some(_), ..
                } => Some(CameraWait::Exposing(true)),
                Step::Closing { .. } => Some(CameraWait::Exposing(false)),
                _ => None,
            },
        }
    }

    /// When to call [`Sequence::step`] with [`Input::Tick`] at the latest.
    #[must_use]
    pub fn deadline(&self) -> Option<Timestamp> {
        let step = match self.step {
            Step::Exposing { end, begin_by } => {
                Some(begin_by.map_or(end, |begin_by| end.min(begin_by)))
            }
            Step::Homing { until }
            | Step::Moving { until }
            | Step::Settling { until }
            | Step::Cooling { until }
            | Step::Selecting { until }
            | Step::Switching { until }
            | Step::Standing { until }
            | Step::Holding { until }
            | Step::Arming { until }
            | Step::Closing { until }
            | Step::Retracting { until, .. } => Some(until),
            Step::Unhomed
            | Step::Ready
            | Step::Lighting
            | Step::Darkening { .. }
            | Step::Faulted => None,
        };
        let host = self
            .capturing()
            .then(|| self.host_heard.after(self.config.host_silence));
        [step, host, self.lamp.deadline()]
            .into_iter()
            .flatten()
            .min()
    }

    // --- orders, already judged by the desk -------------------------------------------------------------------

    pub(crate) fn store(&mut self, plan: CapturePlan) {
        self.plan = Some(plan);
    }

    pub(crate) fn start(&mut self, now: Timestamp, out: &mut Actions) {
        (self.view, self.frame, self.frames_total) = (0, 0, 0);
        self.host_heard = now;
        self.readout_end = now;
        self.move_to_view(now, Why::Start, out);
    }

    pub(crate) fn home(&mut self, now: Timestamp, out: &mut Actions) {
        self.homed = false;
        let ticket = self.next_ticket();
        push(out, Action::Home { ticket });
        self.enter(
            Step::Homing {
                until: now.after(self.config.home_timeout),
            },
            Why::Home,
            now,
            out,
        );
    }

    /// LED off, halt, retract. Halting a retract that is under way would be less safe, so that goes on.
    pub(crate) fn abort(&mut self, now: Timestamp, out: &mut Actions) {
        if self.capturing() {
            self.withdraw(now, true, Then::Ready(Why::Abort), Why::Abort, out);
        } else if matches!(self.step, Step::Homing { .. }) {
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
            self.lamp.acknowledge();
            let next = if self.homed {
                Step::Ready
            } else {
                Step::Unhomed
            };
            self.enter(next, Why::Acknowledged, now, out);
        }
    }

    // --- inputs --------------------------------------------------------------------------------------------------

    /// Takes one input at time `now` and appends what to do about it to `out`. Deadlines are looked at every time.
    pub fn step(&mut self, now: Timestamp, input: Input, out: &mut Actions) {
        match input {
            Input::HostAlive => self.host_heard = now,
            Input::InPosition {
                ticket,
                rotation,
                vertical,
            } if ticket == self.ticket => {
                (self.rotation, self.vertical) = (rotation, vertical);
                self.in_position(now, out);
            }
            Input::StageFailed {
                ticket,
                fault,
                detail,
            } if ticket == self.ticket => {
                self.stage_failed(now, fault, detail, out);
            }
            // An answer to a request that was overtaken by another.
            Input::InPosition { .. } | Input::StageFailed { .. } => {}
            Input::LedSense(level) => self.led_sense(now, level, out),
            Input::PatternSelected(taken) => self.pattern_selected(now, taken, out),
            Input::DmdReady => self.dmd_ready(now, out),
            Input::CameraReady => self.camera_ready(now, out),
            Input::CameraExposing(level) => self.camera_exposing(now, level, out),
            Input::EventsLost => self.fail(now, Fault::EventOverflow, 0, out),
            Input::Tick => {}
        }
        self.tick(now, out);
    }

    /// Everything that happens because its time has come.
    fn tick(&mut self, now: Timestamp, out: &mut Actions) {
        if let Err(fault) = self.lamp.expire(now) {
            self.fail(now, fault, 0, out);
        }
        if self.capturing() && now >= self.host_heard.after(self.config.host_silence) {
            self.fail(now, Fault::HostSilent, 0, out);
        }
        match self.step {
            Step::Homing { until } if now >= until => {
                self.homed = false;
                self.fail(now, Fault::MotionTimeout, 0, out);
            }
            Step::Moving { until } if now >= until => self.fail(now, Fault::MotionTimeout, 0, out),
            Step::Settling { until } if now >= until => self.light(now, out),
            Step::Cooling { until } if now >= until => self.light(now, out),
            Step::Selecting { until } if now >= until => self.fail(now, Fault::DmdSelect, 0, out),
            Step::Switching { until } if now >= until => self.fail(now, Fault::DmdNotReady, 0, out),
            Step::Standing { until } if now >= until => self.hold(now, out),
            Step::Holding { until } if now >= until => self.arm(now),
            Step::Arming { until } if now >= until => self.fail(now, Fault::CameraNotReady, 0, out),
            Step::Exposing {
                begin_by: Some(begin_by),
                ..
            } if now >= begin_by => {
                self.fail(now, Fault::CameraNoExposure, 0, out);
            }
            Step::Exposing { end, begin_by } if now >= end => match begin_by {
                Some(_) => self.fail(now, Fault::CameraNoExposure, 0, out),
                None => self.close(now, end, out),
            },
            Step::Closing { until } if now >= until => self.fail(now, Fault::CameraStuck, 0, out),
            Step::Retracting { until, .. } if now >= until => self.retract_failed(now, 0, out),
            _ => {}
        }
    }

    fn in_position(&mut self, now: Timestamp, out: &mut Actions) {
        match self.step {
            Step::Homing { .. } => {
                self.homed = true;
                self.enter(Step::Ready, Why::Sequence, now, out);
            }
            Step::Moving { .. } => match self.target() {
                Some((view, settle)) if self.stands_at(view) => {
                    push(
                        out,
                        Action::Report(Event::InPosition {
                            view: self.view,
                            rotation: self.rotation,
                            vertical: self.vertical,
                            at: now,
                        }),
                    );
                    self.enter(
                        Step::Settling {
                            until: now.after(settle),
                        },
                        Why::Sequence,
                        now,
                        out,
                    );
                }
                Some(_) => self.fail(now, Fault::OffPosition, 0, out),
                None => self.fail(now, Fault::OutOfStep, 0, out),
            },
            Step::Retracting { then, .. } => {
                let off_um = self.vertical.get().abs_diff(self.retract_position().get());
                if off_um > self.config.vertical_tolerance.get().unsigned_abs() {
                    return self.retract_failed(now, off_um, out);
                }
                self.retracted(now, then, out);
            }
            _ => {}
        }
    }

    fn retracted(&mut self, now: Timestamp, then: Then, out: &mut Actions) {
        match then {
            Then::Ready(why) => self.enter(Step::Ready, why, now, out),
            Then::Faulted => {
                let why = self
                    .fault
                    .map_or(Why::Sequence, |fault| Why::Fault(fault.code()));
                self.enter(Step::Faulted, why, now, out);
            }
            Then::Complete => {
                self.enter(Step::Ready, Why::Complete, now, out);
                let session = self.plan.as_ref().map_or(0, |plan| plan.session);
                let (views, frames) = (self.view.saturating_add(1), self.frames_total);
                push(
                    out,
                    Action::Report(Event::CaptureDone {
                        session,
                        views,
                        frames,
                        at: now,
                    }),
                );
            }
        }
    }

    fn stage_failed(&mut self, now: Timestamp, fault: Fault, detail: u32, out: &mut Actions) {
        match self.step {
            Step::Retracting { .. } => self.retract_failed(now, detail, out),
            Step::Homing { .. } => {
                self.homed = false;
                self.fail(now, fault, detail, out);
            }
            _ => self.fail(now, fault, detail, out),
        }
    }

    fn led_sense(&mut self, now: Timestamp, level: bool, out: &mut Actions) {
        match self.lamp.sense(level) {
            Err(fault) => self.fail(now, fault, 0, out),
            Ok(Some(Confirmed::Lit)) if self.step == Step::Lighting => {
                self.select(now, out);
            }
            Ok(Some(Confirmed::Dark)) => {
                if let Step::Darkening { after_last } = self.step {
                    self.leave_view(now, after_last, out);
                }
            }
            Ok(_) => {}
        }
    }

    // --- one view ------------------------------------------------------------------------------------------------

    fn move_to_view(&mut self, now: Timestamp, why: Why, out: &mut Actions) {
        let Some((view, _)) = self.target() else {
            return self.fail(now, Fault::OutOfStep, 0, out);
        };
        let motion = self
            .plan
            .as_ref()
            .map_or(self.config.retract_timeout, |plan| plan.timeouts.motion);
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

    /// Settled: light the LED, once it has cooled enough to last the whole view.
    fn light(&mut self, now: Timestamp, out: &mut Actions) {
        let Some((need, led, timeout)) = self
            .plan
            .as_ref()
            .map(|plan| (plan.led_on_per_view(), plan.led, plan.timeouts.led))
        else {
            return self.fail(now, Fault::OutOfStep, 0, out);
        };
        match self.lamp.budget().ready_at(now, need) {
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
                self.lamp.switch_on(now, timeout);
                push(out, Action::LedOn(led));
                push(out, Action::Report(Event::Led { on: true, at: now }));
                self.enter(Step::Lighting, Why::Sequence, now, out);
            }
        }
    }

    fn select(&mut self, now: Timestamp, out: &mut Actions) {
        let Some((frame, timeout)) = self
            .frame_spec()
            .zip(self.plan.as_ref().map(|plan| plan.timeouts.dmd))
        else {
            return self.fail(now, Fault::OutOfStep, 0, out);
        };
        push(out, Action::SelectPattern(frame.pattern));
        self.enter(
            Step::Selecting {
                until: now.after(timeout),
            },
            Why::Sequence,
            now,
            out,
        );
    }

    fn pattern_selected(&mut self, now: Timestamp, taken: bool, out: &mut Actions) {
        let Step::Selecting { .. } = self.step else {
            return;
        };
        match self.plan.as_ref().map(|plan| plan.timeouts.dmd) {
            Some(timeout) if taken => {
                self.dmd_at = now;
                push(out, Action::DmdTrigger(true));
                self.step = Step::Switching {
                    until: now.after(timeout),
                };
            }
            _ => self.fail(now, Fault::DmdSelect, 0, out),
        }
    }

    fn dmd_ready(&mut self, now: Timestamp, out: &mut Actions) {
        let Step::Switching { .. } = self.step else {
            return;
        };
        push(out, Action::DmdTrigger(false));
        let settle = self
            .plan
            .as_ref()
            .map_or(Microseconds(0), |plan| plan.dmd_settle);
        self.step = Step::Standing {
            until: now.after(settle),
        };
    }

    fn hold(&mut self, now: Timestamp, out: &mut Actions) {
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

    fn arm(&mut self, now: Timestamp) {
        let timeout = self
            .plan
            .as_ref()
            .map_or(Microseconds(0), |plan| plan.timeouts.camera);
        self.step = Step::Arming {
            until: now.after(timeout),
        };
    }

    fn camera_ready(&mut self, now: Timestamp, out: &mut Actions) {
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

    fn camera_exposing(&mut self, now: Timestamp, level: bool, out: &mut Actions) {
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
    fn close(&mut self, now: Timestamp, end: Timestamp, out: &mut Actions) {
        push(out, Action::CameraTrigger(false));
        let Some((plan, frame)) = self.plan.as_ref().zip(self.frame_spec()) else {
            return self.fail(now, Fault::OutOfStep, 0, out);
        };
        let trigger = Trigger {
            session: plan.session,
            view: self.view,
            frame: self.frame,
            pattern: frame.pattern,
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

    fn frame_done(&mut self, now: Timestamp, out: &mut Actions) {
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
        if self.frame < frames {
            return self.select(now, out);
        }
        self.lamp.switch_off(now, led_timeout);
        push(out, Action::LedOff);
        push(out, Action::Report(Event::Led { on: false, at: now }));
        push(
            out,
            Action::Report(Event::ViewDone {
                session,
                view: self.view,
                frames,
                at: now,
            }),
        );
        let after_last = usize::from(self.view).saturating_add(1) >= views;
        self.enter(Step::Darkening { after_last }, Why::Sequence, now, out);
    }

    fn leave_view(&mut self, now: Timestamp, after_last: bool, out: &mut Actions) {
        if after_last {
            self.withdraw(now, false, Then::Complete, Why::Complete, out);
        } else {
            self.view = self.view.saturating_add(1);
            self.frame = 0;
            self.move_to_view(now, Why::Sequence, out);
        }
    }

    // --- the way out -----------------------------------------------------------------------------------------------

    /// A fault: all lights and triggers off at once, halt, retract, wait for an acknowledgement.
    fn fail(&mut self, now: Timestamp, fault: Fault, detail: u32, out: &mut Actions) {
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

    /// The head could not be brought out: where it is, is not known any more.
    fn retract_failed(&mut self, now: Timestamp, detail: u32, out: &mut Actions) {
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

    fn withdraw(&mut self, now: Timestamp, stop: bool, then: Then, why: Why, out: &mut Actions) {
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
        self.enter(
            Step::Retracting {
                until: now.after(self.config.retract_timeout),
                then,
            },
            why,
            now,
            out,
        );
    }

    /// LED and triggers off, whatever was going on.
    fn dark(&mut self, now: Timestamp, out: &mut Actions) {
        if self.lamp.switch_off(now, self.config.led_off_timeout) {
            push(out, Action::LedOff);
            push(out, Action::Report(Event::Led { on: false, at: now }));
        }
        push(out, Action::CameraTrigger(false));
        push(out, Action::DmdTrigger(false));
    }

    // --- small helpers -----------------------------------------------------------------------------------------------

    fn retract_position(&self) -> Micrometres {
        self.plan
            .as_ref()
            .map_or(self.config.home_vertical, |plan| plan.retract)
    }

    fn frame_spec(&self) -> Option<FrameSpec> {
        self.plan.as_ref()?.frame(self.frame)
    }

    fn target(&self) -> Option<(View, Microseconds)> {
        let plan = self.plan.as_ref()?;
        Some((*plan.views.get(usize::from(self.view))?, plan.settle))
    }

    fn stands_at(&self, view: View) -> bool {
        self.rotation.get().abs_diff(view.rotation.get())
            <= self.config.rotation_tolerance.get().unsigned_abs()
            && self.vertical.get().abs_diff(view.vertical.get())
                <= self.config.vertical_tolerance.get().unsigned_abs()
    }

    fn next_ticket(&mut self) -> u16 {
        self.ticket = self.ticket.wrapping_add(1);
        self.ticket
    }

    fn enter(&mut self, next: Step, why: Why, now: Timestamp, out: &mut Actions) {
        let prev = self.state();
        self.step = next;
        let next = self.state();
        if prev != next {
            push(
                out,
                Action::Report(Event::StateChanged {
                    prev,
                    next,
                    why,
                    at: now,
                }),
            );
        }
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

/// [`MAX_ACTIONS`] is ample for every step (a test counts); should it ever not be, the outputs come first.
fn push(out: &mut Actions, action: Action) {
    if let Err(action) = out.push(action)
        && !matches!(action, Action::Report(_))
        && let Some(report) = out
            .iter()
            .rposition(|kept| matches!(kept, Action::Report(_)))
    {
        let _report = out.remove(report);
        let _fits = out.push(action);
    }
}

#[cfg(test)]
mod tests;
