//! DMD controller: pattern selection over a bus, trigger in, ready out.

use super::{DeviceFault, World};
use embassy_futures::select::{Either, select};
use embassy_time::{Duration, Timer};
use embedded_hal_async::digital::Wait;
use flankscope_protocol::Projector;
use flankscope_sim::ProjectorLines;
use std::rc::Rc;

/// Times of the DMD controller.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DmdTiming {
    /// One selection on the bus: five bytes at 400 kHz are 0.11 ms.
    pub select_us: u64,
    /// Time from trigger to the displayed pattern. A DLP controller like the DLPC350 loads a bit plane in about 0.2 ms and needs
    /// eight for 8 bit; pattern rates of 120 Hz at 8 bit are limited by the LED time, not by this.
    pub switch_us: u64,
    /// Number of patterns; a higher selection is refused.
    pub patterns: u16,
    /// Index of the trigger from which on ready is never signalled, from 0.
    pub dead_from_trigger: Option<u32>,
}

impl Default for DmdTiming {
    fn default() -> Self {
        Self {
            select_us: 110,
            switch_us: 500,
            patterns: 128,
            dead_from_trigger: None,
        }
    }
}

pub(super) async fn run(lines: ProjectorLines, of: Projector, timing: DmdTiming, world: Rc<World>) {
    let (mut trigger, ready, bus) = (lines.dmd_trigger, lines.dmd_ready, lines.pattern_bus);
    let displayed = &world.displayed[of as usize];
    let mut selected = 0;
    let mut triggers = 0;
    loop {
        match select(bus.requested(), trigger.wait_for_rising_edge()).await {
            Either::First(pattern) => {
                Timer::after(Duration::from_micros(timing.select_us)).await;
                if world.faults.spoils(DeviceFault::DmdSilent) {
                    continue;
                }
                let taken =
                    pattern <= timing.patterns && !world.faults.spoils(DeviceFault::DmdRefuses);
                if taken {
                    selected = pattern;
                    ready.set(false);
                }
                bus.answer(taken);
            }
            Either::Second(_) if world.faults.spoils(DeviceFault::DmdMissesTrigger) => {}
            Either::Second(_) => {
                let dead = timing
                    .dead_from_trigger
                    .is_some_and(|from| triggers >= from);
                triggers += 1;
                Timer::after(Duration::from_micros(timing.switch_us)).await;
                if !dead && !world.faults.spoils(DeviceFault::DmdNotReady) {
                    displayed.set(selected);
                    ready.set(true);
                }
                if world.faults.spoils(DeviceFault::DmdExtraTrigger) {
                    // A sequence of one pattern shows the same pattern again.
                    Timer::after(Duration::from_micros(timing.switch_us)).await;
                    displayed.set(selected);
                    ready.set(true);
                }
            }
        }
    }
}
