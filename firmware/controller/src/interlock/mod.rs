//! The press interlock: when the press may stroke, and when the head may be in the die.
//!
//! ```text
//!             home, acknowledge           switch made and retracted
//!   Locked ───────────────────► Armed ─────────────────────────────► Clear ◄──────────────┐
//!     ▲                                             head_clear high │                     │ out, no fault
//!     │ out, for a fault, or not out in time                  enter ▼                     │
//!     └──────────── Withdrawing ◄── any objection ── Claiming ─ press has obeyed ─► Entered
//!                   head retracts, LED off ◄── retract, any objection, stayed too long ┘
//! ```
//! [`rules`] decides without time and is tried exhaustively. [`Interlock`] adds the clock.
//!
//! This is not the certified safety function of the press. It keeps a working controller from doing harm; what must
//! hold when the controller fails belongs into the press's own safety chain.

pub mod rules;
mod verdict;

pub use rules::{Orders, Outputs, Phase, Position, State};
pub use verdict::{VerdictLamp, VerdictLines};

use flankscope_protocol::{Fault, Microseconds, Timestamp};
use rules::{Expired, Inputs};

/// Levels of the press's signals.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Levels {
    /// High = press open.
    pub press_open_a: bool,
    /// Low = press open.
    pub press_open_b: bool,
    /// High = nothing in the die.
    pub die_clear: bool,
    /// High = guard closed.
    pub guard_closed: bool,
    /// Rises when a cycle begins.
    pub cycle: bool,
    /// High = the retract switch is made.
    pub retract_switch: bool,
}

impl Levels {
    /// What a cut cable looks like.
    pub const DEAD: Self = Self {
        press_open_a: false,
        press_open_b: false,
        die_clear: false,
        guard_closed: false,
        cycle: false,
        retract_switch: false,
    };
}

/// Times of the interlock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Timing {
    /// The press-open channels may disagree for this long. Until they agree again the press counts as not open.
    pub disagreement: Microseconds,
    /// Retract switch and position may contradict each other for this long: the way between switch and target.
    pub contradiction: Microseconds,
    /// From taking head-clear away until the press must have obeyed.
    pub hold: Microseconds,
    /// From taking head-clear away until the head is called back whatever it is doing. The press is held for this and
    /// the way out at most; a host may ask for less, never for more.
    pub stay: Microseconds,
    /// For the head to be out. Longer than the sequence's own limit, which then says why.
    pub withdraw: Microseconds,
    /// A verdict shown falls to no-go after this.
    pub verdict_life: Microseconds,
    /// The verdict's heartbeat changes its level this often while a verdict is fresh.
    pub verdict_beat: Microseconds,
}

impl Timing {
    /// 500 ms of discrepancy is usual for two mechanical contacts; a press brake that ignores a start inhibit for
    /// 100 ms is broken.
    pub const DEFAULT: Self = Self {
        disagreement: Microseconds::from_millis(500),
        contradiction: Microseconds::from_millis(1_000),
        hold: Microseconds::from_millis(100),
        stay: Microseconds::from_millis(60_000),
        withdraw: Microseconds::from_millis(6_000),
        verdict_life: Microseconds::from_millis(5_000),
        verdict_beat: Microseconds::from_millis(250),
    };
}

/// What the sequence knows and the interlock must.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Head {
    /// Where the head is believed to be.
    pub position: Position,
    /// The host has spoken recently enough.
    pub host_alive: bool,
}

/// What one look changed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Change {
    /// The head may enter now: the claim was obeyed.
    pub entered: bool,
    /// This fault locks the interlock, now or once the head is out; [`Fault::HoldLimit`] lets the press go instead.
    pub fault: Option<Fault>,
    /// A cycle began.
    pub cycle: bool,
    /// The press opened (`true`) or is open no longer.
    pub press_open: Option<bool>,
}

/// The interlock with its clock.
#[derive(Debug, Clone)]
pub struct Interlock {
    timing: Timing,
    state: State,
    levels: Levels,
    head: Head,
    disagrees_until: Option<Timestamp>,
    contradicts_until: Option<Timestamp>,
    phase_until: Option<Timestamp>,
    stay_until: Option<Timestamp>,
    cycles: u32,
}

impl Interlock {
    /// Locked, with every signal dead.
    #[must_use]
    pub fn new(timing: Timing) -> Self {
        Self {
            timing,
            state: State::POWER_UP,
            levels: Levels::DEAD,
            head: Head {
                position: Position::Unknown,
                host_alive: false,
            },
            disagrees_until: None,
            contradicts_until: None,
            phase_until: None,
            stay_until: None,
            cycles: 0,
        }
    }

    /// Phase and flags.
    pub fn state(&self) -> State {
        self.state
    }

    /// What it says.
    pub fn outputs(&self) -> Outputs {
        rules::outputs(self.state)
    }

    /// Press cycles since power-up.
    pub fn cycles(&self) -> u32 {
        self.cycles
    }

    /// The signals as last looked at.
    pub fn levels(&self) -> Levels {
        self.levels
    }

    /// Both channels said that the press is open.
    pub fn press_open(&self) -> bool {
        self.levels.press_open_a && !self.levels.press_open_b
    }

    /// Why the head could not enter if it were ordered to now.
    pub fn objection(&self) -> Option<Fault> {
        let inputs = Inputs {
            cycle_began: false,
            // Whoever asks is alive.
            host_alive: true,
            ..self.inputs(self.levels, Orders::default(), Expired::default(), false)
        };
        let at_rest = (self.state.phase != Phase::Clear).then_some(match self.state.phase {
            Phase::Locked(Some(fault)) | Phase::Withdrawing(Some(fault)) => fault,
            _ => Fault::InterlockLocked,
        });
        rules::objection::<0>(self.state, &inputs).or(at_rest)
    }

    /// Samples every input, at `now`.
    pub fn sample_inputs(
        &mut self,
        now: Timestamp,
        levels: Levels,
        head: Head,
        orders: Orders,
    ) -> Change {
        let over = |until: Option<Timestamp>| until.is_some_and(|until| now >= until);
        let expired = Expired {
            disagreement: over(self.disagrees_until),
            contradiction: over(self.contradicts_until),
            phase: over(self.phase_until),
            stay: over(self.stay_until),
        };
        let was_open = self.press_open();
        let cycle = levels.cycle && !self.levels.cycle;
        self.cycles = self.cycles.wrapping_add(u32::from(cycle));
        (self.levels, self.head) = (levels, head);
        let before = self.state;
        let inputs = self.inputs(levels, orders, expired, cycle);
        self.state = rules::decide::<0>(before, &inputs);
        self.run_times(now, before);
        let overstayed = expired.stay
            && !orders.retract
            && in_use(before.phase)
            && self.state.phase == Phase::Withdrawing(None);
        Change {
            entered: self.state.phase == Phase::Entered && before.phase != Phase::Entered,
            fault: cause(self.state.phase)
                .filter(|_| cause(before.phase).is_none())
                .or(overstayed.then_some(Fault::HoldLimit)),
            cycle,
            press_open: (self.press_open() != was_open).then_some(self.press_open()),
        }
    }

    /// When to look again at the latest. An expired time that changed nothing is not waited for again.
    #[must_use]
    pub fn deadline(&self, now: Timestamp) -> Option<Timestamp> {
        [
            self.disagrees_until,
            self.contradicts_until,
            self.phase_until,
            self.stay_until,
        ]
        .into_iter()
        .flatten()
        .filter(|until| *until > now)
        .min()
    }

    fn inputs(&self, levels: Levels, orders: Orders, expired: Expired, cycle: bool) -> Inputs {
        Inputs {
            press_open_a: levels.press_open_a,
            press_open_b: levels.press_open_b,
            die_clear: levels.die_clear,
            guard_closed: levels.guard_closed,
            cycle_began: cycle,
            retract_switch: levels.retract_switch,
            position: self.head.position,
            host_alive: self.head.host_alive,
            orders,
            expired,
        }
    }

    /// A time begins when its condition does and ends with it.
    fn run_times(&mut self, now: Timestamp, before: State) {
        let run = |until: Option<Timestamp>, runs: bool, time: Microseconds| {
            runs.then(|| until.unwrap_or(now.after(time)))
        };
        let Timing {
            disagreement,
            contradiction,
            hold,
            stay,
            withdraw,
            ..
        } = self.timing;
        self.disagrees_until = run(self.disagrees_until, self.state.disagrees, disagreement);
        self.contradicts_until = run(
            self.contradicts_until,
            self.state.contradicts,
            contradiction,
        );
        self.stay_until = run(self.stay_until, in_use(self.state.phase), stay);
        let withdrawing = |phase| matches!(phase, Phase::Withdrawing(_));
        self.phase_until = match self.state.phase {
            Phase::Claiming if before.phase != Phase::Claiming => Some(now.after(hold)),
            phase if withdrawing(phase) && !withdrawing(before.phase) => Some(now.after(withdraw)),
            Phase::Claiming | Phase::Withdrawing(_) => self.phase_until,
            _ => None,
        };
    }
}

/// The press is held for the head to go in or be in.
fn in_use(phase: Phase) -> bool {
    matches!(phase, Phase::Claiming | Phase::Entered)
}

fn cause(phase: Phase) -> Option<Fault> {
    match phase {
        Phase::Locked(cause) | Phase::Withdrawing(cause) => cause,
        _ => None,
    }
}

#[cfg(test)]
mod model;
#[cfg(test)]
mod tests;
