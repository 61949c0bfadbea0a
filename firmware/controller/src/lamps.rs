//! The LEDs of all projectors: at most one is enabled, and only once the current of the others is gone.

use crate::lamp::{Confirmed, Lamp};
use flankscope_protocol::{Fault, Limits, Microseconds, Projector, Timestamp};

/// Supervises the LED of each projector as a [`Lamp`]; where none is fitted its sense is low for ever.
#[derive(Debug, Clone)]
pub struct Lamps {
    first: Lamp,
    second: Lamp,
}

impl Lamps {
    /// All off and cold, as [`Lamp::new`].
    #[must_use]
    pub fn new(limits: &Limits, until: Timestamp) -> Self {
        let lamp = Lamp::new(limits, until);
        Self {
            first: lamp.clone(),
            second: lamp,
        }
    }

    fn each(&self) -> [(Projector, &Lamp); 2] {
        Projector::ALL.map(|projector| (projector, self.of(projector)))
    }

    /// The LED of a projector.
    #[must_use]
    pub fn of(&self, projector: Projector) -> &Lamp {
        match projector {
            Projector::First => &self.first,
            Projector::Second => &self.second,
        }
    }

    fn of_mut(&mut self, projector: Projector) -> &mut Lamp {
        match projector {
            Projector::First => &mut self.first,
            Projector::Second => &mut self.second,
        }
    }

    /// Whose enable output is on.
    #[must_use]
    pub fn enabled(&self) -> Option<Projector> {
        let mut each = self.each().into_iter();
        each.find_map(|(projector, lamp)| lamp.enabled().then_some(projector))
    }

    /// Enables the LED of a projector, as [`Lamp::switch_on`]. False, and nothing is enabled, while another may still shine.
    #[must_use]
    pub fn switch_on(
        &mut self,
        projector: Projector,
        now: Timestamp,
        timeout: Microseconds,
    ) -> bool {
        let each = self.each();
        let alone = each
            .iter()
            .all(|(of, lamp)| *of == projector || lamp.is_dark());
        if alone {
            self.of_mut(projector).switch_on(now, timeout);
        }
        alone
    }

    /// Disables all. Whose LED was enabled.
    pub fn switch_off(&mut self, now: Timestamp, timeout: Microseconds) -> Option<Projector> {
        let was = self.enabled();
        for projector in Projector::ALL {
            self.of_mut(projector).switch_off(now, timeout);
        }
        was
    }

    /// The sense level of each projector's LED that would be news.
    #[must_use]
    pub fn awaits(&self) -> [Option<bool>; 2] {
        self.each().map(|(_, lamp)| lamp.awaits())
    }

    /// The current sense of a projector's LED has this level. What is confirmed is dark only when all are.
    ///
    /// # Errors
    /// As [`Lamp::sense`].
    pub fn sense(&mut self, projector: Projector, level: bool) -> Result<Option<Confirmed>, Fault> {
        let confirmed = self.of_mut(projector).sense(level)?;
        let dark = self.each().iter().all(|(_, lamp)| lamp.is_dark());
        Ok(confirmed.filter(|confirmed| *confirmed == Confirmed::Lit || dark))
    }

    /// When all LEDs, being off, may be on for `need` each; as [`crate::budget::LedBudget::ready_at`].
    #[must_use]
    pub fn ready_at(&self, now: Timestamp, need: Microseconds) -> Option<Timestamp> {
        self.each().into_iter().try_fold(now, |latest, (_, lamp)| {
            Some(latest.max(lamp.budget().ready_at(now, need)?))
        })
    }

    /// When [`Lamps::expire`] wants to be called.
    #[must_use]
    pub fn deadline(&self) -> Option<Timestamp> {
        let each = self.each().into_iter();
        each.filter_map(|(_, lamp)| lamp.deadline()).min()
    }

    /// Looks at the clock.
    ///
    /// # Errors
    /// As [`Lamp::expire`], and whose.
    pub fn expire(&mut self, now: Timestamp) -> Result<(), (Projector, Fault)> {
        Projector::ALL.into_iter().try_for_each(|projector| {
            let expired = self.of_mut(projector).expire(now);
            expired.map_err(|fault| (projector, fault))
        })
    }

    /// As [`Lamp::acknowledge`].
    pub fn acknowledge(&mut self) {
        for projector in Projector::ALL {
            self.of_mut(projector).acknowledge();
        }
    }
}
