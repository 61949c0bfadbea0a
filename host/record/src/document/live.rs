//! What a watch says while it runs: lines of JSON on a Unix socket beside its history.
//!
//! A line is complete in itself, so that a reader may begin at any line and lose any.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use flankscope_foundation::date::Date;
use flankscope_metrology::verdict::Shown;
use flankscope_profilometry::HeadModel;
use serde::{Deserialize, Serialize};

/// Longest line of a watch, bytes: the pictures of a check take a tenth of it.
pub const MOST_LIVE_BYTES: u64 = 4 << 20;

/// Path of the socket: that of the history with `.live` after its name.
#[must_use]
pub fn live_socket(history: &Path) -> PathBuf {
    let mut name = OsString::from(history);
    name.push(".live");
    name.into()
}

/// One line.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LiveLine {
    /// What the watch does now.
    State(LiveState),
    /// Deviation maps and frames of the last check.
    Pictures(Vec<LivePicture>),
}

/// What a watch does now.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct LiveState {
    /// Name of the station.
    pub station: String,
    /// Name of the tool.
    pub tool: String,
    /// The bench is simulated.
    pub simulated: bool,
    /// Press cycles, by the controller's counter.
    pub press_cycles: u32,
    /// Press cycles from which the next check is due.
    pub due_cycles: u32,
    /// The verdict that the press is shown: go, warn, no-go, indeterminate or unchecked.
    pub shown: String,
    /// A check is running.
    pub is_checking: bool,
    /// Steps of the check that runs, else of the last one.
    pub steps: Vec<LiveStep>,
    /// When the head has to be calibrated and tested again.
    pub head: HeadDates,
    /// Checks of this watch and their frames.
    pub made: LiveCounts,
}

impl LiveState {
    /// Before the first check.
    #[must_use]
    pub fn new(station: String, tool: String, simulated: bool, head: HeadDates) -> Self {
        Self {
            station,
            tool,
            simulated,
            press_cycles: 0,
            due_cycles: 0,
            shown: Shown::Unchecked.word().into(),
            is_checking: false,
            steps: Vec::new(),
            head,
            made: LiveCounts::default(),
        }
    }
}

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

/// What a watch has done since it began.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct LiveCounts {
    /// Checks.
    pub checks: u64,
    /// Checks that were due and not made, because the press did not admit the head.
    pub missed_checks: u64,
    /// Frames triggered.
    pub frames_triggered: u64,
    /// Frames triggered that never arrived.
    pub frames_lost: u64,
    /// Views that had to be captured again.
    pub recaptured_views: u64,
}

/// A step of a check.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct LiveStep {
    /// Since the check began, ms.
    pub at_ms: u64,
    /// What began then, as the command line says it.
    pub what: String,
}

/// A picture of the last check.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct LivePicture {
    /// What it shows.
    pub caption: String,
    /// The picture as a `data:` address.
    pub image: String,
    /// Columns and rows on a screen.
    pub size_px: [f64; 2],
}
