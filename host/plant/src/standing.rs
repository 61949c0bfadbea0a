//! What stands at a station: of every tool the last check, its age, and whether its verdict still counts.

use std::sync::Arc;

use flankscope_metrology::verdict::Word;
use flankscope_record::history::{Check, FlankRow};
use flankscope_record::seal::StandingNoGo;
use jiff::Timestamp;

/// The station as its history shows it at one moment.
#[derive(Clone, Debug, Default)]
pub struct Standing {
    /// Tools, the most recently checked first.
    pub tools: Vec<ToolStanding>,
    /// Why the history cannot be read, if it cannot: then nothing counts.
    pub fault: Option<Arc<str>>,
    /// Age from which a verdict no longer counts, s.
    pub stale_after_s: u32,
}

/// A tool's last check.
#[derive(Clone, Debug)]
pub struct ToolStanding {
    pub last: Arc<Check>,
    /// The newest no-go of this tool that is not acknowledged.
    pub latched: Option<StandingNoGo>,
    /// Checks by verdict.
    pub counts: Vec<(Word, u64)>,
}

/// What a tool's last verdict is worth now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Worth {
    /// It counts.
    Counts,
    /// It is too old.
    Stale,
    /// The history cannot be read, or its clock is ahead of this one.
    Unknown,
}

impl Standing {
    /// Age of a tool's last check, s; none if its date is in the future or unreadable.
    pub fn age_s(&self, tool: &ToolStanding, now: Timestamp) -> Option<u64> {
        let at: Timestamp = tool.last.at.parse().ok()?;
        let age_ms = now.as_millisecond() - at.as_millisecond();
        u64::try_from(age_ms).ok().map(|age_ms| age_ms / 1000)
    }

    /// What a tool's last verdict is worth.
    pub fn worth(&self, tool: &ToolStanding, now: Timestamp) -> Worth {
        match self.age_s(tool, now) {
            _ if self.fault.is_some() => Worth::Unknown,
            None => Worth::Unknown,
            Some(age_s) if age_s > u64::from(self.stale_after_s) => Worth::Stale,
            Some(_) => Worth::Counts,
        }
    }

    /// The verdict that stands for a tool now: a no-go however old it is, and while one is latched; every other verdict only while
    /// it counts.
    pub fn verdict(&self, tool: &ToolStanding, now: Timestamp) -> Option<Word> {
        let verdict = tool.last.verdict;
        if tool.latched.is_some() || verdict == Word::NoGo {
            return Some(Word::NoGo);
        }
        (self.worth(tool, now) == Worth::Counts).then_some(verdict)
    }
}

/// The flank with the most wear in a check, if any was measured.
pub fn most_worn(check: &Check) -> Option<&FlankRow> {
    let measured = check
        .flanks
        .iter()
        .filter_map(|flank| Some((flank.wear_um?, flank)));
    measured
        .max_by(|(a, _), (b, _)| a.total_cmp(b))
        .map(|(_, flank)| flank)
}
