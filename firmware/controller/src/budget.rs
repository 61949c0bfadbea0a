//! On-time budget of the LED: a bucket that fills while the LED is on and drains while it is off.

use flankscope_protocol::{Limits, Microseconds, Timestamp};

/// Keeps the LED within its longest on-time from cold and its duty for ever.
///
/// On-time adds itself. Off-time takes back d/(1-d) of itself, d being the duty: over any long cycle with that duty
/// the two balance.
#[derive(Debug, Clone)]
pub struct LedBudget {
    capacity_us: u64,
    duty_permille: u64,
    used_us: u64,
    since: Timestamp,
    on: bool,
}

impl LedBudget {
    /// A cold LED.
    #[must_use]
    pub fn new(limits: &Limits) -> Self {
        Self {
            capacity_us: u64::from(limits.led_on_max.get()),
            // Never quite for ever on, so that the rest below stays positive.
            duty_permille: u64::from(limits.led_duty_permille.min(999)),
            used_us: 0,
            since: Timestamp(0),
            on: false,
        }
    }

    fn rest_permille(&self) -> u64 {
        1000u64.saturating_sub(self.duty_permille).max(1)
    }

    /// On-time used up at `now`.
    #[must_use]
    pub fn used_us(&self, now: Timestamp) -> u64 {
        let elapsed = now.since_us(self.since);
        if self.on {
            self.used_us.saturating_add(elapsed)
        } else {
            let drained = elapsed.saturating_mul(self.duty_permille) / self.rest_permille();
            self.used_us.saturating_sub(drained)
        }
    }

    /// The LED was switched at `now`.
    pub fn switch(&mut self, now: Timestamp, on: bool) {
        self.used_us = self.used_us(now);
        self.since = now;
        self.on = on;
    }

    /// When the LED, if on, must be off.
    pub fn exhausted_at(&self) -> Option<Timestamp> {
        let left = self.capacity_us.saturating_sub(self.used_us);
        self.on
            .then(|| Timestamp(self.since.get().saturating_add(left)))
    }

    /// When the LED, being off, may be on for `need` in one go; `now` if it may already. `None`: never.
    #[must_use]
    pub fn ready_at(&self, now: Timestamp, need: Microseconds) -> Option<Timestamp> {
        let allowed = self.capacity_us.checked_sub(u64::from(need.get()))?;
        let excess = self.used_us(now).saturating_sub(allowed);
        if excess == 0 {
            return Some(now);
        }
        let wait = excess
            .saturating_mul(self.rest_permille())
            .div_ceil(self.duty_permille.max(1));
        (self.duty_permille > 0).then(|| Timestamp(now.get().saturating_add(wait)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn budget(led_on_max: u32, led_duty_permille: u16) -> LedBudget {
        LedBudget::new(&Limits {
            led_on_max: Microseconds(led_on_max),
            led_duty_permille,
            ..Limits::DEFAULT
        })
    }

    #[test]
    fn a_cold_led_lasts_its_longest_on_time() {
        let mut led = budget(4_000, 250);
        assert_eq!(led.exhausted_at(), None);
        led.switch(Timestamp(1_000), true);
        assert_eq!(led.exhausted_at(), Some(Timestamp(5_000)));
    }

    #[test]
    fn off_time_gives_back_what_the_duty_allows() {
        let mut led = budget(4_000, 250);
        led.switch(Timestamp(0), true);
        led.switch(Timestamp(4_000), false);
        // A quarter duty: 3 us off for 1 us on.
        assert_eq!(
            led.ready_at(Timestamp(4_000), Microseconds(1_000)),
            Some(Timestamp(7_000))
        );
        assert_eq!(led.used_us(Timestamp(7_000)), 3_000);
        assert_eq!(
            led.ready_at(Timestamp(7_000), Microseconds(1_000)),
            Some(Timestamp(7_000))
        );
        assert_eq!(led.used_us(Timestamp(1_000_000)), 0);
        assert_eq!(led.ready_at(Timestamp(0), Microseconds(4_001)), None);
    }

    #[test]
    fn switching_at_the_duty_balances_for_ever() {
        let mut led = budget(10_000, 400);
        let mut now = 0;
        for _ in 0..10_000 {
            led.switch(Timestamp(now), true);
            assert!(led.exhausted_at() > Some(Timestamp(now + 4_000)));
            led.switch(Timestamp(now + 4_000), false);
            now += 10_000;
        }
        assert_eq!(led.used_us(Timestamp(now)), 0);
    }

    #[test]
    fn an_led_without_duty_never_recovers() {
        let mut led = budget(1_000, 0);
        led.switch(Timestamp(0), true);
        led.switch(Timestamp(600), false);
        assert_eq!(led.ready_at(Timestamp(1_000_000), Microseconds(401)), None);
        assert_eq!(
            led.ready_at(Timestamp(1_000_000), Microseconds(400)),
            Some(Timestamp(1_000_000))
        );
    }
}
