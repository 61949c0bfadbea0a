//! What a station remembers beside its key, in the key's folder: what somebody trusts, where it wrote signed heads, and how far
//! the histories were that it wrote to.

use std::io::Write;
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::{SealError, Seals};
use flankscope_foundation::files::{hash, write_whole};

const TRUSTED: &str = "trusted.jsonl";
const SIGNED: &str = "signed.jsonl";
const HISTORIES: &str = "histories";

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

/// How far a history was when this station last wrote to it: rows that are gone since are missed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Anchor {
    /// The history's own id.
    pub id: String,
    /// Where it is.
    pub file: PathBuf,
    /// Last link of its chain, and its digest.
    pub link: i64,
    /// See [`Self::link`].
    pub digest: String,
    /// A no-go that nobody has acknowledged: of which tool, and when.
    pub stands: Option<String>,
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
    let text = match std::fs::read_to_string(path) {
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

    pub(super) fn note_trust(&self, entry: &TrustEntry) -> Result<(), SealError> {
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

    fn anchor_file(&self, history: &Path) -> Option<PathBuf> {
        let name = hash(place(history).as_os_str().as_encoded_bytes());
        let folder = self.folder.as_ref()?.join(HISTORIES);
        Some(folder.join(format!("{name}.json")))
    }

    /// How far the history at a place was, if this station wrote to it.
    pub fn anchor(&self, history: &Path) -> Result<Option<Anchor>, SealError> {
        let Some(path) = self.anchor_file(history) else {
            return Ok(None);
        };
        match std::fs::read(&path) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(source) => Err(SealError::Memory { path, source }),
            Ok(bytes) => Ok(Some(serde_json::from_slice(&bytes)?)),
        }
    }

    /// A history begins anew.
    pub fn forget_anchor(&self, history: &Path) -> Result<(), SealError> {
        let Some(path) = self.anchor_file(history) else {
            return Ok(());
        };
        match std::fs::remove_file(&path) {
            Err(source) if source.kind() != std::io::ErrorKind::NotFound => {
                Err(SealError::Memory { path, source })
            }
            _ => Ok(()),
        }
    }

    /// Remembers how far a history is; never less far than another process has said.
    pub fn drop_anchor(
        &self,
        history: &Path,
        anchor: Anchor,
        afresh: bool,
    ) -> Result<(), SealError> {
        let Some(path) = self.anchor_file(history) else {
            return Ok(());
        };
        let keep = || -> std::io::Result<()> {
            let folder = path.parent().unwrap_or(Path::new("."));
            std::fs::create_dir_all(folder)?;
            let lock = std::fs::File::open(folder)?;
            rustix::fs::flock(&lock, rustix::fs::FlockOperation::LockExclusive)?;
            let before = std::fs::read(&path).ok();
            let before: Option<Anchor> =
                before.and_then(|bytes| serde_json::from_slice(&bytes).ok());
            let farther = |there: Anchor| there.id == anchor.id && there.link > anchor.link;
            if !afresh && before.is_some_and(farther) {
                return Ok(());
            }
            let anchor = Anchor {
                file: place(history),
                ..anchor
            };
            write_whole(&path, &serde_json::to_vec(&anchor)?)
        };
        keep().map_err(|source| SealError::Memory {
            path: path.clone(),
            source,
        })
    }
}
