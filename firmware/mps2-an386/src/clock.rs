//! The time driver: microseconds since start from TIMER0, one alarm on TIMER1.
//!
//! Both timers count down at 25 MHz. TIMER0 wraps after exactly 2^27 us (134 s), so a time is its wraps and its count
//! without any 64-bit division.
//!
//! **Stalls of the machine below.** While this processor executes, QEMU counts its time in instructions; while it sleeps,
//! in real time, and when the machine below is busy it oversleeps. That time is not this processor's: what an alarm is
//! late by after a sleep is taken off the clock. Nor are the bench's stalls the instrument's: every [`SLICE_US`] the bench
//! is asked whether it is there, and the clock stands until it has answered the question before. So no alarm is ever late
//! but by the instructions before it, and no timeout expires because everybody, or the other side, stood still.

use core::cell::{Cell, UnsafeCell};
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use core::task::Waker;

use critical_section::{CriticalSection, Mutex};
use embassy_time_driver::Driver;

use crate::bench_wire;
use crate::registers::{Block, CLOCK_HZ};
use crate::watchdog;
use flankscope_pin_wire::Subject;

const CONTROL: usize = 0x0;
const VALUE: usize = 0x4;
const RELOAD: usize = 0x8;
const INTERRUPT: usize = 0xC;
const ENABLE: u32 = 1;
const ENABLE_INTERRUPT: u32 = 1 << 3;

const TICKS_PER_US: u32 = CLOCK_HZ / 1_000_000;
const WRAP_LOG2_US: u32 = 27;
/// Counts from here to 0.
const TOP: u32 = (TICKS_PER_US << WRAP_LOG2_US) - 1;

/// Every task waits for one time at most, and there are five tasks.
const WAITING: usize = 8;

/// One task that waits, and for when.
type Wait = Option<(u64, Waker)>;

/// Longest sleep, and how far the clock runs ahead of the bench at most (twice this).
const SLICE_US: u64 = 1_000;

struct Clock {
    wraps: Mutex<Cell<u32>>,
    waiting: Mutex<UnsafeCell<[Wait; WAITING]>>,
    /// When the timer's interrupt is due: at the next deadline, or before.
    alarm_at: Mutex<Cell<u64>>,
    /// The earliest deadline.
    next_at: Mutex<Cell<u64>>,
    /// Time overslept so far, us.
    overslept_us: Mutex<Cell<u64>>,
    asleep: AtomicBool,
    /// When the bench was last asked.
    asked_at: Mutex<Cell<u64>>,
    /// It has not answered yet.
    unanswered: AtomicBool,
    /// The clock stands at the alarm until it does.
    standing: AtomicBool,
    /// Longest time from an alarm's due time to its interrupt, us, when the processor was awake.
    latest_us: AtomicU32,
}

embassy_time_driver::time_driver_impl!(static CLOCK: Clock = Clock {
    wraps: Mutex::new(Cell::new(0)),
    waiting: Mutex::new(UnsafeCell::new([const { None }; WAITING])),
    alarm_at: Mutex::new(Cell::new(u64::MAX)),
    next_at: Mutex::new(Cell::new(u64::MAX)),
    overslept_us: Mutex::new(Cell::new(0)),
    asleep: AtomicBool::new(false),
    asked_at: Mutex::new(Cell::new(0)),
    unanswered: AtomicBool::new(false),
    standing: AtomicBool::new(false),
    latest_us: AtomicU32::new(0),
});

/// Starts the clock.
pub fn start() {
    Block::TIMER0.write(RELOAD, TOP);
    Block::TIMER0.write(VALUE, TOP);
    Block::TIMER0.write(CONTROL, ENABLE | ENABLE_INTERRUPT);
}

/// Time since start, us.
pub fn now_us() -> u64 {
    critical_section::with(|cs| CLOCK.now_in(cs))
}

/// Longest time from an alarm's due time to its interrupt so far, us; of alarms that found the processor awake.
pub fn latest_alarm_us() -> u32 {
    CLOCK.latest_us.load(Ordering::Relaxed)
}

/// Sleeps until the next interrupt.
pub fn sleep() {
    CLOCK.asleep.store(true, Ordering::Relaxed);
    cortex_m::asm::wfi();
    CLOCK.asleep.store(false, Ordering::Relaxed);
}

/// Another interrupt than the alarm's came: the processor is awake.
pub fn awake() {
    CLOCK.asleep.store(false, Ordering::Relaxed);
}

/// TIMER0's interrupt: it has wrapped.
pub fn on_wrap() {
    critical_section::with(|cs| CLOCK.count_wrap(cs));
}

/// TIMER1's interrupt: the alarm.
pub fn on_alarm() {
    critical_section::with(|cs| {
        Block::TIMER1.write(CONTROL, 0);
        Block::TIMER1.write(INTERRUPT, 1);
        let (now, due) = (CLOCK.now_in(cs), CLOCK.alarm_at.borrow(cs).get());
        if let Some(late) = now.checked_sub(due) {
            if CLOCK.asleep.swap(false, Ordering::Relaxed) {
                let overslept = CLOCK.overslept_us.borrow(cs);
                overslept.set(overslept.get() + late);
            } else {
                CLOCK.latest_us.fetch_max(late as u32, Ordering::Relaxed);
            }
        }
        let asked_at = CLOCK.asked_at.borrow(cs);
        if due.saturating_sub(asked_at.get()) >= SLICE_US {
            if CLOCK.unanswered.load(Ordering::Relaxed) {
                CLOCK.standing.store(true, Ordering::Relaxed);
                watchdog::halt();
                return;
            }
            // Not while a deadline is waiting to be served, unless it has been long.
            let deadline = CLOCK.next_at.borrow(cs).get() <= due;
            if !deadline || due - asked_at.get() >= 4 * SLICE_US {
                asked_at.set(due);
                CLOCK.unanswered.store(true, Ordering::Relaxed);
                bench_wire::send(Subject::Tick, 0, CLOCK.now_in(cs));
            }
        }
        CLOCK.wake_due(cs);
    });
}

/// The bench has answered: it is there.
pub fn on_answer() {
    critical_section::with(|cs| {
        CLOCK.unanswered.store(false, Ordering::Relaxed);
        if CLOCK.standing.swap(false, Ordering::Relaxed) {
            watchdog::go_on();
            let stood = CLOCK
                .now_in(cs)
                .saturating_sub(CLOCK.alarm_at.borrow(cs).get());
            let overslept = CLOCK.overslept_us.borrow(cs);
            overslept.set(overslept.get() + stood);
            CLOCK.asked_at.borrow(cs).set(CLOCK.now_in(cs));
            CLOCK.unanswered.store(true, Ordering::Relaxed);
            bench_wire::send(Subject::Tick, 0, CLOCK.now_in(cs));
            CLOCK.wake_due(cs);
        }
    });
}

impl Clock {
    fn count_wrap(&self, cs: CriticalSection<'_>) {
        if Block::TIMER0.read(INTERRUPT) & 1 != 0 {
            Block::TIMER0.write(INTERRUPT, 1);
            let wraps = self.wraps.borrow(cs);
            wraps.set(wraps.get().wrapping_add(1));
        }
    }

    fn now_in(&self, cs: CriticalSection<'_>) -> u64 {
        self.count_wrap(cs);
        let mut ticks = TOP - Block::TIMER0.read(VALUE).min(TOP);
        if Block::TIMER0.read(INTERRUPT) & 1 != 0 {
            // It wrapped between the two looks.
            self.count_wrap(cs);
            ticks = TOP - Block::TIMER0.read(VALUE).min(TOP);
        }
        let raw = (u64::from(self.wraps.borrow(cs).get()) << WRAP_LOG2_US)
            + u64::from(ticks / TICKS_PER_US);
        let now = raw.saturating_sub(self.overslept_us.borrow(cs).get());
        if self.standing.load(Ordering::Relaxed) {
            now.min(self.alarm_at.borrow(cs).get())
        } else {
            now
        }
    }

    fn waiting<'a>(&'a self, cs: CriticalSection<'a>) -> &'a mut [Wait; WAITING] {
        // SAFETY: in a critical section, and no caller holds the reference while it calls another that takes it.
        unsafe { &mut *self.waiting.borrow(cs).get() }
    }

    /// Wakes what is due and sets the alarm for what is not.
    fn wake_due(&self, cs: CriticalSection<'_>) {
        let mut next = u64::MAX;
        let now = self.now_in(cs);
        for slot in self.waiting(cs) {
            match slot {
                Some((at, _)) if *at > now => next = next.min(*at),
                _ => {
                    if let Some((_, waker)) = slot.take() {
                        waker.wake();
                    }
                }
            }
        }
        self.next_at.borrow(cs).set(next);
        Block::TIMER1.write(CONTROL, 0);
        if next == u64::MAX {
            self.alarm_at.borrow(cs).set(next);
            return;
        }
        let ahead_us = (next - now).min(SLICE_US);
        self.alarm_at.borrow(cs).set(now + ahead_us);
        let ticks = ahead_us as u32 * TICKS_PER_US;
        // Loads once and does not come again: the interrupt stops the timer.
        Block::TIMER1.write(RELOAD, ticks);
        Block::TIMER1.write(VALUE, ticks);
        Block::TIMER1.write(CONTROL, ENABLE | ENABLE_INTERRUPT);
    }
}

impl Driver for Clock {
    fn now(&self) -> u64 {
        critical_section::with(|cs| self.now_in(cs))
    }

    fn schedule_wake(&self, at: u64, waker: &Waker) {
        critical_section::with(|cs| {
            let waiting = self.waiting(cs);
            let known = waiting
                .iter_mut()
                .find(|slot| matches!(slot, Some((_, other)) if other.will_wake(waker)));
            match known {
                Some(Some((known_at, _))) if *known_at <= at => return,
                Some(slot) => *slot = Some((at, waker.clone())),
                None => match waiting.iter_mut().find(|slot| slot.is_none()) {
                    Some(slot) => *slot = Some((at, waker.clone())),
                    // More tasks than foreseen: this one polls.
                    None => return waker.wake_by_ref(),
                },
            }
            // A clock that stands looks at all of them when it goes on.
            if at < self.next_at.borrow(cs).get() && !self.standing.load(Ordering::Relaxed) {
                self.wake_due(cs);
            }
        });
    }
}
