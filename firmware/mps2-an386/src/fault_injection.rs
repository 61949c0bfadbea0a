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
    use core::future::poll_fn;
    use core::pin::pin;
    use core::sync::atomic::{AtomicU8, Ordering};
    use core::task::Poll;
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

    /// Does the task's work until ordered otherwise.
    pub async fn exposed<F: Future>(task: Task, work: F) -> F::Output {
        let mut work = pin!(work);
        poll_fn(|context| {
            let order = ORDER.load(Ordering::Relaxed);
            if order == SPIN | task as u8 {
                loop {
                    // Not the spin-loop hint: the emulator takes its time over that.
                    cortex_m::asm::nop();
                }
            }
            if order == HANG | task as u8 {
                return Poll::Pending;
            }
            work.as_mut().poll(context)
        })
        .await
    }
}
