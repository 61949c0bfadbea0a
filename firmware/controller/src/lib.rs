//! The controller, free of any board: capture sequence, drivers over embedded-hal traits, thin tasks.
//!
//! ```text
//!            bytes                 commands                        actions
//! host ──► link::receive ──► run::sequencer( Desk ► Sequence ) ──► LED, DMD, camera pins
//! host ◄── link::transmit ◄── replies, events ◄──┘      ▲ └─────► stage::run ──► stage driver (UART)
//!                                                       └──────── pin levels, in position, deadlines
//! ```
//! [`sequence::Sequence`] and what it is made of ([`lamp::Lamp`], [`budget::LedBudget`], [`session::Session`]) are
//! pure: time comes in as an argument, what to do comes out as a list of [`sequence::Action`]s. They are tested by
//! hand-stepped time. The tasks in [`link`], [`run`] and [`stage`] only carry: they wait, ask, and do what they are
//! told. A board image or the simulator supplies pins, UARTs and the time driver.
#![no_std]
#![forbid(unsafe_code)]
#![allow(async_fn_in_trait)] // single-threaded executors: no Send bounds wanted
#![cfg_attr(
    not(test),
    deny(
        clippy::unwrap_used,
        clippy::expect_used,
        clippy::panic,
        clippy::indexing_slicing,
        clippy::unreachable
    )
)]

pub mod budget;
pub mod desk;
pub mod devices;
pub mod dlpc350;
#[cfg(test)]
mod drawings;
pub mod interlock;
pub mod lamp;
pub mod link;
pub mod mailbox;
pub mod press;
pub mod run;
pub mod sequence;
pub mod session;
pub mod stage;
pub mod vitals;

pub use desk::Desk;
pub use devices::{Camera, CameraWait, Dmd, Led, Optics};
pub use press::{NoPress, PinPress, Press};
pub use run::{Mailboxes, press_sequencer, sequencer};
pub use sequence::{Action, Actions, Config, Input, Sequence};
pub use vitals::{Watchdog, supervise};
