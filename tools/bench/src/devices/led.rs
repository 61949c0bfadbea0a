//! LED driver: enable in, current sense out.

use super::{DeviceFault, World};
use embassy_futures::select::{Either, select};
use embassy_time::{Duration, Timer};
use embedded_hal_async::digital::Wait;
use flankscope_protocol::Projector;
use flankscope_sim::ProjectorLines;
use std::rc::Rc;

/// Times of the LED driver, those of a current regulator for a high-power LED (assumed, order of its soft start).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LedTiming {
    /// Time from enabling to full current.
    pub rise_us: u64,
    /// Time from disabling to no current.
    pub fall_us: u64,
    /// The LED never draws current.
    pub open: bool,
}

/// Time after which an overheated driver cuts the current.
const OVERHEATS_US: u64 = 20_000;

impl Default for LedTiming {
    fn default() -> Self {
        Self {
            rise_us: 200,
            fall_us: 50,
            open: false,
        }
    }
}

pub(super) async fn run(lines: ProjectorLines, of: Projector, timing: LedTiming, world: Rc<World>) {
    let (mut enable, sense) = (lines.led_enable, lines.led_sense);
    let lit = &world.lit[of as usize];
    let mut hot = false;
    loop {
        let Ok(()) = enable.wait_for_high().await;
        let mut abandoned = enable.clone();
        // The driver may be disabled while the current still rises.
        select(
            Timer::after(Duration::from_micros(timing.rise_us)),
            abandoned.wait_for_low(),
        )
        .await;
        if enable.level() && !timing.open && !hot && !world.faults.spoils(DeviceFault::LedOpen) {
            lit.set(true);
            sense.set(true);
            let warming = Timer::after(Duration::from_micros(OVERHEATS_US));
            let lit_on = select(warming, abandoned.wait_for_low()).await;
            if matches!(lit_on, Either::First(())) && world.faults.spoils(DeviceFault::LedOverheats)
            {
                hot = true;
                lit.set(false);
                sense.set(false);
            }
        }
        let Ok(()) = enable.wait_for_low().await;
        Timer::after(Duration::from_micros(timing.fall_us)).await;
        if sense.level() && world.faults.spoils(DeviceFault::LedStuckOn) {
            continue;
        }
        lit.set(false);
        sense.set(false);
    }
}
