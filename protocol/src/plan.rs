//! The capture plan: everything the controller needs to take a series of views on its own.
//!
//! A plan is declarative. Per view the controller shows and exposes, in this order ([`FrameOrder`]):
//! frame 0 = the dark index frame (DMD index 0, all black) at the shortest exposure; then for each exposure, shortest
//! first, every pattern from DMD index 1 on: set by set, each set step by step. Where two projectors show them, the second one
//! shows them all once more at each exposure, after the first: every frame has the light of exactly one.

use crate::units::{
    LensCounts, Micrometres, MicrometresPerSecond, MicrometresPerSecondSquared, Microradians,
    Microseconds, Milliamps, MillidegreesPerSecond, MillidegreesPerSecondSquared,
};
use heapless::Vec;
use serde::{Deserialize, Serialize};

/// Most views in one plan.
pub const MAX_VIEWS: usize = 16;
/// Most exposures per pattern (an HDR series).
pub const MAX_EXPOSURES: usize = 4;
/// Most fringe sets: three frequencies in as many passes, and room for a fourth.
pub const MAX_FRINGE_SETS: usize = 12;
/// DMD index of the all-black pattern.
pub const BLACK_PATTERN: u16 = 0;
/// Fewest phase steps from which a phase can be computed.
pub const MIN_STEPS: u8 = 3;

/// Most projectors of a head.
pub const MAX_PROJECTORS: u8 = 2;

/// One of a head's projectors: an LED and a DMD.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Projector {
    /// The one that every head has.
    First,
    /// The one on the camera's other side.
    Second,
}

impl Projector {
    /// All, in the order in which they show their patterns.
    pub const ALL: [Self; MAX_PROJECTORS as usize] = [Self::First, Self::Second];

    /// What a fault of it has for a detail.
    #[must_use]
    pub fn detail(self) -> u32 {
        match self {
            Self::First => 0,
            Self::Second => 2,
        }
    }
}

/// One pose of the stages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct View {
    /// Commanded angle of the rotary stage: the die is turned by this much.
    pub rotation: Microradians,
    /// Commanded position of the vertical stage: the head is raised by this much.
    pub vertical: Micrometres,
}

/// One fringe frequency, phase-shifted over a full turn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct FringeSet {
    /// Fringe periods over the projector's width.
    pub periods: u16,
    /// Phase steps; step n is shifted by 2*pi*n/steps.
    pub steps: u8,
}

/// How long the controller waits for each device before it declares a fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Timeouts {
    /// From an accepted move to in position, both axes.
    pub motion: Microseconds,
    /// From LED enable to current sense, and from disable to no sense.
    pub led: Microseconds,
    /// From a selected pattern to its being loaded, and from DMD trigger to DMD ready.
    pub dmd: Microseconds,
    /// For the camera to become ready, to start its exposure after the trigger, and to end it after the trigger fell.
    pub camera: Microseconds,
}

impl Default for Timeouts {
    /// Ten seconds for a full turn of the rotary stage, 50 ms for everything electronic.
    fn default() -> Self {
        Self {
            motion: Microseconds::from_millis(10_000),
            led: Microseconds::from_millis(50),
            dmd: Microseconds::from_millis(50),
            camera: Microseconds::from_millis(50),
        }
    }
}

/// How the liquid lens is driven while a series of views is taken. It is off before and after.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Focus {
    /// What its driver is told.
    pub counts: LensCounts,
    /// Wait from there to the first LED on, for the lens to come to rest.
    pub settle: Microseconds,
}

/// A series of views to capture. Build it with struct syntax, check it with [`CapturePlan::validate`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CapturePlan {
    /// Chosen by the host, repeated in every event of this capture so that captures cannot be mixed up.
    pub session: u32,
    /// Poses, in the order of capture.
    pub views: Vec<View, MAX_VIEWS>,
    /// Exposure times, strictly ascending.
    pub exposures: Vec<Microseconds, MAX_EXPOSURES>,
    /// Fringe frequencies, lowest first; in passes that light one part of the field after the other, all of them once per pass.
    pub fringes: Vec<FringeSet, MAX_FRINGE_SETS>,
    /// LED current.
    pub led: Milliamps,
    /// Wait from in position to LED on, for vibrations to die down.
    pub settle: Microseconds,
    /// Wait from DMD ready to the camera trigger, for the mirrors and the decoders to settle.
    pub dmd_settle: Microseconds,
    /// Time the camera needs to read a frame out after its exposure.
    pub camera_readout: Microseconds,
    /// Vertical position of the retracted head.
    pub retract: Micrometres,
    /// Waits that end in a fault.
    pub timeouts: Timeouts,
    /// How the lens is driven; a head without one has none.
    pub focus: Option<Focus>,
    /// How many projectors show the fringes, one after the other: 1 or 2.
    pub projectors: u8,
}

/// What one frame of a view shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameSpec {
    /// Whose light it has.
    pub projector: Projector,
    /// Index in that projector's DMD: 0 is black, fringe patterns count from 1.
    pub pattern: u16,
    /// Exposure time.
    pub exposure: Microseconds,
}

/// The order of the frames of a view: the dark index frame, then at each exposure, shortest first, every pattern.
///
/// Controller, camera process and host all count by it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameOrder {
    /// Exposure steps (HDR series).
    pub exposures: u16,
    /// Fringe patterns per exposure step, those of all projectors.
    pub patterns: u16,
}

/// Which exposure step and pattern a frame has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FramePlace {
    /// Exposure step, 0 the shortest.
    pub exposure: u16,
    /// 0 is black, fringe patterns count from 1; those of a second projector go on from the first one's.
    pub pattern: u16,
}

impl FrameOrder {
    /// Frames of a view, the dark one included.
    #[must_use]
    pub fn frames(self) -> u16 {
        self.patterns
            .saturating_mul(self.exposures)
            .saturating_add(1)
    }

    /// Exposure step and pattern of frame `index` of a view; `None` beyond the last frame.
    #[must_use]
    pub fn place(self, index: u16) -> Option<FramePlace> {
        let Some(fringe_frame) = index.checked_sub(1) else {
            return Some(FramePlace {
                exposure: 0,
                pattern: BLACK_PATTERN,
            });
        };
        let exposure = fringe_frame.checked_div(self.patterns)?;
        let pattern = fringe_frame.checked_rem(self.patterns)?.saturating_add(1);
        (exposure < self.exposures).then_some(FramePlace { exposure, pattern })
    }
}

/// Bounds within which plans and [`crate::StageConfig`]s are accepted; sent by the controller in its hello.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Limits {
    /// Shortest exposure.
    pub exposure_min: Microseconds,
    /// Longest exposure.
    pub exposure_max: Microseconds,
    /// Largest LED current.
    pub led_max: Milliamps,
    /// Longest time the LED may be on, starting cold.
    pub led_on_max: Microseconds,
    /// Part of the time, in thousandths, that the LED may be on for ever: how fast a used-up on-time comes back.
    pub led_duty_permille: u16,
    /// Travel of the rotary stage, lower end.
    pub rotation_min: Microradians,
    /// Travel of the rotary stage, upper end.
    pub rotation_max: Microradians,
    /// Travel of the vertical stage, lower end.
    pub vertical_min: Micrometres,
    /// Travel of the vertical stage, upper end.
    pub vertical_max: Micrometres,
    /// Most fringe patterns that a DMD holds, black not counted.
    pub patterns_max: u16,
    /// Most frames per view.
    pub frames_max: u16,
    /// Longest settle, DMD settle or readout wait.
    pub wait_max: Microseconds,
    /// Longest timeout for electronics (LED, DMD, camera).
    pub timeout_max: Microseconds,
    /// Longest timeout for a motion.
    pub motion_timeout_max: Microseconds,
    /// Largest speed of the rotary axis.
    pub rotation_speed_max: MillidegreesPerSecond,
    /// Largest acceleration of the rotary axis.
    pub rotation_acceleration_max: MillidegreesPerSecondSquared,
    /// Largest speed of the vertical axis.
    pub vertical_speed_max: MicrometresPerSecond,
    /// Largest acceleration of the vertical axis.
    pub vertical_acceleration_max: MicrometresPerSecondSquared,
    /// Axes that the stage controller counts, from 1.
    pub stage_axes: u8,
    /// Slowest line to the stage controller, baud.
    pub stage_baud_min: u32,
    /// Fastest line to the stage controller, baud.
    pub stage_baud_max: u32,
    /// Least that a lens driver is told.
    pub lens_min: LensCounts,
    /// Most that a lens driver is told.
    pub lens_max: LensCounts,
}

impl Limits {
    /// Limits of the instrument with the 20 mm head.
    ///
    /// LED: a view of 49 frames (`scan16` x 3 exposures up to 50 ms) needs about 2.2 s, so 4 s cold; half duty for ever.
    /// Travel: one turn either way; ±150 mm of a 300 mm stage. Speeds and accelerations: two to six times those of
    /// [`crate::StageConfig::DEFAULT`]; a head of 1 kg at 5 m/s² pushes with 5 N, and stops from 0.3 m/s within 9 mm.
    /// Lens: about 33 to 60 V of the 24 to 70 V that the driver gives. No source at hand states what the lens bears: an assumption,
    /// to be replaced by its data sheet's.
    pub const DEFAULT: Self = Self {
        exposure_min: Microseconds(1_000),
        exposure_max: Microseconds(100_000),
        led_max: Milliamps(3_000),
        led_on_max: Microseconds(4_000_000),
        led_duty_permille: 500,
        rotation_min: Microradians(-6_283_186),
        rotation_max: Microradians(6_283_186),
        vertical_min: Micrometres(-150_000),
        vertical_max: Micrometres(150_000),
        patterns_max: 128,
        frames_max: 256,
        wait_max: Microseconds(2_000_000),
        timeout_max: Microseconds(1_000_000),
        motion_timeout_max: Microseconds(60_000_000),
        rotation_speed_max: MillidegreesPerSecond(200_000),
        rotation_acceleration_max: MillidegreesPerSecondSquared(2_000_000),
        vertical_speed_max: MicrometresPerSecond(300_000),
        vertical_acceleration_max: MicrometresPerSecondSquared(5_000_000),
        stage_axes: 3,
        stage_baud_min: 19_200,
        stage_baud_max: 921_600,
        lens_min: LensCounts(200),
        lens_max: LensCounts(800),
    };
}

impl Default for Limits {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// A wait or timeout of a plan, to say which one was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Wait {
    /// [`CapturePlan::settle`].
    Settle,
    /// [`CapturePlan::dmd_settle`].
    DmdSettle,
    /// [`CapturePlan::camera_readout`].
    CameraReadout,
    /// [`Timeouts::motion`].
    MotionTimeout,
    /// [`Timeouts::led`].
    LedTimeout,
    /// [`Timeouts::dmd`].
    DmdTimeout,
    /// [`Timeouts::camera`].
    CameraTimeout,
    /// [`Focus::settle`].
    FocusSettle,
}

/// Why a plan was refused, as a whole: the offending value and the limit it broke.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
pub enum PlanError {
    /// No view.
    #[error("the plan has no view; at least 1 is needed")]
    NoViews,
    /// No exposure.
    #[error("the plan has no exposure; at least 1 is needed")]
    NoExposures,
    /// No fringe set.
    #[error("the plan has no fringe set; at least 1 is needed")]
    NoFringes,
    /// An exposure below the limit.
    #[error("exposure {got} is shorter than {limit}")]
    ExposureTooShort {
        /// Offending value.
        got: Microseconds,
        /// Shortest allowed.
        limit: Microseconds,
    },
    /// An exposure above the limit.
    #[error("exposure {got} is longer than {limit}")]
    ExposureTooLong {
        /// Offending value.
        got: Microseconds,
        /// Longest allowed.
        limit: Microseconds,
    },
    /// Exposures must rise, so that the first is the shortest and none is taken twice.
    #[error("exposure {got} does not exceed the one before it, {limit}")]
    ExposuresNotAscending {
        /// Offending value.
        got: Microseconds,
        /// The exposure before it, which it must exceed.
        limit: Microseconds,
    },
    /// Too few steps for a phase.
    #[error("a fringe set has {got} phase steps; a phase needs at least {limit}")]
    TooFewSteps {
        /// Offending value.
        got: u8,
        /// Fewest allowed.
        limit: u8,
    },
    /// A fringe set without fringes.
    #[error("a fringe set has {got} periods; at least {limit} is needed")]
    TooFewPeriods {
        /// Offending value.
        got: u16,
        /// Fewest allowed.
        limit: u16,
    },
    /// More patterns than the DMD holds.
    #[error("the plan needs {got} patterns; the DMD holds {limit}")]
    TooManyPatterns {
        /// Offending value.
        got: u16,
        /// Most allowed.
        limit: u16,
    },
    /// More frames per view than allowed.
    #[error("the plan takes {got} frames per view; the limit is {limit}")]
    TooManyFrames {
        /// Offending value.
        got: u16,
        /// Most allowed.
        limit: u16,
    },
    /// LED current above the limit.
    #[error("LED current {got} exceeds {limit}")]
    LedCurrent {
        /// Offending value.
        got: Milliamps,
        /// Largest allowed.
        limit: Milliamps,
    },
    /// LED on for too long in one view.
    #[error("a view keeps an LED on for {got}; the budget is {limit}")]
    LedOnTime {
        /// Offending value.
        got: Microseconds,
        /// Longest allowed.
        limit: Microseconds,
    },
    /// A view beyond the rotary stage's travel.
    #[error("rotation {got} is outside {min} .. {max}")]
    RotationOutOfTravel {
        /// Offending value.
        got: Microradians,
        /// Lower end of the travel.
        min: Microradians,
        /// Upper end of the travel.
        max: Microradians,
    },
    /// A view or the retract position beyond the vertical stage's travel.
    #[error("vertical position {got} is outside {min} .. {max}")]
    VerticalOutOfTravel {
        /// Offending value.
        got: Micrometres,
        /// Lower end of the travel.
        min: Micrometres,
        /// Upper end of the travel.
        max: Micrometres,
    },
    /// A wait or timeout beyond its limit.
    #[error("{which:?} of {got} exceeds {limit}")]
    WaitTooLong {
        /// Which wait.
        which: Wait,
        /// Offending value.
        got: Microseconds,
        /// Longest allowed.
        limit: Microseconds,
    },
    /// A timeout of zero would be a fault at once.
    #[error("{which:?} of {got} is shorter than {limit}")]
    WaitTooShort {
        /// Which wait.
        which: Wait,
        /// Offending value.
        got: Microseconds,
        /// Shortest allowed.
        limit: Microseconds,
    },
    /// More or less than a lens may be driven with.
    #[error("focus of {got} is outside {min} .. {max}")]
    FocusOutOfRange {
        /// Offending value.
        got: LensCounts,
        /// Least allowed.
        min: LensCounts,
        /// Most allowed.
        max: LensCounts,
    },
    /// No projector, or more than a head has.
    #[error("the plan uses {got} projectors; 1 to {limit} are possible")]
    Projectors {
        /// Offending value.
        got: u8,
        /// Most allowed.
        limit: u8,
    },
}

/// Shortest timeout that makes sense on any link or device.
const TIMEOUT_MIN: Microseconds = Microseconds(1_000);

impl CapturePlan {
    /// Fringe patterns in all sets together; their indices in a DMD are 1..=this.
    #[must_use]
    pub fn pattern_count(&self) -> u16 {
        self.fringes
            .iter()
            .fold(0u16, |sum, set| sum.saturating_add(u16::from(set.steps)))
    }

    /// The order of the frames of every view.
    #[must_use]
    pub fn order(&self) -> FrameOrder {
        FrameOrder {
            exposures: u16::try_from(self.exposures.len()).unwrap_or(u16::MAX),
            patterns: self
                .pattern_count()
                .saturating_mul(u16::from(self.projectors)),
        }
    }

    /// Frames taken per view: the dark index frame and every pattern of every projector at every exposure.
    #[must_use]
    pub fn frames_per_view(&self) -> u16 {
        self.order().frames()
    }

    /// Projector, pattern and exposure of frame `index` of a view; `None` beyond the last frame. The dark one is the first
    /// projector's.
    #[must_use]
    pub fn frame(&self, index: u16) -> Option<FrameSpec> {
        let FramePlace { exposure, pattern } = self.order().place(index)?;
        let (projector, pattern) = match pattern.checked_sub(self.pattern_count()) {
            Some(beyond @ 1..) => (Projector::Second, beyond),
            _ => (Projector::First, pattern),
        };
        Some(FrameSpec {
            projector,
            pattern,
            exposure: *self.exposures.get(usize::from(exposure))?,
        })
    }

    /// Time a projector's LED is on for one view, with nothing overlapped: exposure, DMD settle and readout of every frame.
    ///
    /// The real sequence overlaps readout with the next frame and is shorter, unless a device dawdles. A second projector shows no
    /// dark frame, and is on for less.
    #[must_use]
    pub fn led_on_per_view(&self) -> Microseconds {
        let overhead = self.dmd_settle.0.saturating_add(self.camera_readout.0);
        let frame = |exposure: Microseconds| exposure.0.saturating_add(overhead);
        let patterns = u32::from(self.pattern_count());
        let dark = self.exposures.first().copied().map_or(0, frame);
        Microseconds(self.exposures.iter().fold(dark, |sum, &exposure| {
            sum.saturating_add(frame(exposure).saturating_mul(patterns))
        }))
    }

    /// Accepts the plan whole or refuses it whole.
    ///
    /// # Errors
    /// The first value found beyond its limit, with that limit.
    pub fn validate(&self, limits: &Limits) -> Result<(), PlanError> {
        self.validate_light(limits)?;
        self.validate_patterns(limits)?;
        if self.led_on_per_view() > limits.led_on_max {
            return Err(PlanError::LedOnTime {
                got: self.led_on_per_view(),
                limit: limits.led_on_max,
            });
        }
        self.validate_travel(limits)?;
        self.validate_focus(limits)?;
        self.validate_waits(limits)
    }

    fn validate_light(&self, limits: &Limits) -> Result<(), PlanError> {
        if self.exposures.is_empty() {
            return Err(PlanError::NoExposures);
        }
        let mut before: Option<Microseconds> = None;
        for &got in &self.exposures {
            if got < limits.exposure_min {
                return Err(PlanError::ExposureTooShort {
                    got,
                    limit: limits.exposure_min,
                });
            }
            if got > limits.exposure_max {
                return Err(PlanError::ExposureTooLong {
                    got,
                    limit: limits.exposure_max,
                });
            }
            if let Some(limit) = before.filter(|&before| got <= before) {
                return Err(PlanError::ExposuresNotAscending { got, limit });
            }
            before = Some(got);
        }
        if self.led > limits.led_max {
            return Err(PlanError::LedCurrent {
                got: self.led,
                limit: limits.led_max,
            });
        }
        Ok(())
    }

    fn validate_patterns(&self, limits: &Limits) -> Result<(), PlanError> {
        if !(1..=MAX_PROJECTORS).contains(&self.projectors) {
            return Err(PlanError::Projectors {
                got: self.projectors,
                limit: MAX_PROJECTORS,
            });
        }
        if self.fringes.is_empty() {
            return Err(PlanError::NoFringes);
        }
        for set in &self.fringes {
            if set.steps < MIN_STEPS {
                return Err(PlanError::TooFewSteps {
                    got: set.steps,
                    limit: MIN_STEPS,
                });
            }
            if set.periods == 0 {
                return Err(PlanError::TooFewPeriods { got: 0, limit: 1 });
            }
        }
        if self.pattern_count() > limits.patterns_max {
            return Err(PlanError::TooManyPatterns {
                got: self.pattern_count(),
                limit: limits.patterns_max,
            });
        }
        if self.frames_per_view() > limits.frames_max {
            return Err(PlanError::TooManyFrames {
                got: self.frames_per_view(),
                limit: limits.frames_max,
            });
        }
        Ok(())
    }

    fn validate_travel(&self, limits: &Limits) -> Result<(), PlanError> {
        if self.views.is_empty() {
            return Err(PlanError::NoViews);
        }
        let (min, max) = (limits.vertical_min, limits.vertical_max);
        let heights = self.views.iter().map(|view| view.vertical);
        if let Some(got) = heights
            .chain([self.retract])
            .find(|got| *got < min || *got > max)
        {
            return Err(PlanError::VerticalOutOfTravel { got, min, max });
        }
        let (min, max) = (limits.rotation_min, limits.rotation_max);
        if let Some(got) = self
            .views
            .iter()
            .map(|view| view.rotation)
            .find(|got| *got < min || *got > max)
        {
            return Err(PlanError::RotationOutOfTravel { got, min, max });
        }
        Ok(())
    }

    fn validate_focus(&self, limits: &Limits) -> Result<(), PlanError> {
        let (min, max) = (limits.lens_min, limits.lens_max);
        match self.focus.map(|focus| focus.counts) {
            Some(got) if got < min || got > max => {
                Err(PlanError::FocusOutOfRange { got, min, max })
            }
            _ => Ok(()),
        }
    }

    fn validate_waits(&self, limits: &Limits) -> Result<(), PlanError> {
        let zero = Microseconds(0);
        let focus_settle = self.focus.map_or(zero, |focus| focus.settle);
        let timeouts = &self.timeouts;
        let (wait, motion, quick) = (
            limits.wait_max,
            limits.motion_timeout_max,
            limits.timeout_max,
        );
        for (which, got, least, limit) in [
            (Wait::Settle, self.settle, zero, wait),
            (Wait::DmdSettle, self.dmd_settle, zero, wait),
            (Wait::CameraReadout, self.camera_readout, zero, wait),
            (Wait::MotionTimeout, timeouts.motion, TIMEOUT_MIN, motion),
            (Wait::LedTimeout, timeouts.led, TIMEOUT_MIN, quick),
            (Wait::DmdTimeout, timeouts.dmd, TIMEOUT_MIN, quick),
            (Wait::CameraTimeout, timeouts.camera, TIMEOUT_MIN, quick),
            (Wait::FocusSettle, focus_settle, zero, wait),
        ] {
            if got < least {
                return Err(PlanError::WaitTooShort {
                    which,
                    got,
                    limit: least,
                });
            }
            if got > limit {
                return Err(PlanError::WaitTooLong { which, got, limit });
            }
        }
        Ok(())
    }
}
