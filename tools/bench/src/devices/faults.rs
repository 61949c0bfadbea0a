//! Faults that can be injected into a device while it runs, with a record of whether they took effect.

use flankscope_sim::now_us;
use std::cell::Cell;

/// Fault of a device from now on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum DeviceFault {
    /// The LED draws no current when it is enabled.
    LedOpen,
    /// The LED keeps its current when it is disabled.
    LedStuckOn,
    /// The LED driver overheats: it cuts the current some time after enabling, and stays off.
    LedOverheats,
    /// The DMD never signals that a pattern is displayed.
    DmdNotReady,
    /// The DMD refuses a selection.
    DmdRefuses,
    /// The DMD does not answer a selection.
    DmdSilent,
    DmdMissesTrigger,
    /// The DMD sees one trigger twice.
    DmdExtraTrigger,
    /// The camera does not become ready again after a frame.
    CameraNotReady,
    /// The camera ignores a trigger.
    CameraDeaf,
    /// The camera goes on exposing after the trigger falls.
    CameraStuck,
    /// The camera exposes once without a trigger, right after a frame.
    CameraExtraTrigger,
    /// The rotary stage never stops moving.
    RotationStalls,
    /// The vertical stage never stops moving.
    VerticalStalls,
    /// The stage controller no longer answers.
    StageSilent,
    /// One answer of the stage controller is garbage.
    StageGarbage,
    /// One answer of the stage controller comes 300 ms late.
    StageLate,
    /// The stage controller reports an error of its own, once.
    StageError,
    /// The vertical stage once reports a position 1 mm off its target.
    StageBeside,
    /// The vertical stage once stops 0.5 mm beyond its target.
    StageOvershoots,
    /// The vertical stage meets a limit switch halfway, once: its controller stops it and switches its motor off.
    StageLimit,
    /// The lens driver no longer acknowledges.
    LensSilent,
    /// The supply of the lens driver failed for a moment, once.
    LensForgets,
    /// A lens is disconnected from its driver.
    LensOpen,
    /// A lens is shorted.
    LensShort,
    /// The lens driver is too hot.
    LensHot,
    /// The lens driver does not reach its voltage.
    LensNoBoost,
}

impl DeviceFault {
    /// Whether it occurs only once.
    #[must_use]
    pub fn once(self) -> bool {
        matches!(
            self,
            Self::DmdMissesTrigger
                | Self::DmdExtraTrigger
                | Self::CameraExtraTrigger
                | Self::StageGarbage
                | Self::StageLate
                | Self::StageError
                | Self::StageBeside
                | Self::StageOvershoots
                | Self::StageLimit
                | Self::LensForgets
        )
    }
}

/// The injected fault, if any, and the time at which it took effect.
#[derive(Debug, Default)]
pub struct Faults {
    given: Cell<Option<DeviceFault>>,
    fired_us: Cell<Option<u64>>,
}

impl Faults {
    /// Injects a fault from now on.
    pub fn give(&self, fault: DeviceFault) {
        self.given.set(Some(fault));
    }

    /// Time at which it took effect, virtual time.
    pub fn fired_us(&self) -> Option<u64> {
        self.fired_us.get()
    }

    /// Called when a device is about to do what this fault affects; true if the fault must occur.
    pub(super) fn spoils(&self, fault: DeviceFault) -> bool {
        let spoils = self.given.get() == Some(fault);
        if spoils {
            if self.fired_us.get().is_none() {
                self.fired_us.set(Some(now_us()));
            }
            if fault.once() {
                self.given.set(None);
            }
        }
        spoils
    }
}
