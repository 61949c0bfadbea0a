//! The running instrument: controller client, zero-copy capture, inspection job, report.

pub mod capture;
pub mod controller;
pub mod files;
