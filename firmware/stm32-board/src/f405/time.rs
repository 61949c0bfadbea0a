//! The time driver: TIM2 counts microseconds, the processor's SysTick is the alarm.
//!
//! The emulator's model of the timers has no compare channels, with which embassy-stm32's own driver wakes, and no clock from RCC:
//! they count at 1 GHz. Its SysTick has the board's 168 MHz.
//!
//! The emulator's time is that of the machine below, which may be busy. What an alarm is late by is not the program's: it is taken
//! off the clock, so that no time limit expires because the emulator stood still.

use core::cell::{Cell, RefCell};
use core::task::Waker;

use cortex_m::peripheral::SYST;
use cortex_m_rt::exception;
use critical_section::{CriticalSection, Mutex};
use embassy_stm32::pac;
use embassy_time_driver::Driver;
use embassy_time_queue_utils::Queue;

/// The model's 1 GHz to 1 MHz.
const PRESCALER: u16 = 999;
const SYSTICK_MHZ: u32 = 168;
/// Longest time to an alarm: the counter of 24 bits holds 99 ms.
const SLICE_US: u64 = 50_000;
/// Later than any alarm is by the program's own instructions.
const LATE_US: u64 = 1_000;
/// Counts the processor's clock, interrupts, runs.
const SYSTICK_ON: u32 = 0b111;

struct Clock {
    queue: Mutex<RefCell<Queue>>,
    /// The counter as last read, and its wraps (one in 71 minutes, seen by an alarm at the latest).
    seen: Mutex<Cell<(u32, u32)>>,
    alarm_at: Mutex<Cell<u64>>,
    /// Time taken off so far.
    overslept_us: Mutex<Cell<u64>>,
}

embassy_time_driver::time_driver_impl!(static CLOCK: Clock = Clock {
    queue: Mutex::new(RefCell::new(Queue::new())),
    seen: Mutex::new(Cell::new((0, 0))),
    alarm_at: Mutex::new(Cell::new(u64::MAX)),
    overslept_us: Mutex::new(Cell::new(0)),
});

/// Starts counter and alarm.
pub fn start() {
    pac::TIM2.psc().write_value(PRESCALER);
    pac::TIM2.cr1().modify(|bits| bits.set_cen(true));
    critical_section::with(|cs| CLOCK.serve(cs));
}

impl Clock {
    fn now_in(&self, cs: CriticalSection<'_>) -> u64 {
        let (last, mut wraps) = self.seen.borrow(cs).get();
        let count = pac::TIM2.cnt().read();
        if count < last {
            wraps = wraps.wrapping_add(1);
        }
        self.seen.borrow(cs).set((count, wraps));
        let raw = u64::from(wraps) << 32 | u64::from(count);
        raw.saturating_sub(self.overslept_us.borrow(cs).get())
    }

    fn on_alarm(&self, cs: CriticalSection<'_>) {
        let late = self
            .now_in(cs)
            .saturating_sub(self.alarm_at.borrow(cs).get());
        if late > LATE_US {
            let overslept = self.overslept_us.borrow(cs);
            overslept.set(overslept.get() + late);
        }
        self.serve(cs);
    }

    /// Wakes what is due and sets the alarm for what is not.
    fn serve(&self, cs: CriticalSection<'_>) {
        // Borrowed by nobody else: in a critical section, and a waker does not come back here.
        let Ok(mut queue) = self.queue.borrow(cs).try_borrow_mut() else {
            return;
        };
        let now = self.now_in(cs);
        let ahead_us = queue
            .next_expiration(now)
            .saturating_sub(now)
            .clamp(1, SLICE_US);
        self.alarm_at.borrow(cs).set(now + ahead_us);
        let ticks = ahead_us as u32 * SYSTICK_MHZ;
        // SAFETY: nothing else uses SysTick.
        unsafe {
            let alarm = &*SYST::PTR;
            alarm.rvr.write(ticks - 1);
            alarm.cvr.write(0);
            alarm.csr.write(SYSTICK_ON);
        }
    }
}

impl Driver for Clock {
    fn now(&self) -> u64 {
        critical_section::with(|cs| self.now_in(cs))
    }

    fn schedule_wake(&self, at: u64, waker: &Waker) {
        critical_section::with(|cs| {
            let queue = self.queue.borrow(cs).try_borrow_mut();
            let earlier = queue.is_ok_and(|mut queue| queue.schedule_wake(at, waker));
            if earlier {
                self.serve(cs);
            }
        });
    }
}

#[exception]
fn SysTick() {
    critical_section::with(|cs| CLOCK.on_alarm(cs));
}
