//! The controller, as the host sees it: a serial port behind which orders are answered and events arrive.
//!
//! `link` moves bytes on threads of its own; `client` speaks the protocol on the I/O runtime;
//! `interrupt` is how somebody ends what runs.

mod client;
mod interrupt;
mod link;

pub use client::{Client, ClientError, ClientSettings};
pub use interrupt::{Interrupt, Interrupter};
pub use link::{Incoming, Link, LinkError};
