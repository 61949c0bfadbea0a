//! The running instrument: controller client, inspection job, report.
//!
//! ```text
//!  controller ── orders, triggers ──┐                 ┌─ inspection ── verdict ── sinks: history, report, lines
//!                                   ├─ acquisition ───┼─ scan
//!  camera ────── frames, in place ──┘                 └─ calibration
//! ```

pub mod acquisition;
pub mod baseline;
pub mod calibration;
pub mod controller;
pub mod die;
pub mod doctor;
pub mod files;
pub mod history;
pub mod inspection;
pub mod kinematics;
pub mod origin;
pub mod patterns;
pub mod poses;
pub mod report;
pub mod scan;
pub mod seal;
pub mod settings;
pub mod sink;
pub mod watch;
