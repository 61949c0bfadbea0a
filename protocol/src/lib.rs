//! Wire contract between the host and the controller: units, messages, capture plan, framing.
//!
//! This crate is the only thing both sides know. It does no I/O, needs no allocator and never panics on input:
//! the host links it with std, the controller links it into a microcontroller image.
//!
//! | module      | what it holds                                                             |
//! |-------------|---------------------------------------------------------------------------|
//! | [`pattern_memory`] | where a pattern lies in the projector's memory                   |
//! | [`units`]   | integer newtypes with the unit in their name                              |
//! | [`plan`]    | the declarative [`CapturePlan`], its [`Limits`] and the refusal [`PlanError`] |
//! | [`stage`](mod@stage) | [`StageConfig`]: axes, travel, dynamics, homing and line of the stages           |
//! | [`stage_name`] | what a stage says it is                                                |
//! | [`message`] | [`Command`] host -> controller, [`Reply`] and [`Event`] controller -> host |
//! | [`fault`]   | stable fault numbers                                                      |
//! | [`line`](mod@line) | how the serial line between them is set                                   |
//! | [`frame`]   | COBS + CRC-32C frames carrying one message each                           |
//!
//! ```
//! use flankscope_protocol::{Command, Decoder, Header, encode, MAX_FRAME_BYTES};
//!
//! let mut wire = [0u8; MAX_FRAME_BYTES];
//! let header = Header { session: 7, sequence: 1, ack: 0 };
//! let length = encode(header, &Command::Heartbeat, &mut wire).expect("fits");
//!
//! let mut decoder = Decoder::new();
//! let mut received = None;
//! for &byte in &wire[..length] {
//!     if let Some(frame) = decoder.push(byte) {
//!         let frame = frame.expect("undamaged");
//!         received = Some((frame.header(), frame.message::<Command>().expect("a command")));
//!     }
//! }
//! assert_eq!(received, Some((header, Command::Heartbeat)));
//! ```
#![no_std]
#![forbid(unsafe_code)]
#![deny(missing_docs)]
#![cfg_attr(
    not(test),
    deny(
        clippy::unwrap_used,
        clippy::expect_used,
        clippy::panic,
        clippy::indexing_slicing,
        clippy::unreachable,
        clippy::arithmetic_side_effects
    )
)]

pub mod fault;
pub mod frame;
pub mod line;
pub mod message;
pub mod pattern_memory;
pub mod plan;
pub mod stage;
pub mod stage_name;
pub mod units;

pub use fault::{Fault, FaultClass, FaultCode};
pub use frame::{
    DecodeError, Decoder, EncodeError, Frame, Header, Kind, MAX_FRAME_BYTES, Message, encode,
};
pub use line::{FlowControl, Line, LineRecord, Parity};
pub use message::{
    Command, Event, Identity, PressStatus, Refusal, Reply, State, Status, Trigger, Why,
};
pub use plan::{
    CapturePlan, Focus, FrameOrder, FramePlace, FrameSpec, FringeSet, Limits, PlanError, Projector,
    Timeouts, View,
};
pub use stage::{
    Axis, AxisPosition, HomeAt, LinearAxis, RotaryAxis, StageConfig, StageError, StageValue,
};
pub use stage_name::StageName;
pub use units::{
    LensCounts, Micrometres, MicrometresPerSecond, MicrometresPerSecondSquared, Microradians,
    Microseconds, Milliamps, MillidegreesPerSecond, MillidegreesPerSecondSquared, Timestamp,
};

/// Version of the meaning of the messages; raised whenever a golden byte vector changes.
pub const PROTOCOL_VERSION: u32 = 6;

/// CRC-32C over the golden bytes of every message, in the order of `tests/golden.rs`, which also checks it.
///
/// Two builds whose messages are laid out differently have different hashes and refuse each other in the hello,
/// even when somebody forgot to raise [`PROTOCOL_VERSION`].
pub const SCHEMA_HASH: u32 = 0x163c_6a9b;
