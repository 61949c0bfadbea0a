//! The frame contract: what a camera process and the host agree on, and nothing else.
//!
//! ```text
//!  camera process                      shared memory                       host
//!  FrameSender ── loan ─► [ slot | slot | slot | … ] ◄─ borrow ── FrameReceiver ── pixels ─► decoder
//!       ▲   written once                                     read in place, then released        │
//!       └──────────────────────────── Arm (session, order of the plan) ◄─────────────────────────┘
//! ```
//! Both processes open the same services below one private [`SharedRoot`]; the host owns it and removes what a killed
//! predecessor left.
//!
//! | module | holds |
//! |---|---|
//! | [`header`] | what travels with a frame, its checksum and its clock |
//! | [`arm`] | what the host tells the camera before it triggers, and how the camera labels by it |
//! | [`link`] | [`FrameSource`] and [`FrameSink`]: either end, whatever carries the frames |
//! | [`conformance`] | the checks that every camera process must pass |
//!
//! A camera process links this crate alone; `examples/camera.rs` is a whole one. What it owes the host:
//!
//! * It is started with the folder of the host's root and ends when its standard input does.
//! * It looks for an [`Arm`] before it labels an exposure, and counts by [`Labels`].
//! * Every exposure has the next counter value, from 0, whether its frame is delivered or not: a gap is a lost frame.
//! * Every frame has the same size; nothing is allocated after the first.
//!
//! How a camera process labels its exposures:
//!
//! ```
//! use flankscope_frames::{Arm, FrameLabel, Labels};
//!
//! // One view of three patterns in one exposure step: a dark frame comes first.
//! let mut labels = Labels::default();
//! labels.arm(Arm { session: 7, first_view: 0, views: 1, exposures: 1, patterns: 3 });
//! let patterns: Vec<u16> = (0..4).map(|_| labels.take().1.pattern).collect();
//! assert_eq!(patterns, [0, 1, 2, 3]);
//! assert_eq!(labels.take(), (7, FrameLabel::BEYOND));
//! ```
#![warn(missing_docs)]

pub mod arm;
pub mod conformance;
pub mod header;
pub mod link;
mod node;
mod private;
mod ready;
mod receiver;
mod root;
mod root_error;
mod sender;
mod services;

pub use arm::{Arm, Labels};
pub use header::{EXPOSURE_TOLERANCE_US, FrameHeader, FrameLabel, checksum, monotonic_ns};
pub use link::{
    BorrowedFrame, FrameSink, FrameSlot, FrameSource, ReceiveError, SealedFrame, SendError,
};
pub use node::ServiceError;
pub use private::{RunFolder, default_base, remove_run_folders};
pub use ready::Ready;
pub use receiver::{Frame, FrameReceiver};
pub use root::SharedRoot;
pub use root_error::RootError;
pub use sender::{FrameSender, LoanedFrame, Overflow};
pub use services::{BUFFERED_FRAMES, MAX_FRAME_PIXELS, SEGMENT_BYTES};
