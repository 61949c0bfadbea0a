//! What goes into the sequence and what comes out.

use crate::lens::LensFault;
use crate::stage_fault::StageFault;
use flankscope_protocol::{
    Event, Fault, LensCounts, Micrometres, Microradians, Milliamps, Projector, StageName, View,
};

/// Most actions of one step: the longest chain is a fault (event, LED, event, camera, DMD, stop, retract, event).
pub const MAX_ACTIONS: usize = 16;

/// What one step wants done, in this order.
pub type Actions = heapless::Vec<Action, MAX_ACTIONS>;

/// What to wait for at the camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CameraWait {
    /// Ready is high.
    Ready,
    /// Exposing has this level.
    Exposing(bool),
}

/// Something the outside did, or found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Input {
    /// A valid command arrived: the host is alive.
    HostAlive,
    /// The stages stand where request `ticket` sent them.
    InPosition {
        /// Which request.
        ticket: u16,
        /// Reported angle.
        rotation: Microradians,
        /// Reported position.
        vertical: Micrometres,
    },
    /// The stages failed at request `ticket`.
    StageFailed {
        /// Which request.
        ticket: u16,
        /// How.
        fault: Fault,
        /// The stage controller's own error number, 0 if none.
        detail: u32,
    },
    /// What the stages answered to request `ticket`, rotation and vertical.
    StagesAre {
        /// Which request.
        ticket: u16,
        /// Their names, or why there are none.
        outcome: Result<[StageName; 2], StageFault>,
    },
    /// Level of the current sense of a projector's LED.
    LedSense(Projector, bool),
    /// The DMD took the pattern selection, or did not.
    PatternSelected(bool),
    /// Whether the selected pattern can be triggered yet; `None`: the DMD does not say.
    PatternLoaded(Option<bool>),
    /// The DMD awaited says that the selected pattern stands.
    DmdReady,
    /// The camera can be triggered.
    CameraReady,
    /// Level of the camera's exposure-active line.
    CameraExposing(bool),
    /// The lens has the voltage that it was given, or what is wrong with it.
    Lens(Result<(), LensFault>),
    /// Events for the host were lost.
    EventsLost,
    /// The press was claimed and has had its time to obey: the head may enter.
    MayEnter,
    /// The interlock wants the head out.
    Unsafe(Fault),
    /// Only time has passed.
    Tick,
}

/// Something to be done now.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Action {
    /// Ask what the stages are.
    Identify {
        /// To be repeated in the answer.
        ticket: u16,
    },
    /// Reference both axes, vertical first.
    Home {
        /// To be repeated in the answer.
        ticket: u16,
    },
    /// Move both axes to a view.
    Move {
        /// To be repeated in the answer.
        ticket: u16,
        /// Where to.
        view: View,
    },
    /// Move the vertical axis alone.
    Retract {
        /// To be repeated in the answer.
        ticket: u16,
        /// Where to.
        vertical: Micrometres,
    },
    /// Halt both axes.
    StopStages,
    /// Enable this projector's LED at this current, and no other.
    LedOn(Projector, Milliamps),
    /// Disable every LED.
    LedOff,
    /// Select a projector's pattern; answer with [`Input::PatternSelected`] before anything else.
    SelectPattern(Projector, u16),
    /// Ask a projector's DMD whether it has loaded the selected pattern; answer with [`Input::PatternLoaded`] before anything else.
    AskPattern(Projector),
    /// Give the lens its voltage; answer with [`Input::Lens`] before anything else.
    SetLens(LensCounts),
    /// Make sure that the lens has it still; answer with [`Input::Lens`] before anything else.
    CheckLens(LensCounts),
    /// Switch the lens off.
    LensOff,
    /// Whose DMD trigger is high, every other is low: the rising edge shows the selected pattern.
    DmdTrigger(Option<Projector>),
    /// Level of the camera trigger: exposed while high.
    CameraTrigger(bool),
    /// Tell the host.
    Report(Event),
}

/// Which pins to watch; anything they say is passed to [`super::Sequence::step`].
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Awaiting {
    /// Level of the current sense of each projector's LED that would be news.
    pub led_sense: [Option<bool>; 2],
    /// Watch this projector's DMD's ready line.
    pub dmd_ready: Option<Projector>,
    /// Watch the camera.
    pub camera: Option<CameraWait>,
}

/// [`MAX_ACTIONS`] is ample for every step (a test counts); should it ever not be, the outputs come first.
pub(super) fn push(out: &mut Actions, action: Action) {
    if let Err(action) = out.push(action)
        && !matches!(action, Action::Report(_))
        && let Some(report) = out
            .iter()
            .rposition(|kept| matches!(kept, Action::Report(_)))
    {
        let _report = out.remove(report);
        let _fits = out.push(action);
    }
}
