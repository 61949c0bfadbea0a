//! The controller's tasks, and the mailboxes between them. They only carry: they wait, ask, and do what they are told.
//!
//! | task | in | out |
//! |---|---|---|
//! | [`link::receive`] | bytes | requests |
//! | [`sequencer`] | requests, stage reports, pins, deadlines | pins, stage requests, replies, events |
//! | [`serve_stage`] | stage requests | stage reports |
//! | [`link::transmit`] | replies, events | bytes |
//! | [`supervise`] | signs of life | the watchdog |

pub mod link;
mod sequencer;
mod stage;
mod supervisor;

pub use sequencer::{now, press_sequencer, sequencer};
pub use stage::serve_stage;
pub use supervisor::supervise;

use crate::liveness::Liveness;
use crate::mailbox::Mailbox;
use crate::stage::{StageReport, StageRequest};
use core::sync::atomic::AtomicU32;
use flankscope_protocol::{Command, Event, Header, Reply};

/// Events waiting for the link: about two views' worth of triggers.
pub const EVENTS_QUEUED: usize = 64;
/// A command as it came off the link; `None` when the payload could not be read.
#[derive(Debug, Clone)]
pub struct Request {
    /// Addressing of its frame.
    pub header: Header,
    pub command: Option<Command>,
}

/// A message on its way to the host.
#[derive(Debug, Clone)]
#[allow(clippy::large_enum_variant)] // queued in static memory
pub enum Outgoing {
    /// To the command with this addressing.
    Reply(Header, Reply),
    /// In the open session.
    Event(Event),
}

/// Everything the tasks share; one static per controller.
pub struct Mailboxes {
    pub(crate) requests: Mailbox<Request, 2>,
    pub(crate) outgoing: Mailbox<Outgoing, EVENTS_QUEUED>,
    /// What the sequence asks of the stages: [`serve_stage`] takes it from here.
    pub stage_requests: Mailbox<StageRequest, 4>,
    /// What became of it.
    pub stage_reports: Mailbox<StageReport, 4>,
    pub(crate) liveness: Liveness,
    pub(crate) session: AtomicU32,
    pub(crate) frames_dropped: AtomicU32,
    pub(crate) events_lost: AtomicU32,
}

impl Mailboxes {
    /// Empty, without a watchdog.
    #[must_use]
    pub const fn new() -> Self {
        Self::with(false)
    }

    /// Empty; [`crate::supervise`] must run, and every task wakes up to show life.
    #[must_use]
    pub const fn supervised() -> Self {
        Self::with(true)
    }

    const fn with(supervised: bool) -> Self {
        Self {
            liveness: Liveness::new(supervised),
            requests: Mailbox::new(),
            outgoing: Mailbox::new(),
            stage_requests: Mailbox::new(),
            stage_reports: Mailbox::new(),
            session: AtomicU32::new(0),
            frames_dropped: AtomicU32::new(0),
            events_lost: AtomicU32::new(0),
        }
    }
}

impl Default for Mailboxes {
    fn default() -> Self {
        Self::new()
    }
}
