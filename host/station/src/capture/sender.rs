//! The camera process's end: writes each frame once, into the shared memory.

use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;

use super::frame::{Arm, FrameHeader, checksum, monotonic_ns};
use super::root::SharedRoot;
use super::services::{LOANED_FRAMES, MAX_FRAME_PIXELS, ServiceError, Services, refused};

/// Why a frame was not handed over.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SendError {
    /// The frame is larger than the segment's slots.
    #[error("a frame of {pixels} px does not fit a slot of {MAX_FRAME_PIXELS} px")]
    TooLarge {
        /// Pixels asked for.
        pixels: usize,
    },
    /// The host takes frames too slowly, or is gone: this frame is lost, and its number missing tells the host so.
    #[error("frame {counter} could not be delivered: {reason}")]
    Undelivered {
        /// Frame counter.
        counter: u32,
        /// The library's own reason.
        reason: String,
    },
}

/// What happens to a frame when the host's buffer is full.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Overflow {
    /// It is lost: a real camera's clock does not wait. The loss is an error here and a gap in the numbers there.
    Drop,
    /// It waits until the host has room: for a camera whose time can stand still.
    Wait,
}

/// The camera process's port for frames. It stays on the thread that made it.
#[derive(Debug)]
pub struct FrameSender {
    publisher: Publisher<ipc::Service, [u16], FrameHeader>,
    notifier: Notifier<ipc::Service>,
    arm: Subscriber<ipc::Service, Arm, ()>,
    _services: Services,
}

/// A frame being written in the shared memory.
#[derive(Debug)]
pub struct LoanedFrame {
    sample: iceoryx2::sample_mut::SampleMut<ipc::Service, [u16], FrameHeader>,
}

/// A frame whose pixels and header are final; only the hand-over is left.
#[derive(Debug)]
pub struct SealedFrame(LoanedFrame);

impl FrameSender {
    /// Connects to the services of the host that owns `root`.
    ///
    /// # Errors
    /// iceoryx2 refuses: see [`ServiceError`].
    pub fn open(root: &SharedRoot, overflow: Overflow) -> Result<Self, ServiceError> {
        let services = Services::open(root)?;
        let publisher = services
            .frames
            .publisher_builder()
            .initial_max_slice_len(MAX_FRAME_PIXELS)
            .allocation_strategy(AllocationStrategy::Static)
            .max_loaned_samples(LOANED_FRAMES)
            .backpressure_strategy(match overflow {
                Overflow::Drop => BackpressureStrategy::DiscardData,
                Overflow::Wait => BackpressureStrategy::RetryUntilDelivered,
            })
            .create()
            .map_err(refused("publish frames", root))?;
        let notifier = services
            .ready
            .notifier_builder()
            .create()
            .map_err(refused("notify of frames", root))?;
        let arm = services
            .arm
            .subscriber_builder()
            .history_request(1)
            .create()
            .map_err(refused("subscribe to the arming", root))?;
        Ok(Self {
            publisher,
            notifier,
            arm,
            _services: services,
        })
    }

    /// The newest arming that the host sent since the last call.
    pub fn armed(&self) -> Option<Arm> {
        let mut newest = None;
        while let Ok(Some(sample)) = self.arm.receive() {
            newest = Some(*sample.payload());
        }
        newest
    }

    /// A slot of `pixels` to write the next frame into, uninitialised content of an earlier frame.
    ///
    /// # Errors
    /// The frame is too large, or the host holds every slot.
    pub fn loan(&self, pixels: usize, counter: u32) -> Result<LoanedFrame, SendError> {
        if pixels > MAX_FRAME_PIXELS {
            return Err(SendError::TooLarge { pixels });
        }
        let sample =
            self.publisher
                .loan_slice_uninit(pixels)
                .map_err(|error| SendError::Undelivered {
                    counter,
                    reason: format!("{error:?}"),
                })?;
        // SAFETY: the slot lies in a shared-memory object that the kernel zeroed when it was made, so its bytes are
        // initialised, and every bit pattern is a u16. Filling it first would write each frame twice.
        let sample = unsafe { sample.assume_init() };
        Ok(LoanedFrame { sample })
    }

    /// Hands the frame over and wakes the host. The time of hand-over is filled in.
    ///
    /// # Errors
    /// The host did not get it.
    pub fn send(&self, frame: SealedFrame) -> Result<(), SendError> {
        let SealedFrame(LoanedFrame { mut sample }) = frame;
        let header = sample.user_header_mut();
        header.published_monotonic_ns = monotonic_ns();
        let counter = header.counter;
        let undelivered = |reason: String| SendError::Undelivered { counter, reason };
        match sample.send() {
            Ok(1..) => {}
            Ok(0) => {
                return Err(undelivered(
                    "no host is connected or its buffer is full".into(),
                ));
            }
            Err(error) => return Err(undelivered(format!("{error:?}"))),
        }
        self.notifier
            .notify()
            .map(drop)
            .map_err(|error| undelivered(format!("{error:?}")))
    }
}

impl LoanedFrame {
    /// The pixels, in the shared memory.
    pub fn pixels(&mut self) -> &mut [u16] {
        self.sample.payload_mut()
    }

    /// Closes the frame: header and checksum are written beside the pixels.
    #[must_use]
    pub fn seal(mut self, header: FrameHeader) -> SealedFrame {
        let checksum = checksum(self.sample.payload());
        *self.sample.user_header_mut() = FrameHeader { checksum, ..header };
        SealedFrame(self)
    }
}
