//! From figures with uncertainty to a verdict.
//!
//! ```text
//!  figure, uncertainty, limits ─► rule ─► flank ─► policy: all flanks, what speaks against ─► word ─► latch ─► press
//!                                   └── reason: why nothing can be said
//! ```
//!
//! | file | holds |
//! |---|---|
//! | `word` | the four words in order of severity, with their exit codes |
//! | `reason` | reasons for the verdict indeterminate, each with its code in files and its remedy |
//! | `rule` | one figure against its limits, with a guard band |
//! | `flank` | all figures of a flank, and what forbids a verdict on it |
//! | `class` | all quantities of a gear against the tolerances of a class |
//! | `policy` | several verdicts to one, and what is left of one that something speaks against |
//! | `latch` | a row of words to what is shown at the press |
//!
//! Whatever is missing, late, partial, unsure or not finite is *indeterminate*, never *go*. Words become text at the borders
//! alone: JSON, database, command line.

mod class;
pub mod flank;
mod latch;
mod policy;
mod reason;
mod rule;
mod word;

pub use class::holds_class;
pub use latch::{Latch, Shown};
pub use policy::{Undecided, combine};
pub use reason::{Code, Reason, UnknownCode};
pub use rule::{PROBABILITY, Rule, decide, decide_parts, repeating_could_decide};
pub use word::{UnknownWord, Word};

/// Verdict of the instrument on a flank, a tooth or a die.
#[derive(Debug, Clone, PartialEq)]
pub enum Verdict {
    /// Wear is below the warning limit.
    Go,
    /// Wear is below the stop limit, but not below the warning limit.
    Warn,
    /// Wear exceeds the stop limit.
    NoGo,
    /// Nothing can be said.
    Indeterminate {
        /// Reason.
        reason: Reason,
    },
}

impl Verdict {
    /// The word for press, tables and files.
    pub fn word(&self) -> Word {
        match self {
            Self::Go => Word::Go,
            Self::Warn => Word::Warn,
            Self::NoGo => Word::NoGo,
            Self::Indeterminate { .. } => Word::Indeterminate,
        }
    }

    /// Reason of an indeterminate verdict; none for the others.
    pub fn reason(&self) -> Option<&Reason> {
        match self {
            Self::Indeterminate { reason } => Some(reason),
            Self::Go | Self::Warn | Self::NoGo => None,
        }
    }
}

impl std::fmt::Display for Verdict {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.word().fmt(f)
    }
}
