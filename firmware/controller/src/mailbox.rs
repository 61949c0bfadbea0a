//! A bounded queue between tasks, and from interrupts, without any path that could panic.

use core::cell::RefCell;
use core::future::poll_fn;
use core::task::Poll;
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::waitqueue::WakerRegistration;
use heapless::Deque;

struct State<T, const N: usize> {
    queue: Deque<T, N>,
    receiver: WakerRegistration,
    sender: WakerRegistration,
}

/// Holds up to `N` messages. One task receives; one task may wait to send, any may try.
pub struct Mailbox<T, const N: usize>(Mutex<CriticalSectionRawMutex, RefCell<State<T, N>>>);

impl<T, const N: usize> Mailbox<T, N> {
    /// Empty.
    #[must_use]
    pub const fn new() -> Self {
        Self(Mutex::new(RefCell::new(State {
            queue: Deque::new(),
            receiver: WakerRegistration::new(),
            sender: WakerRegistration::new(),
        })))
    }

    /// `None` never happens: no message is handled while the state is borrowed, and a critical section keeps others out.
    fn with<R>(&self, work: impl FnOnce(&mut State<T, N>) -> R) -> Option<R> {
        self.0.lock(|state| {
            state
                .try_borrow_mut()
                .ok()
                .map(|mut state| work(&mut state))
        })
    }

    /// Queues a message.
    ///
    /// # Errors
    /// There is no room; the message comes back.
    pub fn try_send(&self, message: T) -> Result<(), T> {
        let mut message = Some(message);
        self.with(|state| {
            if !state.queue.is_full()
                && let Some(message) = message.take()
            {
                let _room = state.queue.push_back(message);
                state.receiver.wake();
            }
        });
        message.map_or(Ok(()), Err)
    }

    /// Queues a message once there is room.
    pub async fn send(&self, message: T) {
        let mut message = Some(message);
        poll_fn(|context| {
            let Some(unsent) = message.take() else {
                return Poll::Ready(());
            };
            let Err(unsent) = self.try_send(unsent) else {
                return Poll::Ready(());
            };
            message = Some(unsent);
            let room = self.with(|state| {
                state.sender.register(context.waker());
                !state.queue.is_full()
            });
            if room == Some(true) {
                // It came between the two looks.
                context.waker().wake_by_ref();
            }
            Poll::Pending
        })
        .await;
    }

    /// Takes the oldest message, once there is one. May be dropped at any time without losing any.
    pub async fn receive(&self) -> T {
        poll_fn(|context| {
            let taken = self.with(|state| {
                let taken = state.queue.pop_front();
                match taken {
                    Some(_) => state.sender.wake(),
                    None => state.receiver.register(context.waker()),
                }
                taken
            });
            taken.flatten().map_or(Poll::Pending, Poll::Ready)
        })
        .await
    }

    /// Messages that there is room for.
    pub fn free_capacity(&self) -> usize {
        self.with(|state| N.saturating_sub(state.queue.len()))
            .unwrap_or(0)
    }
}

impl<T, const N: usize> Default for Mailbox<T, N> {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use core::future::Future;
    use core::pin::pin;
    use core::task::{Context, Waker};
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::task::Wake;

    struct Count(AtomicUsize);

    impl Wake for Count {
        fn wake(self: Arc<Self>) {
            self.0.fetch_add(1, Ordering::Relaxed);
        }
    }

    #[test]
    fn messages_keep_their_order_and_a_full_box_gives_them_back() {
        let mail = Mailbox::<u8, 2>::new();
        assert_eq!((mail.try_send(1), mail.try_send(2)), (Ok(()), Ok(())));
        assert_eq!((mail.try_send(3), mail.free_capacity()), (Err(3), 0));
        let mut context = Context::from_waker(Waker::noop());
        for expected in [1, 2] {
            assert_eq!(
                pin!(mail.receive()).poll(&mut context),
                Poll::Ready(expected)
            );
        }
        assert_eq!(pin!(mail.receive()).poll(&mut context), Poll::Pending);
    }

    #[test]
    fn who_waits_is_woken_by_the_other_side() {
        let mail = Mailbox::<u8, 1>::new();
        let woken = Arc::new(Count(AtomicUsize::new(0)));
        let waker = Waker::from(Arc::clone(&woken));
        let mut context = Context::from_waker(&waker);
        let mut receiving = pin!(mail.receive());
        assert_eq!(receiving.as_mut().poll(&mut context), Poll::Pending);
        assert_eq!(mail.try_send(1), Ok(()));
        assert_eq!(woken.0.load(Ordering::Relaxed), 1);

        let mut sending = pin!(mail.send(2));
        assert_eq!(sending.as_mut().poll(&mut context), Poll::Pending);
        assert_eq!(receiving.as_mut().poll(&mut context), Poll::Ready(1));
        assert_eq!(woken.0.load(Ordering::Relaxed), 2);
        assert_eq!(sending.as_mut().poll(&mut context), Poll::Ready(()));
        assert_eq!(pin!(mail.receive()).poll(&mut context), Poll::Ready(2));
    }
}
