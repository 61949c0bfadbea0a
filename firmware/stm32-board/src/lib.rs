//! The controller on boards with an STM32: pins, drivers, tasks, and the way down when something fails.
//!
//! An image is this crate with the feature of its chip, a memory map, and an entry that calls [`run()`]. What differs from chip to
//! chip (clocks, reset flags, registers that outlive a reset, names) is its module `chip`.
#![no_std]

mod board;
#[cfg_attr(feature = "h743", path = "h743.rs")]
#[cfg_attr(feature = "f405", path = "f405/mod.rs")]
mod chip;
mod failsafe;
mod run;

pub use run::run;
