//! The instrument end to end: commands, controller, camera, stages, calibration, signals and packages.

mod calibrate;
mod camera_python;
mod deployment;
mod doctor;
mod frames;
mod gige;
mod hardware;
mod init;
mod interrupts;
mod line;
mod stages;
mod tampered_line;
mod view;
mod watch;
