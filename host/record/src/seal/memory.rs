//! The station's memory, in the folder of its key: trusted files, where signed heads were written, and how far each history was written.

use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use flankscope_foundation::files::{
    MOST_DOCUMENT_BYTES, hash, read_regular, read_text, write_whole,
};
use flankscope_foundation::seal::Seal;
use rustix::fs::{FlockOperation, flock};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::{Kind, SealError, Seals, Standing};
use crate::die::DieKey;

const TRUSTED: &str = "trusted.jsonl";
const SIGNED: &str = "signed.jsonl";
const HISTORIES: &str = "histories";
/// File names in [`HISTORIES`]: the anchor of a history by its id, and the history that is at a path.
const HISTORY: &str = "history";
const PLACE: &str = "place";
/// Longest wait for other processes of the station.
const PATIENCE: Duration = Duration::from_secs(2);

/// A file that a person declared to be trusted.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct TrustEntry {
    /// Digest of its content, with this station's key.
    pub digest: String,
    /// Kind of file.
    pub what: String,
    /// Its path at that time.
    pub file: PathBuf,
    /// Name of the person.
    pub by: String,
    pub date: String,
}

#[derive(Serialize, Deserialize)]
struct SignedHead {
    file: PathBuf,
    date: String,
}

/// How far a history has been written, independent of its file name: a copy that is behind is refused wherever it is.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Anchor {
    /// Id of the history.
    pub id: String,
    /// Path at which this station last wrote to it.
    pub file: PathBuf,
    /// Number of the last link of its chain.
    pub link: i64,
    /// Digest of that link.
    pub digest: String,
    /// Whether its checks are simulated; `None` while it has no check.
    pub simulated: Option<bool>,
    /// Unacknowledged no-gos, the newest of each die.
    pub stands: Vec<StandingNoGo>,
}

/// An unacknowledged no-go.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct StandingNoGo {
    #[serde(flatten)]
    pub die: DieKey,
    /// Number of the check.
    pub check: i64,
    /// When it was stored.
    pub at: String,
}

impl std::fmt::Display for StandingNoGo {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}, check {} of {}", self.die.tool, self.check, self.at)
    }
}

/// Id of the history that was last written at a path.
#[derive(Serialize, Deserialize)]
struct Place {
    file: PathBuf,
    id: String,
}

/// A lock, held while a history and the station's memory of it are changed together.
#[derive(Debug)]
pub struct Alone {
    _lock: Option<std::fs::File>,
}

/// The canonical path, whether the file exists or not.
fn place(path: &Path) -> PathBuf {
    let folder = match path.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    };
    let folder = folder
        .canonicalize()
        .unwrap_or_else(|_| folder.to_path_buf());
    folder.join(path.file_name().unwrap_or_default())
}

fn lines<T: DeserializeOwned>(path: &Path) -> Result<Vec<T>, SealError> {
    let failed = |source| SealError::Memory {
        path: path.to_owned(),
        source,
    };
    let text = match read_text(path) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        text => text.map_err(failed)?,
    };
    // The last line may be cut short by a power failure; it was not yet in use then.
    Ok(text
        .lines()
        .filter_map(|line| serde_json::from_str(line).ok())
        .collect())
}

impl Seals {
    fn append(&self, name: &str, line: &impl Serialize) -> Result<(), SealError> {
        let Some(folder) = &self.folder else {
            return Err(SealError::NoPlace);
        };
        let path = folder.join(name);
        let append = |text: String| {
            let mut file = std::fs::OpenOptions::new()
                .create(true)
                .append(true)
                .open(&path)?;
            file.write_all(text.as_bytes())?;
            file.sync_all()
        };
        append(serde_json::to_string(line)? + "\n").map_err(|source| SealError::Memory {
            path: path.clone(),
            source,
        })
    }

    /// All trusted files.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn all_trusted(&self) -> Result<Vec<TrustEntry>, SealError> {
        let Some(folder) = &self.folder else {
            return Ok(Vec::new());
        };
        lines(&folder.join(TRUSTED))
    }

    pub(super) fn trusted(&self, digest: &str) -> Result<Option<String>, SealError> {
        let all = self.all_trusted()?;
        let found = all.into_iter().rev().find(|entry| entry.digest == digest);
        Ok(found.map(|entry| entry.by))
    }

    pub(crate) fn note_trust(&self, entry: &TrustEntry) -> Result<(), SealError> {
        self.append(TRUSTED, entry)
    }

    pub(super) fn note_signed(&self, head: &Path) -> Result<(), SealError> {
        if self.folder.is_none() {
            return Ok(());
        }
        self.append(
            SIGNED,
            &SignedHead {
                file: place(head),
                date: flankscope_foundation::date::now(),
            },
        )
    }

    /// When this station wrote a signed head to this path, if it did.
    pub(super) fn signed_here(&self, head: &Path) -> Result<Option<String>, SealError> {
        let Some(folder) = &self.folder else {
            return Ok(None);
        };
        let at = place(head);
        let all: Vec<SignedHead> = lines(&folder.join(SIGNED))?;
        let found = all.into_iter().rev().find(|signed| signed.file == at);
        Ok(found.map(|signed| signed.date))
    }

    /// Path of an entry in the station's memory of histories, which is one folder.
    fn remembered(&self, of: &str, what: &[u8]) -> Option<PathBuf> {
        let folder = self.folder.as_ref()?.join(HISTORIES);
        Some(folder.join(format!("{of}-{}.json", hash(what))))
    }

    fn recall<T: DeserializeOwned>(&self, path: Option<PathBuf>) -> Result<Option<T>, SealError> {
        let Some(path) = path else {
            return Ok(None);
        };
        let failed = |source| SealError::Memory {
            path: path.clone(),
            source,
        };
        let bytes = match read_regular(&path, MOST_DOCUMENT_BYTES) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
            bytes => bytes.map_err(failed)?,
        };
        let read = || -> Result<Option<T>, SealError> {
            let document: Value = serde_json::from_slice(&bytes)?;
            if self.standing(Kind::Memory, &document)? != Standing::Signed {
                return Ok(None);
            }
            Ok(Some(serde_json::from_value(document)?))
        };
        match read() {
            Ok(Some(found)) => Ok(Some(found)),
            _ => Err(failed(std::io::Error::new(
                ErrorKind::InvalidData,
                "it is not as this station wrote it; restore it, or remove it and look at every history that the station wrote",
            ))),
        }
    }

    fn keep(&self, path: &Path, what: &impl Serialize) -> Result<(), SealError> {
        let mut document = serde_json::to_value(what)?;
        document[Seal::KEY] = serde_json::to_value(self.seal(Kind::Memory, &document)?)?;
        write_whole(path, &serde_json::to_vec(&document)?).map_err(|source| SealError::Memory {
            path: path.to_owned(),
            source,
        })
    }

    /// Locks a history, all its copies and the station's memory of it against other processes of this station, until the result is dropped.
    ///
    /// # Errors
    /// The lock cannot be created, or was held by another process for 2 s.
    pub fn alone(&self, id: &str) -> Result<Alone, SealError> {
        let Some(path) = self.remembered(HISTORY, id.as_bytes()) else {
            return Ok(Alone { _lock: None });
        };
        let path = path.with_extension("lock");
        let lock = || {
            std::fs::create_dir_all(path.parent().unwrap_or(Path::new(".")))?;
            let lock = std::fs::OpenOptions::new()
                .create(true)
                .append(true)
                .open(&path)?;
            let until = Instant::now() + PATIENCE;
            loop {
                match flock(&lock, FlockOperation::NonBlockingLockExclusive) {
                    Err(rustix::io::Errno::WOULDBLOCK) if Instant::now() < until => {
                        std::thread::sleep(Duration::from_millis(1));
                    }
                    Err(error) => return Err(error.into()),
                    Ok(()) => return Ok(Alone { _lock: Some(lock) }),
                }
            }
        };
        lock().map_err(|source| SealError::Memory {
            path: path.clone(),
            source,
        })
    }

    /// The anchor of a history, by its id.
    ///
    /// # Errors
    /// It cannot be read, or was changed by others.
    pub fn anchor(&self, id: &str) -> Result<Option<Anchor>, SealError> {
        self.recall(self.remembered(HISTORY, id.as_bytes()))
    }

    /// The id of the history that this station last wrote at a path.
    pub fn history_at(&self, file: &Path) -> Result<Option<String>, SealError> {
        let path = self.remembered(PLACE, place(file).as_os_str().as_encoded_bytes());
        Ok(self.recall::<Place>(path)?.map(|there| there.id))
    }

    /// The anchor of the history that this station last wrote at a path, unless it wrote to it elsewhere since.
    pub fn anchor_at(&self, file: &Path) -> Result<Option<Anchor>, SealError> {
        let Some(id) = self.history_at(file)? else {
            return Ok(None);
        };
        let anchor = self.anchor(&id)?;
        Ok(anchor.filter(|anchor| anchor.file == place(file)))
    }

    /// An unacknowledged no-go of the same real die in a history other than `own`, with that history's path.
    pub fn stands_elsewhere(
        &self,
        die: &DieKey,
        own: &str,
    ) -> Result<Option<(PathBuf, StandingNoGo)>, SealError> {
        let Some(folder) = self.folder.as_ref().map(|folder| folder.join(HISTORIES)) else {
            return Ok(None);
        };
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            let name = entry.file_name();
            let name = name.to_string_lossy();
            if !(name.starts_with(HISTORY) && name.ends_with(".json")) {
                continue;
            }
            let Some(anchor) = self.recall::<Anchor>(Some(entry.path()))? else {
                continue;
            };
            if anchor.id == own || anchor.simulated != Some(false) {
                continue;
            }
            let same = |no_go: &StandingNoGo| no_go.die.is_same(die);
            if let Some(no_go) = anchor.stands.into_iter().find(same) {
                return Ok(Some((anchor.file, no_go)));
            }
        }
        Ok(None)
    }

    /// Removes the memory of the history at a path, so that a new one can begin there.
    ///
    /// # Errors
    /// The memory cannot be removed.
    pub fn forget_anchor(&self, file: &Path) -> Result<(), SealError> {
        let gone = self.anchor_at(file)?;
        for path in [
            gone.and_then(|anchor| self.remembered(HISTORY, anchor.id.as_bytes())),
            self.remembered(PLACE, place(file).as_os_str().as_encoded_bytes()),
        ]
        .into_iter()
        .flatten()
        {
            match std::fs::remove_file(&path) {
                Err(source) if source.kind() != ErrorKind::NotFound => {
                    return Err(SealError::Memory { path, source });
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Stores the anchor of a history.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn drop_anchor(&self, _alone: &Alone, anchor: Anchor) -> Result<(), SealError> {
        let file = place(&anchor.file);
        let here = self.remembered(PLACE, file.as_os_str().as_encoded_bytes());
        let (Some(path), Some(here)) = (self.remembered(HISTORY, anchor.id.as_bytes()), here)
        else {
            return Ok(());
        };
        let before = self.history_at(&file)?;
        if before.as_ref() != Some(&anchor.id) {
            // Another history was at this path and was replaced on purpose.
            if before.is_some() {
                self.forget_anchor(&file)?;
            }
            let id = anchor.id.clone();
            let file = file.clone();
            self.keep(&here, &Place { file, id })?;
        }
        self.keep(&path, &Anchor { file, ..anchor })
    }
}
