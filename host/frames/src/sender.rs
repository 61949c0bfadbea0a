//! The camera process's end: writes each frame once, into the shared memory.

use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;

use crate::arm::Arm;
use crate::header::{FrameHeader, monotonic_ns};
use crate::link::{FrameSink, FrameSlot, SealedFrame, SendError};
use crate::node::{ServiceError, refused};
use crate::ready::Ready;
use crate::root::SharedRoot;
use crate::services::{LOANED_FRAMES, MAX_FRAME_PIXELS, Services};

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
    ready: Publisher<ipc::Service, Ready, ()>,
    _services: Services,
}

/// A frame being written in the shared memory.
#[derive(Debug)]
pub struct LoanedFrame {
    sample: iceoryx2::sample_mut::SampleMut<ipc::Service, [u16], FrameHeader>,
}

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
            .map_err(refused("publish frames", root.path()))?;
        let notifier = services
            .wake
            .notifier_builder()
            .create()
            .map_err(refused("notify of frames", root.path()))?;
        let arm = services
            .arm
            .subscriber_builder()
            .history_request(1)
            .create()
            .map_err(refused("subscribe to the arming", root.path()))?;
        let ready = services
            .ready
            .publisher_builder()
            .create()
            .map_err(refused("speak for the camera", root.path()))?;
        Ok(Self {
            publisher,
            notifier,
            arm,
            ready,
            _services: services,
        })
    }
}

impl FrameSink for FrameSender {
    type Slot = LoanedFrame;

    fn armed(&mut self) -> Option<Arm> {
        let mut newest = None;
        while let Ok(Some(sample)) = self.arm.receive() {
            newest = Some(*sample.payload());
        }
        newest
    }

    /// Wakes the host.
    fn ready(&mut self, ready: Ready) -> Result<(), SendError> {
        let counter = ready.counter;
        let undelivered = |reason: String| SendError::Undelivered { counter, reason };
        self.ready
            .send_copy(ready)
            .map_err(|error| undelivered(format!("{error:?}")))?;
        let woken = self.notifier.notify();
        woken
            .map(drop)
            .map_err(|error| undelivered(format!("{error:?}")))
    }

    fn loan(&mut self, pixels: usize, counter: u32) -> Result<LoanedFrame, SendError> {
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

    /// Wakes the host.
    fn send(&mut self, frame: SealedFrame<LoanedFrame>) -> Result<(), SendError> {
        let LoanedFrame { mut sample } = frame.into_slot();
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

impl FrameSlot for LoanedFrame {
    fn pixels(&mut self) -> &mut [u16] {
        self.sample.payload_mut()
    }

    fn header_mut(&mut self) -> &mut FrameHeader {
        self.sample.user_header_mut()
    }
}
