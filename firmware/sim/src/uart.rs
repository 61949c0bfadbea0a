//! Virtual UARTs: two byte queues, one per direction. Ends may live on different threads.

use core::convert::Infallible;
use core::future::poll_fn;
use core::task::{Poll, Waker};
use embedded_io_async::{ErrorType, Read, Write};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

#[derive(Debug, Default)]
struct Queue {
    bytes: VecDeque<u8>,
    reader: Option<Waker>,
}

/// One direction.
#[derive(Debug, Clone, Default)]
struct Pipe(Arc<Mutex<Queue>>);

impl Pipe {
    fn lock(&self) -> MutexGuard<'_, Queue> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn write(&self, bytes: &[u8]) {
        let mut queue = self.lock();
        queue.bytes.extend(bytes);
        let reader = queue.reader.take();
        drop(queue);
        if let Some(reader) = reader {
            reader.wake();
        }
    }

    fn take(&self, buffer: &mut [u8]) -> usize {
        let mut queue = self.lock();
        let count = buffer.len().min(queue.bytes.len());
        for (slot, byte) in buffer.iter_mut().zip(queue.bytes.drain(..count)) {
            *slot = byte;
        }
        count
    }
}

/// One end of a UART. Bytes written arrive at the other end at once.
#[derive(Debug, Clone)]
pub struct Port {
    incoming: Pipe,
    outgoing: Pipe,
}

impl Port {
    /// Two ends joined to each other.
    #[must_use]
    pub fn pair() -> (Self, Self) {
        let (a, b) = (Pipe::default(), Pipe::default());
        (
            Self {
                incoming: a.clone(),
                outgoing: b.clone(),
            },
            Self {
                incoming: b,
                outgoing: a,
            },
        )
    }

    /// Writes from any thread; never waits.
    pub fn send(&self, bytes: &[u8]) {
        self.outgoing.write(bytes);
    }

    /// Takes what has arrived, without waiting.
    #[must_use]
    pub fn take(&self) -> Vec<u8> {
        self.incoming.lock().bytes.drain(..).collect()
    }
}

impl ErrorType for Port {
    type Error = Infallible;
}

impl Read for Port {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        poll_fn(|context| {
            let count = self.incoming.take(buffer);
            if count > 0 || buffer.is_empty() {
                return Poll::Ready(Ok(count));
            }
            let mut queue = self.incoming.lock();
            queue.reader = Some(context.waker().clone());
            // Bytes may have come between the look and the lock.
            if !queue.bytes.is_empty() {
                context.waker().wake_by_ref();
            }
            Poll::Pending
        })
        .await
    }
}

impl Write for Port {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        self.send(bytes);
        Ok(bytes.len())
    }
    async fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}
