//! The safety word: what the press, the files and the exit code get to know of a verdict.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// A verdict without its reason, in ascending severity: of several, the greatest counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Word {
    /// Wear is below the warning limit.
    Go,
    /// Wear is below the stop limit, but not below the warning limit.
    Warn,
    /// Nothing can be said.
    Indeterminate,
    /// Wear exceeds the stop limit.
    NoGo,
}

/// Not a verdict.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{got:?} is no verdict; go, warn, no-go and indeterminate are")]
pub struct UnknownWord {
    got: String,
}

impl Word {
    /// All of them, in ascending severity.
    pub const ALL: [Self; 4] = [Self::Go, Self::Warn, Self::Indeterminate, Self::NoGo];

    /// As tables and files have it.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Go => "go",
            Self::Warn => "warn",
            Self::Indeterminate => "indeterminate",
            Self::NoGo => "no-go",
        }
    }

    /// The process exit code.
    pub const fn exit_code(self) -> u8 {
        match self {
            Self::Go => 0,
            Self::NoGo => 1,
            Self::Indeterminate => 2,
            Self::Warn => 4,
        }
    }

    /// Whether the verdict lets the press continue: go or warn.
    pub const fn passes(self) -> bool {
        matches!(self, Self::Go | Self::Warn)
    }
}

impl fmt::Display for Word {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl FromStr for Word {
    type Err = UnknownWord;

    fn from_str(text: &str) -> Result<Self, UnknownWord> {
        let known = Self::ALL.into_iter().find(|word| word.as_str() == text);
        known.ok_or_else(|| UnknownWord { got: text.into() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_word_is_the_same_in_text_and_json_and_no_other_text_is_one() {
        for word in Word::ALL {
            assert_eq!(word.as_str().parse(), Ok(word));
            let json = serde_json::to_string(&word).unwrap();
            assert_eq!(json, format!("\"{word}\""));
            assert_eq!(serde_json::from_str::<Word>(&json).unwrap(), word);
        }
        for text in ["", "GO", "nogo", "go ", "unchecked"] {
            assert!(text.parse::<Word>().is_err(), "{text:?}");
            assert!(serde_json::from_str::<Word>(&format!("{text:?}")).is_err());
        }
    }

    #[test]
    fn only_go_ends_in_zero_and_every_word_in_its_own_code() {
        assert_eq!(Word::ALL.map(Word::exit_code), [0, 4, 2, 1]);
        assert_eq!(Word::ALL.map(Word::passes), [true, true, false, false]);
        assert!(Word::ALL.is_sorted(), "in order of severity");
    }
}
