//! What can go wrong on the way from a position to the sums of its frames, and how far it is.

use flankscope_profilometry::FrameError;
use flankscope_protocol::{Event, FaultCode, PlanError, StageConfig, StageName};

use super::pairing::PairingError;
use super::program::ProgramError;
use super::recording::ImageProblem;
use super::route::RouteTime;
use crate::controller::ClientError;
use flankscope_frames::{ReceiveError, ServiceError};

/// Why nothing could be captured at all. What goes wrong once a capture runs ends in a [`Stop`] or a [`ViewError`].
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AcquisitionError {
    /// No frames.
    #[error(transparent)]
    Services(#[from] ServiceError),
    /// No controller.
    #[error(transparent)]
    Client(#[from] ClientError),
    /// More than a plan holds.
    #[error(transparent)]
    Program(#[from] ProgramError),
    /// The plan breaks the controller's limits.
    #[error("the controller's limits do not allow the plan: {0}")]
    Plan(#[from] PlanError),
    /// A thread ended early.
    #[error("the {thread} thread ended early")]
    Thread {
        /// Which.
        thread: &'static str,
    },
    /// Somebody asked for it.
    #[error("interrupted")]
    Interrupted,
    /// The head's focus follows a lens that nobody drives.
    #[error(
        "the head's file has a [lens], and the controller found no lens driver when it started: is the driver powered, wired as in firmware/README.md, and the controller reset since?"
    )]
    NoLens,
    /// The head has a projector that nobody switches.
    #[error(
        "the head's file has {needed} projectors, and the controller found {fitted} when it started: is the second one plugged in, wired as in firmware/README.md, and the controller reset since?"
    )]
    TooFewProjectors {
        /// Of the head.
        needed: usize,
        /// Of the controller.
        fitted: u8,
    },
    /// A stage is another one than the station's, and nothing has moved.
    #[error(
        "axis {axis} of the stages answers as {got:?}, station.toml names {named:?} ([stages], model): it is another stage, or plugged in elsewhere"
    )]
    OtherStage {
        /// Number of the axis.
        axis: u8,
        /// By its own word.
        got: StageName,
        /// By the station's file.
        named: StageName,
    },
    /// The controller waits for somebody.
    #[error(
        "the controller stands in {fault}; clear the cause and acknowledge it (flankscope doctor --acknowledge-fault)"
    )]
    Faulted {
        /// Its fault.
        fault: FaultCode,
    },
}

impl AcquisitionError {
    /// The complaint, where an event says that a stage is another one than it should be.
    pub(super) fn other_stage(event: &Event, stage: &StageConfig) -> Option<Self> {
        let Event::StageIdentity {
            axis,
            answer: Ok(got),
            ..
        } = *event
        else {
            return None;
        };
        let (_, named) = stage
            .models()
            .into_iter()
            .find(|(number, _)| *number == axis)?;
        let named = named.filter(|named| named.model() != got.model())?;
        Some(Self::OtherStage { axis, got, named })
    }
}

/// Why a capture that had begun ended before its last view.
#[derive(Debug, thiserror::Error)]
pub enum Stop {
    /// The controller stopped.
    #[error("{0}")]
    Fault(FaultCode),
    /// What happened is not known whole.
    #[error("{count} events were lost in the controller")]
    EventsLost {
        /// How many.
        count: u32,
    },
    /// The link to the controller, or a thread, broke on the way.
    #[error(transparent)]
    Broken(#[from] AcquisitionError),
    /// The press must go on.
    #[error("the check did not fit into the time for which the press may be held")]
    HoldLimit,
    /// The camera cannot be used, and nothing has moved.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// Frames do not come to an end.
    #[error("the capture thread does not answer")]
    Stalled,
    /// Somebody asked for it.
    #[error("interrupted")]
    Interrupted,
}

/// Why the camera cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CameraError {
    /// It cannot be told or heard.
    #[error("the camera process cannot be reached: {reason}")]
    Unreachable {
        /// The library's own reason.
        reason: String,
    },
    /// It has not come, or does not answer.
    #[error("no camera said within {patience_ms} ms that it is armed and drained: {state}")]
    NotReady {
        /// Patience, ms.
        patience_ms: u128,
        /// What is known of it.
        state: &'static str,
    },
    /// It is another camera than the head's.
    #[error(
        "the camera {model} has {got} {of}, the head file says {expected}: it is another camera, or set otherwise"
    )]
    Differs {
        /// Maker and model, by its own word.
        model: String,
        /// Of what.
        of: &'static str,
        /// By its own word.
        got: String,
        /// By the head file.
        expected: String,
    },
}

/// Why a view's frames cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ViewError {
    /// A frame did not fit the plan, or showed the wrong thing.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// A frame could not be read.
    #[error(transparent)]
    Receive(#[from] ReceiveError),
    /// Triggers and frames do not pair.
    #[error(transparent)]
    Pairing(#[from] PairingError),
    /// The camera process is labelling another session.
    #[error("a frame of session {got} came during session {expected}")]
    Session {
        /// Session of the frame.
        got: u32,
        /// Session armed.
        expected: u32,
    },
    /// Frames are missing at the end.
    #[error("only {got} of {planned} frames came")]
    Incomplete {
        /// Frames that came.
        got: usize,
        /// Frames planned.
        planned: usize,
    },
    /// Nobody recorded it.
    #[error("the recording has no frames of {of}")]
    NotRecorded {
        /// What is in the middle of the view: a tooth, or a patch.
        of: String,
    },
    /// A recorded frame cannot be used.
    #[error(transparent)]
    Image(#[from] ImageProblem),
    /// Nobody said where the camera stood, or what was said is not to be trusted.
    #[error("{0}")]
    Pose(String),
    /// One more than was triggered, and nobody knows before which of the others.
    #[error("the camera sent a frame beyond the plan")]
    BeyondPlan,
}

/// How far a run is; for somebody who watches. A view is its place in the plan, from 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Progress {
    /// The controller answered.
    Connected,
    /// The stages reference.
    Homing,
    /// The way through the views is planned.
    Planned(RouteTime),
    /// The head moves to a view.
    Moving {
        /// Which.
        view: usize,
        /// Its number in the order of visits, from 0.
        number: usize,
        /// Of how many.
        of: usize,
    },
    /// A frame of the view was exposed.
    Exposed {
        /// Its number, from 0.
        frame: u16,
        /// Of how many.
        of: u16,
    },
    /// A view is being captured again.
    Recapture(usize),
    /// A view's figures are too near to a limit: it is measured again.
    Repeat(usize),
    /// The stages retract.
    Retracting,
    /// A view is evaluated.
    Evaluated(usize),
}
