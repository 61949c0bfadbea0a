//! The controller, free of any board: capture sequence, drivers over embedded-hal traits, thin tasks.
//!
//! ```text
//!            bytes                 commands                                  actions
//! host ──► link::receive ──► tasks::sequencer( CommandHandler ► Sequence ) ──► LED, DMD, camera pins
//! host ◄── link::transmit ◄── replies, events ◄──────────────┘ ▲ └─────────► serve_stage ──► stage driver (UART)
//!                                                              └──────────── pin levels, in position, deadlines
//! ```
//! [`sequence::Sequence`] and what it is made of ([`lamps::Lamps`], [`budget::LedBudget`], [`session::Session`]) are
//! pure: time comes in as an argument, what to do comes out as a list of [`sequence::Action`]s. They are tested by
//! hand-stepped time. The tasks in [`tasks`] only carry: they wait, ask, and do what they are
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
pub mod command_handler;
pub mod devices;
#[cfg(test)]
mod diagrams;
pub mod dlpc;
pub mod dlpc350;
pub mod dlpc900;
pub mod interlock;
pub mod lamp;
pub mod lamps;
pub mod lens;
pub mod liveness;
pub mod mailbox;
pub mod max14574;
pub mod press;
pub mod sequence;
pub mod session;
pub mod stage;
mod stage_fault;
pub mod tasks;

pub use command_handler::CommandHandler;
pub use devices::{Camera, Dmd, Led, LightEngine, Optics};
pub use lens::{Lens, NoLens};
pub use liveness::Watchdog;
pub use press::{NoPress, PinPress, Press};
pub use sequence::{Action, Actions, Config, Input, Sequence};
pub use tasks::{Mailboxes, link, press_sequencer, sequencer, serve_stage, supervise};
