//! What goes into the sequence and what comes out.

use crate::lens::LensFault;
use flankscope_protocol::{Event, Fault, LensCounts, Micrometres, Microradians, Milliamps, View};

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
    /// Level of the LED's current sense.
    LedSense(bool),
    /// The DMD took the pattern selection, or did not.
    PatternSelected(bool),
    /// The DMD says that the selected pattern stands.
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
    /// Enable the LED at this current.
    LedOn(Milliamps),
    /// Disable the LED.
    LedOff,
    /// Select a pattern; answer with [`Input::PatternSelected`] before anything else.
    SelectPattern(u16),
    /// Give the lens its voltage; answer with [`Input::Lens`] before anything else.
    SetLens(LensCounts),
    /// Make sure that the lens has it still; answer with [`Input::Lens`] before anything else.
    CheckLens(LensCounts),
    /// Switch the lens off.
    LensOff,
    /// Level of the DMD trigger: the rising edge shows the selected pattern.
    DmdTrigger(bool),
    /// Level of the camera trigger: exposed while high.
    CameraTrigger(bool),
    /// Tell the host.
    Report(Event),
}

/// Which pins to watch; anything they say is passed to [`super::Sequence::step`].
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Awaiting {
    /// Level of the LED's current sense that would be news.
    pub led_sense: Option<bool>,
    /// Watch the DMD's ready line.
    pub dmd_ready: bool,
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
