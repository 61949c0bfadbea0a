//! Either end of the way of a frame, whatever carries it.
//!
//! The host takes frames from a [`FrameSource`], a camera gives them to a [`FrameSink`]. [`FrameReceiver`] and
//! [`FrameSender`] are the pair for two processes on one machine.
//!
//! [`FrameReceiver`]: crate::FrameReceiver
//! [`FrameSender`]: crate::FrameSender

use std::time::Duration;

use crate::arm::Arm;
use crate::header::{FrameHeader, checksum};
use crate::ready::Ready;
use crate::services::MAX_FRAME_PIXELS;

/// A frame where it lies; dropping it gives its memory back.
pub trait BorrowedFrame {
    /// The header.
    fn header(&self) -> &FrameHeader;

    /// Row after row, `stride_px` apart.
    fn pixels(&self) -> &[u16];

    /// When the host saw it, monotonic clock, ns.
    fn received_monotonic_ns(&self) -> u64;
}

/// Where the host's frames come from.
pub trait FrameSource {
    /// How a frame is held.
    type Frame: BorrowedFrame;

    /// Tells the camera what will be exposed next.
    ///
    /// # Errors
    /// The camera cannot be told.
    fn arm(&mut self, arm: Arm) -> Result<(), ReceiveError>;

    /// The newest word of the camera, if it has said one.
    ///
    /// # Errors
    /// The source failed.
    fn ready(&mut self) -> Result<Option<Ready>, ReceiveError>;

    /// The next frame, if one comes within `timeout`.
    ///
    /// # Errors
    /// The source failed, or the frame's header or checksum does not fit its pixels.
    fn receive(&mut self, timeout: Duration) -> Result<Option<Self::Frame>, ReceiveError>;
}

/// Memory that a frame is being written into.
pub trait FrameSlot: Sized {
    /// The pixels, with the content of some earlier frame.
    fn pixels(&mut self) -> &mut [u16];

    /// The header beside them.
    fn header_mut(&mut self) -> &mut FrameHeader;

    /// Closes the frame: header and checksum are written beside the pixels.
    #[must_use]
    fn seal(mut self, header: FrameHeader) -> SealedFrame<Self> {
        let checksum = checksum(self.pixels());
        *self.header_mut() = FrameHeader { checksum, ..header };
        SealedFrame(self)
    }
}

/// A frame whose pixels and header are final; only the hand-over is left.
#[derive(Debug)]
pub struct SealedFrame<S>(S);

impl<S> SealedFrame<S> {
    /// The slot, for the sink that delivers it.
    #[must_use]
    pub fn into_slot(self) -> S {
        self.0
    }
}

/// Where a camera's frames go.
pub trait FrameSink {
    /// Memory for one frame.
    type Slot: FrameSlot;

    /// The newest arming that came since the last call.
    fn armed(&mut self) -> Option<Arm>;

    /// Tells the host who the camera is, and what it is armed for.
    ///
    /// # Errors
    /// The host cannot be told.
    fn ready(&mut self, ready: Ready) -> Result<(), SendError>;

    /// A slot of `pixels` to write frame number `counter` into.
    ///
    /// # Errors
    /// The frame is too large, or the host holds every slot.
    fn loan(&mut self, pixels: usize, counter: u32) -> Result<Self::Slot, SendError>;

    /// Hands the frame over. The time of hand-over is filled in.
    ///
    /// # Errors
    /// The host did not get it.
    fn send(&mut self, frame: SealedFrame<Self::Slot>) -> Result<(), SendError>;
}

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

impl ReceiveError {
    /// Checks a header against the pixels beside it.
    ///
    /// # Errors
    /// Its size is not theirs, or they are not those that were sent.
    pub fn check(header: &FrameHeader, pixels: &[u16]) -> Result<(), Self> {
        let (rows, stride) = (u64::from(header.height_px), u64::from(header.stride_px));
        if header.width_px > header.stride_px || rows * stride != pixels.len() as u64 {
            return Err(Self::Geometry {
                counter: header.counter,
                width_px: header.width_px,
                height_px: header.height_px,
                stride_px: header.stride_px,
                pixels: pixels.len(),
            });
        }
        let got = checksum(pixels);
        if got != header.checksum {
            return Err(Self::Corrupt {
                counter: header.counter,
                expected: header.checksum,
                got,
            });
        }
        Ok(())
    }
}

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_header_that_does_not_fit_its_pixels_is_refused() {
        let pixels: Vec<u16> = (0..12).collect();
        let good = FrameHeader {
            width_px: 3,
            height_px: 3,
            stride_px: 4,
            checksum: checksum(&pixels),
            ..FrameHeader::default()
        };
        assert!(ReceiveError::check(&good, &pixels).is_ok());
        for bad in [
            FrameHeader {
                width_px: 5,
                ..good
            },
            FrameHeader {
                height_px: 4,
                ..good
            },
            FrameHeader {
                stride_px: 3,
                ..good
            },
            // Their product is 12 in 32 bits.
            FrameHeader {
                height_px: 0x4000_0003,
                ..good
            },
        ] {
            assert!(
                matches!(
                    ReceiveError::check(&bad, &pixels),
                    Err(ReceiveError::Geometry { .. })
                ),
                "{bad:?}"
            );
        }
        let mut other = pixels.clone();
        other[11] ^= 1;
        assert!(matches!(
            ReceiveError::check(&good, &other),
            Err(ReceiveError::Corrupt { .. })
        ));
    }
}
