//! The period of an export: from one moment to another, both included. What names no zone is UTC, as the files state it.

use std::str::FromStr;

use jiff::Timestamp;
use jiff::civil::{Date, DateTime, Time};
use jiff::tz::TimeZone;

/// A moment, or a whole day in UTC.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Bound {
    Day(Date),
    Moment(Timestamp),
}

/// The text is neither a day nor a moment.
#[derive(Debug, thiserror::Error)]
#[error(
    "'{got}' is neither a day nor a moment; 2026-11-30, 2026-11-30T06:00:00 (UTC) or 2026-11-30T06:00:00+01:00 would be"
)]
pub struct NoBound {
    got: String,
}

impl FromStr for Bound {
    type Err = NoBound;

    fn from_str(text: &str) -> Result<Self, NoBound> {
        let no_bound = || NoBound { got: text.into() };
        if !text.contains(['T', 't', ' ']) {
            return text.parse().map(Self::Day).map_err(|_| no_bound());
        }
        let with_zone = text.parse().ok();
        let moment = with_zone.or_else(|| utc(text.parse().ok()?));
        moment.map(Self::Moment).ok_or_else(no_bound)
    }
}

impl Bound {
    /// Its first moment.
    fn first(self) -> Option<Timestamp> {
        match self {
            Self::Day(day) => utc(day.to_datetime(Time::midnight())),
            Self::Moment(moment) => Some(moment),
        }
    }

    /// Its last moment.
    fn last(self) -> Option<Timestamp> {
        match self {
            Self::Day(day) => utc(day.to_datetime(Time::MAX)),
            Self::Moment(moment) => Some(moment),
        }
    }
}

fn utc(at: DateTime) -> Option<Timestamp> {
    TimeZone::UTC.to_timestamp(at).ok()
}

/// Moments from which and until which checks are taken.
#[derive(Debug)]
pub struct Period {
    since: Timestamp,
    until: Timestamp,
}

impl Period {
    /// Without a bound it is open at that end.
    pub fn new(since: Option<Bound>, until: Option<Bound>) -> anyhow::Result<Self> {
        let since = since.and_then(Bound::first).unwrap_or(Timestamp::MIN);
        let until = until.and_then(Bound::last).unwrap_or(Timestamp::MAX);
        anyhow::ensure!(
            since <= until,
            "--since {since} is after --until {until}: nothing can lie between them"
        );
        Ok(Self { since, until })
    }

    pub fn holds(&self, at: Timestamp) -> bool {
        (self.since..=self.until).contains(&at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_day_is_whole_and_a_moment_has_its_zone_or_utc() {
        let period = |since: &str, until: &str| {
            let bound = |text: &str| text.parse().unwrap();
            Period::new(Some(bound(since)), Some(bound(until))).unwrap()
        };
        let at = |text: &str| text.parse().unwrap();
        let november = period("2026-11-01", "2026-11-30");
        for (text, inside) in [
            ("2026-10-31T23:59:59.999Z", false),
            ("2026-11-01T00:00:00Z", true),
            ("2026-11-30T23:59:59.999Z", true),
            ("2026-12-01T00:00:00Z", false),
        ] {
            assert_eq!(november.holds(at(text)), inside, "{text}");
        }
        let shift = period("2026-11-30T06:00:00+01:00", "2026-11-30T14:00:00");
        for (text, inside) in [
            ("2026-11-30T04:59:59Z", false),
            ("2026-11-30T05:00:00Z", true),
            ("2026-11-30T14:00:00Z", true),
            ("2026-11-30T14:00:01Z", false),
        ] {
            assert_eq!(shift.holds(at(text)), inside, "{text}");
        }
        for text in [
            "",
            "yesterday",
            "2026-13-01",
            "2026-11-30T25:00:00",
            "30.11.2026",
        ] {
            let error = text.parse::<Bound>().unwrap_err().to_string();
            assert!(error.contains("2026-11-30"), "{error}");
        }
    }
}
