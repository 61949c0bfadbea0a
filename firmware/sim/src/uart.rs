//! Virtual UARTs: two byte queues, one per direction. Ends may live on different threads.

use crate::sync::{Mutex, MutexGuard};
use core::convert::Infallible;
use core::future::poll_fn;
use core::task::{Poll, Waker};
use embedded_io_async::{ErrorType, Read, Write};
use flankscope_controller::stage::StagePort;
use flankscope_protocol::Line;
use std::collections::VecDeque;
use std::sync::{Arc, PoisonError};

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

/// How one end is set; nobody has set it: as the other end.
type Setting = Arc<Mutex<Option<Line>>>;

/// One end of a UART. Bytes written arrive at the other end at once, and as other bytes where both are set differently.
#[derive(Debug, Clone)]
pub struct Port {
    incoming: Pipe,
    outgoing: Pipe,
    line: Setting,
    line_there: Setting,
}

impl Port {
    /// Two ends joined to each other.
    #[must_use]
    pub fn pair() -> (Self, Self) {
        let (a, b) = (Pipe::default(), Pipe::default());
        let (here, there) = (Setting::default(), Setting::default());
        (
            Self {
                incoming: a.clone(),
                outgoing: b.clone(),
                line: Arc::clone(&here),
                line_there: Arc::clone(&there),
            },
            Self {
                incoming: b,
                outgoing: a,
                line: there,
                line_there: here,
            },
        )
    }

    /// Writes from any thread; never waits.
    pub fn send(&self, bytes: &[u8]) {
        let setting = |of: &Setting| *of.lock().unwrap_or_else(PoisonError::into_inner);
        match (setting(&self.line), setting(&self.line_there)) {
            (Some(here), Some(there)) if here != there => {
                // What a receiver makes of bits at another speed is no text.
                let garbled: Vec<u8> = bytes.iter().map(|byte| byte | 0x80).collect();
                self.outgoing.write(&garbled);
            }
            _ => self.outgoing.write(bytes),
        }
    }

    /// Sets this end's line.
    pub fn set(&self, line: Line) {
        *self.line.lock().unwrap_or_else(PoisonError::into_inner) = Some(line);
    }

    /// Takes what has arrived, without waiting.
    pub fn take(&self) -> Vec<u8> {
        self.incoming.lock().bytes.drain(..).collect()
    }
}

impl ErrorType for Port {
    type Error = Infallible;
}

impl StagePort for Port {
    fn set_line(&mut self, line: &Line) -> bool {
        self.set(*line);
        true
    }
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
