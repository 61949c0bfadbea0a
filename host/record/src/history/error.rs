//! What can be wrong with a history.

use std::path::PathBuf;

use crate::origin::looked_at;
use crate::seal::StandingNoGo;

/// Why a history cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum HistoryError {
    /// The database refuses: no permission, disk full, damaged, locked for too long.
    #[error("history {}: cannot {doing}: {source}", path.display())]
    Database {
        /// The file.
        path: PathBuf,
        /// What was tried.
        doing: &'static str,
        /// Cause.
        source: rusqlite::Error,
    },
    /// Somebody else's file.
    #[error(
        "{} is a database, but no history of this instrument (application id {got:#x}, right would be {expected:#x}); name another file", path.display()
    )]
    Foreign {
        /// The file.
        path: PathBuf,
        /// Its application id.
        got: i32,
        /// A history's.
        expected: i32,
    },
    /// Written by another release.
    #[error(
        "history {} has layout {got}, this release reads and writes layout {expected}; use the release that wrote it", path.display()
    )]
    Layout {
        /// The file.
        path: PathBuf,
        /// Its layout.
        got: i32,
        /// This release's.
        expected: i32,
    },
    /// Simulated checks and real ones never share a history.
    #[error(
        "history {} holds checks of {} since {since}, this is {}: name another file by --history, or the --link that it was begun with",
        path.display(), looked_at(*simulated), looked_at(!simulated)
    )]
    OtherKind {
        /// The file.
        path: PathBuf,
        /// Whether the checks in it are of the simulated bench.
        simulated: bool,
        /// When it was begun.
        since: String,
    },
    /// A stored document that is no JSON, or lacks what is read of it.
    #[error("the stored document of check {id} cannot be read: {source}")]
    Stored {
        /// Check.
        id: i64,
        /// Cause.
        source: serde_json::Error,
    },
    /// A result that cannot be put into words.
    #[error("history {}: the result cannot be written as JSON: {source}", path.display())]
    Document {
        /// The file.
        path: PathBuf,
        /// Cause.
        source: serde_json::Error,
    },
    /// Phasors that cannot be written or read.
    #[error("phasors {}: {source}", path.display())]
    Phasors {
        /// The file.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// Phasors that are not what was stored.
    #[error("phasors {} are damaged: their BLAKE3 is {got}, stored was {expected}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Of the file.
        got: String,
        /// Of the check.
        expected: String,
    },
    /// Rows that are not what was written, or are not there.
    #[error("history {}: {why}. If it is right as it is: flankscope trust {} --name WHO", path.display(), path.display())]
    Broken {
        /// The file.
        path: PathBuf,
        /// What is wrong, and where.
        why: String,
    },
    /// The file is gone, and with it a no-go that nobody acknowledged.
    #[error("history {} is gone, and with it a no-go that nobody has acknowledged ({stands}). If it was removed on purpose: flankscope trust {} --name WHO", path.display(), path.display())]
    Gone {
        /// The file.
        path: PathBuf,
        /// Against which die, and when.
        stands: Box<StandingNoGo>,
    },
    /// A no-go stands against the die in another history of this station.
    #[error("history {}: a no-go that nobody has acknowledged stands against this die ({stands}) in {}: acknowledge it in a watch with --history {}, or if that file was removed on purpose: flankscope trust {} --name WHO", path.display(), elsewhere.display(), elsewhere.display(), elsewhere.display())]
    StandsElsewhere {
        /// The file.
        path: PathBuf,
        /// The other one.
        elsewhere: PathBuf,
        /// Against which die, and when.
        stands: Box<StandingNoGo>,
    },
    /// A file with more than one name.
    #[error("history {} has {names} names (hard links): SQLite and other watches know a file by its name; leave it one, and copy it with sqlite3 {} \".backup COPY\"", path.display(), path.display())]
    SeveralNames {
        /// One of them.
        path: PathBuf,
        /// How many.
        names: u64,
    },
    /// A folder, pipe or device.
    #[error("history {}: not a regular file", path.display())]
    NoFile {
        /// What it is called.
        path: PathBuf,
    },
    /// Another watch holds the die.
    #[error("history {}: {tool} is watched by {who} since {since}; one watch at a time holds a die. Dies of one design are told apart by `serial` in their tool files", path.display())]
    Held {
        /// The file.
        path: PathBuf,
        /// The tool there.
        tool: String,
        /// Who watches it.
        who: String,
        /// Since when.
        since: String,
    },
    /// Whether another watch holds the die cannot be told.
    #[error("{}: {source}", path.display())]
    Watches {
        /// Folder of the locks.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// The station's key or memory cannot be used.
    #[error(transparent)]
    Seal(#[from] crate::seal::SealError),
    /// A head without a digest where the history knows a signed one of its name.
    #[error(
        "head {head}: check {id} of {at} was made with a signed head of this name, and this file carries no digest: it was taken off, or it is another head. If it is right as it is: flankscope trust HEAD.toml --name WHO"
    )]
    Stripped {
        /// Name of the head.
        head: String,
        /// The check.
        id: i64,
        /// When.
        at: String,
    },
    /// No such check.
    #[error("history {} has no check {id}; it has {}", path.display(), match last {
        Some(last) => format!("checks up to {last}"),
        None => "none".to_owned(),
    })]
    NoSuchCheck {
        /// The file.
        path: PathBuf,
        /// Asked for.
        id: i64,
        /// Last one there.
        last: Option<i64>,
    },
}
