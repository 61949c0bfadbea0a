//! The host's end: borrows frames where the camera process wrote them.

use std::time::{Duration, Instant};

use iceoryx2::port::listener::Listener;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::*;

use super::frame::{Arm, Frame, FrameHeader, checksum, monotonic_ns};
use super::root::SharedRoot;
use super::services::{ServiceError, Services, refused};

/// Why a frame cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReceiveError {
    /// The port failed.
    #[error("the frame port failed: {reason}")]
    Port {
        /// The library's own reason.
        reason: String,
    },
    /// The header does not describe the pixels that came.
    #[error(
        "frame {counter} says {width_px} x {height_px} px with stride {stride_px}, but {pixels} pixels came"
    )]
    Geometry {
        /// Frame counter.
        counter: u32,
        /// Width in the header.
        width_px: u32,
        /// Height in the header.
        height_px: u32,
        /// Stride in the header.
        stride_px: u32,
        /// Pixels in the payload.
        pixels: usize,
    },
    /// The pixels are not those that were sent.
    #[error("frame {counter} is corrupt: its checksum is {got:#x}, its header says {expected:#x}")]
    Corrupt {
        /// Frame counter.
        counter: u32,
        /// From the header.
        expected: u64,
        /// From the pixels.
        got: u64,
    },
}

/// The host's port for frames. It stays on the thread that made it.
#[derive(Debug)]
pub struct FrameReceiver {
    subscriber: Subscriber<ipc::Service, [u16], FrameHeader>,
    listener: Listener<ipc::Service>,
    arm: Publisher<ipc::Service, Arm, ()>,
    _services: Services,
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
            .map_err(refused("subscribe to frames", root))?;
        let listener = services
            .ready
            .listener_builder()
            .create()
            .map_err(refused("listen for frames", root))?;
        let arm = services
            .arm
            .publisher_builder()
            .create()
            .map_err(refused("publish the arming", root))?;
        Ok(Self {
            subscriber,
            listener,
            arm,
            _services: services,
        })
    }

    /// Tells the camera process what will be exposed next.
    ///
    /// # Errors
    /// The port failed.
    pub fn arm(&self, arm: Arm) -> Result<(), ReceiveError> {
        self.arm.send_copy(arm).map(drop).map_err(port_failed)
    }

    /// The next frame, if one comes within `timeout`. Its pixels stay where they are.
    ///
    /// # Errors
    /// The port failed, or the frame's header or checksum does not fit its pixels.
    pub fn receive(&self, timeout: Duration) -> Result<Option<Frame>, ReceiveError> {
        let end = Instant::now() + timeout;
        loop {
            if let Some(frame) = self.take()? {
                return Ok(Some(frame));
            }
            // A camera process that came after the arming gets it only when this port looks for new peers.
            self.arm.update_connections().map_err(port_failed)?;
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Ok(None);
            }
            // Woken by the camera process; the event may tell of a frame that was already taken, hence the loop.
            self.listener
                .timed_wait(|_| {}, left)
                .map_err(port_failed)?;
        }
    }

    fn take(&self) -> Result<Option<Frame>, ReceiveError> {
        let Some(sample) = self.subscriber.receive().map_err(port_failed)? else {
            return Ok(None);
        };
        let frame = Frame {
            sample,
            received_monotonic_ns: monotonic_ns(),
        };
        let header = frame.header();
        let (rows, stride) = (u64::from(header.height_px), u64::from(header.stride_px));
        if header.width_px > header.stride_px || rows * stride != frame.pixels().len() as u64 {
            return Err(ReceiveError::Geometry {
                counter: header.counter,
                width_px: header.width_px,
                height_px: header.height_px,
                stride_px: header.stride_px,
                pixels: frame.pixels().len(),
            });
        }
        let got = checksum(frame.pixels());
        if got != header.checksum {
            return Err(ReceiveError::Corrupt {
                counter: header.counter,
                expected: header.checksum,
                got,
            });
        }
        Ok(Some(frame))
    }
}

fn port_failed<E: std::fmt::Debug>(error: E) -> ReceiveError {
    ReceiveError::Port {
        reason: format!("{error:?}"),
    }
}
