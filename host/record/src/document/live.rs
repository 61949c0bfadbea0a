//! What a watch says while it runs: lines of JSON on a Unix socket beside its history.
//!
//! A line is complete in itself, so that a reader may begin at any line and lose any.

use std::path::{Path, PathBuf};
use std::time::Duration;

use flankscope_foundation::clock::BootTime;
use flankscope_metrology::verdict::Shown;
use flankscope_profilometry::head::HeadDates;
use serde::{Deserialize, Serialize};

use crate::beside::beside;

/// Longest line of a watch, bytes: the pictures of a check take a tenth of it.
pub const MOST_LIVE_BYTES: u64 = 4 << 20;

/// Path of the socket: that of the history with `.live` after its name.
#[must_use]
pub fn live_socket(history: &Path) -> PathBuf {
    beside(history, ".live")
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
    /// Number of the statement since the watch began, from 1; 0 of a watch that does not count.
    #[serde(default)]
    pub sequence: u64,
    /// When it was made; absent from a watch that does not say, whose statements are never taken for the present.
    #[serde(default)]
    pub said_at: Option<BootTime>,
    /// Time from then on for which it holds, ms. Without a next statement by then, what the watch does is not known.
    #[serde(default)]
    pub holds_ms: u64,
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
            sequence: 0,
            said_at: None,
            holds_ms: 0,
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

    /// Time for which it still holds; zero if it does no longer, or if no clock proves when it was made.
    #[must_use]
    pub fn valid_for(&self, now: &BootTime) -> Duration {
        let said_at = self.said_at.as_ref();
        let age = said_at.and_then(|said_at| now.since(said_at));
        let holds = Duration::from_millis(self.holds_ms);
        age.map_or(Duration::ZERO, |age| holds.saturating_sub(age))
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
