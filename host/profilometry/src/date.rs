//! Calendar days, for calibrations that carry one.

use std::fmt;
use std::str::FromStr;
use std::time::{SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

/// A day of the Gregorian calendar (UTC), written `2026-01-31` (ISO 8601).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Date {
    days_since_1970: i64,
}

/// Not a day.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("'{got}' is no day: expected year-month-day as in 2026-01-31, from 1970 to 9999")]
pub struct NoDate {
    got: String,
}

/// Days of 400 years.
const CYCLE_DAYS: i64 = 146_097;
/// From 1 March of the year 0 to 1 January 1970.
const EPOCH_DAYS: i64 = 719_468;

impl Date {
    /// The clock's day.
    pub fn today() -> Self {
        let since = SystemTime::now().duration_since(UNIX_EPOCH);
        Self::of_days(since.map_or(0, |since| since.as_secs() / 86_400))
    }

    /// The day that many days after 1 January 1970.
    #[must_use]
    pub fn of_days(days: u64) -> Self {
        Self {
            days_since_1970: i64::try_from(days).unwrap_or(i64::MAX / 2),
        }
    }

    /// The day that many days later.
    #[must_use]
    pub fn plus_days(self, days: u32) -> Self {
        Self {
            days_since_1970: self.days_since_1970 + i64::from(days),
        }
    }

    /// Years begin in March, so that the leap day is a year's last.
    fn from_civil(year: i64, month: i64, day: i64) -> Self {
        let year = if month <= 2 { year - 1 } else { year };
        let (cycle, of_cycle) = (year.div_euclid(400), year.rem_euclid(400));
        let of_year = (153 * ((month + 9) % 12) + 2) / 5 + day - 1;
        let days = of_cycle * 365 + of_cycle / 4 - of_cycle / 100 + of_year;
        Self {
            days_since_1970: cycle * CYCLE_DAYS + days - EPOCH_DAYS,
        }
    }

    fn civil(self) -> (i64, i64, i64) {
        let days = self.days_since_1970 + EPOCH_DAYS;
        let (cycle, days) = (days.div_euclid(CYCLE_DAYS), days.rem_euclid(CYCLE_DAYS));
        let of_cycle = (days - days / 1_460 + days / 36_524 - days / 146_096) / 365;
        let of_year = days - (365 * of_cycle + of_cycle / 4 - of_cycle / 100);
        let march_month = (5 * of_year + 2) / 153;
        let day = of_year - (153 * march_month + 2) / 5 + 1;
        let month = (march_month + 2) % 12 + 1;
        (cycle * 400 + of_cycle + i64::from(month <= 2), month, day)
    }
}

impl fmt::Display for Date {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (year, month, day) = self.civil();
        write!(f, "{year:04}-{month:02}-{day:02}")
    }
}

impl FromStr for Date {
    type Err = NoDate;

    fn from_str(text: &str) -> Result<Self, NoDate> {
        let bad = || NoDate {
            got: text.chars().take(30).collect(),
        };
        let mut numbers = text.splitn(3, '-').map(|part| part.parse::<u16>().ok());
        let mut next = || numbers.next().flatten().map(i64::from).ok_or_else(bad);
        let (year, month, day) = (next()?, next()?, next()?);
        let date = Self::from_civil(year, month, day);
        // 30 February is 2 March; written out it differs.
        if (1970..=9999).contains(&year) && (1..=12).contains(&month) && date.to_string() == text {
            Ok(date)
        } else {
            Err(bad())
        }
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
        ] {
            assert!(text.parse::<Date>().is_err(), "{text}");
        }
    }
}
