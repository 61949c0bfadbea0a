//! The camera process: whatever camera there is, its frames are written once, into the slot that the host reads.
//!
//! ```text
//!  camera ── Backend: configure, arm, next, status ── serve ── FrameSink ── shared memory ── host
//! ```
//!
//! | module | holds |
//! |---|---|
//! | [`command`] | which camera, from the command line |
//! | [`backend`] | the four verbs of a camera; a folder of images as one, and what speaks GigE Vision or USB3 Vision |
//! | [`unpack`] | a camera's packed samples into the slot's |
//! | [`frame_id`] | which frames are missing, by numbers that wrap |
//! | [`serve`] | the loop between them |
//! | [`screen`] | a host that only looks: frames as text, for `--dry-run` |
//! | [`diagnosis`] | what is wrong with the link, in words |

pub mod backend;
pub mod command;
pub mod diagnosis;
pub mod frame_id;
#[cfg(feature = "aravis")]
mod namespace;
pub mod screen;
pub mod serve;
pub mod unpack;
