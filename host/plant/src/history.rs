//! The history's file, kept open between looks: opening verifies every entry.

use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use flankscope_record::history::{Check, History, HistoryError};
use flankscope_record::seal::Seals;

/// A history, opened when it is needed, and again when another file stands in its place.
#[derive(Debug)]
pub struct HistoryFile {
    path: PathBuf,
    seals: Seals,
    open: Option<Opened>,
}

#[derive(Debug)]
struct Opened {
    history: History,
    /// Device and inode.
    file: Option<[u64; 2]>,
    /// Commits when it was last verified.
    commits: Option<i64>,
}

impl HistoryFile {
    /// Opens nothing yet.
    pub fn new(path: &Path, seals: Seals) -> Self {
        Self {
            path: path.into(),
            seals,
            open: None,
        }
    }

    /// The history.
    ///
    /// # Errors
    /// It cannot be read, or was changed by others than the instrument.
    pub fn opened(&mut self) -> Result<&History, HistoryError> {
        let (open, _) = self.current()?;
        Ok(&open.history)
    }

    /// The history, verified anew if something was committed since the last time; and whether that is so. What others wrote
    /// meanwhile is believed as little as what they wrote before.
    ///
    /// # Errors
    /// It cannot be read, or was changed by others than the instrument.
    pub fn verified(&mut self) -> Result<(&History, bool), HistoryError> {
        let (open, is_new) = self.current()?;
        // Before the rows: what is committed while they are read is seen the next time.
        let commits = open.history.commits()?;
        let is_changed = is_new || open.commits != Some(commits);
        if is_changed && !is_new {
            open.history.verify()?;
        }
        open.commits = Some(commits);
        Ok((&open.history, is_changed))
    }

    /// The history of the file that stands there now, and whether it was opened just now.
    fn current(&mut self) -> Result<(&mut Opened, bool), HistoryError> {
        let file = file_of(&self.path);
        let before = self.open.take().filter(|open| open.file == file);
        let is_new = before.is_none();
        let open = match before {
            Some(open) => open,
            None => Opened {
                history: History::read(&self.path, &self.seals)?,
                file,
                commits: None,
            },
        };
        Ok((self.open.insert(open), is_new))
    }

    /// Closes it, so that the next use opens and verifies it anew.
    pub fn close(&mut self) {
        self.open = None;
    }
}

fn file_of(path: &Path) -> Option<[u64; 2]> {
    let of = std::fs::metadata(path).ok()?;
    Some([of.dev(), of.ino()])
}

/// What identifies a check in all histories: BLAKE3 of its number, its time and its document.
pub fn check_id(check: &Check, document: &str) -> String {
    let text = format!("{} {}\n{document}", check.id, check.at);
    blake3::hash(text.as_bytes()).to_hex().to_string()
}
