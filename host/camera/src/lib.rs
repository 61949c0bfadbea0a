//! The camera process: whatever camera there is, its frames are written once, into the slot that the host reads.
//!
//! ```text
//!  camera ── Backend: configure, arm, next, status ── serve ── FrameSink ── shared memory ── host
//! ```
//!
//! | module | holds |
//! |---|---|
//! | [`backend`] | the four verbs of a camera, and a folder of images as one |
//! | [`unpack`] | a camera's packed samples into the slot's |
//! | [`frame_id`] | which frames are missing, by numbers that wrap |
//! | [`serve`] | the loop between them |
//! | [`diagnosis`] | what is wrong with the link, in words |

pub mod backend;
pub mod diagnosis;
pub mod frame_id;
pub mod serve;
pub mod unpack;
