//! The four verbs of a camera.

#[cfg(feature = "aravis")]
mod aravis;
mod folder;

use std::time::Duration;

use crate::frame_id::Counting;
use crate::unpack::UnpackError;

#[cfg(feature = "aravis")]
pub use aravis::{Aravis, Settings, Stamp};
pub use folder::Folder;

/// What a camera says of itself once it is configured.
#[derive(Clone, Debug, PartialEq)]
pub struct Description {
    /// Maker and model.
    pub model: String,
    /// By what it is connected, and its serial number.
    pub link: String,
    pub width_px: u32,
    pub height_px: u32,
    /// Bits of a sample.
    pub bits: u32,
    /// Counts without light, if it tells.
    pub offset_dn: Option<f64>,
    /// Electrons per count, if it tells.
    pub gain_e_per_dn: Option<f64>,
    /// How it counts its frames.
    pub counting: Counting,
}

/// A whole frame that was written into the slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Taken {
    /// The camera's own number.
    pub id: u64,
    /// Start of exposure on the camera's clock, µs.
    pub exposure_start_us: u64,
    /// End of exposure on the camera's clock, µs.
    pub exposure_end_us: u64,
    /// End of exposure on the host's monotonic clock, ns.
    pub exposure_end_monotonic_ns: u64,
    /// What of this was measured: bits as in [`FrameHeader`](flankscope_frames::FrameHeader).
    pub measured: u32,
}

/// What came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// Nothing in time.
    Nothing,
    /// A whole frame.
    Whole(Taken),
    /// A frame of which something is missing: nobody may see its pixels.
    Incomplete {
        /// The camera's own number, where that came.
        id: Option<u64>,
    },
    /// No frame will come any more.
    End,
}

/// How the link does, since the last arming.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Status {
    /// Frames that came whole.
    pub whole: u64,
    /// Frames that came in part.
    pub incomplete: u64,
    /// Frames that did not come.
    pub missing: u64,
    /// Packets lost, where that is counted.
    pub packets_lost: Option<u64>,
    /// Bytes of a frame on the link.
    pub frame_bytes: u64,
    /// The link is a network, with sockets.
    pub network: bool,
}

/// What a camera does wrong.
#[derive(Debug, thiserror::Error)]
pub enum CameraError {
    /// It is not there, or not any more.
    #[error("the camera is gone: {reason}")]
    Gone {
        /// The driver's own reason.
        reason: String,
    },
    /// It cannot be set as it must be.
    #[error("{setting}: {reason}")]
    Setting {
        /// What.
        setting: String,
        /// Why, and what would be right.
        reason: String,
    },
    /// Its samples cannot be read.
    #[error(transparent)]
    Unpack(#[from] UnpackError),
}

/// A camera that exposes when its trigger line says so.
pub trait Backend {
    /// Finds the camera and sets format, trigger and exposure; also after it was unplugged.
    ///
    /// # Errors
    /// It is not there, or cannot be set so.
    fn configure(&mut self) -> Result<Description, CameraError>;

    /// Throws away whatever is still in its buffers and begins to wait for `frames` triggers. Returns when no frame of
    /// before can come any more.
    ///
    /// # Errors
    /// The camera is gone.
    fn arm(&mut self, frames: u32) -> Result<(), CameraError>;

    /// Writes the next frame into the slot, if one comes within `patience`.
    ///
    /// # Errors
    /// The camera is gone, or sends something else than it was set to.
    fn next(&mut self, slot: &mut [u16], patience: Duration) -> Result<Next, CameraError>;

    /// How the link does.
    fn status(&self) -> Status;
}
