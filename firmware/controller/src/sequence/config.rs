//! Settings of the instrument.

use crate::interlock::Timing;
use flankscope_protocol::{Limits, Micrometres, Microradians, Microseconds};

/// What is true of the instrument, not of a plan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Config {
    /// Plans are judged by these.
    pub limits: Limits,
    /// For a whole reference run, at least; stages that need longer for their travel have longer.
    pub home_timeout: Microseconds,
    /// For a retract, at least.
    pub retract_timeout: Microseconds,
    /// How long the host may say nothing during a capture.
    pub host_silence: Microseconds,
    /// For the LED current to be gone when no plan says otherwise.
    pub led_off_timeout: Microseconds,
    /// How far from its target the rotary stage may report itself in position.
    pub rotation_tolerance: Microradians,
    /// How far from its target the vertical stage may report itself in position.
    pub vertical_tolerance: Micrometres,
    /// How much longer than commanded a trigger pulse may come out.
    pub exposure_tolerance: Microseconds,
    /// How long a claimed press may take to let the head in, hold time included.
    pub claim_timeout: Microseconds,
    /// Times of the press interlock.
    pub interlock: Timing,
}

impl Config {
    /// The instrument with the 20 mm head.
    ///
    /// Tolerances are three times the stages' own errors (±15 mdeg = 262 urad, ±5 um). A pulse 100 us too long would
    /// brighten a 10 ms frame by 1 %.
    pub const DEFAULT: Self = Self {
        limits: Limits::DEFAULT,
        home_timeout: Microseconds::from_millis(30_000),
        retract_timeout: Microseconds::from_millis(5_000),
        host_silence: Microseconds::from_millis(100),
        led_off_timeout: Microseconds::from_millis(50),
        rotation_tolerance: Microradians(786),
        vertical_tolerance: Micrometres(15),
        exposure_tolerance: Microseconds(100),
        claim_timeout: Microseconds::from_millis(1_000),
        interlock: Timing::DEFAULT,
    };
}
