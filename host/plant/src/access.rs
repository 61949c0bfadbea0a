//! Who may see the page. A token is 256 random bits, so that its plain hash gives nothing away.

use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use blake3::Hash;
use flankscope_foundation::files::write_whole_with_mode;
use flankscope_foundation::textfile::{self, BadValue, TextFileError};
use serde::{Deserialize, Serialize};

/// What a person or program may do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// See everything.
    View,
    /// Acknowledge a no-go, too.
    Acknowledge,
}

/// A person or program.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct User {
    pub name: String,
    pub role: Role,
    /// BLAKE3 of the token.
    token_blake3: String,
}

/// Everybody with a token.
#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Users {
    #[serde(default)]
    user: Vec<User>,
    #[serde(skip)]
    hashes: Vec<Hash>,
}

/// Why the users cannot be read or changed.
#[derive(Debug, thiserror::Error)]
pub enum UsersError {
    #[error(transparent)]
    File(#[from] TextFileError),
    #[error("{}: {source}", path.display())]
    Io {
        path: PathBuf,
        source: std::io::Error,
    },
    #[error("{}: mode {mode:o} lets others read or write it; chmod 600", path.display())]
    Open { path: PathBuf, mode: u32 },
    #[error("{}: nobody has a token; flankscope-plant token NAME --users {}", path.display(), path.display())]
    Nobody { path: PathBuf },
    #[error("{}: {name} has a token already; remove the line to give another one", path.display())]
    Known { path: PathBuf, name: String },
    #[error(transparent)]
    Toml(#[from] toml::ser::Error),
    #[error("'{got}' is no name: 1 to 64 letters, digits, spaces, - . _ @ are")]
    NoName { got: String },
}

/// Largest file of users, bytes.
const MOST_BYTES: u64 = 1 << 20;
/// Largest length of a name, characters.
const MOST_NAME: usize = 64;

impl Users {
    /// Reads a file of users with at least one.
    ///
    /// # Errors
    /// It cannot be read, others can read it, or it names nobody.
    pub fn load(path: &Path) -> Result<Self, UsersError> {
        let users = Self::read(path)?;
        if users.hashes.is_empty() {
            return Err(UsersError::Nobody { path: path.into() });
        }
        Ok(users)
    }

    fn read(path: &Path) -> Result<Self, UsersError> {
        require_private(path)?;
        let (mut users, text): (Self, _) = textfile::load_toml(path, MOST_BYTES, |_| Ok(()))?;
        let hashes = users.hashed();
        users.hashes = hashes.map_err(|bad| bad.in_file(path, &text))?;
        Ok(users)
    }

    /// The hashes, as the file has them.
    fn hashed(&self) -> Result<Vec<Hash>, BadValue> {
        let hash = |of: &User| {
            let hex = &of.token_blake3;
            let expected = "must be a BLAKE3 hash of 64 hexadecimal digits";
            Hash::from_hex(hex).map_err(|_| BadValue::new("user.token_blake3", hex, expected))
        };
        self.user.iter().map(hash).collect()
    }

    /// Adds a person or program and returns the token.
    ///
    /// # Errors
    /// The name is none or known, or the file cannot be read or written.
    pub fn add(path: &Path, name: &str, role: Role) -> Result<String, UsersError> {
        let letters = |c: char| c.is_alphanumeric() || " -._@".contains(c);
        if name.trim().is_empty() || name.chars().count() > MOST_NAME || !name.chars().all(letters)
        {
            return Err(UsersError::NoName { got: name.into() });
        }
        let failed = |source| UsersError::Io {
            path: path.into(),
            source,
        };
        let mut users = if path.exists() {
            Self::read(path)?
        } else {
            Self::default()
        };
        if users.user.iter().any(|user| user.name == name) {
            return Err(UsersError::Known {
                path: path.into(),
                name: name.into(),
            });
        }
        let mut random = [0_u8; 32];
        let mut filled = 0;
        while filled < random.len() {
            let flags = rustix::rand::GetRandomFlags::empty();
            filled += rustix::rand::getrandom(&mut random[filled..], flags)
                .map_err(|error| failed(error.into()))?;
        }
        let token = Hash::from_bytes(random).to_hex().to_string();
        users.user.push(User {
            name: name.into(),
            role,
            token_blake3: blake3::hash(token.as_bytes()).to_hex().to_string(),
        });
        let text = toml::to_string(&users)?;
        write_whole_with_mode(path, text.as_bytes(), 0o600).map_err(failed)?;
        Ok(token)
    }

    /// Whose token it is. All are compared, each in constant time.
    pub fn of_token(&self, token: &str) -> Option<&User> {
        let hash = blake3::hash(token.as_bytes());
        let mut found = None;
        for (user, of) in self.user.iter().zip(&self.hashes) {
            if *of == hash {
                found = Some(user);
            }
        }
        found
    }

    /// The person or program of this name.
    #[cfg(feature = "opcua")]
    pub fn named(&self, name: &str) -> Option<&User> {
        self.user.iter().find(|user| user.name == name)
    }
}

/// Refuses a file of secrets that others can read or write.
///
/// # Errors
/// They can, or it is not there.
pub fn require_private(path: &Path) -> Result<(), UsersError> {
    let meta = std::fs::metadata(path).map_err(|source| UsersError::Io {
        path: path.into(),
        source,
    })?;
    let mode = meta.permissions().mode() & 0o777;
    match mode & 0o077 {
        0 => Ok(()),
        _ => Err(UsersError::Open {
            path: path.into(),
            mode,
        }),
    }
}
