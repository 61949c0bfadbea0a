//! The stages: what the sequence asks of them, and the task that gets it done.
//!
//! Accepted is not done: a move is started, then asked about until both axes stand. A newer request overtakes an
//! older one between two questions; no question is ever cut off in the middle, so answers cannot be mixed up.

pub mod decimal;
pub mod esp301;

use crate::run::Mailboxes;
use crate::sequence::Input;
use crate::vitals::Task;
use embassy_futures::select::{Either, select};
use embassy_time::{Duration, Timer};
use flankscope_protocol::{Fault, Micrometres, Microradians, View};

/// How often the stages are asked whether they stand. At 115200 baud a question with its answer takes about 1 ms.
const POLL: Duration = Duration::from_millis(5);

/// An order to the stages.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StageRequest {
    /// Reference both axes, vertical first.
    Home {
        /// Repeated in the report.
        ticket: u16,
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
            Self::Home { ticket } | Self::Move { ticket, .. } | Self::Retract { ticket, .. } => {
                Some(ticket)
            }
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

/// A driver for both stages.
pub trait Stage {
    /// Starts a request; returning means accepted, not done.
    async fn start(&mut self, request: StageRequest) -> Result<(), StageFault>;
    /// Where the stages stand, or `None` while they move.
    async fn standing(&mut self) -> Result<Option<Pose>, StageFault>;
}

/// Serves the sequence's requests for ever.
pub async fn run(mut stage: impl Stage, mail: &Mailboxes) -> ! {
    let mut next = None;
    loop {
        let request = match next.take() {
            Some(request) => request,
            None => {
                let next = mail.stage_requests.receive();
                mail.vitals.alive(Task::Stage, next).await
            }
        };
        // Every question has a time limit of its own, so this ends.
        let started = mail.vitals.alive(Task::Stage, stage.start(request)).await;
        let mut outcome = started.map(|()| None);
        let overtaken = loop {
            match outcome {
                Ok(None) => {}
                Ok(Some(pose)) => break Ok(pose),
                Err(fault) => break Err(fault),
            }
            match select(mail.stage_requests.receive(), Timer::after(POLL)).await {
                Either::First(newer) => {
                    next = Some(newer);
                    break Err(StageFault {
                        fault: Fault::OutOfStep,
                        detail: 0,
                    });
                }
                Either::Second(()) => {
                    outcome = mail.vitals.alive(Task::Stage, stage.standing()).await;
                }
            }
        };
        if let (None, Some(ticket)) = (&next, request.ticket()) {
            let report = StageReport {
                ticket,
                outcome: overtaken,
            };
            let sent = mail.stage_reports.send(report);
            mail.vitals.alive(Task::Stage, sent).await;
        }
    }
}
