//! An executor at one interrupt level, static and started once.

use core::cell::UnsafeCell;
use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicBool, Ordering};

use cortex_m::interrupt::InterruptNumber;
use cortex_m::peripheral::NVIC;
use embassy_executor::raw::Executor;
use embassy_executor::{SpawnError, SpawnToken, Spawner};

use crate::registers::Irq;

/// An executor and what wakes it.
pub struct Level {
    irq: Irq,
    executor: UnsafeCell<MaybeUninit<Executor>>,
    started: AtomicBool,
}

// SAFETY: the executor is written once, before `started` is set, and only polled afterwards, at one level.
unsafe impl Sync for Level {}

impl Level {
    /// Polled by the handler of this software interrupt.
    pub const fn new(irq: Irq) -> Self {
        Self {
            irq,
            executor: UnsafeCell::new(MaybeUninit::uninit()),
            started: AtomicBool::new(false),
        }
    }

    /// Starts the executor with its tasks. A second time does nothing.
    pub fn start(&'static self, tasks: impl FnOnce(Tasks)) {
        if self.started.load(Ordering::Acquire) {
            return;
        }
        // What embassy's Cortex-M port pends when a task is woken.
        let context = usize::from(self.irq.number());
        // SAFETY: not started yet, so nobody else looks at the executor.
        let executor = unsafe { (*self.executor.get()).write(Executor::new(context as *mut ())) };
        tasks(Tasks(executor.spawner()));
        self.started.store(true, Ordering::Release);
        NVIC::pend(self.irq);
        // SAFETY: the handler polls this level, which is ready now.
        unsafe { NVIC::unmask(self.irq) };
    }

    /// Runs what is ready. Only to be called by the handler of this level's interrupt.
    pub fn poll(&'static self) {
        if self.started.load(Ordering::Acquire) {
            // SAFETY: started, so written; a level does not interrupt itself, so not reentrant.
            unsafe { (*self.executor.get()).assume_init_ref().poll() };
        }
    }
}

/// Where to spawn.
#[derive(Clone, Copy)]
pub struct Tasks(Spawner);

impl Tasks {
    /// Spawns a task; one that is running already stays alone.
    pub fn spawn_if<S>(self, token: Result<SpawnToken<S>, SpawnError>) {
        if let Ok(token) = token {
            self.0.spawn(token);
        }
    }
}
