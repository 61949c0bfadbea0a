//! Signatures: every file that the instrument writes and later relies on carries a keyed digest of its whole content.
//!
//! The key belongs to the station (`key`); a valid digest shows that this station wrote the file and that nobody without the key
//! changed it. Files of another station or an earlier release are accepted once a person declares them trusted by name
//! (`memory`). `SECURITY.md` says what this does not protect against.

mod key;
mod memory;

use std::path::{Path, PathBuf};

use flankscope_foundation::files::read_text;
use flankscope_foundation::seal::Seal;
use serde::Serialize;
use serde_json::Value;

pub use memory::{Alone, Anchor, StandingNoGo, TrustEntry};

/// Kind of a signed file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Baseline,
    /// A head file.
    Head,
    /// A head's self-test.
    SelfTest,
    /// Result of a scan, used as the reference of later ones.
    Scan,
    /// The manifest of a scan's session folder.
    Session,
    /// An entry of the station's memory of a history.
    Memory,
}

impl Kind {
    /// The kind in words, for messages and for the digest.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Baseline => "baseline",
            Self::Head => "head file",
            Self::SelfTest => "self-test",
            Self::Scan => "scan",
            Self::Session => "scan session",
            Self::Memory => "memory of a history",
        }
    }
}

/// Status of a file's signature.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Standing {
    /// Signed by this station and unchanged.
    Signed,
    /// Declared trusted by a person.
    Trusted {
        /// Name of the person.
        by: String,
    },
    /// Without a digest.
    Unsigned,
    /// Signed by another station.
    Foreign {
        /// Id of that station.
        station: String,
    },
    /// It carries this station's digest, but the content was changed.
    Changed,
}

impl Standing {
    /// The status in words, for results.
    pub fn words(&self) -> String {
        match self {
            Self::Signed => "signed".into(),
            Self::Trusted { by } => format!("trusted by {by}"),
            Self::Unsigned => "unsigned".into(),
            Self::Foreign { station } => format!("of station {station}"),
            Self::Changed => "changed".into(),
        }
    }
}

/// Why a file is not accepted, or cannot be signed.
#[derive(Debug, thiserror::Error)]
pub enum SealError {
    /// The key cannot be read or created.
    #[error("the station's key {}: {source} (choose another folder with FLANKSCOPE_STATE)", path.display())]
    Key {
        /// Key or folder.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    #[error("{} is of user {uid} with mode {mode:o}: the station's key and its folder must be this user's alone (0600 in 0700); if others may have read it, remove it: what it signed must then be trusted anew", path.display())]
    KeyOpen {
        /// Key or folder.
        path: PathBuf,
        /// User id of the owner.
        uid: u32,
        /// Permission bits.
        mode: u32,
    },
    /// No folder for the key is known.
    #[error("no place for the station's key: set FLANKSCOPE_STATE, XDG_STATE_HOME or HOME")]
    NoPlace,
    /// The station's memory cannot be read or written.
    #[error("{}: {source}", path.display())]
    Memory {
        /// The file.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    #[error("cannot be signed: {0}")]
    Document(#[from] serde_json::Error),
    /// The file is neither signed by this station nor trusted.
    #[error("{}: this {what} is not believed: {why}. If it is right as it is: flankscope trust {} --name WHO", path.display(), path.display())]
    NotBelieved {
        /// The file.
        path: PathBuf,
        /// Kind of file.
        what: &'static str,
        /// Reason.
        why: String,
    },
}

/// The station's key and memory.
#[derive(Clone, Debug)]
pub struct Seals {
    key: key::Key,
    /// `None`: nothing is stored beyond this process.
    folder: Option<PathBuf>,
}

impl Seals {
    /// Default folder of key and memory.
    ///
    /// # Errors
    /// No folder is known.
    pub fn default_folder() -> Result<PathBuf, SealError> {
        key::default_folder()
    }

    /// Key and memory in a folder; the key is created at first use.
    ///
    /// # Errors
    /// The key cannot be read or created, or other users may have read it.
    pub fn open(folder: &Path) -> Result<Self, SealError> {
        Ok(Self {
            key: key::Key::open(folder)?,
            folder: Some(folder.to_owned()),
        })
    }

    /// Key and memory in a folder in which a key is, to verify what that station wrote.
    ///
    /// # Errors
    /// There is no key, or other users may have read it.
    pub fn existing(folder: &Path) -> Result<Self, SealError> {
        Ok(Self {
            key: key::Key::existing(folder)?,
            folder: Some(folder.to_owned()),
        })
    }

    /// A temporary key for this process; its signatures cannot be verified later.
    ///
    /// # Errors
    /// The system provides no random numbers.
    pub fn passing() -> Result<Self, SealError> {
        let key = key::Key::passing().map_err(|source| SealError::Key {
            path: "/dev/urandom".into(),
            source,
        })?;
        Ok(Self { key, folder: None })
    }

    /// Path of a file in the station's folder; `None` if nothing is stored.
    pub(crate) fn place_for(&self, what: &str) -> Option<PathBuf> {
        Some(self.folder.as_ref()?.join(what))
    }

    /// Id of the station's key.
    pub fn station(&self) -> String {
        self.key.id()
    }

    /// Digest of data that are not a document.
    pub fn digest<'a>(&self, kind: &'a str, parts: impl IntoIterator<Item = &'a [u8]>) -> String {
        self.key.digest(kind, parts)
    }

    /// The seal of a document, ignoring a seal that it already has.
    ///
    /// # Errors
    /// It is not JSON.
    pub fn seal(&self, kind: Kind, document: &impl Serialize) -> Result<Seal, SealError> {
        // Through its text, so that numbers are as a reader of the file parses them.
        let document: Value = serde_json::from_str(&serde_json::to_string(document)?)?;
        Ok(Seal {
            station: self.station(),
            blake3: self.of(kind, &document),
        })
    }

    /// Digest of everything but the seal: keys in alphabetical order, without white space.
    fn of(&self, kind: Kind, document: &Value) -> String {
        let mut document = document.clone();
        if let Some(map) = document.as_object_mut() {
            map.remove(Seal::KEY);
        }
        self.key
            .digest(kind.word(), [document.to_string().as_bytes()])
    }

    /// Status of a document's signature.
    ///
    /// # Errors
    /// The list of trusted files cannot be read.
    pub fn standing(&self, kind: Kind, document: &Value) -> Result<Standing, SealError> {
        let right = self.of(kind, document);
        let seal = document.get(Seal::KEY).cloned();
        // A seal that cannot be parsed was not written by the station.
        let seal = match seal.map(serde_json::from_value::<Seal>).transpose() {
            Ok(seal) => seal,
            Err(_) => {
                return Ok(self
                    .trusted(&right)?
                    .map_or(Standing::Changed, |by| Standing::Trusted { by }));
            }
        };
        let own = |seal: &&Seal| seal.station == self.station();
        if seal
            .as_ref()
            .filter(own)
            .is_some_and(|seal| seal.blake3 == right)
        {
            return Ok(Standing::Signed);
        }
        if let Some(by) = self.trusted(&right)? {
            return Ok(Standing::Trusted { by });
        }
        Ok(match seal {
            None => Standing::Unsigned,
            Some(seal) if own(&&seal) => Standing::Changed,
            Some(seal) => Standing::Foreign {
                station: seal.station,
            },
        })
    }

    /// Refuses a document that is neither signed by this station nor trusted.
    ///
    /// # Errors
    /// [`SealError::NotBelieved`] with the remedy.
    pub fn believe(
        &self,
        kind: Kind,
        path: &Path,
        document: &Value,
    ) -> Result<Standing, SealError> {
        let standing = self.standing(kind, document)?;
        let why = match &standing {
            Standing::Signed | Standing::Trusted { .. } => return Ok(standing),
            Standing::Unsigned => {
                "it carries no digest: it was taken off, or was never there".into()
            }
            Standing::Foreign { station } => {
                format!(
                    "station {station} signed it, this is station {}",
                    self.station()
                )
            }
            Standing::Changed => "it was changed after this station had signed it".into(),
        };
        Err(SealError::NotBelieved {
            path: path.to_owned(),
            what: kind.word(),
            why,
        })
    }

    /// Declares a document trusted on the word of a named person.
    ///
    /// # Errors
    /// The entry cannot be written.
    pub fn trust(
        &self,
        kind: Kind,
        path: &Path,
        document: &Value,
        by: &str,
    ) -> Result<(), SealError> {
        self.note_trust(&TrustEntry {
            digest: self.of(kind, document),
            what: kind.word().into(),
            file: path.to_owned(),
            by: by.to_owned(),
            date: flankscope_foundation::date::now(),
        })
    }

    /// Seals a TOML file in place.
    ///
    /// # Errors
    /// It cannot be read or written.
    pub fn seal_toml(&self, kind: Kind, path: &Path) -> Result<(), SealError> {
        let failed = |source| SealError::Memory {
            path: path.to_owned(),
            source,
        };
        let text = read_text(path).map_err(failed)?;
        let Seal { station, blake3 } = self.seal(kind, &toml_document(path, &text)?)?;
        let text = format!(
            "{}\n\n[{}]\nstation = \"{station}\"\nblake3 = \"{blake3}\"\n",
            text.trim_end(),
            Seal::KEY
        );
        flankscope_foundation::files::write_whole(path, text.as_bytes()).map_err(failed)?;
        if kind == Kind::Head {
            self.note_signed(path)?;
        }
        Ok(())
    }

    /// Checks whether a head file may be used, with its self-test if it has a calibration.
    ///
    /// `[calibration]` is relied on, so the file must be signed or trusted. A head file without it is a user's input like the
    /// tool file, unless this station wrote a signed head to this path.
    ///
    /// # Errors
    /// [`SealError::NotBelieved`] with the remedy.
    pub fn head(&self, path: &Path, calibrated: bool) -> Result<Standing, SealError> {
        let read = |path: &Path| {
            read_text(path).map_err(|source| SealError::Memory {
                path: path.to_owned(),
                source,
            })
        };
        let text = read(path)?;
        if flankscope_profilometry::io::is_file_storage(&text) {
            return Ok(Standing::Unsigned);
        }
        let document = toml_document(path, &text)?;
        let standing = self.standing(Kind::Head, &document)?;
        if standing == Standing::Unsigned && !calibrated {
            return match self.signed_here(path)? {
                None => Ok(standing),
                Some(date) => Err(SealError::NotBelieved {
                    path: path.to_owned(),
                    what: Kind::Head.word(),
                    why: format!(
                        "this station signed a head file of this name on {date}, and this one carries no digest"
                    ),
                }),
            };
        }
        self.believe(Kind::Head, path, &document)?;
        let test = flankscope_profilometry::head::SelfTest::path_of(path);
        if calibrated && test.exists() {
            let document = toml_document(&test, &read(&test)?)?;
            self.believe(Kind::SelfTest, &test, &document)?;
        }
        Ok(standing)
    }
}

/// A TOML file as the document that is signed.
///
/// # Errors
/// It is not TOML.
pub fn toml_document(path: &Path, text: &str) -> Result<Value, SealError> {
    let table: toml::Table = toml::from_str(text).map_err(|error| SealError::Memory {
        path: path.to_owned(),
        source: std::io::Error::new(std::io::ErrorKind::InvalidData, error.message().to_owned()),
    })?;
    Ok(serde_json::to_value(table)?)
}

#[cfg(test)]
mod tests;
