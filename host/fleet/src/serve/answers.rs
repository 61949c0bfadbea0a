//! Rows of the questions that the page asks.

use jiff::Timestamp;
use serde::{Deserialize, Deserializer};

/// A flank, or a patch of a surface that has no teeth.
#[derive(Clone, Debug, Deserialize)]
pub struct FlankName {
    tooth: Option<i64>,
    flank: Option<String>,
    patch: Option<String>,
}

impl std::fmt::Display for FlankName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match (&self.patch, self.tooth, &self.flank) {
            (Some(patch), ..) => f.write_str(patch),
            (None, Some(tooth), Some(flank)) => write!(f, "tooth {tooth} {flank}"),
            _ => f.write_str("—"),
        }
    }
}

/// The last check of a station, with the flank that is nearest to its limit.
#[derive(Clone, Debug, Deserialize)]
pub struct LastCheck {
    pub station: String,
    /// `recorded frames` or `recorded clouds` if nothing was measured at the press.
    pub link: String,
    #[serde(flatten)]
    pub check: CheckRow,
    /// Whether the lake had it once, and has nothing of the station any more.
    #[serde(skip)]
    pub is_gone: bool,
}

/// A check, with the flank that is nearest to its limit.
#[derive(Clone, Debug, Deserialize)]
pub struct CheckRow {
    pub simulated: bool,
    pub history: String,
    pub epoch: String,
    pub check_number: i64,
    pub date: String,
    #[serde(deserialize_with = "time")]
    pub stored_at: Timestamp,
    pub tool: String,
    pub serial: Option<String>,
    pub tool_cycles: i64,
    pub check_verdict: String,
    pub reason: String,
    #[serde(flatten)]
    pub nearest: FlankName,
    pub wear_um: Option<f64>,
    pub u95_um: Option<f64>,
    pub limit_um: Option<f64>,
}

/// A flank of a check.
#[derive(Clone, Debug, Deserialize)]
pub struct FlankRow {
    #[serde(flatten)]
    pub check: CheckRow,
    pub warn_um: Option<f64>,
    pub verdict: Option<String>,
    pub code: Option<String>,
}

/// A row of `dies-by-strokes-left`.
#[derive(Clone, Debug, Deserialize)]
pub struct Die {
    pub station: String,
    pub tool: String,
    pub serial: Option<String>,
    #[serde(flatten)]
    pub flank: FlankName,
    pub simulated: bool,
    #[serde(deserialize_with = "time")]
    pub last_check: Timestamp,
    pub now_um: Option<f64>,
    pub limit_um: Option<f64>,
    pub strokes_left: Option<f64>,
    pub at_least: Option<f64>,
    pub why_not: Option<String>,
}

/// A row of `stations-unlike-the-others`.
#[derive(Clone, Debug, Deserialize)]
pub struct Unlike {
    pub station: String,
    pub simulated: bool,
    pub dies: i64,
    pub flanks: i64,
    pub difference_um: Option<f64>,
    pub expanded_um: Option<f64>,
    pub u95_um: Option<f64>,
    pub beyond_expanded: Option<bool>,
    pub beyond_u95: Option<bool>,
}

fn time<'de, D: Deserializer<'de>>(of: D) -> Result<Timestamp, D::Error> {
    let text = String::deserialize(of)?;
    text.parse().map_err(serde::de::Error::custom)
}
