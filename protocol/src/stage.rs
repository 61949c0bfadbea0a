//! The stages as a station has them: their serial line, axes, travel, dynamics and homing.
//!
//! Nothing of this is compiled into the controller but the bounds: [`Limits`]. The host reads a [`StageConfig`] from its
//! station's file and sends it in every session; before the controller has accepted one, nothing moves.

use crate::line::{FlowControl, Line, Parity};
use crate::plan::Limits;
use crate::stage_name::StageName;
use crate::units::{
    Micrometres, MicrometresPerSecond, MicrometresPerSecondSquared, Microradians, Microseconds,
    MillidegreesPerSecond, MillidegreesPerSecondSquared,
};
use core::fmt;
use serde::{Deserialize, Serialize};

/// Version of what a [`StageConfig`] means; sent beside it.
pub const STAGE_CONFIG_VERSION: u16 = 2;

/// What an axis looks for when it is referenced.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum HomeAt {
    /// The home switch, then the encoder's index pulse.
    SwitchAndIndex,
    /// The home switch.
    Switch,
    /// The limit switch at the upper end.
    UpperLimit,
    /// The limit switch at the lower end.
    LowerLimit,
}

/// Position on one kind of axis, which decides the units of its speeds.
pub trait AxisPosition: Copy + Into<i32> {
    /// Speed of a move.
    type Speed: Copy + Into<u32>;
    /// Acceleration of a move.
    type Acceleration: Copy + Into<u32>;
    /// Names of an axis' values: speed, acceleration, lower end, upper end, home, home search speed.
    const VALUES: [StageValue; 6];
    /// Units of [`Self::distance`] per unit of a speed's length.
    const PER_SPEED: u64;
    /// Length of a move by so many units of position, rounded up.
    fn distance(units: u32) -> u64;
}

/// One axis of the stages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Axis<P: AxisPosition> {
    /// Its number at the stage controller.
    pub number: u8,
    /// The model that the stage must answer as; `None`: nobody asks.
    pub model: Option<StageName>,
    /// Speed of a move.
    pub speed: P::Speed,
    /// Acceleration and deceleration of a move.
    pub acceleration: P::Acceleration,
    /// Lower end of the travel.
    pub from: P,
    /// Upper end of the travel.
    pub to: P,
    /// Position assigned to the place that homing finds; the head is clear of the die there.
    pub home: P,
    /// Speed of the search.
    pub home_speed: P::Speed,
    /// What is searched for.
    pub home_at: HomeAt,
}

/// The axis that turns die or head.
pub type RotaryAxis = Axis<Microradians>;
/// The axis that raises the head.
pub type LinearAxis = Axis<Micrometres>;

impl AxisPosition for Microradians {
    type Speed = MillidegreesPerSecond;
    type Acceleration = MillidegreesPerSecondSquared;
    const VALUES: [StageValue; 6] = [
        StageValue::RotationSpeed,
        StageValue::RotationAcceleration,
        StageValue::RotationFrom,
        StageValue::RotationTo,
        StageValue::RotationHome,
        StageValue::RotationHomeSpeed,
    ];
    const PER_SPEED: u64 = 1_000;

    /// Millionths of a degree. 180/pi: a micro-radian is 57.295780 of them.
    fn distance(units: u32) -> u64 {
        let scaled = u64::from(units).saturating_mul(57_295_780);
        scaled.div_ceil(1_000_000)
    }
}

impl AxisPosition for Micrometres {
    type Speed = MicrometresPerSecond;
    type Acceleration = MicrometresPerSecondSquared;
    const VALUES: [StageValue; 6] = [
        StageValue::VerticalSpeed,
        StageValue::VerticalAcceleration,
        StageValue::VerticalFrom,
        StageValue::VerticalTo,
        StageValue::VerticalHome,
        StageValue::VerticalHomeSpeed,
    ];
    const PER_SPEED: u64 = 1;

    fn distance(units: u32) -> u64 {
        units.into()
    }
}

/// The stages of a station.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct StageConfig {
    /// The line between controller and stage controller.
    pub line: Line,
    /// The axis that turns die or head.
    pub rotation: RotaryAxis,
    /// The axis that raises the head.
    pub vertical: LinearAxis,
}

/// A number of a [`StageConfig`], to say which one was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum StageValue {
    /// [`Line::baud`].
    Baud,
    /// [`RotaryAxis::number`].
    RotationNumber,
    /// [`RotaryAxis::speed`].
    RotationSpeed,
    /// [`RotaryAxis::acceleration`].
    RotationAcceleration,
    /// [`RotaryAxis::from`].
    RotationFrom,
    /// [`RotaryAxis::to`].
    RotationTo,
    /// [`RotaryAxis::home`].
    RotationHome,
    /// [`RotaryAxis::home_speed`].
    RotationHomeSpeed,
    /// [`LinearAxis::number`].
    VerticalNumber,
    /// [`LinearAxis::speed`].
    VerticalSpeed,
    /// [`LinearAxis::acceleration`].
    VerticalAcceleration,
    /// [`LinearAxis::from`].
    VerticalFrom,
    /// [`LinearAxis::to`].
    VerticalTo,
    /// [`LinearAxis::home`].
    VerticalHome,
    /// [`LinearAxis::home_speed`].
    VerticalHomeSpeed,
}

impl StageValue {
    /// In words, and the unit of its number.
    const fn words(self) -> (&'static str, &'static str) {
        match self {
            Self::Baud => ("line speed", "baud"),
            Self::RotationNumber => ("number of the rotary axis", ""),
            Self::RotationSpeed => ("rotation speed", "mdeg/s"),
            Self::RotationAcceleration => ("rotation acceleration", "mdeg/s2"),
            Self::RotationFrom => ("lower end of the rotation", "urad"),
            Self::RotationTo => ("upper end of the rotation", "urad"),
            Self::RotationHome => ("home of the rotation", "urad"),
            Self::RotationHomeSpeed => ("home search speed of the rotation", "mdeg/s"),
            Self::VerticalNumber => ("number of the vertical axis", ""),
            Self::VerticalSpeed => ("vertical speed", "um/s"),
            Self::VerticalAcceleration => ("vertical acceleration", "um/s2"),
            Self::VerticalFrom => ("lower end of the vertical travel", "um"),
            Self::VerticalTo => ("upper end of the vertical travel", "um"),
            Self::VerticalHome => ("home of the vertical axis", "um"),
            Self::VerticalHomeSpeed => ("home search speed of the vertical axis", "um/s"),
        }
    }
}

impl fmt::Display for StageValue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.words().0)
    }
}

/// Why a configuration of the stages was refused, as a whole: the offending value and the limit it broke.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
pub enum StageError {
    /// The host means something else by a configuration.
    #[error("stage configuration of version {got}; the controller knows version {want}")]
    Version {
        /// The host's version.
        got: u16,
        /// The controller's version.
        want: u16,
    },
    /// A number beyond its limit.
    #[error("{what} {got} is outside {min} .. {max} {}", .what.words().1)]
    Outside {
        /// Which number.
        what: StageValue,
        /// Offending value, in the unit of the message.
        got: i64,
        /// Least allowed.
        min: i64,
        /// Most allowed.
        max: i64,
    },
    /// A travel whose upper end does not lie above its lower one.
    #[error("{what} {got} does not lie above the lower end, {limit} {}", .what.words().1)]
    Inverted {
        /// The upper end.
        what: StageValue,
        /// Offending value.
        got: i64,
        /// The lower end, which it must exceed.
        limit: i64,
    },
    /// Both axes have the same number.
    #[error("both axes have number {got}; each needs its own")]
    SameNumber {
        /// The number.
        got: u8,
    },
    /// The whole travel takes longer than a motion may.
    #[error("{what} {value} {}: the whole travel takes {got}; at most {limit}", .what.words().1)]
    TooSlow {
        /// The speed.
        what: StageValue,
        /// Its value.
        value: i64,
        /// Time for the whole travel, with a quarter to spare.
        got: Microseconds,
        /// Longest timeout for a motion.
        limit: Microseconds,
    },
    /// A model that no stage answers as.
    #[error(
        "model {got:?} of axis {axis}: 1 to {} printable ASCII characters without a comma",
        StageName::LONGEST_MODEL
    )]
    Model {
        /// Number of the axis.
        axis: u8,
        /// Offending value.
        got: StageName,
    },
    /// A form of characters that the controller's port does not have.
    #[error("line {got}: the controller's port to the stages has 8N1, no flow control, only")]
    LineForm {
        /// The line asked for.
        got: Line,
    },
}

impl StageConfig {
    /// URS150BCC (80 deg/s) and IMS300V (100 mm/s) on a Newport ESP301: full speed within 0.25 s and 0.125 s, one turn
    /// either way, ±150 mm, home 100 mm above the working zero, clear of a 66 mm die.
    pub const DEFAULT: Self = Self {
        line: Line {
            baud: 115_200,
            ..Line::HOST
        },
        rotation: RotaryAxis {
            number: 1,
            model: None,
            speed: MillidegreesPerSecond(80_000),
            acceleration: MillidegreesPerSecondSquared(320_000),
            from: Microradians(-6_283_185),
            to: Microradians(6_283_185),
            home: Microradians(0),
            home_speed: MillidegreesPerSecond(80_000),
            home_at: HomeAt::SwitchAndIndex,
        },
        vertical: LinearAxis {
            number: 2,
            model: None,
            speed: MicrometresPerSecond(100_000),
            acceleration: MicrometresPerSecondSquared(800_000),
            from: Micrometres(-150_000),
            to: Micrometres(150_000),
            home: Micrometres(100_000),
            home_speed: MicrometresPerSecond(100_000),
            home_at: HomeAt::SwitchAndIndex,
        },
    };

    /// Accepts the configuration whole or refuses it whole.
    ///
    /// # Errors
    /// The first value found beyond its limit, with that limit.
    pub fn validate(&self, limits: &Limits) -> Result<(), StageError> {
        let (turn, lift) = (&self.rotation, &self.vertical);
        let (got, min, max) = (self.line.baud, limits.stage_baud_min, limits.stage_baud_max);
        within(StageValue::Baud, got, min, max)?;
        let form = Line {
            data_bits: 8,
            parity: Parity::None,
            stop_bits: 1,
            flow: FlowControl::None,
            ..self.line
        };
        if form != self.line {
            return Err(StageError::LineForm { got: self.line });
        }
        let axes = limits.stage_axes;
        within(StageValue::RotationNumber, turn.number, 1, axes)?;
        within(StageValue::VerticalNumber, lift.number, 1, axes)?;
        if turn.number == lift.number {
            return Err(StageError::SameNumber { got: turn.number });
        }
        for (axis, model) in self.models() {
            if let Some(got) = model
                && !got.is_model()
            {
                return Err(StageError::Model { axis, got });
            }
        }
        turn.validate_speeds(limits.rotation_speed_max, limits.rotation_acceleration_max)?;
        lift.validate_speeds(limits.vertical_speed_max, limits.vertical_acceleration_max)?;
        turn.validate_travel(limits.rotation_min, limits.rotation_max)?;
        lift.validate_travel(limits.vertical_min, limits.vertical_max)?;
        turn.validate_times(limits.motion_timeout_max)?;
        lift.validate_times(limits.motion_timeout_max)
    }

    /// Number and model of each axis: rotation, vertical.
    #[must_use]
    pub fn models(&self) -> [(u8, Option<StageName>); 2] {
        [
            (self.rotation.number, self.rotation.model),
            (self.vertical.number, self.vertical.model),
        ]
    }

    /// Whether the stages must be asked what they are.
    #[must_use]
    pub fn names_a_model(&self) -> bool {
        self.models().iter().any(|(_, model)| model.is_some())
    }

    /// Number of the first axis whose stage answers as another model than that of this configuration; `answers` in its order.
    #[must_use]
    pub fn other_model(&self, answers: &[StageName; 2]) -> Option<u8> {
        let mut axes = self.models().into_iter().zip(answers);
        let other = axes.find(|((_, model), answer)| {
            model.is_some_and(|model| model.model() != answer.model())
        })?;
        Some(other.0.0)
    }

    /// Time after which a move from anywhere to anywhere has failed: that of the whole travel, and a quarter of it.
    #[must_use]
    pub fn motion_timeout(&self) -> Microseconds {
        with_margin(
            self.rotation
                .longest_move()
                .max(self.vertical.longest_move()),
        )
    }

    /// The same for the vertical axis alone.
    #[must_use]
    pub fn retract_timeout(&self) -> Microseconds {
        with_margin(self.vertical.longest_move())
    }

    /// The same for the search of both homes, one after the other.
    #[must_use]
    pub fn home_timeout(&self) -> Microseconds {
        let (turn, lift) = (
            self.rotation.longest_search(),
            self.vertical.longest_search(),
        );
        with_margin(Microseconds(turn.get().saturating_add(lift.get())))
    }
}

impl<P: AxisPosition> Axis<P> {
    /// Time of a move: trapezoidal, or triangular where full speed is not reached; rounded up.
    #[must_use]
    pub fn travel_time(&self, from: P, to: P) -> Microseconds {
        let [speed, acceleration] = [self.speed.into(), self.acceleration.into()]
            .map(|counts| u64::from(counts).saturating_mul(P::PER_SPEED));
        let distance = P::distance(from.into().abs_diff(to.into()));
        trapezoid(distance, speed, acceleration)
    }

    fn longest_move(&self) -> Microseconds {
        self.travel_time(self.from, self.to)
    }

    fn longest_search(&self) -> Microseconds {
        let search = Self {
            speed: self.home_speed,
            ..*self
        };
        search.longest_move()
    }

    /// Speeds and acceleration above zero and within their limits.
    fn validate_speeds(
        &self,
        speed_max: P::Speed,
        acceleration_max: P::Acceleration,
    ) -> Result<(), StageError> {
        let [speed, acceleration, .., home_speed] = P::VALUES;
        within(speed, self.speed.into(), 1, speed_max.into())?;
        let (got, max) = (self.acceleration.into(), acceleration_max.into());
        within(acceleration, got, 1, max)?;
        within(home_speed, self.home_speed.into(), 1, speed_max.into())
    }

    /// Both ends in order and within the limits, zero and home between them: stage controllers count their travel from zero.
    fn validate_travel(&self, min: P, max: P) -> Result<(), StageError> {
        let [_, _, lower, upper, middle, _] = P::VALUES;
        let [from, to, home] = [self.from, self.to, self.home].map(P::into);
        if to <= from {
            return Err(StageError::Inverted {
                what: upper,
                got: to.into(),
                limit: from.into(),
            });
        }
        within(lower, from, min.into(), 0)?;
        within(upper, to, 0, max.into())?;
        within(middle, home, from, to)
    }

    /// Time of the whole travel, by a move and by a search, within the longest timeout.
    fn validate_times(&self, limit: Microseconds) -> Result<(), StageError> {
        let [speed, .., home_speed] = P::VALUES;
        for (what, value, got) in [
            (speed, self.speed, self.longest_move()),
            (home_speed, self.home_speed, self.longest_search()),
        ] {
            let got = with_margin(got);
            if got > limit {
                return Err(StageError::TooSlow {
                    what,
                    value: value.into().into(),
                    got,
                    limit,
                });
            }
        }
        Ok(())
    }
}

impl Limits {
    /// These limits with the travel of these stages, which lies within.
    #[must_use]
    pub fn within(&self, stage: &StageConfig) -> Self {
        Self {
            rotation_min: self.rotation_min.max(stage.rotation.from),
            rotation_max: self.rotation_max.min(stage.rotation.to),
            vertical_min: self.vertical_min.max(stage.vertical.from),
            vertical_max: self.vertical_max.min(stage.vertical.to),
            ..*self
        }
    }
}

fn within<N: Into<i64> + Copy>(what: StageValue, got: N, min: N, max: N) -> Result<(), StageError> {
    let (got, min, max) = (got.into(), min.into(), max.into());
    if got < min || got > max {
        return Err(StageError::Outside {
            what,
            got,
            min,
            max,
        });
    }
    Ok(())
}

/// Time of a move that begins and ends at rest: d/v + v/a, or 2 sqrt(d/a) where d is shorter than v²/a. Any unit of length,
/// rounded up to 20 us.
fn trapezoid(distance: u64, speed: u64, acceleration: u64) -> Microseconds {
    let square = speed.saturating_mul(speed);
    let us = if distance.saturating_mul(acceleration) >= square {
        let cruise_us = ratio_us(distance, speed);
        cruise_us.saturating_add(ratio_us(speed, acceleration))
    } else {
        // sqrt(10^10 d/a) is in units of 10 us.
        let square = ratio(distance.saturating_mul(10_000_000_000), acceleration);
        square.isqrt().saturating_add(1).saturating_mul(20)
    };
    Microseconds(u32::try_from(us).unwrap_or(u32::MAX))
}

fn ratio_us(distance: u64, speed: u64) -> u64 {
    ratio(distance.saturating_mul(1_000_000), speed)
}

/// Rounded up; without end by nothing.
fn ratio(of: u64, by: u64) -> u64 {
    match by {
        0 => u64::MAX,
        by => of.div_ceil(by),
    }
}

fn with_margin(time: Microseconds) -> Microseconds {
    Microseconds(time.get().saturating_add(time.get() >> 2))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moves_take_as_long_as_the_closed_form_says() {
        let stage = StageConfig::DEFAULT;
        // 67 mm at 100 mm/s and one ramp of 0.125 s.
        let lift = stage
            .vertical
            .travel_time(Micrometres(100_000), Micrometres(33_000));
        assert_eq!(lift, Microseconds(795_000));
        // 2 mm: 2 sqrt(2 / 800) s = 0.1 s, and full speed is not reached (12.5 mm).
        let short = stage
            .vertical
            .travel_time(Micrometres(0), Micrometres(2_000));
        assert!((100_000..=100_040).contains(&short.get()), "{short}");
        // Where both forms meet.
        let meet = stage
            .vertical
            .travel_time(Micrometres(0), Micrometres(12_500));
        assert_eq!(meet, Microseconds(250_000));
        let almost = stage
            .vertical
            .travel_time(Micrometres(0), Micrometres(12_499));
        assert!((249_960..=250_010).contains(&almost.get()), "{almost}");
        // Half a turn at 80 deg/s and 0.25 s.
        let turn = stage
            .rotation
            .travel_time(Microradians(0), Microradians(-3_141_593));
        assert!((2_500_000..=2_500_002).contains(&turn.get()), "{turn}");
        assert_eq!(
            stage.rotation.travel_time(Microradians(7), Microradians(7)),
            Microseconds(20)
        );
    }

    fn refused(change: impl FnOnce(&mut StageConfig)) -> StageError {
        let mut stage = StageConfig::DEFAULT;
        change(&mut stage);
        stage
            .validate(&Limits::DEFAULT)
            .expect_err("beyond a limit")
    }

    #[test]
    fn what_lies_beyond_a_limit_is_refused_by_name_with_value_and_limit() {
        assert_eq!(StageConfig::DEFAULT.validate(&Limits::DEFAULT), Ok(()));
        extern crate std;
        use std::string::ToString;
        for (error, words) in [
            (
                refused(|s| s.line.baud = 300),
                "line speed 300 is outside 19200 .. 921600 baud",
            ),
            (
                refused(|s| s.line.parity = Parity::Even),
                "line 115200 8E1, no flow control: the controller's port to the stages has 8N1, no flow control, only",
            ),
            (
                refused(|s| s.rotation.speed.0 = 200_001),
                "rotation speed 200001 is outside 1 .. 200000 mdeg/s",
            ),
            (
                refused(|s| s.vertical.acceleration.0 = 0),
                "vertical acceleration 0 is outside 1 .. 5000000 um/s2",
            ),
            (
                refused(|s| s.vertical.to.0 = 150_001),
                "upper end of the vertical travel 150001 is outside 0 .. 150000 um",
            ),
            (
                refused(|s| s.vertical.to.0 = -150_000),
                "upper end of the vertical travel -150000 does not lie above the lower end, -150000 um",
            ),
            (
                refused(|s| s.vertical.home.0 = -150_001),
                "home of the vertical axis -150001 is outside -150000 .. 150000 um",
            ),
            (
                refused(|s| s.vertical.number = 1),
                "both axes have number 1; each needs its own",
            ),
            (
                refused(|s| s.rotation.number = 4),
                "number of the rotary axis 4 is outside 1 .. 3 ",
            ),
            (
                refused(|s| s.vertical.home_speed.0 = 1_000),
                "home search speed of the vertical axis 1000 um/s: the whole travel takes 375001562 us; at most 60000000 us",
            ),
        ] {
            assert_eq!(error.to_string(), words);
        }
    }

    #[test]
    fn plans_are_judged_by_the_travel_of_the_stages() {
        let mut stage = StageConfig::DEFAULT;
        (stage.vertical.from, stage.vertical.to) = (Micrometres(-10), Micrometres(20));
        let limits = Limits::DEFAULT.within(&stage);
        assert_eq!(
            (limits.vertical_min, limits.vertical_max),
            (Micrometres(-10), Micrometres(20))
        );
        assert_eq!(limits.rotation_max, stage.rotation.to);
        assert_eq!(limits.led_max, Limits::DEFAULT.led_max);
    }
}
