//! The faults, and what is promised for each.

use crate::CAPTURE_MS;
use crate::frames::FrameFault;
use flankscope_bench::devices::DeviceFault;
use flankscope_controller::liveness::Task;
use flankscope_protocol::message::Boot;
use flankscope_protocol::{Fault, Microseconds, Timeouts};

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum PressLine {
    OpenA,
    OpenB,
    DieClear,
    Guard,
    Cycle,
}

/// What goes wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Injection {
    Device(DeviceFault),
    /// The LED goes out while it should be on.
    LedLost,
    /// The LED comes on while it should be off.
    LedGhost,
    /// A line of the press goes to this level.
    Press(PressLine, bool),
    /// Both press-open channels change as when the ram closes.
    PressCloses,
    /// The retract switch stays at this level.
    Switch(bool),
    /// The host sends nothing more.
    HostDead,
    /// The cable to the host is pulled in the middle of a frame.
    CablePulled,
    /// Junk between the host's frames.
    Noise,
    /// Every frame of the host comes three times.
    Echo,
    /// Another host's frames come in between.
    Stranger,
    /// Power fails for a moment.
    Reset,
    Hang(Task),
    /// A frame does not reach the host as it was exposed.
    Frame(FrameFault),
}

/// How a run must end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Safe {
    /// Dark, faulted, the head proven out.
    Retracted,
    /// As above, or, where it only disturbed a retract, overcome by trying that again.
    RetractedOrOvercome,
    /// Dark, faulted, head-clear low: the head cannot be brought out, or not be proven to be.
    Held,
    /// Restarted for this reason: dark, nothing moves, head-clear low.
    Restarted(Boot),
    /// Nothing at all: the capture is completed.
    Unharmed,
}

/// A fault with its promise: dark and safe within these times of its showing.
pub struct Promise {
    pub injection: Injection,
    pub safe: Safe,
    pub faults: &'static [Fault],
    pub dark_ms: u64,
    pub safe_ms: u64,
}

/// A retract from the lowest view: 67 mm at 100 mm/s with ramps, and its questions.
const RETRACT_MS: u64 = 1_500;

/// The contradiction's time, or what is left of one capture and that of the next.
const SWITCH_MS: u64 = CAPTURE_MS + 1_021;

pub fn promises() -> Vec<Promise> {
    use Injection::{
        CablePulled, Device, Echo, Frame, Hang, HostDead, LedGhost, LedLost, Noise, Press,
        PressCloses, Reset, Stranger, Switch,
    };
    let promise = |injection, safe, faults, dark_ms, safe_ms| Promise {
        injection,
        safe,
        faults,
        dark_ms,
        safe_ms,
    };
    let out = |injection, faults, detect_ms| {
        promise(
            injection,
            Safe::Retracted,
            faults,
            detect_ms,
            detect_ms + RETRACT_MS,
        )
    };
    let once = |injection, faults, detect_ms| {
        let safe_ms = detect_ms + RETRACT_MS;
        promise(
            injection,
            Safe::RetractedOrOvercome,
            faults,
            detect_ms,
            safe_ms,
        )
    };
    let held = |injection, faults, detect_ms, safe_ms| {
        promise(injection, Safe::Held, faults, detect_ms, safe_ms)
    };
    let timeouts = Timeouts::default();
    let ms = |time: Microseconds| u64::from(time.get()) / 1_000;
    let motion_ms = ms(timeouts.motion);
    let stuck = promise(
        Device(DeviceFault::LedStuckOn),
        Safe::Retracted,
        &[Fault::LedStuckOn],
        // The enable is low before the fault shows; the current stays, which is what is reported.
        0,
        ms(timeouts.led) + RETRACT_MS,
    );
    let mut all = vec![
        out(
            Device(DeviceFault::LedOpen),
            &[Fault::LedNotOn],
            ms(timeouts.led),
        ),
        stuck,
        // Cut while it is lit, or found dead at the next view.
        out(
            Device(DeviceFault::LedOverheats),
            &[Fault::LedLost, Fault::LedNotOn],
            1,
        ),
        out(LedLost, &[Fault::LedLost], 1),
        out(LedGhost, &[Fault::LedStuckOn], 1),
        out(
            Device(DeviceFault::DmdNotReady),
            &[Fault::DmdNotReady],
            ms(timeouts.dmd),
        ),
        out(Device(DeviceFault::DmdRefuses), &[Fault::DmdSelect], 1),
        out(Device(DeviceFault::DmdSilent), &[Fault::DmdSelect], 21),
        out(
            Device(DeviceFault::DmdMissesTrigger),
            &[Fault::DmdNotReady],
            ms(timeouts.dmd),
        ),
        // What is shown is what was selected, however often it is triggered.
        promise(
            Device(DeviceFault::DmdExtraTrigger),
            Safe::Unharmed,
            &[],
            0,
            0,
        ),
        // Not the controller's to see: the host finds a frame too many.
        promise(
            Device(DeviceFault::CameraExtraTrigger),
            Safe::Unharmed,
            &[],
            0,
            0,
        ),
        out(
            Device(DeviceFault::CameraNotReady),
            &[Fault::CameraNotReady],
            // After the frame it is missed at once, or at the first frame of the next capture.
            ms(timeouts.camera) + 50,
        ),
        out(
            Device(DeviceFault::CameraDeaf),
            &[Fault::CameraNoExposure],
            ms(timeouts.camera),
        ),
        out(
            Device(DeviceFault::CameraStuck),
            &[Fault::CameraStuck],
            ms(timeouts.camera),
        ),
        // The head comes out, but the stages never say that they stand: not proven.
        held(
            Device(DeviceFault::RotationStalls),
            &[Fault::MotionTimeout, Fault::RetractFailed],
            motion_ms,
            motion_ms + 5_100,
        ),
        held(
            Device(DeviceFault::VerticalStalls),
            &[
                Fault::MotionTimeout,
                Fault::RetractFailed,
                Fault::HeadSwitch,
            ],
            motion_ms,
            motion_ms + 5_100,
        ),
        held(
            Device(DeviceFault::StageSilent),
            &[Fault::StageSilent, Fault::RetractFailed, Fault::HeadSwitch],
            100,
            6_000,
        ),
        once(Device(DeviceFault::StageGarbage), &[Fault::StageReply], 250),
        once(
            Device(DeviceFault::StageLate),
            &[Fault::StageSilent, Fault::StageReply],
            600,
        ),
        once(Device(DeviceFault::StageError), &[Fault::StageError], 250),
        once(Device(DeviceFault::StageBeside), &[Fault::OffPosition], 250),
        // Seen when it stands, which takes as long as the move.
        once(
            Device(DeviceFault::StageOvershoots),
            &[Fault::OffPosition],
            RETRACT_MS + 250,
        ),
        once(
            Device(DeviceFault::StageLimit),
            &[Fault::StageError],
            RETRACT_MS + 250,
        ),
        out(
            Press(PressLine::OpenA, false),
            &[Fault::PressNotOpen, Fault::PressSignal],
            21,
        ),
        out(
            Press(PressLine::OpenB, true),
            &[Fault::PressNotOpen, Fault::PressSignal],
            21,
        ),
        out(PressCloses, &[Fault::PressNotOpen], 21),
        out(Press(PressLine::DieClear, false), &[Fault::DieNotClear], 21),
        out(Press(PressLine::Guard, false), &[Fault::GuardOpen], 21),
        out(Press(PressLine::Cycle, true), &[Fault::PressCycled], 21),
        promise(
            // Late in a capture it is not contradicted for long enough: seen in the next.
            Switch(true),
            Safe::Retracted,
            &[Fault::HeadSwitch],
            SWITCH_MS,
            SWITCH_MS + RETRACT_MS,
        ),
        // Nobody knows before the head is back that the switch does not say so.
        held(
            Switch(false),
            &[Fault::HeadSwitch, Fault::RetractFailed],
            6_100,
            6_100 + RETRACT_MS,
        ),
        out(HostDead, &[Fault::HostSilent], 100),
        out(CablePulled, &[Fault::HostSilent], 100),
        promise(Noise, Safe::Unharmed, &[], 0, 0),
        promise(Echo, Safe::Unharmed, &[], 0, 0),
        promise(Stranger, Safe::Unharmed, &[], 0, 0),
        promise(Reset, Safe::Restarted(Boot::Requested), &[], 0, 150),
    ];
    for fault in FrameFault::ALL {
        all.push(promise(Frame(fault), Safe::Unharmed, &[], 0, 0));
    }
    for task in Task::ALL {
        all.push(promise(
            Hang(task),
            Safe::Restarted(Boot::Watchdog),
            &[],
            300,
            450,
        ));
    }
    all
}
