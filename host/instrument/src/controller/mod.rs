//! The controller as seen from the host: a serial port that answers commands and sends events.
//!
//! `link` moves bytes on its own threads; `client` speaks the protocol on the I/O runtime; `interrupt` lets the operator end a run.

mod client;
mod interrupt;
mod link;

pub use client::{Client, ClientError, ClientSettings};
pub use interrupt::{Interrupt, Interrupter};
pub use link::{Incoming, Link, LinkError};
