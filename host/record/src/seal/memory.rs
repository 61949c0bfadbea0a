//! What a station remembers beside its key, in the key's folder: what somebody trusts, where it wrote signed heads, and how far
//! the histories were that it wrote to.

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
/// Files in [`HISTORIES`]: of a history by its id, and which one is at a place.
const HISTORY: &str = "history";
const PLACE: &str = "place";
/// How long the station's other processes are waited for.
const PATIENCE: Duration = Duration::from_secs(2);

/// Somebody's word for a file.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct TrustEntry {
    /// Of its content, with this station's key.
    pub digest: String,
    /// What kind of file.
    pub what: String,
    /// Where it was then.
    pub file: PathBuf,
    /// Who says so.
    pub by: String,
    /// When.
    pub date: String,
}

#[derive(Serialize, Deserialize)]
struct SignedHead {
    file: PathBuf,
    date: String,
}

/// How far a history is, whatever its file is called: a store of it that is behind is refused wherever it lies.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Anchor {
    /// The history's own id.
    pub id: String,
    /// Where this station last wrote to it.
    pub file: PathBuf,
    /// Last link of its chain, and its digest.
    pub link: i64,
    /// See [`Self::link`].
    pub digest: String,
    /// Whether its checks are of the simulated bench; none while it has no check.
    pub simulated: Option<bool>,
    /// No-gos that nobody has acknowledged, the newest of each die.
    pub stands: Vec<StandingNoGo>,
}

/// A no-go that nobody has acknowledged.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct StandingNoGo {
    /// Against which die.
    #[serde(flatten)]
    pub die: DieKey,
    /// Of which check.
    pub check: i64,
    /// When it was stored.
    pub at: String,
}

impl std::fmt::Display for StandingNoGo {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}, check {} of {}", self.die.tool, self.check, self.at)
    }
}

/// Which history was last written at a place.
#[derive(Serialize, Deserialize)]
struct Place {
    file: PathBuf,
    id: String,
}

/// Held while a history and what the station remembers of it change together.
#[derive(Debug)]
pub struct Alone {
    _lock: Option<std::fs::File>,
}

/// The same place under one name, whether something is there or not.
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
    // The last line may be cut short by a loss of power: then it was not believed by anybody yet.
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

    /// Everything that somebody trusts.
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

    /// When this station wrote a signed head to this place, if it did.
    pub(super) fn signed_here(&self, head: &Path) -> Result<Option<String>, SealError> {
        let Some(folder) = &self.folder else {
            return Ok(None);
        };
        let at = place(head);
        let all: Vec<SignedHead> = lines(&folder.join(SIGNED))?;
        let found = all.into_iter().rev().find(|signed| signed.file == at);
        Ok(found.map(|signed| signed.date))
    }

    /// What a station remembers of all histories is in one folder.
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

    /// Nobody else of this station changes a history, any copy of it, or what is remembered of it, as long as the answer lives.
    ///
    /// # Errors
    /// The lock cannot be made, or somebody held it for as long as [`PATIENCE`].
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

    /// How far a history is, by its id.
    ///
    /// # Errors
    /// It cannot be read, or is not as this station wrote it.
    pub fn anchor(&self, id: &str) -> Result<Option<Anchor>, SealError> {
        self.recall(self.remembered(HISTORY, id.as_bytes()))
    }

    /// The id of the history that this station last wrote at a place.
    ///
    /// # Errors
    /// As [`Self::anchor`].
    pub fn history_at(&self, file: &Path) -> Result<Option<String>, SealError> {
        let path = self.remembered(PLACE, place(file).as_os_str().as_encoded_bytes());
        Ok(self.recall::<Place>(path)?.map(|there| there.id))
    }

    /// How far the history was that this station last wrote at a place, unless it wrote to it elsewhere since.
    ///
    /// # Errors
    /// As [`Self::anchor`].
    pub fn anchor_at(&self, file: &Path) -> Result<Option<Anchor>, SealError> {
        let Some(id) = self.history_at(file)? else {
            return Ok(None);
        };
        let anchor = self.anchor(&id)?;
        Ok(anchor.filter(|anchor| anchor.file == place(file)))
    }

    /// A no-go of a real die that stands in another history than `own`, with that history's file: the die takes it along.
    ///
    /// # Errors
    /// As [`Self::anchor`].
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

    /// A history begins anew at a place.
    ///
    /// # Errors
    /// What is remembered cannot be removed.
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

    /// Remembers how far a history is.
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
            // Another one that was here has given way, on purpose.
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
