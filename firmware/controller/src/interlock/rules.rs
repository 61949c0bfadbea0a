//! The decisions of the interlock, without time: what follows from a state and one vector of inputs.
//!
//! Everything here is small enough to be tried exhaustively (`model.rs`): 4 phases
//! without a cause and 2 with one of 10, three flags, and inputs of 14 bits and three positions. Outputs follow from
//! the phase alone, so each condition stands in one place only.

use flankscope_protocol::Fault;

/// Where the head is, as far as the sequence knows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Position {
    /// Not referenced, or lost.
    Unknown,
    /// The stages reported that they stand retracted, and have not been sent away since.
    Retracted,
    /// On its way, or in the die.
    Away,
}

/// What the host and the sequence want in this step.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub struct Orders {
    /// Homing was ordered or a fault acknowledged: leave the locked state.
    pub release: bool,
    /// A capture was ordered: the head wants to enter the die.
    pub enter: bool,
    /// The head is being retracted. Wins over everything else.
    pub retract: bool,
}

/// Which of the running times are over. A time that does not run says nothing.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub struct Expired {
    /// The press-open channels have disagreed for too long.
    pub disagreement: bool,
    /// Retract switch and position have contradicted each other for too long.
    pub contradiction: bool,
    /// Claiming: the press must have obeyed by now. Withdrawing: the head should be out by now.
    pub phase: bool,
    /// Claiming or entered: the press has been held for as long as it may be.
    pub stay: bool,
}

/// Everything the interlock decides by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Inputs {
    /// Channel A: high = press open.
    pub press_open_a: bool,
    /// Channel B: low = press open. A broken wire or a short makes the two equal.
    pub press_open_b: bool,
    /// High = nothing in the die.
    pub die_clear: bool,
    /// High = guard closed.
    pub guard_closed: bool,
    /// A press cycle began.
    pub cycle_began: bool,
    /// Retract switch: high = made.
    pub retract_switch: bool,
    /// Where the sequence believes the head to be.
    pub position: Position,
    /// The host has spoken recently enough.
    pub host_alive: bool,
    /// What is wanted.
    pub orders: Orders,
    /// What time has passed.
    pub expired: Expired,
}

impl Inputs {
    /// Both channels say that the press is open.
    pub fn press_open(&self) -> bool {
        self.press_open_a && !self.press_open_b
    }
}

/// What the interlock is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Phase {
    /// After power-up (`None`) or a fault: the press may not stroke, the head may not enter, nothing moves by itself.
    Locked(Option<Fault>),
    /// Released by an order; the press may not stroke yet because the head is not proven clear.
    Armed,
    /// The head is proven clear: the press may stroke.
    Clear,
    /// The press may not stroke any more; waiting until it must have obeyed.
    Claiming,
    /// The head may be in the die, and the LED may be on.
    Entered,
    /// The head is being retracted; for a fault, which will lock the interlock once the head is out, or for none.
    Withdrawing(Option<Fault>),
}

/// State between steps. Whether a time runs follows from it: `disagrees`, `contradicts`, and two of the phases.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct State {
    pub phase: Phase,
    /// The press-open channels disagree.
    pub disagrees: bool,
    /// Retract switch and position contradict each other.
    pub contradicts: bool,
    /// A cycle has begun and the press has not left its open position yet: it is about to close.
    pub cycling: bool,
}

impl State {
    /// After power-up.
    pub const POWER_UP: Self = Self {
        phase: Phase::Locked(None),
        disagrees: false,
        contradicts: false,
        cycling: false,
    };
}

/// What the interlock says.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub struct Outputs {
    /// The press may stroke. Drives two outputs that are low without power.
    pub head_clear: bool,
    /// The head may leave its retracted position, and the LED may be on.
    pub may_enter: bool,
    /// The head must be retracted now.
    pub retract: bool,
}

/// Follows from the phase alone.
#[must_use]
pub fn outputs(state: State) -> Outputs {
    Outputs {
        head_clear: state.phase == Phase::Clear,
        may_enter: state.phase == Phase::Entered,
        retract: matches!(state.phase, Phase::Withdrawing(_)),
    }
}

/// Every rule, so that a test can switch each of them off and see that it is missed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum Rule {
    /// Clear is reached only with the retract switch made.
    SwitchToClear,
    /// Clear is reached only at a known, retracted position.
    PositionToClear,
    /// Clear ends when the retract switch opens.
    SwitchHoldsClear,
    /// Clear ends when the position is not the retracted one any more.
    PositionHoldsClear,
    /// Channel A of press open must be high.
    ChannelA,
    /// Channel B of press open must be low.
    ChannelB,
    /// The die must be clear.
    DieClear,
    /// The guard must be closed.
    Guard,
    /// The host must be alive.
    Host,
    /// The position must be known.
    PositionKnown,
    /// The press must not begin a cycle.
    NoCycle,
    /// A cycle that began before must have been seen to close the press.
    CycleSeenThrough,
    /// A retract wins over an entry, and ends a claim or a stay.
    RetractWins,
    /// The press is given time to obey before the head enters.
    Hold,
    /// Channels that disagree for too long lock.
    Disagreement,
    /// Switch and position that contradict each other for too long lock.
    Contradiction,
    /// A retract that takes too long locks.
    WithdrawTime,
    /// A retract for a cause ends locked.
    CauseLocks,
    /// Only an order ends the locked state.
    ReleaseByOrder,
    /// Only an order claims the press.
    EnterByOrder,
    /// A stay that takes too long ends, and the press is let go.
    StayTime,
}

impl Rule {
    /// All of them, in the order of their numbers.
    #[cfg(test)]
    pub const ALL: [Self; 21] = [
        Self::SwitchToClear,
        Self::PositionToClear,
        Self::SwitchHoldsClear,
        Self::PositionHoldsClear,
        Self::ChannelA,
        Self::ChannelB,
        Self::DieClear,
        Self::Guard,
        Self::Host,
        Self::PositionKnown,
        Self::NoCycle,
        Self::CycleSeenThrough,
        Self::RetractWins,
        Self::Hold,
        Self::Disagreement,
        Self::Contradiction,
        Self::WithdrawTime,
        Self::CauseLocks,
        Self::ReleaseByOrder,
        Self::EnterByOrder,
        Self::StayTime,
    ];
}

/// Why the head may not be in the die, or enter it.
#[must_use]
pub fn objection<const OFF: u32>(before: State, inputs: &Inputs) -> Option<Fault> {
    let open = (inputs.press_open_a || off::<OFF>(Rule::ChannelA))
        && (!inputs.press_open_b || off::<OFF>(Rule::ChannelB));
    let unknown = inputs.position == Position::Unknown;
    [
        (open, Fault::PressNotOpen),
        (
            !inputs.cycle_began || off::<OFF>(Rule::NoCycle),
            Fault::PressCycled,
        ),
        (
            !before.cycling || off::<OFF>(Rule::CycleSeenThrough),
            Fault::PressCycled,
        ),
        (
            inputs.die_clear || off::<OFF>(Rule::DieClear),
            Fault::DieNotClear,
        ),
        (
            inputs.guard_closed || off::<OFF>(Rule::Guard),
            Fault::GuardOpen,
        ),
        (
            !unknown || off::<OFF>(Rule::PositionKnown),
            Fault::PositionLost,
        ),
        (
            inputs.host_alive || off::<OFF>(Rule::Host),
            Fault::HostSilent,
        ),
    ]
    .into_iter()
    .find_map(|(fine, fault)| (!fine).then_some(fault))
}

/// One step. `OFF` is 0 except in tests that switch rules off (bit n: rule n).
#[must_use]
pub fn decide<const OFF: u32>(before: State, inputs: &Inputs) -> State {
    let orders = inputs.orders;
    let retract = orders.retract && !off::<OFF>(Rule::RetractWins);
    let out = (inputs.retract_switch || off::<OFF>(Rule::SwitchToClear))
        && (inputs.position == Position::Retracted || off::<OFF>(Rule::PositionToClear));
    let time_over = inputs.expired.phase;
    let stay_over = inputs.expired.stay && !off::<OFF>(Rule::StayTime);
    let broken = broken::<OFF>(before, inputs);

    let phase = match before.phase {
        Phase::Locked(_) if orders.release || off::<OFF>(Rule::ReleaseByOrder) => Phase::Armed,
        locked @ Phase::Locked(_) => locked,
        Phase::Armed => match broken {
            Some(_) => Phase::Locked(broken),
            None if out => Phase::Clear,
            None => Phase::Armed,
        },
        Phase::Clear => {
            let left = if !inputs.retract_switch && !off::<OFF>(Rule::SwitchHoldsClear) {
                Some(Fault::HeadSwitch)
            } else if inputs.position != Position::Retracted
                && !off::<OFF>(Rule::PositionHoldsClear)
            {
                Some(Fault::PositionLost)
            } else {
                None
            };
            let enter = (orders.enter || off::<OFF>(Rule::EnterByOrder)) && !retract;
            match broken.or(left) {
                // The reference run takes the position away on purpose.
                _ if orders.release => Phase::Armed,
                Some(fault) => Phase::Withdrawing(Some(fault)),
                None if enter && objection::<OFF>(before, inputs).is_none() => Phase::Claiming,
                None => Phase::Clear,
            }
        }
        Phase::Claiming | Phase::Entered => match broken.or(objection::<OFF>(before, inputs)) {
            Some(fault) => Phase::Withdrawing(Some(fault)),
            // Without a cause: what locks would hold the press for longer still.
            None if retract || stay_over => Phase::Withdrawing(None),
            None if time_over || off::<OFF>(Rule::Hold) => Phase::Entered,
            None => before.phase,
        },
        Phase::Withdrawing(cause) => {
            let cause = cause.or(broken);
            match cause {
                Some(_) if out && !off::<OFF>(Rule::CauseLocks) => Phase::Locked(cause),
                _ if out => Phase::Clear,
                _ if time_over && !off::<OFF>(Rule::WithdrawTime) => {
                    Phase::Locked(cause.or(Some(Fault::RetractFailed)))
                }
                _ => Phase::Withdrawing(cause),
            }
        }
    };
    State {
        phase,
        disagrees: inputs.press_open_a == inputs.press_open_b,
        contradicts: matches!(
            (inputs.retract_switch, inputs.position),
            (true, Position::Away) | (false, Position::Retracted)
        ),
        cycling: (before.cycling || inputs.cycle_began) && inputs.press_open(),
    }
}

/// Signals that have been impossible for too long.
fn broken<const OFF: u32>(before: State, inputs: &Inputs) -> Option<Fault> {
    if before.disagrees && inputs.expired.disagreement && !off::<OFF>(Rule::Disagreement) {
        Some(Fault::PressSignal)
    } else if before.contradicts && inputs.expired.contradiction && !off::<OFF>(Rule::Contradiction)
    {
        Some(Fault::HeadSwitch)
    } else {
        None
    }
}

/// A constant in every build: `OFF` is known at compile time.
const fn off<const OFF: u32>(rule: Rule) -> bool {
    OFF & (1 << rule as u32) != 0
}
