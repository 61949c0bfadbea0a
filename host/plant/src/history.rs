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
    /// Commits, and its files, when it was last verified.
    verified: Option<(i64, WrittenFiles)>,
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

    /// The history, verified anew if something was committed or its files were written to since the last time; and whether that is
    /// so. What others wrote meanwhile is believed as little as what they wrote before.
    ///
    /// # Errors
    /// It cannot be read, or was changed by others than the instrument.
    pub fn verified(&mut self) -> Result<(&History, bool), HistoryError> {
        // Before the rows: what is written while they are read is seen the next time.
        let written = WrittenFiles::beside(&self.path);
        if let Some(open) = &self.open
            && let Some((commits, before)) = &open.verified
            && open.history.commits()? == *commits
        {
            if written == *before {
                return Ok((self.opened()?, false));
            }
            // Bytes that no commit announced: pages that this connection has in memory say nothing about them.
            self.open = None;
        }
        let (open, is_new) = self.current()?;
        let commits = open.history.commits()?;
        if !is_new {
            open.history.verify()?;
        }
        open.verified = Some((commits, written));
        Ok((&open.history, true))
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
                verified: None,
            },
        };
        Ok((self.open.insert(open), is_new))
    }

    /// Closes it, so that the next use opens and verifies it anew.
    pub fn close(&mut self) {
        self.open = None;
    }
}

/// When the database and its journal were last written, and their sizes. It differs after every write, also after one that no
/// commit announced, such as that of a damaged disk or another program.
#[derive(Clone, Debug, PartialEq, Eq)]
struct WrittenFiles([Option<[i64; 7]>; 2]);

impl WrittenFiles {
    fn beside(database: &Path) -> Self {
        let database = &database.canonicalize().unwrap_or_else(|_| database.into());
        let mut journal = database.as_os_str().to_owned();
        journal.push("-wal");
        let state = |path: &Path| {
            let metadata = std::fs::metadata(path).ok()?;
            let file = [metadata.dev().cast_signed(), metadata.ino().cast_signed()];
            let size = metadata.len().cast_signed();
            let times = [
                metadata.mtime(),
                metadata.mtime_nsec(),
                metadata.ctime(),
                metadata.ctime_nsec(),
            ];
            // A reader creates an empty journal.
            (size > 0).then_some([
                file[0], file[1], size, times[0], times[1], times[2], times[3],
            ])
        };
        Self([state(database), state(Path::new(&journal))])
    }
}

fn file_of(path: &Path) -> Option<[u64; 2]> {
    let metadata = std::fs::metadata(path).ok()?;
    Some([metadata.dev(), metadata.ino()])
}

/// What identifies a check in all histories: BLAKE3 of its number, its time and its document.
pub fn check_id(check: &Check, document: &str) -> String {
    let text = format!("{} {}\n{document}", check.id, check.at);
    blake3::hash(text.as_bytes()).to_hex().to_string()
}
