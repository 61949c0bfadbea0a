//! Why the shared memory of a station has no private place.

use std::io;
use std::path::PathBuf;

/// Why there is no private place.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RootError {
    /// The folder cannot be made or cleaned.
    #[error(
        "cannot prepare the private folder {}: {source} (choose another place with TMPDIR)", path.display()
    )]
    Folder {
        /// The folder.
        path: PathBuf,
        /// The operating system's word.
        source: io::Error,
    },
    /// In the temporary folder, others may put another folder in place of this user's.
    #[error(
        "{} is of user {uid} with mode {mode:o}: others may exchange folders in it; right would be a folder of root or of this user, sticky where others may write (chmod +t). Choose another with TMPDIR", path.display()
    )]
    Exchangeable {
        /// The temporary folder.
        path: PathBuf,
        /// Its owner.
        uid: u32,
        /// Its mode.
        mode: u32,
    },
    /// The library's sockets have longer names than the system takes.
    #[error(
        "{} has {} characters, at most {LONGEST_BASE} leave room for the names of sockets below it; choose a shorter place with TMPDIR or XDG_RUNTIME_DIR", path.display(), path.as_os_str().len()
    )]
    Long {
        /// The base folder.
        path: PathBuf,
    },
    /// The root of another process is not there any more.
    #[error("the host that made {} is gone: {source}", path.display())]
    Gone {
        /// The folder.
        path: PathBuf,
        /// The operating system's word.
        source: io::Error,
    },
    /// The library's files of each of several fresh roots were spoiled.
    #[error(
        "shared memory cannot be used, with {tries} unforeseeable names in a row: {reason}{}",
        culprits(culprit)
    )]
    Spoiled {
        /// Roots that were tried.
        tries: u32,
        /// The library's own reason, for the last of them.
        reason: String,
        /// Files there that somebody else could write to.
        culprit: String,
    },
}

fn culprits(files: &str) -> String {
    if files.is_empty() {
        String::new()
    } else {
        format!("; others may write to {files}")
    }
}

/// Characters of a base below which the longest name of a socket still fits into the 108 that a `sockaddr_un` has.
pub(crate) const LONGEST_BASE: usize = 34;
