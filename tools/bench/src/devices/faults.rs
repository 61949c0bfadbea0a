//! Faults that a device can be given while it runs, and the proof that it had them.

use flankscope_sim::now_us;
use std::cell::Cell;

/// What a device does wrong from now on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum DeviceFault {
    /// The LED draws no current when it is enabled.
    LedOpen,
    /// The LED keeps its current when it is disabled.
    LedStuckOn,
    /// The LED driver is too hot: it cuts the current a while after it was enabled, and gives none any more.
    LedOverheats,
    /// The DMD never says that a pattern stands.
    DmdNotReady,
    /// The DMD refuses a selection.
    DmdRefuses,
    /// The DMD does not answer a selection.
    DmdSilent,
    /// The DMD misses one trigger.
    DmdMissesTrigger,
    /// The DMD sees one trigger twice.
    DmdExtraTrigger,
    /// The camera does not become ready again after a frame.
    CameraNotReady,
    /// The camera does not obey a trigger.
    CameraDeaf,
    /// The camera goes on exposing when the trigger falls.
    CameraStuck,
    /// The camera exposes once without having been triggered, right after a frame.
    CameraExtraTrigger,
    /// The rotary stage never comes to a stand.
    RotationStalls,
    /// The vertical stage never comes to a stand.
    VerticalStalls,
    /// The stage controller answers nothing any more.
    StageSilent,
    /// One answer of the stage controller is garbage.
    StageGarbage,
    /// One answer of the stage controller comes 300 ms late.
    StageLate,
    /// The stage controller reports an error of its own, once.
    StageError,
    /// The vertical stage reads 1 mm beside its target, once.
    StageBeside,
    /// The vertical stage comes to stand 0.5 mm beyond its target, once.
    StageOvershoots,
    /// The vertical stage meets a limit switch halfway, once: its controller stops it and switches its motor off.
    StageLimit,
    /// The lens driver does not acknowledge any more.
    LensSilent,
    /// The supply of the lens driver failed for a moment, once.
    LensForgets,
    /// A lens came off its driver.
    LensOpen,
    /// A lens is shorted.
    LensShort,
    /// The lens driver is too hot.
    LensHot,
    /// The lens driver does not reach its voltage.
    LensNoBoost,
}

impl DeviceFault {
    /// It happens once and is over.
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

/// The fault given, if any, and when it first showed.
#[derive(Debug, Default)]
pub struct Faults {
    given: Cell<Option<DeviceFault>>,
    fired_us: Cell<Option<u64>>,
}

impl Faults {
    /// From here on.
    pub fn give(&self, fault: DeviceFault) {
        self.given.set(Some(fault));
    }

    /// When it first showed, virtual time.
    #[must_use]
    pub fn fired_us(&self) -> Option<u64> {
        self.fired_us.get()
    }

    /// A device is about to do what this fault spoils: true if it must.
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
