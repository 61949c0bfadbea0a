//! The instrument's devices: the controller, frames from the camera, the poses of views, and the settings of the station.
//!
//! ```text
//!  controller ── orders, triggers ──┐
//!                                   ├─ acquisition ──► sums of each view, added where the frames lie
//!  camera ────── frames, in place ──┘
//! ```
//!
//! | module | holds |
//! |---|---|
//! | [`controller`] | the client of the controller's serial protocol |
//! | [`acquisition`] | runs a capture plan: pairs triggers with frames, sums them, repeats captures; live or recorded frames |
//! | [`doctor`] | what is installed and connected: one finding each, with the remedy |
//! | [`poses`] | poses of the camera from sources other than the stages |
//! | [`settings`] | `station.toml`: ports, stages, press, light, camera |
//! | [`patterns`] | the pictures that the DMD shows |
//!
//! This crate handles frames and time; it knows neither verdicts nor stored results.

pub mod acquisition;
pub mod controller;
pub mod doctor;
pub mod patterns;
pub mod poses;
pub mod settings;
