//! The stages: what the sequence asks of them, what they answer, and the drivers.
//!
//! Accepted is not done: a move is started, then asked about until both axes stand ([`crate::serve_stage`] does so).

pub mod decimal;
pub mod esp301;

use crate::sequence::Input;
pub use crate::stage_fault::StageFault;
use embassy_time::Duration;
use embedded_io_async::{Read, Write};
use flankscope_protocol::{Fault, Line, Micrometres, Microradians, StageConfig, StageName, View};

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
    /// Say what the stages are; nothing moves.
    Identify {
        /// Repeated in the report.
        ticket: u16,
        /// Their line and the numbers of their axes.
        stage: StageConfig,
    },
    /// Halt both axes; not reported.
    Stop,
}

impl StageRequest {
    pub(crate) fn ticket(self) -> Option<u16> {
        match self {
            Self::Home { ticket, .. }
            | Self::Move { ticket, .. }
            | Self::Retract { ticket, .. }
            | Self::Identify { ticket, .. } => Some(ticket),
            Self::Stop => None,
        }
    }

    /// The report that it came to nothing; none where none is expected.
    pub(crate) fn failed(self, fault: Fault) -> Option<StageReport> {
        let failed = StageFault { fault, detail: 0 };
        let ticket = self.ticket()?;
        Some(match self {
            Self::Identify { .. } => StageReport::Identity {
                ticket,
                outcome: Err(failed),
            },
            _ => StageReport::Motion {
                ticket,
                outcome: Err(failed),
            },
        })
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

/// What became of a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StageReport {
    Motion {
        /// Which request.
        ticket: u16,
        /// Standing there, or not.
        outcome: Result<Pose, StageFault>,
    },
    /// Of the question what the stages are.
    Identity {
        /// Which request.
        ticket: u16,
        /// Rotation, vertical.
        outcome: Result<[StageName; 2], StageFault>,
    },
}

impl From<StageReport> for Input {
    fn from(report: StageReport) -> Self {
        match report {
            StageReport::Motion {
                ticket,
                outcome: Ok(Pose { rotation, vertical }),
            } => Self::InPosition {
                ticket,
                rotation,
                vertical,
            },
            StageReport::Motion {
                ticket,
                outcome: Err(StageFault { fault, detail }),
            } => Self::StageFailed {
                ticket,
                fault,
                detail,
            },
            StageReport::Identity { ticket, outcome } => Self::StagesAre { ticket, outcome },
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
    /// Starts a motion or a stop; returning means accepted, not done. Never called with [`StageRequest::Identify`].
    async fn start(&mut self, request: StageRequest) -> Result<(), StageFault>;
    /// Where the stages stand, or `None` while they move.
    async fn standing(&mut self) -> Result<Option<Pose>, StageFault>;
    /// Patience with [`Stage::standing`] at a view.
    fn watch_limit(&self) -> Duration;
    /// What the stages of this line and these axes say they are, rotation and vertical; nothing moves.
    async fn identity(&mut self, stage: &StageConfig) -> Result<[StageName; 2], StageFault>;
}
