//! The press around the die: the ram with its signals, and the switch that reports the retracted head.
//!
//! ```text
//!  ram      top ──► leaves ──► closed ──► returns ──► top, waits for head-clear ──► ..
//!  cycle    ▔▔▔▔ 60 ms
//!  open A   ▔▔▔▔▔▔▔▔▔▔╲______________╱▔▔▔▔▔▔▔▔▔▔▔▔▔▔▔▔▔▔
//!  open B   __________╱▔▔▔▔▔▔▔▔▔▔▔▔▔▔╲__________________
//! ```

use super::{ExposureSink, World};
use embassy_futures::select::select;
use embassy_time::{Duration, Instant, Timer};
use embedded_hal_async::digital::Wait;
use flankscope_sim::Board;
use std::cell::RefCell;
use std::rc::Rc;

/// Properties of the press.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PressModel {
    /// Strokes per minute; 0: it stays open.
    pub strokes_per_minute: f64,
    /// Fraction of a cycle during which it counts as open, half before and half after the top.
    pub open_share: f64,
    /// Delay of channel B relative to channel A.
    pub skew_us: u64,
    /// Height of the vertical stage from which the retract switch is closed, mm.
    pub switch_mm: f64,
    /// Whether the ram waits at the top for the head when a check is due; a real press does not.
    pub waits: Option<WaitForHead>,
}

/// A ram that waits for checks, so that a host in real time keeps up with a press that is faster than real time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WaitForHead {
    /// Strokes from check to check; the first check is due after the first stroke.
    pub every: u32,
    /// The ram waits no longer than this for one check.
    pub patience_us: u64,
}

impl Default for PressModel {
    /// Stopped and open; the switch is 14 mm above the demo die.
    fn default() -> Self {
        Self {
            strokes_per_minute: 0.0,
            open_share: 0.4,
            skew_us: 5_000,
            switch_mm: 80.0,
            waits: None,
        }
    }
}

/// Length of the cycle pulse.
const CYCLE_PULSE: Duration = Duration::from_millis(60);

pub(super) async fn ram<S: ExposureSink>(board: Board, model: PressModel, sink: Rc<RefCell<S>>) {
    let mut lines = board.press;
    lines.guard_closed.set(true);
    lines.die_clear.set(true);
    lines.press_open_b.set(false);
    lines.press_open_a.set(true);
    if model.strokes_per_minute <= 0.0 {
        return core::future::pending().await;
    }
    let cycle_us = 60e6 / model.strokes_per_minute;
    let half_open = Duration::from_micros((0.5 * model.open_share * cycle_us) as u64);
    let closed = Duration::from_micros(((1.0 - model.open_share) * cycle_us) as u64);
    let skew = Duration::from_micros(model.skew_us);
    let mut strokes = 0;
    let mut strokes_to_check = 1;
    loop {
        if let Some(WaitForHead { every, patience_us }) = model.waits
            && strokes_to_check == 0
        {
            let head_in = select(
                lines.head_clear_1.wait_for_low(),
                lines.head_clear_2.wait_for_low(),
            );
            select(head_in, Timer::after_micros(patience_us)).await;
            strokes_to_check = every;
        }
        // Both channels are needed; otherwise the ram stays at the top.
        while !(lines.head_clear_1.level() && lines.head_clear_2.level()) {
            let Ok(()) = lines.head_clear_1.wait_for_high().await;
            let Ok(()) = lines.head_clear_2.wait_for_high().await;
            // A check; before the first stroke the controller only was not ready yet.
            if strokes > 0 {
                strokes_to_check = model.waits.map_or(0, |waits| waits.every);
            }
        }
        strokes_to_check = strokes_to_check.saturating_sub(1);
        let top = Instant::now();
        strokes += 1;
        sink.borrow_mut().cycled(strokes);
        lines.cycle.set(true);
        Timer::at(top + half_open.min(CYCLE_PULSE)).await;
        lines.cycle.set(false);
        Timer::at(top + half_open).await;
        lines.press_open_a.set(false);
        Timer::after(skew).await;
        lines.press_open_b.set(true);
        lines.die_clear.set(false);
        Timer::at(top + half_open + closed).await;
        lines.die_clear.set(true);
        lines.press_open_b.set(false);
        Timer::after(skew).await;
        lines.press_open_a.set(true);
        Timer::at(top + half_open + closed + half_open).await;
    }
}

/// The switch follows the stage's true position.
pub(super) async fn retract_switch(board: Board, model: PressModel, world: Rc<World>) {
    let switch = board.press.retract_switch;
    loop {
        let now_us = Instant::now().as_micros();
        let crossing_us = {
            let stage = world.stage.borrow();
            let made = stage.true_pose(now_us).vertical_mm >= model.switch_mm;
            switch.set(world.switch_stuck.get().unwrap_or(made));
            stage.vertical_crossing_us(now_us, model.switch_mm)
        };
        let crossing = async {
            match crossing_us {
                Some(at_us) => Timer::at(Instant::from_micros(at_us)).await,
                None => core::future::pending().await,
            }
        };
        select(crossing, world.course.wait()).await;
    }
}
