//! The host's end: borrows frames where the camera process wrote them.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use iceoryx2::port::listener::{Listener, ListenerWaitError};
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::*;
use iceoryx2::sample::Sample;

use crate::arm::Arm;
use crate::header::{FrameHeader, monotonic_ns};
use crate::link::{BorrowedFrame, FrameSource, ReceiveError};
use crate::node::{ServiceError, refused};
use crate::ready::Ready;
use crate::root::SharedRoot;
use crate::services::Services;

/// A socket counts its time-out in microseconds, and none is for ever (socket(7), `SO_RCVTIMEO`); iceoryx2 rounds down. What is left
/// of a wait may be less.
const SHORTEST_WAIT: Duration = Duration::from_micros(1);

/// A frame that still lies in the shared memory; dropping it gives the slot back to the camera process.
#[derive(Debug)]
pub struct Frame {
    sample: Sample<ipc::Service, [u16], FrameHeader>,
    received_monotonic_ns: u64,
}

/// Bytes of frames that this process copied out of the shared memory, as it says itself.
static BYTES_COPIED: AtomicU64 = AtomicU64::new(0);

impl BorrowedFrame for Frame {
    fn header(&self) -> &FrameHeader {
        self.sample.user_header()
    }

    fn pixels(&self) -> &[u16] {
        self.sample.payload()
    }

    fn received_monotonic_ns(&self) -> u64 {
        self.received_monotonic_ns
    }
}

impl Frame {
    /// Counts pixels that are copied out of the shared memory, such as into a file.
    pub fn count_copied(pixels: &[u16]) {
        let bytes = std::mem::size_of_val(pixels) as u64;
        BYTES_COPIED.fetch_add(bytes, Ordering::Relaxed);
    }

    /// Bytes of frames copied by this process so far.
    #[must_use]
    pub fn bytes_copied() -> u64 {
        BYTES_COPIED.load(Ordering::Relaxed)
    }
}

/// The host's port for frames. It stays on the thread that made it.
#[derive(Debug)]
pub struct FrameReceiver {
    subscriber: Subscriber<ipc::Service, [u16], FrameHeader>,
    listener: Listener<ipc::Service>,
    arm: Publisher<ipc::Service, Arm, ()>,
    ready: Subscriber<ipc::Service, Ready, ()>,
    services: Services,
}

impl FrameReceiver {
    /// Makes the services below `root` and connects to them.
    ///
    /// # Errors
    /// iceoryx2 refuses: see [`ServiceError`].
    pub fn create(root: &SharedRoot) -> Result<Self, ServiceError> {
        let services = Services::open(root)?;
        let subscriber = services
            .frames
            .subscriber_builder()
            .create()
            .map_err(refused("subscribe to frames", root.path()))?;
        let listener = services
            .wake
            .listener_builder()
            .create()
            .map_err(refused("listen for frames", root.path()))?;
        let arm = services
            .arm
            .publisher_builder()
            .create()
            .map_err(refused("publish the arming", root.path()))?;
        let ready = services
            .ready
            .subscriber_builder()
            .history_request(1)
            .create()
            .map_err(refused("listen to the camera", root.path()))?;
        Ok(Self {
            subscriber,
            listener,
            arm,
            ready,
            services,
        })
    }

    /// Whether a camera process has opened its end.
    #[must_use]
    pub fn camera_connected(&self) -> bool {
        self.services.arm.dynamic_config().number_of_subscribers() > 0
    }

    fn take(&self) -> Result<Option<Frame>, ReceiveError> {
        let Some(sample) = self.subscriber.receive().map_err(port_failed)? else {
            return Ok(None);
        };
        let frame = Frame {
            sample,
            received_monotonic_ns: monotonic_ns(),
        };
        ReceiveError::check(frame.header(), frame.pixels())?;
        Ok(Some(frame))
    }
}

impl FrameSource for FrameReceiver {
    type Frame = Frame;

    fn arm(&mut self, arm: Arm) -> Result<(), ReceiveError> {
        self.arm.send_copy(arm).map(drop).map_err(port_failed)
    }

    fn ready(&mut self) -> Result<Option<Ready>, ReceiveError> {
        // A camera process that came after the arming gets it only when this port looks for new peers.
        self.arm.update_connections().map_err(port_failed)?;
        let mut newest = None;
        while let Some(sample) = self.ready.receive().map_err(port_failed)? {
            newest = Some(*sample.payload());
        }
        Ok(newest)
    }

    /// Its pixels stay where they are.
    fn receive(&mut self, timeout: Duration) -> Result<Option<Frame>, ReceiveError> {
        let end = Instant::now() + timeout;
        loop {
            if let Some(frame) = self.take()? {
                return Ok(Some(frame));
            }
            // A camera process that came after the arming gets it only when this port looks for new peers.
            self.arm.update_connections().map_err(port_failed)?;
            let left = end.saturating_duration_since(Instant::now());
            if left < SHORTEST_WAIT {
                return Ok(None);
            }
            // Woken by the camera process; the event may tell of a frame that was already taken, hence the loop.
            match self.listener.timed_wait(|_| {}, left) {
                // Stopped and continued, or a debugger looked: nothing is wrong with the port.
                Ok(_) | Err(ListenerWaitError::InterruptSignal) => {}
                Err(error) => return Err(port_failed(error)),
            }
        }
    }
}

fn port_failed<E: std::fmt::Debug>(error: E) -> ReceiveError {
    ReceiveError::Port {
        reason: format!("{error:?}"),
    }
}
