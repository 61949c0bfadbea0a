//! Whose word a file is: everything that the instrument writes and later believes carries a keyed digest over all of it.
//!
//! The key is the station's own (`key`); a digest says that this station wrote the file and that nobody without the key
//! changed it since. What another station wrote, or an earlier release, is believed once somebody says so by name
//! (`memory`). `SECURITY.md` says what this does not protect.

mod key;
mod memory;

use std::path::{Path, PathBuf};

use flankscope_foundation::files::read_text;
use flankscope_foundation::seal::Seal;
use serde::Serialize;
use serde_json::Value;

pub use memory::{Alone, Anchor, StandingNoGo, TrustEntry};

/// What is sealed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A baseline.
    Baseline,
    /// A head file.
    Head,
    /// A head's self-test.
    SelfTest,
    /// The result of a scan: the reference of later ones.
    Scan,
    /// The manifest of a scan's session folder.
    Session,
    /// What a station remembers of a history.
    Memory,
}

impl Kind {
    /// In words, for sentences and for the digest.
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

/// What is known of where a file comes from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Standing {
    /// This station wrote it, and nobody changed it.
    Signed,
    /// Somebody says that it is to be believed as it is.
    Trusted {
        /// Who.
        by: String,
    },
    /// It carries no digest.
    Unsigned,
    /// It carries another station's digest.
    Foreign {
        /// Its id.
        station: String,
    },
    /// It carries this station's digest, which is not that of its content.
    Changed,
}

impl Standing {
    /// For results.
    #[must_use]
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

/// Why a file is not believed, or cannot be signed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SealError {
    /// The key cannot be read or made.
    #[error("the station's key {}: {source} (choose another folder with FLANKSCOPE_STATE)", path.display())]
    Key {
        /// Key or folder.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// Others may have read or exchanged the key.
    #[error("{} is of user {uid} with mode {mode:o}: the station's key and its folder must be this user's alone (0600 in 0700); if others may have read it, remove it: what it signed must then be trusted anew", path.display())]
    KeyOpen {
        /// Key or folder.
        path: PathBuf,
        /// Owner.
        uid: u32,
        /// Mode.
        mode: u32,
    },
    /// There is no folder for it.
    #[error("no place for the station's key: set FLANKSCOPE_STATE, XDG_STATE_HOME or HOME")]
    NoPlace,
    /// What the station remembers cannot be read or written.
    #[error("{}: {source}", path.display())]
    Memory {
        /// The file.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// What should be signed is no JSON.
    #[error("cannot be signed: {0}")]
    Document(#[from] serde_json::Error),
    /// Not by this station.
    #[error("{}: this {what} is not believed: {why}. If it is right as it is: flankscope trust {} --name WHO", path.display(), path.display())]
    NotBelieved {
        /// The file.
        path: PathBuf,
        /// What it is.
        what: &'static str,
        /// Why not.
        why: String,
    },
}

/// The station's key, and what it remembers.
#[derive(Clone, Debug)]
pub struct Seals {
    key: key::Key,
    /// None: nothing is remembered beyond this process.
    folder: Option<PathBuf>,
}

impl Seals {
    /// Where they are kept unless somebody says otherwise.
    ///
    /// # Errors
    /// No place is known.
    pub fn default_folder() -> Result<PathBuf, SealError> {
        key::default_folder()
    }

    /// Those in a folder; the key is made there at first use.
    ///
    /// # Errors
    /// The key cannot be read or made, or others may have read it.
    pub fn open(folder: &Path) -> Result<Self, SealError> {
        Ok(Self {
            key: key::Key::open(folder)?,
            folder: Some(folder.to_owned()),
        })
    }

    /// Those of this process alone: what they sign nobody believes later.
    ///
    /// # Errors
    /// The system has no random numbers.
    pub fn passing() -> Result<Self, SealError> {
        let key = key::Key::passing().map_err(|source| SealError::Key {
            path: "/dev/urandom".into(),
            source,
        })?;
        Ok(Self { key, folder: None })
    }

    /// Where the station keeps something beside its key; none where nothing is kept.
    pub(crate) fn place_for(&self, what: &str) -> Option<PathBuf> {
        Some(self.folder.as_ref()?.join(what))
    }

    /// Names the station's key.
    #[must_use]
    pub fn station(&self) -> String {
        self.key.id()
    }

    /// A digest of something that is no document.
    pub fn digest<'a>(&self, kind: &'a str, parts: impl IntoIterator<Item = &'a [u8]>) -> String {
        self.key.digest(kind, parts)
    }

    /// The seal of a document, whatever seal is in it.
    ///
    /// # Errors
    /// It is no JSON.
    pub fn seal(&self, kind: Kind, document: &impl Serialize) -> Result<Seal, SealError> {
        // By its text: a number is what a reader of the file makes of it.
        let document: Value = serde_json::from_str(&serde_json::to_string(document)?)?;
        Ok(Seal {
            station: self.station(),
            blake3: self.of(kind, &document),
        })
    }

    /// Over everything but the seal itself: keys in alphabetical order, without white space.
    fn of(&self, kind: Kind, document: &Value) -> String {
        let mut document = document.clone();
        if let Some(map) = document.as_object_mut() {
            map.remove(Seal::KEY);
        }
        self.key
            .digest(kind.word(), [document.to_string().as_bytes()])
    }

    /// Where a document comes from.
    ///
    /// # Errors
    /// What was trusted cannot be read.
    pub fn standing(&self, kind: Kind, document: &Value) -> Result<Standing, SealError> {
        let right = self.of(kind, document);
        let seal = document.get(Seal::KEY).cloned();
        // One that cannot be read is not what the station wrote.
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

    /// Somebody says that a document is to be believed as it is.
    ///
    /// # Errors
    /// It cannot be noted.
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

    /// Whether a head file may be used, with its self-test where it has a calibration.
    ///
    /// What `[calibration]` says is believed, so it must be signed or trusted. A head without one makes no claim: it is a
    /// user's input like the tool file, unless this station wrote a signed head to this place.
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

/// A TOML file as the document that is sealed.
///
/// # Errors
/// It is no TOML.
pub fn toml_document(path: &Path, text: &str) -> Result<Value, SealError> {
    let table: toml::Table = toml::from_str(text).map_err(|error| SealError::Memory {
        path: path.to_owned(),
        source: std::io::Error::new(std::io::ErrorKind::InvalidData, error.message().to_owned()),
    })?;
    Ok(serde_json::to_value(table)?)
}

#[cfg(test)]
mod tests;
