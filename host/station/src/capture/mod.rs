//! Frames from the camera process, without a copy.
//!
//! ```text
//!  camera process                      shared memory                       host
//!  FrameSender ── loan ─► [ slot | slot | slot | … ] ◄─ borrow ── FrameReceiver ── FrameView ─► decoder
//!       ▲   written once                                     read in place, then released        │
//!       └──────────────────────────── Arm (session, order of the plan) ◄─────────────────────────┘
//! ```
//! Both processes open the services below one private [`SharedRoot`]; the host owns it and removes what a
//! killed predecessor left.

mod frame;
mod receiver;
mod root;
mod sender;
mod services;

pub use frame::{Arm, Frame, FrameHeader, FrameLabel, checksum, monotonic_ns};
pub use receiver::{FrameReceiver, ReceiveError};
pub use root::{RootError, SharedRoot};
pub use sender::{FrameSender, LoanedFrame, Overflow, SealedFrame, SendError};
pub use services::{BUFFERED_FRAMES, MAX_FRAME_PIXELS, ServiceError};
