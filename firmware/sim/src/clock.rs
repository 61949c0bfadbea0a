//! The one time driver: a clock per thread, moved by the [`crate::Sim`] that owns the thread.

use core::cell::RefCell;
use core::task::Waker;
use embassy_time_driver::Driver;

#[derive(Default)]
struct ThreadClock {
    now_us: u64,
    /// Few timers are ever pending (one or two per task), so a plain list is the fastest queue.
    timers: Vec<(u64, Waker)>,
    /// Bus transactions under way.
    transactions: u32,
}

thread_local! {
    static CLOCK: RefCell<ThreadClock> = RefCell::default();
}

struct ThreadClocks;

impl Driver for ThreadClocks {
    fn now(&self) -> u64 {
        now_us()
    }

    fn schedule_wake(&self, at: u64, waker: &Waker) {
        let due = CLOCK.with_borrow_mut(|clock| {
            let due = at <= clock.now_us;
            if !due
                && !clock
                    .timers
                    .iter()
                    .any(|(other, task)| *other == at && task.will_wake(waker))
            {
                clock.timers.push((at, waker.clone()));
            }
            due
        });
        if due {
            waker.wake_by_ref();
        }
    }
}

embassy_time_driver::time_driver_impl!(static DRIVER: ThreadClocks = ThreadClocks);

/// Virtual time of this thread's simulation in microseconds; 0 where there is none.
#[must_use]
pub fn now_us() -> u64 {
    CLOCK.with_borrow(|clock| clock.now_us)
}

/// A transaction on a bus. While one lives, time goes on although it is held: the task that waits for its end does nothing else
/// meanwhile, and would leave the host without an answer for as long as the hold lasts.
pub(crate) struct Transaction(());

impl Transaction {
    pub(crate) fn begin() -> Self {
        CLOCK.with_borrow_mut(|clock| clock.transactions += 1);
        Self(())
    }
}

impl Drop for Transaction {
    fn drop(&mut self) {
        CLOCK.with_borrow_mut(|clock| clock.transactions = clock.transactions.saturating_sub(1));
    }
}

/// Whether a bus transaction is under way.
pub(crate) fn in_transaction() -> bool {
    CLOCK.with_borrow(|clock| clock.transactions > 0)
}

/// A new simulation begins on this thread.
pub(crate) fn reset() {
    CLOCK.with_borrow_mut(|clock| *clock = ThreadClock::default());
}

/// Forgets the timers of a task about to be polled: it asks again for those it still wants.
///
/// Without this, timers of abandoned waits would stay behind and a stepped clock would run on to each of them.
pub(crate) fn forget(task: &Waker) {
    CLOCK.with_borrow_mut(|clock| clock.timers.retain(|(_, waker)| !waker.will_wake(task)));
}

/// The next time at which something is due.
pub(crate) fn next_deadline_us() -> Option<u64> {
    CLOCK.with_borrow(|clock| clock.timers.iter().map(|(at, _)| *at).min())
}

/// Moves time forward, never back, and wakes what is due, the earliest first.
pub(crate) fn advance_to(time_us: u64) {
    let mut due = CLOCK.with_borrow_mut(|clock| {
        clock.now_us = clock.now_us.max(time_us);
        let now_us = clock.now_us;
        clock
            .timers
            .extract_if(.., |(at, _)| *at <= now_us)
            .collect::<Vec<_>>()
    });
    due.sort_by_key(|(at, _)| *at);
    for (_, waker) in due {
        waker.wake();
    }
}
