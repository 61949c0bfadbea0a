//! Age of a check. It is counted by the time since the computer started, which is never set and counts while a process is stopped;
//! the wall clock may only make a check older.

use std::collections::BTreeMap;
use std::time::Duration;

use flankscope_foundation::clock::BootTime;
use flankscope_record::document::LastExposure;
use flankscope_record::history::Check;
use jiff::{SignedDuration, Timestamp};

use super::Facts;

/// Difference of two clocks that is no step: reading them takes time, and a leap second is one.
const CLOCK_TOLERANCE: Duration = Duration::from_secs(2);

fn tolerance() -> SignedDuration {
    SignedDuration::try_from(CLOCK_TOLERANCE).unwrap_or(SignedDuration::ZERO)
}

/// A moment, by both clocks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Moment {
    pub boot: BootTime,
    pub wall: Timestamp,
}

impl Moment {
    pub fn now() -> Self {
        Self {
            boot: BootTime::now(),
            wall: Timestamp::now(),
        }
    }
}

/// Why the verdict of a check does not count although it may be young.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Doubt {
    /// It is a recording: nothing was looked at when it was made.
    Recording,
    /// Its date is unreadable or in the future.
    ClockAhead,
    /// The wall clock went back since its last exposure.
    ClockSetBack,
    /// The computer was started since its last exposure, so that no clock proves its age.
    BeforeBoot,
}

impl Doubt {
    /// The name for metrics and messages.
    pub fn word(self) -> &'static str {
        match self {
            Self::Recording => "recording",
            Self::ClockAhead => "clock_ahead",
            Self::ClockSetBack => "clock_set_back",
            Self::BeforeBoot => "before_boot",
        }
    }
}

/// When a check was first seen, and how old it was then.
#[derive(Clone, Debug)]
pub struct Sight {
    /// Number and date of the check.
    check: (i64, String),
    /// The moment of first sight.
    seen: Moment,
    /// Age at that moment.
    age_then: Result<Duration, Doubt>,
    /// When the last exposure ended, by the wall clock; when the check was stored, if its document does not say.
    pub exposed_at: Option<Timestamp>,
}

impl Sight {
    fn new(check: &Check, exposure: Option<&LastExposure>, now: &Moment) -> Self {
        let at = exposure.map_or(&check.at, |exposure| &exposure.at);
        let exposed_at = at.parse::<Timestamp>().ok();
        Self {
            check: (check.id, check.at.clone()),
            seen: now.clone(),
            age_then: age(exposed_at, exposure.map(|exposure| &exposure.boot), now),
            exposed_at,
        }
    }

    /// Time since the last exposure.
    ///
    /// # Errors
    /// No clock proves it.
    pub fn age(&self, now: &Moment) -> Result<Duration, Doubt> {
        let since = now.boot.since(&self.seen.boot).unwrap_or(Duration::MAX);
        let by_wall = self
            .exposed_at
            .map_or(Duration::MAX, |at| wall_age(at, now));
        Ok(by_wall.max(self.age_then?.saturating_add(since)))
    }

    /// When the check becomes too old, by the wall clock at first sight.
    pub fn counts_until(&self, stale_after: Duration) -> Option<Timestamp> {
        let left = stale_after.saturating_sub(self.age_then.ok()?);
        let left = SignedDuration::try_from(left).ok()?;
        self.seen.wall.checked_add(left).ok()
    }
}

/// Time since a moment by the wall clock, zero if that is in the future.
fn wall_age(at: Timestamp, now: &Moment) -> Duration {
    now.wall
        .duration_since(at)
        .try_into()
        .unwrap_or(Duration::ZERO)
}

/// Age of an exposure at first sight.
fn age(
    exposed_at: Option<Timestamp>,
    boot: Option<&BootTime>,
    now: &Moment,
) -> Result<Duration, Doubt> {
    let exposed_at = exposed_at.ok_or(Doubt::ClockAhead)?;
    let by_wall = wall_age(exposed_at, now);
    let by_boot = match boot {
        Some(boot) => now.boot.since(boot).ok_or(Doubt::BeforeBoot)?,
        // An older program stored it.
        None => Duration::ZERO,
    };
    if by_boot > by_wall + CLOCK_TOLERANCE {
        return Err(Doubt::ClockSetBack);
    }
    match exposed_at.duration_since(now.wall) > tolerance() {
        true => Err(Doubt::ClockAhead),
        false => Ok(by_wall.max(by_boot)),
    }
}

/// Remembers when each check was first seen, and notices when the wall clock goes back.
#[derive(Clone, Debug, Default)]
pub struct Tracker {
    sights: BTreeMap<String, Sight>,
    last_look: Option<Moment>,
}

impl Tracker {
    /// Compares both clocks with those of the last look; true if the wall clock went back since. Every check that was seen before
    /// then no longer counts: the next one does.
    pub fn clock_went_back(&mut self, now: &Moment) -> bool {
        let before = self.last_look.replace(now.clone());
        let went_back = before.is_some_and(|before| {
            let passed = now.boot.since(&before.boot).unwrap_or(Duration::ZERO);
            let expected = SignedDuration::try_from(passed).unwrap_or(SignedDuration::ZERO);
            let step = now.wall.duration_since(before.wall) - expected;
            step < -tolerance()
        });
        if went_back {
            for sight in self.sights.values_mut() {
                sight.age_then = Err(Doubt::ClockSetBack);
            }
        }
        went_back
    }

    /// Sights of the last checks, in the order of the facts; none for a tool with recordings alone.
    pub(super) fn see(&mut self, facts: &Facts, now: &Moment) -> Vec<Option<Sight>> {
        let newest = facts.newest_date.as_deref();
        let newest: Option<Timestamp> = newest.and_then(|date| date.parse().ok());
        let is_behind = newest.is_some_and(|newest| newest.duration_since(now.wall) > tolerance());
        let mut sights = BTreeMap::new();
        for (checks, _) in &facts.tools {
            let Some(check) = &checks.check else { continue };
            let exposure = checks.exposure.as_ref();
            let sight = self.sights.remove(&check.tool);
            let sight = sight.filter(|sight| sight.check == (check.id, check.at.clone()));
            let sight = sight.unwrap_or_else(|| {
                let mut sight = Sight::new(check, exposure, now);
                // The clock is behind a date that this computer wrote, and the check states nothing better.
                if is_behind && exposure.is_none() && sight.age_then.is_ok() {
                    sight.age_then = Err(Doubt::ClockSetBack);
                }
                sight
            });
            sights.insert(check.tool.clone(), sight);
        }
        self.sights = sights;
        let of_tool = |checks: &flankscope_record::history::LastChecks| {
            let check = checks.check.as_ref()?;
            self.sights.get(&check.tool).cloned()
        };
        facts
            .tools
            .iter()
            .map(|(checks, _)| of_tool(checks))
            .collect()
    }
}
