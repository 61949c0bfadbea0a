//! What moves and sees: the controller, frames from the camera, the poses of views, and the settings of the station.
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
//! | [`acquisition`] | a capture plan run: triggers and frames paired, added up, captured again; live or recorded frames |
//! | [`doctor`] | what is installed and connected, a finding each with the remedy |
//! | [`poses`] | poses of the camera stated by somebody else than the stages |
//! | [`settings`] | `station.toml`: ports, stages, press, light, camera |
//! | [`patterns`] | the pictures that the DMD shows |
//!
//! It knows frames and time, neither verdicts nor what is stored.

pub mod acquisition;
pub mod controller;
pub mod doctor;
pub mod patterns;
pub mod poses;
pub mod settings;
