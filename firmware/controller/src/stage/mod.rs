//! The stages: what the sequence asks of them, what they answer, and the drivers.
//!
//! Accepted is not done: a move is started, then asked about until both axes stand ([`crate::serve_stage`] does so).

pub mod decimal;
pub mod esp301;

use crate::sequence::Input;
use embedded_io_async::{Read, Write};
use flankscope_protocol::{Fault, Line, Micrometres, Microradians, StageConfig, View};

/// An order to the stages.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StageRequest {
    /// Reference both axes, vertical first. Nothing but [`StageRequest::Stop`] comes before.
    Home {
        /// Repeated in the report.
        ticket: u16,
        /// What these stages are, from here on.
        stage: StageConfig,
    },
    /// Both axes to a view.
    Move {
        /// Repeated in the report.
        ticket: u16,
        /// Where to.
        view: View,
    },
    /// The vertical axis alone.
    Retract {
        /// Repeated in the report.
        ticket: u16,
        /// Where to.
        vertical: Micrometres,
    },
    /// Halt both axes; not reported.
    Stop,
}

impl StageRequest {
    pub(crate) fn ticket(self) -> Option<u16> {
        match self {
            Self::Home { ticket, .. }
            | Self::Move { ticket, .. }
            | Self::Retract { ticket, .. } => Some(ticket),
            Self::Stop => None,
        }
    }
}

/// Where the stages say they are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pose {
    /// Rotary stage.
    pub rotation: Microradians,
    /// Vertical stage.
    pub vertical: Micrometres,
}

/// Why the stages did not do what they were asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StageFault {
    /// In the instrument's numbering.
    pub fault: Fault,
    /// In the stage controller's own numbering, 0 if none.
    pub detail: u32,
}

/// What became of a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StageReport {
    /// Which request.
    pub ticket: u16,
    /// Standing there, or not.
    pub outcome: Result<Pose, StageFault>,
}

impl From<StageReport> for Input {
    fn from(report: StageReport) -> Self {
        let ticket = report.ticket;
        match report.outcome {
            Ok(Pose { rotation, vertical }) => Self::InPosition {
                ticket,
                rotation,
                vertical,
            },
            Err(StageFault { fault, detail }) => Self::StageFailed {
                ticket,
                fault,
                detail,
            },
        }
    }
}

/// The controller's port to the stages: bytes, on a line that a station's file sets.
pub trait StagePort: Read + Write {
    /// Sets the line for all bytes from here on; what was written before must have left. `false` if the port cannot.
    fn set_line(&mut self, line: &Line) -> bool;
}

/// A driver for both stages.
pub trait Stage {
    /// Starts a request; returning means accepted, not done.
    async fn start(&mut self, request: StageRequest) -> Result<(), StageFault>;
    /// Where the stages stand, or `None` while they move.
    async fn standing(&mut self) -> Result<Option<Pose>, StageFault>;
}
