//! Calendar days and moments, ISO 8601 in UTC.

use std::fmt;
use std::str::FromStr;

use jiff::tz::TimeZone;
use jiff::{Timestamp, ToSpan, civil};
use serde::{Deserialize, Serialize};

/// A day of the Gregorian calendar (UTC), written `2026-01-31`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Date(civil::Date);

/// Not a day.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("'{got}' is no day: expected year-month-day as in 2026-01-31, from 1970 to 9999")]
pub struct NoDate {
    got: String,
}

impl Date {
    /// The clock's day.
    #[must_use]
    pub fn today() -> Self {
        Self(Timestamp::now().to_zoned(TimeZone::UTC).date())
    }

    /// The day that many days later, at most the last of 9999.
    #[must_use]
    pub fn plus_days(self, days: u32) -> Self {
        // A span of days is bounded; any that exceeds it ends beyond 9999 anyway.
        let span = i64::from(days).min(4_000_000).days();
        Self(self.0.saturating_add(span))
    }

    /// When the day begins, seconds since 1970 (UTC).
    #[must_use]
    pub fn begins_s(self) -> i64 {
        self.0.duration_since(civil::date(1970, 1, 1)).as_secs()
    }
}

/// This moment by the host's clock: ISO 8601, UTC, to the second.
#[must_use]
pub fn now() -> String {
    moment(Timestamp::now().as_second())
}

/// The moment that long before this one, by the host's clock: ISO 8601, UTC, to the millisecond; the beginning of 1970 if it is before that.
#[must_use]
pub fn before_now(age: std::time::Duration) -> String {
    let age_ms = i64::try_from(age.as_millis()).unwrap_or(i64::MAX);
    let ms = Timestamp::now().as_millisecond().saturating_sub(age_ms);
    let moment = Timestamp::from_millisecond(ms.max(0)).unwrap_or(Timestamp::UNIX_EPOCH);
    format!("{moment:.3}")
}

fn moment(since_1970_s: i64) -> String {
    Timestamp::from_second(since_1970_s)
        .unwrap_or(Timestamp::UNIX_EPOCH)
        .to_string()
}

impl fmt::Display for Date {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl FromStr for Date {
    type Err = NoDate;

    fn from_str(text: &str) -> Result<Self, NoDate> {
        // The parser takes other forms of ISO 8601 too, moments among them: a file's day has one form.
        text.parse()
            .ok()
            .filter(|date: &civil::Date| date.year() >= 1970 && date.to_string() == text)
            .map(Self)
            .ok_or_else(|| NoDate {
                got: text.chars().take(30).collect(),
            })
    }
}

impl TryFrom<String> for Date {
    type Error = NoDate;

    fn try_from(text: String) -> Result<Self, NoDate> {
        text.parse()
    }
}

impl From<Date> for String {
    fn from(date: Date) -> Self {
        date.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against counting day by day with the rule of leap years.
    #[test]
    fn days_are_counted_like_a_calendar() {
        let mut at = "1970-01-01".parse::<Date>().unwrap();
        for year in 1970..2405 {
            let leap = year % 4 == 0 && (year % 100 != 0 || year % 400 == 0);
            let february = if leap { 29 } else { 28 };
            for (month, days) in [31, february, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31]
                .into_iter()
                .enumerate()
            {
                for day in 1..=days {
                    let text = format!("{year:04}-{:02}-{day:02}", month + 1);
                    assert_eq!(at.to_string(), text);
                    assert_eq!(text.parse(), Ok(at));
                    at = at.plus_days(1);
                }
            }
        }
    }

    #[test]
    fn moments_are_written_in_utc() {
        assert_eq!(moment(0), "1970-01-01T00:00:00Z");
        assert_eq!(moment(951_827_696), "2000-02-29T12:34:56Z");
        assert_eq!(moment(4_102_444_799), "2099-12-31T23:59:59Z");
    }

    #[test]
    fn no_day_follows_the_last() {
        let last: Date = "9999-12-31".parse().unwrap();
        assert_eq!(last.plus_days(1), last);
        assert_eq!(
            "2026-01-31".parse::<Date>().unwrap().plus_days(u32::MAX),
            last
        );
    }

    #[test]
    fn what_is_no_day_is_refused() {
        for text in [
            "",
            "2026",
            "2026-13-01",
            "2026-02-30",
            "2026-1-31",
            "26-01-31",
            "2026-01-31x",
            "1969-12-31",
            "20260131",
            "2026-01-31T00:00:00",
        ] {
            assert!(text.parse::<Date>().is_err(), "{text}");
        }
    }
}
