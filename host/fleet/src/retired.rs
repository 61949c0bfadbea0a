//! Marks of checks that retention removed on purpose. They are small objects whose names say everything, so that what is missing
//! without a mark is a loss.

use std::fmt;

use crate::name::FileName;
use crate::rows::Stream;

/// Checks before `kept` were removed on purpose.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Retired {
    pub stream: Stream,
    /// Number of the first check that was kept.
    pub kept: i64,
}

impl Retired {
    /// Folder of the marks; readers of Parquet pass over names that begin with `_`.
    pub const FOLDER: &'static str = "_retired";

    /// Reads a name, below the lake's root.
    #[must_use]
    pub fn parse(path: &str) -> Option<Self> {
        let name = path.strip_prefix(Self::FOLDER)?.strip_prefix('/')?;
        let words: Vec<&str> = name.split('-').collect();
        let &[history, epoch, kept] = &words[..] else {
            return None;
        };
        let retired = Self {
            stream: Stream {
                history: history.to_owned(),
                epoch: epoch.to_owned(),
            },
            kept: kept.parse().ok()?,
        };
        (retired.to_string() == path).then_some(retired)
    }
}

impl fmt::Display for Retired {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { stream, kept } = self;
        let folder = Self::FOLDER;
        write!(f, "{folder}/{}-{}-{kept:010}", stream.history, stream.epoch)
    }
}

/// Number of the first check of a history that is to be in the lake: 1, or behind what was removed on purpose.
#[must_use]
pub fn first_kept(retired: &[Retired], stream: &Stream) -> i64 {
    let marks = retired.iter().filter(|mark| mark.stream == *stream);
    marks.map(|mark| mark.kept).max().unwrap_or(1)
}

/// The names without those of checks that were removed on purpose, whose files may still be there.
pub fn kept(names: impl IntoIterator<Item = FileName>, retired: &[Retired]) -> Vec<FileName> {
    let kept = |name: &FileName| name.range.last >= first_kept(retired, &name.range.stream);
    names.into_iter().filter(kept).collect()
}
