//! What a watch says while it runs: lines of JSON on a Unix socket beside its history.
//!
//! A line is complete in itself, so that a reader may begin at any line and lose any.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use flankscope_metrology::verdict::Shown;
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
}

impl LiveState {
    /// Before the first check.
    #[must_use]
    pub fn new(station: String, tool: String, simulated: bool) -> Self {
        Self {
            station,
            tool,
            simulated,
            press_cycles: 0,
            due_cycles: 0,
            shown: Shown::Unchecked.word().into(),
            is_checking: false,
            steps: Vec::new(),
        }
    }
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
