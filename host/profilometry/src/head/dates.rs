//! When a head has to be calibrated and tested again.

use flankscope_foundation::date::Date;
use serde::{Deserialize, Serialize};

use super::HeadModel;

/// A calibration that expires within this many days should be renewed.
const RENEWED_DAYS_BEFORE: u32 = 14;
/// A self-test is announced this many days before it is due.
const TESTED_DAYS_BEFORE: u32 = 1;

/// When a head has to be calibrated and tested again; absent for a head that never was.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct HeadDates {
    /// Last day on which its calibration judges.
    pub calibration_expires: Option<Date>,
    /// Day on which its self-test is due.
    pub self_test_due: Option<Date>,
}

impl HeadDates {
    /// The dates in a head's file.
    #[must_use]
    pub fn of(head: &HeadModel) -> Self {
        Self {
            calibration_expires: head.calibration.as_ref().map(|made| made.expires),
            self_test_due: head.self_test.as_ref().map(|test| test.due),
        }
    }

    /// Whether the calibration should be renewed on this day.
    #[must_use]
    pub fn is_calibration_due(&self, today: Date) -> bool {
        let soon = today.plus_days(RENEWED_DAYS_BEFORE);
        self.calibration_expires
            .is_some_and(|expires| expires < soon)
    }

    /// Whether the self-test should be made on this day.
    #[must_use]
    pub fn is_self_test_due(&self, today: Date) -> bool {
        let soon = today.plus_days(TESTED_DAYS_BEFORE);
        self.self_test_due.is_some_and(|due| due <= soon)
    }
}
