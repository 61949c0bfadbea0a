//! The capture sequence as a pure state machine: inputs with their time go in, actions come out.
//!
//! ```text
//! Unhomed ─► Homing ─► Ready ─► (Claiming) ─► Moving ─► Settling ─► (Cooling) ─► Lighting ─┐
//!              ▲         ▲        ▲                   ┌─ next projector ─►   ▼
//!              │         │        └── next view ── Darkening ◄── Capturing, per frame:
//!              │         │                             │            select ► loaded ► trigger DMD ► ready ► settle
//!              │         └──────── Retracting ◄────────┘            ► earliest start ► camera ready
//!              │                    │    ▲ abort, retract,          ► expose ► exposure over
//!              └── Unhomed ◄── Faulted   └ any fault: from every state, LED off first
//! ```
//! Rules that hold in every state, and that the tests check by brute force:
//! * an LED is enabled only between the settle of a view and its last frame: never while a stage moves;
//! * it is enabled only for the frames of its own projector, and only once the current of the other's is gone;
//! * a fault, an abort or a retract switches the LEDs and the camera trigger off in the same step that it arrives in;
//! * after a fault nothing starts until it is acknowledged, after power-up nothing until homed;
//! * every wait has a deadline;
//! * a lens has its voltage from the start of a capture to its end, however it ends, and at no other time. It is told before
//!   anything moves, and asked before every view whether it has it still.
//!
//! **Readout overlap.** The camera reads frame n out while frame n+1 is exposed. If the readout of frame n ends at r
//! and frame n+1 is exposed for e, it is triggered no earlier than r - e, so that it never ends inside that readout.

mod config;
mod exit;
mod identity;
mod orders;
mod signals;
mod view;

pub use config::Config;
pub use signals::{Action, Actions, Awaiting, CameraWait, Input, MAX_ACTIONS};
pub use view::earliest_trigger;

use crate::interlock::{Head, Position};
use crate::lamp::Confirmed;
use crate::lamps::Lamps;
use flankscope_protocol::{
    CapturePlan, Event, Fault, Limits, Micrometres, Microradians, Microseconds, PressStatus,
    Projector, StageConfig, State, Status, Timestamp, Why,
};
use signals::push;

/// Patience with the stages' answers to what they are: each is given up within 0.4 s.
const IDENTITY_TIMEOUT: Microseconds = Microseconds::from_millis(1_500);

/// Between two questions whether a pattern is loaded: a hundredth of the 200 ms that its maker names for an image in flash.
const LOADING_POLL: Microseconds = Microseconds::from_millis(2);

/// Between two tries of a retract.
const RETRACT_PAUSE: Microseconds = Microseconds::from_millis(50);

/// What happens once the head is retracted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Then {
    Ready(Why),
    Complete,
    Faulted,
}

/// What is done once all LEDs are dark.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Dark {
    /// The view goes on with the next projector's frames.
    NextProjector,
    NextView,
    Leave,
}

/// Inner state; [`Sequence::state`] is the coarser one that the host sees.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Step {
    Unhomed,
    /// The stages are asked what they are, before they reference.
    Identifying {
        until: Timestamp,
    },
    Homing {
        until: Timestamp,
    },
    Ready,
    /// Waiting for the interlock to let the head in.
    Claiming {
        until: Timestamp,
    },
    Moving {
        until: Timestamp,
    },
    Settling {
        until: Timestamp,
    },
    /// Settled; the lens is asked whether it has its voltage.
    Checking {
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
    /// The selected pattern is fetched from the DMD's flash; a trigger would be missed. It is asked again at `ask`.
    Loading {
        ask: Timestamp,
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
    /// LEDs off, waiting for them to be dark.
    Darkening {
        then: Dark,
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
    /// The stages as they are in force.
    stage: StageConfig,
    /// Others, from the next reference run on.
    next_stage: Option<StageConfig>,
    plan: Option<CapturePlan>,
    step: Step,
    lamps: Lamps,
    fault: Option<Fault>,
    homed: bool,
    /// The stages reported to stand retracted and have not been sent away since.
    parked: bool,
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
    /// The interlock has let the head in.
    may_enter: bool,
    /// The stages answered as the station's, or need not be asked, since the start of the capture.
    stages_known: bool,
    /// The lens has a voltage.
    lens_on: bool,
    /// It has come to rest by then.
    lens_rests_at: Timestamp,
    /// A retract failed and is tried again then.
    retract_again: Option<Timestamp>,
    host_heard: Timestamp,
}

impl Sequence {
    /// After power-up: nothing known, nothing moving.
    #[must_use]
    pub fn new(config: Config) -> Self {
        Self {
            config,
            stage: StageConfig::DEFAULT,
            next_stage: None,
            plan: None,
            step: Step::Unhomed,
            lamps: Lamps::new(&config.limits, Timestamp(0).after(config.led_off_timeout)),
            fault: None,
            homed: false,
            parked: false,
            rotation: Microradians(0),
            vertical: StageConfig::DEFAULT.vertical.home,
            ticket: 0,
            view: 0,
            frame: 0,
            frames_total: 0,
            dmd_at: Timestamp(0),
            camera_at: Timestamp(0),
            readout_end: Timestamp(0),
            may_enter: false,
            stages_known: false,
            lens_on: false,
            lens_rests_at: Timestamp(0),
            retract_again: None,
            host_heard: Timestamp(0),
        }
    }

    /// The clock stands here at the start: what a reset put out has its time from now on.
    pub fn begin(&mut self, now: Timestamp) {
        let until = now.after(self.config.led_off_timeout);
        self.lamps = Lamps::new(&self.config.limits, until);
    }

    /// What is true of the instrument.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The stages as they are in force: since the last reference run.
    pub fn stage(&self) -> &StageConfig {
        &self.stage
    }

    /// The stages as they are from the next reference run on.
    pub fn stage_to_be(&self) -> &StageConfig {
        self.next_stage.as_ref().unwrap_or(&self.stage)
    }

    /// What plans are judged by: the compiled limits, and the travel of the stages.
    pub fn plan_limits(&self) -> Limits {
        self.config.limits.within(self.stage_to_be())
    }

    /// Other stages were configured since the last reference run.
    pub fn must_home(&self) -> bool {
        self.next_stage.is_some()
    }

    /// The stored plan.
    pub fn plan(&self) -> Option<&CapturePlan> {
        self.plan.as_ref()
    }

    /// The fault that waits for its acknowledgement.
    pub fn fault(&self) -> Option<Fault> {
        self.fault
    }

    /// Both axes are referenced.
    pub fn homed(&self) -> bool {
        self.homed
    }

    /// What the host is told.
    pub fn state(&self) -> State {
        match self.step {
            Step::Unhomed => State::Unhomed,
            Step::Identifying { .. } | Step::Homing { .. } => State::Homing,
            Step::Ready => State::Ready,
            Step::Claiming { .. } => State::Claiming,
            Step::Moving { .. } => State::Moving,
            Step::Settling { .. } | Step::Checking { .. } => State::Settling,
            Step::Cooling { .. } => State::Cooling,
            Step::Lighting => State::Lighting,
            Step::Selecting { .. }
            | Step::Loading { .. }
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
    pub fn capturing(&self) -> bool {
        matches!(
            self.state(),
            State::Claiming
                | State::Moving
                | State::Settling
                | State::Cooling
                | State::Lighting
                | State::Capturing
                | State::Darkening
        )
    }

    /// What the interlock must know of the head.
    #[must_use]
    pub fn head(&self, now: Timestamp) -> Head {
        Head {
            position: match (self.homed, self.parked) {
                (false, _) => Position::Unknown,
                (true, true) => Position::Retracted,
                (true, false) => Position::Away,
            },
            host_alive: now < self.host_heard.after(self.config.host_silence),
        }
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
            led_on: self.lamps.enabled().is_some(),
            homed: self.homed && !self.must_home(),
            rotation: self.rotation,
            vertical: self.vertical,
            press: PressStatus::default(),
            at: now,
            frames_dropped: 0,
            events_lost: 0,
        }
    }

    /// Which pins to watch.
    pub fn awaiting(&self) -> Awaiting {
        Awaiting {
            led_sense: self.lamps.awaits(),
            dmd_ready: match self.step {
                Step::Switching { .. } => Some(self.shows()),
                _ => None,
            },
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
    pub fn deadline(&self) -> Option<Timestamp> {
        let step = match self.step {
            Step::Exposing { end, begin_by } => {
                Some(begin_by.map_or(end, |begin_by| end.min(begin_by)))
            }
            Step::Loading { ask, until } => Some(ask.min(until)),
            Step::Identifying { until }
            | Step::Homing { until }
            | Step::Claiming { until }
            | Step::Moving { until }
            | Step::Settling { until }
            | Step::Checking { until }
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
        [step, host, self.lamps.deadline(), self.retract_again]
            .into_iter()
            .flatten()
            .min()
    }

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
            Input::StagesAre { ticket, outcome } if ticket == self.ticket => {
                self.stages_are(now, outcome, out);
            }
            // An answer to a request that was overtaken by another.
            Input::InPosition { .. } | Input::StageFailed { .. } | Input::StagesAre { .. } => {}
            Input::LedSense(projector, level) => self.led_sense(now, projector, level, out),
            Input::PatternSelected(taken) => self.pattern_selected(now, taken, out),
            Input::PatternLoaded(loaded) => self.pattern_loaded(now, loaded, out),
            Input::DmdReady => self.dmd_ready(now, out),
            Input::CameraReady => self.camera_ready(now, out),
            Input::CameraExposing(level) => self.camera_exposing(now, level, out),
            Input::Lens(outcome) => self.lens(now, outcome, out),
            Input::EventsLost => self.fail(now, Fault::EventOverflow, 0, out),
            Input::MayEnter => {
                self.may_enter = true;
                self.enter_die(now, out);
            }
            Input::Unsafe(fault) => self.unsafe_press(now, fault, out),
            Input::Tick => {}
        }
        self.tick(now, out);
    }

    /// Everything that happens because its time has come.
    fn tick(&mut self, now: Timestamp, out: &mut Actions) {
        if let Err((projector, fault)) = self.lamps.expire(now) {
            self.fail(now, fault, projector.detail(), out);
        }
        if self.capturing() && now >= self.host_heard.after(self.config.host_silence) {
            self.fail(now, Fault::HostSilent, 0, out);
        }
        if self.retract_again.is_some_and(|at| now >= at) {
            self.retry_retract(out);
        }
        match self.step {
            Step::Identifying { until } if now >= until => {
                self.fail(now, Fault::StageSilent, 0, out);
            }
            Step::Homing { until } if now >= until => {
                self.homed = false;
                self.fail(now, Fault::MotionTimeout, 0, out);
            }
            Step::Claiming { until } if now >= until => {
                let fault = match self.stages_known {
                    true => Fault::InterlockLocked,
                    false => Fault::StageSilent,
                };
                self.fail(now, fault, 0, out);
            }
            Step::Moving { until } if now >= until => self.fail(now, Fault::MotionTimeout, 0, out),
            Step::Settling { until } if now >= until => self.settled(now, out),
            Step::Checking { until } if now >= until => self.fail(now, Fault::LensSilent, 0, out),
            Step::Cooling { until } if now >= until => self.light(now, out),
            Step::Selecting { until } | Step::Loading { until, .. } if now >= until => {
                self.fail(now, Fault::DmdSelect, self.shows().detail(), out);
            }
            Step::Loading { ask, until } if now >= ask => {
                self.step = Step::Loading { ask: until, until };
                push(out, Action::AskPattern(self.shows()));
            }
            Step::Switching { until } if now >= until => {
                self.fail(now, Fault::DmdNotReady, self.shows().detail(), out);
            }
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
                (self.homed, self.parked) = (true, true);
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
                            until: now.after(settle).max(self.lens_rests_at),
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
                    self.retract_again = Some(now.after(RETRACT_PAUSE));
                    return;
                }
                self.parked = true;
                self.retracted(now, then, out);
            }
            // Not as it was when it arrived.
            _ if self.at_view() => {
                let target = self.target();
                if !target.is_some_and(|(view, _)| self.stands_at(view)) {
                    self.fail(now, Fault::OffPosition, 0, out);
                }
            }
            _ => {}
        }
    }

    /// The head stands at a view and must not leave it.
    fn at_view(&self) -> bool {
        matches!(
            self.state(),
            State::Settling
                | State::Cooling
                | State::Lighting
                | State::Capturing
                | State::Darkening
        )
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
            // Whatever it was, the head must come out: tried again until the time for it is over.
            Step::Retracting { .. } => self.retract_again = Some(now.after(RETRACT_PAUSE)),
            Step::Homing { .. } => {
                self.homed = false;
                self.fail(now, fault, detail, out);
            }
            _ => self.fail(now, fault, detail, out),
        }
    }

    fn led_sense(&mut self, now: Timestamp, projector: Projector, level: bool, out: &mut Actions) {
        match self.lamps.sense(projector, level) {
            Err(fault) => self.fail(now, fault, projector.detail(), out),
            Ok(Some(Confirmed::Lit)) if self.step == Step::Lighting => {
                self.select(now, out);
            }
            Ok(Some(Confirmed::Dark)) => {
                if let Step::Darkening { then } = self.step {
                    self.darkened(now, then, out);
                }
            }
            Ok(_) => {}
        }
    }

    fn next_ticket(&mut self) -> u16 {
        self.ticket = self.ticket.wrapping_add(1);
        self.ticket
    }

    fn enter(&mut self, next: Step, why: Why, now: Timestamp, out: &mut Actions) {
        let prev = self.state();
        self.retract_again = None;
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
        // Last, as its bus takes its time.
        if self.lens_on && !self.capturing() {
            self.lens_on = false;
            push(out, Action::LensOff);
        }
    }
}

#[cfg(test)]
mod tests;
