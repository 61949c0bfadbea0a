//! Signs of life: the watchdog is fed only when every task has shown one since it was last fed.
//!
//! A task that waits shows life too, by waking up for it: [`Liveness::alive`] wraps whatever it waits for. A task that
//! loops without end, or is never polled again, does not.

use core::pin::pin;
use core::sync::atomic::{AtomicBool, Ordering};
use embassy_futures::select::{Either, select};
use embassy_time::{Duration, Timer};

/// The tasks that must show life.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Task {
    Receive,
    Transmit,
    Stage,
    Sequencer,
}

impl Task {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Receive, Self::Transmit, Self::Stage, Self::Sequencer];
}

/// How often a waiting task shows life, and how often it is looked for.
pub const BEAT: Duration = Duration::from_millis(50);

/// A watchdog that resets the controller when it is not fed in time. Its window must be longer than two beats plus
/// the longest that a task is busy without waiting, a pattern selection of 20 ms.
pub trait Watchdog {
    /// Starts the time anew.
    fn feed(&mut self);
}

/// One flag per task.
#[derive(Debug, Default)]
pub struct Liveness {
    /// Nobody looks: waiting tasks need not wake up.
    unsupervised: bool,
    seen: [AtomicBool; 4],
}

impl Liveness {
    pub(crate) const fn new(supervised: bool) -> Self {
        Self {
            unsupervised: !supervised,
            seen: [const { AtomicBool::new(false) }; 4],
        }
    }

    fn show(&self, task: Task) {
        if let Some(seen) = self.seen.get(task as usize) {
            seen.store(true, Ordering::Relaxed);
        }
    }

    /// Waits for `work`, showing life meanwhile. Dropping this drops the work.
    pub async fn alive<F: Future>(&self, task: Task, work: F) -> F::Output {
        let mut work = pin!(work);
        loop {
            self.show(task);
            let beat = async {
                if self.unsupervised {
                    core::future::pending::<()>().await;
                }
                Timer::after(BEAT).await;
            };
            if let Either::First(output) = select(work.as_mut(), beat).await {
                return output;
            }
        }
    }

    /// Every task has shown life; forgets it.
    pub(crate) fn all(&self) -> bool {
        let all = self.seen.iter().all(|seen| seen.load(Ordering::Relaxed));
        if all {
            for seen in &self.seen {
                seen.store(false, Ordering::Relaxed);
            }
        }
        all
    }
}
