//! The messages themselves. Enums are append-only: a variant's position is its number on the wire.
//!
//! | direction          | message     | carries                                                        |
//! |--------------------|-------------|----------------------------------------------------------------|
//! | host -> controller | [`Command`] | one order; answered by exactly one [`Reply`], safe to repeat   |
//! | controller -> host | [`Reply`]   | the answer; its frame's `ack` is the command's sequence number |
//! | controller -> host | [`Event`]   | what happened, when; its own sequence numbers show any gap     |
//!
//! `Accepted` means that the order was understood and has begun, never that it is done: completion is an event.

use crate::fault::FaultCode;
use crate::plan::{CapturePlan, Limits, PlanError, Projector};
use crate::stage::{StageConfig, StageError};
use crate::stage_name::StageName;
use crate::units::{Micrometres, Microradians, Microseconds, Timestamp};
use serde::{Deserialize, Serialize};

/// An order from the host.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[allow(clippy::large_enum_variant)] // no allocator to box the plan with; commands are handled one at a time
pub enum Command {
    /// Opens a session: the frame's session number becomes the link's, everything before is forgotten.
    /// Layout and number of this variant never change, so that any two versions can refuse each other by name.
    Hello {
        /// The host's [`crate::PROTOCOL_VERSION`].
        protocol: u32,
        /// The host's [`crate::SCHEMA_HASH`].
        schema: u32,
    },
    /// Stores a plan for [`Command::Start`]; nothing moves.
    LoadPlan(CapturePlan),
    /// Runs the stored plan.
    Start {
        /// Must be the stored plan's session.
        session: u32,
    },
    /// LED off, stages halted, then retract.
    Abort,
    /// LED off, then retract.
    Retract,
    /// References both axes, vertical first, and leaves the head retracted.
    Home,
    /// Says that the host is alive. Every other command says so too.
    Heartbeat,
    /// Asks for a [`Status`].
    Status,
    /// Clears a fault whose cause is gone; the head must be retracted again before a start.
    AcknowledgeFault,
    /// Shows a verdict at the press for [`Identity::verdict_life`]; without another one it falls to no-go.
    ShowVerdict {
        /// Go; everything else is no-go.
        go: bool,
    },
    /// Says what stages these are. Before one was accepted in this session, no order moves them; one that differs from the last
    /// takes effect at the next [`Command::Home`], which is then needed.
    ConfigureStage {
        /// The host's [`crate::stage::STAGE_CONFIG_VERSION`].
        version: u16,
        /// The stages.
        stage: StageConfig,
    },
    /// Asks the stages what they are; nothing moves. Answered by one [`Event::StageIdentity`] for each axis.
    IdentifyStages,
}

/// The answer to one command.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Reply {
    /// Understood and begun.
    Accepted,
    /// Not done, and nothing has changed.
    Refused(Refusal),
    /// Answer to [`Command::Hello`].
    Hello(Identity),
    /// Answer to [`Command::Status`].
    Status(Status),
}

/// Why a command was not carried out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
pub enum Refusal {
    /// The hello named another protocol version. Layout and number of this variant never change.
    #[error("the host speaks protocol {got}, the controller speaks {want}")]
    ProtocolVersion {
        /// The host's version.
        got: u32,
        /// The controller's version.
        want: u32,
    },
    /// The hello named another message layout. Layout and number of this variant never change.
    #[error("the host's message layout is {got:#010x}, the controller's is {want:#010x}")]
    SchemaHash {
        /// The host's hash.
        got: u32,
        /// The controller's hash.
        want: u32,
    },
    /// No session is open under the frame's session number: say hello first.
    #[error("no session {got} is open; say hello first")]
    NoSession {
        /// The frame's session number.
        got: u32,
    },
    /// The sequence number lies in the past and its reply is no longer kept.
    #[error("sequence number {got} lies before {last}")]
    StaleSequence {
        /// The frame's sequence number.
        got: u16,
        /// The last one carried out.
        last: u16,
    },
    /// The frame was whole but its payload is no command of this version.
    #[error("the command could not be read")]
    Unreadable,
    /// The plan breaks a limit.
    #[error("plan refused: {0}")]
    Plan(#[from] PlanError),
    /// Start without a stored plan.
    #[error("no plan is loaded")]
    NoPlan,
    /// Start names another plan than the stored one.
    #[error("start names session {got}, the loaded plan is {want}")]
    WrongPlan {
        /// Session named by the start.
        got: u32,
        /// Session of the stored plan.
        want: u32,
    },
    /// The instrument is busy.
    #[error("not possible while {state:?}")]
    Busy {
        /// What it is doing.
        state: State,
    },
    /// The position of the stages is not known: home first.
    #[error("the stages are not referenced; home first")]
    NotHomed,
    /// A fault waits for its acknowledgement.
    #[error("{fault} is not acknowledged")]
    Faulted {
        /// The fault.
        fault: FaultCode,
    },
    /// The head may not enter the die as the press is now.
    #[error("the head may not enter: {fault}")]
    Interlock {
        /// What would be the fault if it did.
        fault: FaultCode,
    },
    /// The configuration of the stages breaks a limit.
    #[error("stages refused: {0}")]
    Stage(#[from] StageError),
    /// A motion before the stages were configured in this session.
    #[error("the stages are not configured in this session; configure them first")]
    NotConfigured,
    /// The plan drives a lens, and no driver of one answered when the controller started.
    #[error("the plan drives a lens, and no lens driver is fitted")]
    NoLens,
    /// The plan uses more projectors than the controller has.
    #[error("the plan uses {got} projectors, the controller has {fitted}")]
    TooFewProjectors {
        /// Projectors of the plan.
        got: u8,
        /// Projectors fitted.
        fitted: u8,
    },
}

/// What the controller is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Identity {
    /// The controller's [`crate::PROTOCOL_VERSION`].
    pub protocol: u32,
    /// The controller's [`crate::SCHEMA_HASH`].
    pub schema: u32,
    /// Firmware release: major, minor, patch.
    pub firmware: [u8; 3],
    /// Plans and stages are judged by these; compiled in.
    pub limits: Limits,
    /// During a capture the host may be silent for this long at most.
    pub host_silence: Microseconds,
    /// A verdict shown at the press falls to no-go after this.
    pub verdict_life: Microseconds,
    /// Why the controller last started.
    pub boot: Boot,
    /// A lens driver answered when the controller started: plans may have a [`crate::Focus`].
    pub lens: bool,
    /// Projectors fitted: a plan uses no more.
    pub projectors: u8,
}

/// Why the controller last started.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Boot {
    /// Power came on.
    PowerUp,
    /// A task missed its check-in and the watchdog reset the controller.
    Watchdog,
    /// The panic handler reset the controller.
    Panic,
    /// Somebody asked for a reset.
    Requested,
}

/// What the controller is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum State {
    /// After power-up or a failed retract: position unknown, waiting for a home command.
    Unhomed,
    /// Referencing the axes.
    Homing,
    /// Head retracted, ready for a start.
    Ready,
    /// Moving to a view.
    Moving,
    /// In position, letting vibrations die down.
    Settling,
    /// Waiting for the LED to have cooled enough for a whole view.
    Cooling,
    /// LED enabled, waiting for its current.
    Lighting,
    /// Showing patterns and exposing them; the status says which frame.
    Capturing,
    /// LED disabled, waiting for its current to be gone.
    Darkening,
    /// LED off, retracting the head.
    Retracting,
    /// Safe and waiting for an acknowledgement.
    Faulted,
    /// Head-clear is withdrawn; waiting until the press must have obeyed before the head leaves its retracted position.
    Claiming,
}

/// Why the state changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Why {
    /// The sequence went on as planned.
    Sequence,
    /// The host said start.
    Start,
    /// The host said abort.
    Abort,
    /// The host said retract.
    Retract,
    /// The host said home.
    Home,
    /// The last view is done.
    Complete,
    /// A fault.
    Fault(FaultCode),
    /// The fault was acknowledged.
    Acknowledged,
}

/// What the controller knows about itself right now.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Status {
    /// What it is doing.
    pub state: State,
    /// The fault that waits for acknowledgement.
    pub fault: Option<FaultCode>,
    /// Session of the stored plan.
    pub plan: Option<u32>,
    /// View being captured, counted from 0.
    pub view: u8,
    /// Frame of the view being captured, counted from 0.
    pub frame: u16,
    /// An LED enable output is on.
    pub led_on: bool,
    /// Both axes are referenced.
    pub homed: bool,
    /// Position of the rotary stage as last reported by it.
    pub rotation: Microradians,
    /// Position of the vertical stage as last reported by it.
    pub vertical: Micrometres,
    /// What the interlock sees and says.
    pub press: PressStatus,
    /// Controller time of this status.
    pub at: Timestamp,
    /// Damaged or foreign frames dropped since the hello.
    pub frames_dropped: u32,
    /// Events lost to a full queue since power-up.
    pub events_lost: u32,
}

/// What the press interlock sees and says.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PressStatus {
    /// Both press-open channels say so.
    pub open: bool,
    /// The press may stroke: both outputs are asserted.
    pub head_clear: bool,
    /// Go is shown.
    pub go: bool,
    /// Press cycles since power-up.
    pub cycles: u32,
}

/// One frame as it was triggered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Trigger {
    /// Session of the plan.
    pub session: u32,
    /// View, counted from 0.
    pub view: u8,
    /// Frame of the view, counted from 0; frame 0 is the dark index frame.
    pub frame: u16,
    /// Pattern shown, as [`crate::FramePlace`] counts: 0 is black.
    pub pattern: u16,
    /// Commanded exposure.
    pub exposure: Microseconds,
    /// DMD trigger.
    pub dmd_at: Timestamp,
    /// Camera trigger: start of the exposure.
    pub camera_at: Timestamp,
    /// Camera trigger released: end of the exposure.
    pub end_at: Timestamp,
}

/// What happened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Event {
    /// The controller does something else now.
    StateChanged {
        /// State before.
        prev: State,
        /// State after.
        next: State,
        /// Cause.
        why: Why,
        /// When.
        at: Timestamp,
    },
    /// One frame was exposed.
    Triggered(Trigger),
    /// Both stages reported that they stand at a view.
    InPosition {
        /// View, counted from 0.
        view: u8,
        /// Reported angle.
        rotation: Microradians,
        /// Reported position.
        vertical: Micrometres,
        /// When.
        at: Timestamp,
    },
    /// An LED enable output changed.
    Led {
        /// Whose.
        projector: Projector,
        /// On or off.
        on: bool,
        /// When.
        at: Timestamp,
    },
    /// All frames of a view were exposed.
    ViewDone {
        /// Session of the plan.
        session: u32,
        /// View, counted from 0.
        view: u8,
        /// Frames exposed.
        frames: u16,
        /// When.
        at: Timestamp,
    },
    /// All views were captured and the head is retracted.
    CaptureDone {
        /// Session of the plan.
        session: u32,
        /// Views captured.
        views: u8,
        /// Frames exposed in all views.
        frames: u32,
        /// When.
        at: Timestamp,
    },
    /// Something went wrong.
    Fault {
        /// What.
        fault: FaultCode,
        /// While doing what.
        state: State,
        /// A device's own error number, 0 if it has none; of a projector [`Projector::detail`].
        detail: u32,
        /// When.
        at: Timestamp,
    },
    /// The queue to the host overflowed: this many events are missing before this one.
    EventsLost {
        /// How many.
        count: u32,
        /// When.
        at: Timestamp,
    },
    /// The press began a cycle.
    Cycle {
        /// Cycles since power-up.
        count: u32,
        /// When.
        at: Timestamp,
    },
    /// The press opened or is open no longer.
    PressOpen {
        /// Both channels say that it is open.
        open: bool,
        /// When.
        at: Timestamp,
    },
    /// What the stage of an axis says it is. Told when somebody asked, and before stages move that the station names.
    StageIdentity {
        /// Number of the axis at the stage controller.
        axis: u8,
        /// Model and serial number, or why there is no answer.
        answer: Result<StageName, FaultCode>,
        /// When.
        at: Timestamp,
    },
}
