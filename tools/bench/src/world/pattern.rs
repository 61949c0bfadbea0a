//! Patterns of the DMD.

use super::WorldError;
use serde::Deserialize;

/// One sinusoidal frame of the DMD: brightness `0.5 + 0.5 cos(2π periods (x + 0.5) / width + 2π step / steps)` at column x.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
pub struct PatternSpec {
    /// Periods over the width of the DMD; 0 is uniform.
    pub periods: f64,
    /// Number of the phase step, from 0.
    pub step: u32,
    /// Phase steps per period.
    pub steps: u32,
}

/// A frequency of a set that is specific to a head.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
pub struct Fringes {
    /// Periods over the width of the DMD.
    pub periods: u32,
    /// Phase steps.
    pub steps: u32,
}

impl PatternSpec {
    /// All frames of sets given as (periods, steps), set by set in the order in which the DMD shows them.
    pub fn sequence(sets: &[(f64, u32)]) -> Vec<Self> {
        sets.iter()
            .flat_map(|&(periods, steps)| {
                (0..steps).map(move |step| Self {
                    periods,
                    step,
                    steps,
                })
            })
            .collect()
    }

    /// A set by its name in head files and plans.
    pub fn named(name: &str) -> Option<Vec<Self>> {
        match name {
            "article8" => Some(Self::sequence(&[(4.0, 4), (48.0, 4)])),
            "insitu12" => Some(Self::insitu12()),
            "scan16" => Some(Self::scan16()),
            "high12" => Some(Self::sequence(&[(36.0, 4), (39.0, 4), (48.0, 4)])),
            "high16" => Some(Self::sequence(&[(41.0, 4), (45.0, 4), (48.0, 8)])),
            _ => None,
        }
    }

    /// The set of a head file: its own, or one by name.
    pub fn of_head(name: &str, fringes: &[Fringes]) -> Option<Vec<Self>> {
        if fringes.is_empty() {
            return Self::named(name);
        }
        let own: Vec<(f64, u32)> = fringes
            .iter()
            .map(|set| (f64::from(set.periods), set.steps))
            .collect();
        Some(Self::sequence(&own))
    }

    /// In-situ set: 4 periods in 4 steps, 48 periods in 8 steps.
    pub fn insitu12() -> Vec<Self> {
        Self::sequence(&[(4.0, 4), (48.0, 8)])
    }

    /// Offline set: 4 and 13 periods in 4 steps, 48 periods in 8 steps.
    pub fn scan16() -> Vec<Self> {
        Self::sequence(&[(4.0, 4), (13.0, 4), (48.0, 8)])
    }

    /// Phase shift of the step, rad.
    pub fn step_rad(&self) -> f64 {
        std::f64::consts::TAU * f64::from(self.step) / f64::from(self.steps)
    }

    pub(crate) fn validate(&self) -> Result<(), WorldError> {
        WorldError::check("periods", self.periods, 0.0, 512.0)?;
        WorldError::check("steps", f64::from(self.steps), 1.0, 1000.0)?;
        WorldError::check(
            "step",
            f64::from(self.step),
            0.0,
            f64::from(self.steps) - 1.0,
        )
    }
}
