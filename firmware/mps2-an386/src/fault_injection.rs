//! With the feature `fault-injection`, the bench can make this image hang, panic or fault, to see what comes of it. Without
//! it, as delivered, nothing of this is in the image.

use flankscope_controller::liveness::Task;

/// Does the task's work.
#[cfg(not(feature = "fault-injection"))]
pub fn exposed<F: Future>(_task: Task, work: F) -> F {
    // Not an `async fn`: that would hold the task's memory twice.
    work
}

#[cfg(feature = "fault-injection")]
pub use ordered::{exposed, order};

#[cfg(feature = "fault-injection")]
mod ordered {
    use super::Task;
    use core::pin::Pin;
    use core::sync::atomic::{AtomicU8, Ordering};
    use core::task::{Context, Poll};
    use flankscope_pin_wire::injection::{FAULT, HANG, PANIC, SPIN};

    /// What the bench ordered.
    static ORDER: AtomicU8 = AtomicU8::new(0);

    /// Takes an order of the bench; those about no task are carried out at once.
    pub fn order(order: u8) {
        ORDER.store(order, Ordering::Relaxed);
        match order {
            PANIC => panic!("ordered by the bench"),
            // An undefined instruction.
            FAULT => cortex_m::asm::udf(),
            _ => {}
        }
    }

    /// A task's work until ordered otherwise.
    pub struct Exposed<F> {
        task: Task,
        work: F,
    }

    /// Does the task's work until ordered otherwise.
    pub fn exposed<F: Future>(task: Task, work: F) -> Exposed<F> {
        // Here neither: the stack would run into what is held twice.
        Exposed { task, work }
    }

    impl<F: Future> Future for Exposed<F> {
        type Output = F::Output;

        fn poll(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<F::Output> {
            let order = ORDER.load(Ordering::Relaxed);
            if order == SPIN | self.task as u8 {
                loop {
                    // Not the spin-loop hint: the emulator takes its time over that.
                    cortex_m::asm::nop();
                }
            }
            if order == HANG | self.task as u8 {
                return Poll::Pending;
            }
            // SAFETY: the work is pinned as a part of the whole: nothing moves it out, and nothing else drops it.
            let work = unsafe { self.map_unchecked_mut(|whole| &mut whole.work) };
            work.poll(context)
        }
    }
}
