//! The LED as the sequence sees it: an enable output, a current-sense input that must follow it, and a budget.

use crate::budget::LedBudget;
use flankscope_protocol::{Fault, Limits, Microseconds, Timestamp};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    Dark,
    Rising {
        until: Timestamp,
    },
    Lit,
    Falling {
        until: Timestamp,
    },
    /// The sense contradicted the output; reported once, silent until acknowledged.
    Broken,
}

/// What the current sense confirmed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Confirmed {
    /// The LED has its current.
    Lit,
    /// The LED's current is gone.
    Dark,
}

/// Supervises the LED: its sense must follow its enable, within time and within the budget.
#[derive(Debug, Clone)]
pub struct Lamp {
    phase: Phase,
    enabled: bool,
    budget: LedBudget,
}

impl Lamp {
    /// An LED that is off and cold; where a reset put it out, its current may still flow until then.
    #[must_use]
    pub fn new(limits: &Limits, until: Timestamp) -> Self {
        Self {
            phase: Phase::Falling { until },
            enabled: false,
            budget: LedBudget::new(limits),
        }
    }

    /// The enable output.
    pub fn enabled(&self) -> bool {
        self.enabled
    }

    /// Its current is known to be gone.
    pub fn is_dark(&self) -> bool {
        self.phase == Phase::Dark
    }

    /// On-time bookkeeping.
    pub fn budget(&self) -> &LedBudget {
        &self.budget
    }

    /// The LED is being enabled; its current must flow within `timeout`.
    pub fn switch_on(&mut self, now: Timestamp, timeout: Microseconds) {
        self.enabled = true;
        self.phase = Phase::Rising {
            until: now.after(timeout),
        };
        self.budget.switch(now, true);
    }

    /// The LED is being disabled; its current must be gone within `timeout`. True if it was enabled.
    pub fn switch_off(&mut self, now: Timestamp, timeout: Microseconds) -> bool {
        let was = core::mem::take(&mut self.enabled);
        if was {
            self.budget.switch(now, false);
            if self.phase != Phase::Broken {
                self.phase = Phase::Falling {
                    until: now.after(timeout),
                };
            }
        }
        was
    }

    /// The sense level that would be news.
    pub fn awaits(&self) -> Option<bool> {
        match self.phase {
            Phase::Dark | Phase::Rising { .. } => Some(true),
            Phase::Lit | Phase::Falling { .. } => Some(false),
            Phase::Broken => None,
        }
    }

    /// The current sense has this level.
    ///
    /// # Errors
    /// The LED went out or came on by itself.
    pub fn sense(&mut self, level: bool) -> Result<Option<Confirmed>, Fault> {
        let (phase, outcome) = match (self.phase, level) {
            (Phase::Rising { .. }, true) => (Phase::Lit, Ok(Some(Confirmed::Lit))),
            (Phase::Falling { .. }, false) => (Phase::Dark, Ok(Some(Confirmed::Dark))),
            (Phase::Lit, false) => (Phase::Broken, Err(Fault::LedLost)),
            (Phase::Dark, true) => (Phase::Broken, Err(Fault::LedStuckOn)),
            (phase, _) => (phase, Ok(None)),
        };
        self.phase = phase;
        outcome
    }

    /// When [`Lamp::expire`] wants to be called.
    pub fn deadline(&self) -> Option<Timestamp> {
        let sense = match self.phase {
            Phase::Rising { until } | Phase::Falling { until } => Some(until),
            Phase::Dark | Phase::Lit | Phase::Broken => None,
        };
        [sense, self.budget.exhausted_at()]
            .into_iter()
            .flatten()
            .min()
    }

    /// Looks at the clock.
    ///
    /// # Errors
    /// The sense did not follow in time, or the budget is used up.
    pub fn expire(&mut self, now: Timestamp) -> Result<(), Fault> {
        let fault = match self.phase {
            Phase::Rising { until } if now >= until => Some(Fault::LedNotOn),
            Phase::Falling { until } if now >= until => Some(Fault::LedStuckOn),
            _ => None,
        };
        if let Some(fault) = fault {
            self.phase = Phase::Broken;
            return Err(fault);
        }
        match self.budget.exhausted_at() {
            Some(end) if now >= end => Err(Fault::LedBudget),
            _ => Ok(()),
        }
    }

    /// Believes in the LED again after a fault; the sense is watched anew.
    pub fn acknowledge(&mut self) {
        if self.phase == Phase::Broken && !self.enabled {
            self.phase = Phase::Dark;
        }
    }
}
