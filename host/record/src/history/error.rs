//! Errors of a history.

use std::path::PathBuf;

use crate::origin::looked_at;
use crate::seal::StandingNoGo;

/// Why a history cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum HistoryError {
    /// SQLite returns an error: no permission, disk full, damaged, locked for too long.
    #[error("history {}: cannot {doing}: {source}", path.display())]
    Database {
        /// The file.
        path: PathBuf,
        /// Operation that failed.
        doing: &'static str,
        /// Cause.
        source: rusqlite::Error,
    },
    #[error(
        "{} is a database, but no history of this instrument (application id {got:#x}, right would be {expected:#x}); name another file", path.display()
    )]
    Foreign {
        /// The file.
        path: PathBuf,
        got: i32,
        expected: i32,
    },
    /// The file was written by a release with another table layout.
    #[error(
        "history {} has layout {got}, this release reads and writes layout {expected}; use the release that wrote it", path.display()
    )]
    Layout {
        /// The file.
        path: PathBuf,
        /// Layout version of the file.
        got: i32,
        /// Layout version of this release.
        expected: i32,
    },
    /// Simulated and real checks are never stored in one history.
    #[error(
        "history {} holds checks of {} since {since}, this is {}: name another file by --history, or the --link that it was begun with",
        path.display(), looked_at(*simulated), looked_at(!simulated)
    )]
    OtherKind {
        /// The file.
        path: PathBuf,
        /// Whether the checks in it are of the simulated bench.
        simulated: bool,
        /// Date of its first check.
        since: String,
    },
    /// A stored document is not JSON, or lacks a required entry.
    #[error("the stored document of check {id} cannot be read: {source}")]
    Stored {
        id: i64,
        /// Cause.
        source: serde_json::Error,
    },
    #[error("history {}: the result cannot be written as JSON: {source}", path.display())]
    Document {
        /// The file.
        path: PathBuf,
        /// Cause.
        source: serde_json::Error,
    },
    /// Phasors cannot be written or read.
    #[error("phasors {}: {source}", path.display())]
    Phasors {
        /// The file.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// Phasors differ from those that were stored.
    #[error("phasors {} are damaged: their BLAKE3 is {got}, stored was {expected}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// BLAKE3 of the file.
        got: String,
        /// BLAKE3 in the check.
        expected: String,
    },
    /// Rows were changed, added or removed.
    #[error("history {}: {why}. If it is right as it is: flankscope trust {} --name WHO", path.display(), path.display())]
    Broken {
        /// The file.
        path: PathBuf,
        /// What is wrong, and where.
        why: String,
    },
    /// The file is missing, and its unacknowledged no-go with it.
    #[error("history {} is gone, and with it a no-go that nobody has acknowledged ({stands}). If it was removed on purpose: flankscope trust {} --name WHO", path.display(), path.display())]
    Gone {
        /// The file.
        path: PathBuf,
        /// Die and time of the no-go.
        stands: Box<StandingNoGo>,
    },
    /// Another history of this station has an unacknowledged no-go for the die.
    #[error("history {}: a no-go that nobody has acknowledged stands against this die ({stands}) in {}: acknowledge it in a watch with --history {}, or if that file was removed on purpose: flankscope trust {} --name WHO", path.display(), elsewhere.display(), elsewhere.display(), elsewhere.display())]
    StandsElsewhere {
        /// The file.
        path: PathBuf,
        /// File of the other history.
        elsewhere: PathBuf,
        /// Die and time of the no-go.
        stands: Box<StandingNoGo>,
    },
    /// A person acknowledged a no-go that does not stand, or not as the newest of its die.
    #[error("history {}: check {check} is not a no-go that stands: it was acknowledged already, or a newer one of this die stands; look again", path.display())]
    NotStanding {
        /// The file.
        path: PathBuf,
        /// Number of the check.
        check: i64,
    },
    /// A no-go was stored after the check that the person saw.
    #[error("history {}: a newer no-go stands ({newest}) than check {seen}, which was acknowledged: look again", path.display())]
    NewerNoGo {
        /// The file.
        path: PathBuf,
        /// The newest check that the person saw.
        seen: i64,
        newest: Box<StandingNoGo>,
    },
    #[error("history {} has {names} names (hard links): SQLite and other watches know a file by its name; leave it one, and copy it with sqlite3 {} \".backup COPY\"", path.display(), path.display())]
    SeveralNames {
        /// One of the names.
        path: PathBuf,
        /// Number of names.
        names: u64,
    },
    /// The path is a folder, pipe or device.
    #[error("history {}: not a regular file", path.display())]
    NoFile { path: PathBuf },
    /// Another watch already runs on the die.
    #[error("history {}: {tool} is watched by {who} since {since}; one watch at a time holds a die. Dies of one design are told apart by `serial` in their tool files", path.display())]
    Held {
        /// The file.
        path: PathBuf,
        tool: String,
        /// Process that watches it.
        who: String,
        /// Since when.
        since: String,
    },
    /// Whether another watch runs on the die cannot be determined.
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
    /// The head file has no digest, but the history knows a signed head of this name.
    #[error(
        "head {head}: check {id} of {at} was made with a signed head of this name, and this file carries no digest: it was taken off, or it is another head. If it is right as it is: flankscope trust HEAD.toml --name WHO"
    )]
    Stripped {
        head: String,
        id: i64,
        /// Time of the check.
        at: String,
    },
    /// The check does not exist.
    #[error("history {} has no check {id}; it has {}", path.display(), match last {
        Some(last) => format!("checks up to {last}"),
        None => "none".to_owned(),
    })]
    NoSuchCheck {
        /// The file.
        path: PathBuf,
        /// Requested number.
        id: i64,
        /// Last number in the history.
        last: Option<i64>,
    },
}
