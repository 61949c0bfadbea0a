//! The watchdog: not fed for a window, it raises the NMI, which falls safe and keeps the cause; not fed for another, it
//! resets by itself.
//!
//! Source: Arm DDI 0479 (Cortex-M System Design Kit), APB watchdog.

use core::sync::atomic::{AtomicU32, Ordering};

use flankscope_controller::Watchdog;

use crate::registers::{Block, CLOCK_HZ};

/// What it counts down from; writing it begins anew.
const LOAD: usize = 0x000;
const VALUE: usize = 0x004;
const CONTROL: usize = 0x008;
const LOCK: usize = 0xC00;
/// Opens the registers for writing; anything else closes them.
const UNLOCK: u32 = 0x1ACC_E551;
/// It counts, and raises the NMI.
const COUNT: u32 = 1 << 0;
const RESET: u32 = 1 << 1;

/// Real boards have 200 ms. This processor sleeps in the real time of a machine that it shares with everything else.
const WINDOW: u32 = 2 * CLOCK_HZ;

/// What was left of the window when it was halted.
static LEFT: AtomicU32 = AtomicU32::new(WINDOW);

/// The one of this machine.
pub struct Cmsdk(());

impl Cmsdk {
    /// Starts it; from here on it must be fed.
    pub fn start() -> Self {
        go_on();
        Self(())
    }
}

impl Watchdog for Cmsdk {
    fn feed(&mut self) {
        write(LOAD, WINDOW);
    }
}

/// Halts it: while the clock stands because the bench does, no task can show life.
pub fn halt() {
    LEFT.store(Block::WATCHDOG.read(VALUE), Ordering::Relaxed);
    write(CONTROL, 0);
}

/// It goes on where it was halted.
pub fn go_on() {
    write(LOAD, LEFT.load(Ordering::Relaxed));
    write(CONTROL, COUNT | RESET);
}

fn write(register: usize, value: u32) {
    Block::WATCHDOG.write(LOCK, UNLOCK);
    Block::WATCHDOG.write(register, value);
    Block::WATCHDOG.write(LOCK, 0);
}
