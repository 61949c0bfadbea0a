//! Fault numbers. Once given, a number keeps its meaning for ever and is never used again for another.

use serde::{Deserialize, Serialize};

/// What went wrong, as a stable number.
///
/// 1–31 concern the link, 32–95 stop the instrument (LED off, stages halted, head retracted), 96 and above limit it
/// without stopping it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, thiserror::Error)]
#[repr(u8)]
#[non_exhaustive]
pub enum Fault {
    /// No valid command arrived for longer than the host may be silent while a capture ran.
    #[error("the host fell silent during a capture")]
    HostSilent = 1,
    /// An event could not be queued for the host: the record of the capture has a hole.
    #[error("the event queue overflowed: the record of the capture has a hole")]
    EventOverflow = 2,

    /// A stage accepted a move but was not in position when its time was up.
    #[error("a stage was not in position in time")]
    MotionTimeout = 32,
    /// The stage controller did not answer a question in time.
    #[error("the stage controller did not answer")]
    StageSilent = 33,
    /// The stage controller reported an error of its own.
    #[error("the stage controller reported an error")]
    StageError = 34,
    /// The stage controller's answer could not be understood.
    #[error("the stage controller's answer made no sense")]
    StageReply = 35,
    /// A stage stopped outside the tolerance about its target.
    #[error("a stage stopped outside its tolerance")]
    OffPosition = 36,
    /// The LED's current sense did not come on in time.
    #[error("the LED did not come on")]
    LedNotOn = 37,
    /// The LED's current sense stayed on after the LED was switched off.
    #[error("the LED did not go off")]
    LedStuckOn = 38,
    /// The LED lost its current while it should be on.
    #[error("the LED went out during a capture")]
    LedLost = 39,
    /// The LED would have been on for longer than its budget.
    #[error("the LED's on-time budget is used up")]
    LedBudget = 40,
    /// The DMD did not report the pattern ready in time.
    #[error("the DMD did not become ready")]
    DmdNotReady = 41,
    /// The DMD refused or lost the selection of a pattern.
    #[error("the DMD did not take the pattern selection")]
    DmdSelect = 42,
    /// The camera was not ready for a trigger in time.
    #[error("the camera did not become ready")]
    CameraNotReady = 43,
    /// The camera did not start its exposure after the trigger.
    #[error("the camera did not start its exposure")]
    CameraNoExposure = 44,
    /// The camera did not end its exposure when the trigger fell.
    #[error("the camera did not end its exposure")]
    CameraStuck = 45,
    /// Retracting the head failed: where the head is, is not known.
    #[error("the head could not be retracted")]
    RetractFailed = 46,
    /// The sequencer received an input that its state cannot have caused.
    #[error("the sequencer lost step with its devices")]
    OutOfStep = 47,
    /// An exposure came out at a width other than the commanded one.
    #[error("an exposure had the wrong width")]
    ExposureWidth = 48,
    /// The press was not open, by one of its two channels at least, while the head was or was about to be in the die.
    #[error("the press was not open while it was held for the head")]
    PressNotOpen = 49,
    /// The two press-open channels, of which one must be the opposite of the other, did not agree for too long.
    #[error("the two press-open signals contradict each other")]
    PressSignal = 50,
    /// The die was not clear while the press was held for the head.
    #[error("the die was not clear while the press was held for the head")]
    DieNotClear = 51,
    /// The guard was open while the press was held for the head.
    #[error("the guard was open while the press was held for the head")]
    GuardOpen = 52,
    /// The press began a cycle while it was held for the head.
    #[error("the press began a cycle while it was held for the head")]
    PressCycled = 53,
    /// The retract switch and the position of the head contradict each other.
    #[error("the retract switch and the head's position contradict each other")]
    HeadSwitch = 54,
    /// The position of the head became unknown while it was in the die or about to be.
    #[error("the position of the head was lost")]
    PositionLost = 55,
    /// The interlock is locked since power-up or since a fault: the host must home or acknowledge.
    #[error("the interlock is locked; home or acknowledge first")]
    InterlockLocked = 56,
    /// The press was held for the head for as long as it may be. The head is retracted and the press let go.
    #[error("the press was held for the head for as long as it may be")]
    HoldLimit = 57,
    /// The lens driver did not answer.
    #[error("the lens driver did not answer")]
    LensSilent = 58,
    /// The lens driver does not hold what it was told.
    #[error("the lens driver lost its setting")]
    LensLost = 59,
    /// The lens driver finds no lens at an output.
    #[error("the lens is not connected")]
    LensOpen = 60,
    /// The lens driver finds its outputs shorted.
    #[error("the lens is shorted")]
    LensShort = 61,
    /// The lens driver is too hot and has switched off.
    #[error("the lens driver is too hot")]
    LensHot = 62,
    /// The lens driver does not reach the voltage that it was told.
    #[error("the lens driver does not reach its voltage")]
    LensVoltage = 63,
    /// A stage answered as another model than the station's. Nothing moves; the detail is the number of its axis.
    #[error("a stage answers as another model than the station's")]
    OtherStage = 64,

    /// The LED must cool before the next view; the capture goes on by itself.
    #[error("the LED must cool before the next view")]
    LedCooling = 96,
    /// A damaged or foreign frame arrived on the link; it was dropped.
    #[error("a damaged frame was dropped")]
    LinkNoise = 97,
}

/// What a fault does to the instrument.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum FaultClass {
    /// The link to the host is at fault; a running capture ends with the head retracted.
    Link,
    /// LED off, stages halted, head retracted, waiting for an acknowledgement.
    Stop,
    /// Noted; the instrument carries on within narrower bounds.
    Limit,
}

impl Fault {
    /// Every fault known to this version, by rising number.
    pub const ALL: [Self; 37] = [
        Self::HostSilent,
        Self::EventOverflow,
        Self::MotionTimeout,
        Self::StageSilent,
        Self::StageError,
        Self::StageReply,
        Self::OffPosition,
        Self::LedNotOn,
        Self::LedStuckOn,
        Self::LedLost,
        Self::LedBudget,
        Self::DmdNotReady,
        Self::DmdSelect,
        Self::CameraNotReady,
        Self::CameraNoExposure,
        Self::CameraStuck,
        Self::RetractFailed,
        Self::OutOfStep,
        Self::ExposureWidth,
        Self::PressNotOpen,
        Self::PressSignal,
        Self::DieNotClear,
        Self::GuardOpen,
        Self::PressCycled,
        Self::HeadSwitch,
        Self::PositionLost,
        Self::InterlockLocked,
        Self::HoldLimit,
        Self::LensSilent,
        Self::LensLost,
        Self::LensOpen,
        Self::LensShort,
        Self::LensHot,
        Self::LensVoltage,
        Self::OtherStage,
        Self::LedCooling,
        Self::LinkNoise,
    ];

    /// The stable number.
    #[must_use]
    pub const fn code(self) -> FaultCode {
        FaultCode(self as u8)
    }

    /// What the fault does to the instrument, by its number's range.
    #[must_use]
    pub const fn class(self) -> FaultClass {
        match self as u8 {
            0..=31 => FaultClass::Link,
            32..=95 => FaultClass::Stop,
            96..=255 => FaultClass::Limit,
        }
    }
}

/// A fault number as it came over the wire: possibly from a newer controller, hence possibly unknown here.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct FaultCode(pub u8);

impl FaultCode {
    /// The fault, if this version knows the number.
    #[must_use]
    pub fn known(self) -> Option<Fault> {
        Fault::ALL.into_iter().find(|fault| fault.code() == self)
    }
}

impl From<Fault> for FaultCode {
    fn from(fault: Fault) -> Self {
        fault.code()
    }
}

impl core::fmt::Display for FaultCode {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self.known() {
            Some(fault) => write!(f, "fault {}: {fault}", self.0),
            None => write!(f, "fault {} (unknown to this version)", self.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_rise_and_name_their_fault() {
        for pair in Fault::ALL.windows(2) {
            assert!(pair[0].code().0 < pair[1].code().0, "{pair:?}");
        }
        for fault in Fault::ALL {
            assert_eq!(fault.code().known(), Some(fault));
        }
        assert_eq!(
            (0..=255)
                .filter(|&n| FaultCode(n).known().is_some())
                .count(),
            Fault::ALL.len()
        );
    }
}
