//! Virtual UARTs: two byte queues, one per direction. Bytes of a line that has a speed take their time on it, by the clock of the
//! simulation in which both ends are then; ends of other lines may live on different threads.

use crate::clock::now_us;
use crate::sync::{Mutex, MutexGuard};
use core::convert::Infallible;
use core::future::Future;
use core::future::poll_fn;
use core::pin::pin;
use core::task::{Poll, Waker};
use embassy_time::{Instant, Timer};
use embedded_io_async::{ErrorType, Read, Write};
use flankscope_controller::stage::StagePort;
use flankscope_protocol::Line;
use std::collections::VecDeque;
use std::sync::{Arc, PoisonError};

#[derive(Debug, Default)]
struct Queue {
    /// Each with the time at which it has arrived, us.
    bytes: VecDeque<(u64, u8)>,
    /// When the last of them has left the wire.
    idle_at_ns: u64,
    reader: Option<Waker>,
}

impl Queue {
    /// Bytes that can be read now.
    fn arrived(&self) -> usize {
        let now_us = now_us();
        let late = self.bytes.iter().position(|(at_us, _)| *at_us > now_us);
        late.unwrap_or(self.bytes.len())
    }
}

/// One direction.
#[derive(Debug, Clone, Default)]
struct Pipe(Arc<Mutex<Queue>>);

impl Pipe {
    fn lock(&self) -> MutexGuard<'_, Queue> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// `byte_ns`: what one of them takes on the wire.
    fn write(&self, bytes: &[u8], byte_ns: u64) {
        let mut queue = self.lock();
        for &byte in bytes {
            if byte_ns > 0 {
                queue.idle_at_ns = queue.idle_at_ns.max(1_000 * now_us()) + byte_ns;
            }
            let arrived = queue.idle_at_ns.div_ceil(1_000);
            queue.bytes.push_back((arrived, byte));
        }
        let reader = queue.reader.take();
        drop(queue);
        if let Some(reader) = reader {
            reader.wake();
        }
    }

    fn take(&self, buffer: &mut [u8]) -> usize {
        let mut queue = self.lock();
        let arrived = queue.arrived();
        let count = buffer.len().min(arrived);
        for (slot, (_, byte)) in buffer.iter_mut().zip(queue.bytes.drain(..count)) {
            *slot = byte;
        }
        count
    }
}

/// How one end is set; nobody has set it: as the other end.
type Setting = Arc<Mutex<Option<Line>>>;

/// One end of a UART. Bytes written arrive at the other end at the speed that this end is set to, or the other; at once where
/// neither is; and as other bytes where both are set differently.
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
        let (here, there) = (setting(&self.line), setting(&self.line_there));
        let byte_ns = here.or(there).map_or(0, |line| line.byte_ns());
        match (here, there) {
            (Some(here), Some(there)) if here != there => {
                // What a receiver makes of bits at another speed is no text.
                let garbled: Vec<u8> = bytes.iter().map(|byte| byte | 0x80).collect();
                self.outgoing.write(&garbled, byte_ns);
            }
            _ => self.outgoing.write(bytes, byte_ns),
        }
    }

    /// Sets this end's line.
    pub fn set(&self, line: Line) {
        *self.line.lock().unwrap_or_else(PoisonError::into_inner) = Some(line);
    }

    /// Takes what has arrived, without waiting.
    pub fn take(&self) -> Vec<u8> {
        let mut queue = self.incoming.lock();
        let arrived = queue.arrived();
        let bytes = queue.bytes.drain(..arrived);
        bytes.map(|(_, byte)| byte).collect()
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
            let Some(&(at_us, _)) = queue.bytes.front() else {
                return Poll::Pending;
            };
            drop(queue);
            // Still on the wire, or come between the look and the lock.
            if pin!(Timer::at(Instant::from_micros(at_us)))
                .poll(context)
                .is_ready()
            {
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
        let idle_at_ns = self.outgoing.lock().idle_at_ns;
        if idle_at_ns > 1_000 * now_us() {
            Timer::at(Instant::from_micros(idle_at_ns.div_ceil(1_000))).await;
        }
        Ok(())
    }
}
