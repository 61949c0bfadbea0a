//! Errors on the way from a stage position to the summed frames of a view, and the progress of a run.

use flankscope_profilometry::FrameError;
use flankscope_protocol::{Event, FaultCode, PlanError, StageConfig, StageName};

use super::pairing::PairingError;
use super::program::ProgramError;
use super::recording::ImageProblem;
use super::route::RouteTime;
use crate::controller::ClientError;
use flankscope_frames::{ReceiveError, ServiceError};

/// Why nothing could be captured at all. Errors after a capture has begun are a [`Stop`] or a [`ViewError`].
#[derive(Debug, thiserror::Error)]
pub enum AcquisitionError {
    /// The shared-memory services of the frames could not be opened.
    #[error(transparent)]
    Services(#[from] ServiceError),
    /// The controller could not be connected, or did not answer.
    #[error(transparent)]
    Client(#[from] ClientError),
    /// The program has more views, exposures or sets than a capture plan holds.
    #[error(transparent)]
    Program(#[from] ProgramError),
    #[error("the controller's limits do not allow the plan: {0}")]
    Plan(#[from] PlanError),
    #[error("the {thread} thread ended early")]
    Thread {
        /// Name of the thread.
        thread: &'static str,
    },
    /// The operator interrupted the run.
    #[error("interrupted")]
    Interrupted,
    #[error(
        "the head's file has a [lens], and the controller found no lens driver when it started: is the driver powered, wired as in firmware/README.md, and the controller reset since?"
    )]
    NoLens,
    /// The head has more projectors than the controller switches.
    #[error(
        "the head's file has {needed} projectors, and the controller found {fitted} when it started: is the second one plugged in, wired as in firmware/README.md, and the controller reset since?"
    )]
    TooFewProjectors {
        needed: usize,
        /// Projectors that the controller switches.
        fitted: u8,
    },
    /// The model of a stage is not the one in the station file; nothing has moved.
    #[error(
        "axis {axis} of the stages answers as {got:?}, station.toml names {named:?} ([stages], model): it is another stage, or plugged in elsewhere"
    )]
    OtherStage {
        /// Number of the axis.
        axis: u8,
        /// Model that the stage reports.
        got: StageName,
        /// Model in the station file.
        named: StageName,
    },
    /// The controller is in a fault that must be acknowledged.
    #[error(
        "the controller stands in {fault}; clear the cause and acknowledge it (flankscope doctor --acknowledge-fault)"
    )]
    Faulted { fault: FaultCode },
}

impl AcquisitionError {
    /// The error, if an event reports that a stage has another model than the configured one.
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
    /// The controller stopped with a fault.
    #[error("{0}")]
    Fault(FaultCode),
    /// Events of the controller were lost, so its record is incomplete.
    #[error("{count} events were lost in the controller")]
    EventsLost {
        /// Number of lost events.
        count: u32,
    },
    /// The link to the controller, or a thread, failed during the capture.
    #[error(transparent)]
    Broken(#[from] AcquisitionError),
    #[error("the check did not fit into the time for which the press may be held")]
    HoldLimit,
    /// The camera cannot be used, and nothing has moved.
    #[error(transparent)]
    Camera(#[from] CameraError),
    #[error("the capture thread does not answer")]
    Stalled,
    /// The operator interrupted the run.
    #[error("interrupted")]
    Interrupted,
}

/// Why the camera cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CameraError {
    /// The camera process cannot be reached over shared memory.
    #[error("the camera process cannot be reached: {reason}")]
    Unreachable {
        /// Reason given by the shared-memory library.
        reason: String,
    },
    /// The camera did not start, or does not answer.
    #[error("no camera said within {patience_ms} ms that it is armed and drained: {state}")]
    NotReady {
        /// Longest wait, ms.
        patience_ms: u128,
        /// Last known state of the camera.
        state: &'static str,
    },
    #[error(
        "the camera {model} has {got} {of}, the head file says {expected}: it is another camera, or set otherwise"
    )]
    Differs {
        /// Maker and model that the camera reports.
        model: String,
        /// Property that differs.
        of: &'static str,
        /// Value that the camera reports.
        got: String,
        /// Value in the head file.
        expected: String,
    },
}

/// Why a view's frames cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ViewError {
    /// A frame does not fit the plan, or shows another pattern than planned.
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
        got: u32,
        /// Session armed.
        expected: u32,
    },
    /// Frames are missing at the end of the capture.
    #[error("only {got} of {planned} frames came")]
    Incomplete { got: usize, planned: usize },
    /// No recorded frames of this view exist.
    #[error("the recording has no frames of {of}")]
    NotRecorded {
        /// Tooth or patch in the middle of the view.
        of: String,
    },
    /// A recorded frame cannot be used.
    #[error(transparent)]
    Image(#[from] ImageProblem),
    /// No pose of the camera was stated, or the stated one cannot be used.
    #[error("{0}")]
    Pose(String),
    /// One frame more than was triggered; which of the frames is the extra one is unknown.
    #[error("the camera sent a frame beyond the plan")]
    BeyondPlan,
}

/// Progress of a run, for display. A view is given by its index in the plan, from 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Progress {
    /// The controller answered.
    Connected,
    /// The stages are being referenced.
    Homing,
    /// The way through the views is planned.
    Planned(RouteTime),
    /// The head moves to a view.
    Moving {
        /// Index of the view.
        view: usize,
        /// Its number in the order of visits, from 0.
        number: usize,
        /// Number of views.
        of: usize,
    },
    /// A frame of the view was exposed.
    Exposed {
        /// Its number, from 0.
        frame: u16,
        /// Number of frames of the view.
        of: u16,
    },
    /// A view is being captured again.
    Recapture(usize),
    /// A result of the view is too near to a limit: it is measured again.
    Repeat(usize),
    /// An earlier view does not show enough of a flank: it is looked at from a further place, that of this view.
    Further(usize),
    /// The stages retract.
    Retracting,
    /// A view is evaluated.
    Evaluated(usize),
}
