//! The press's signals as pins.
//!
//! | line           | direction | meaning                                                                      |
//! |----------------|-----------|------------------------------------------------------------------------------|
//! | press open A   | in        | high = press open                                                            |
//! | press open B   | in        | low = press open: a cut or shorted cable makes A and B equal                 |
//! | die clear      | in        | high = no part in the die                                                    |
//! | guard closed   | in        | high = guard closed                                                          |
//! | cycle          | in        | rises when a cycle begins; stays high for 50 ms at least                     |
//! | retract switch | in        | high = the head is out of the press's way                                    |
//! | head clear 1/2 | out       | both high = the press may stroke; low without power                          |
//! | go, no-go      | out       | one is the opposite of the other, else the verdict is invalid                |
//! | verdict beat   | out       | changes its level while the verdict is fresh                                 |

use crate::interlock::{Levels, VerdictLines};
use core::convert::Infallible;
use embassy_futures::select::select_array;
use embedded_hal::digital::{InputPin, OutputPin, PinState};
use embedded_hal_async::digital::Wait;

/// The press as the sequencer sees it.
pub trait Press {
    /// The signals now. `parked`: the stages say that the head is out, for a bench that has no switch.
    fn levels(&mut self, parked: bool) -> Levels;
    /// Completes when a signal is not as it was seen. May be dropped at any time.
    async fn changed(&mut self, seen: Levels);
    /// Drives both head-clear outputs and the verdict.
    fn drive(&mut self, head_clear: bool, verdict: VerdictLines);
}

/// No press around the instrument: a table, with the guard of good sense.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoPress;

impl Press for NoPress {
    fn levels(&mut self, parked: bool) -> Levels {
        Levels {
            press_open_a: true,
            press_open_b: false,
            die_clear: true,
            guard_closed: true,
            cycle: false,
            retract_switch: parked,
        }
    }
    async fn changed(&mut self, _: Levels) {
        core::future::pending().await
    }
    fn drive(&mut self, _: bool, _: VerdictLines) {}
}

#[derive(Debug)]
pub struct PinPress<I, O> {
    /// Input: press open A.
    pub press_open_a: I,
    /// Input: press open B.
    pub press_open_b: I,
    /// Input: die clear.
    pub die_clear: I,
    /// Input: guard closed.
    pub guard_closed: I,
    /// Input: cycle.
    pub cycle: I,
    /// Input: retract switch.
    pub retract_switch: I,
    /// Outputs: head clear, both channels.
    pub head_clear: [O; 2],
    /// Output: go.
    pub go: O,
    /// Output: no-go.
    pub no_go: O,
    /// Output: heartbeat of the verdict.
    pub beat: O,
}

impl<I, O> Press for PinPress<I, O>
where
    I: InputPin<Error = Infallible> + Wait,
    O: OutputPin<Error = Infallible>,
{
    fn levels(&mut self, _: bool) -> Levels {
        Levels {
            press_open_a: high(&mut self.press_open_a),
            press_open_b: high(&mut self.press_open_b),
            die_clear: high(&mut self.die_clear),
            guard_closed: high(&mut self.guard_closed),
            cycle: high(&mut self.cycle),
            retract_switch: high(&mut self.retract_switch),
        }
    }

    async fn changed(&mut self, seen: Levels) {
        select_array([
            leaves(&mut self.press_open_a, seen.press_open_a),
            leaves(&mut self.press_open_b, seen.press_open_b),
            leaves(&mut self.die_clear, seen.die_clear),
            leaves(&mut self.guard_closed, seen.guard_closed),
            leaves(&mut self.cycle, seen.cycle),
            leaves(&mut self.retract_switch, seen.retract_switch),
        ])
        .await;
    }

    fn drive(&mut self, head_clear: bool, verdict: VerdictLines) {
        for pin in &mut self.head_clear {
            drive(pin, head_clear);
        }
        drive(&mut self.go, verdict.go);
        drive(&mut self.no_go, verdict.no_go);
        drive(&mut self.beat, verdict.beat);
    }
}

fn high(pin: &mut impl InputPin<Error = Infallible>) -> bool {
    let Ok(high) = pin.is_high();
    high
}

fn drive(pin: &mut impl OutputPin<Error = Infallible>, level: bool) {
    let Ok(()) = pin.set_state(PinState::from(level));
}

/// Completes when `pin` has the other level.
async fn leaves<P: Wait<Error = Infallible>>(pin: &mut P, seen: bool) {
    let Ok(()) = if seen {
        pin.wait_for_low().await
    } else {
        pin.wait_for_high().await
    };
}
