//! Who may see the page and come in by OPC UA. A token is 256 random bits, so that its plain hash gives nothing away.

use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

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
    /// Acknowledge a no-go and start a check, too.
    Acknowledge,
    /// Give and revoke tokens, too.
    Admin,
}

impl Role {
    pub fn acknowledges(self) -> bool {
        matches!(self, Self::Acknowledge | Self::Admin)
    }

    /// Its name, as files and command line spell it.
    pub fn word(self) -> &'static str {
        match self {
            Self::View => "view",
            Self::Acknowledge => "acknowledge",
            Self::Admin => "admin",
        }
    }
}

/// A person or program.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct User {
    pub name: String,
    pub role: Role,
    /// When the token was made: ISO 8601, UTC. Older files do not state it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub created: Option<String>,
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
    #[error("{}: nobody of the name {name} has a token", path.display())]
    Unknown { path: PathBuf, name: String },
    #[error("{}: {name} is the last one with the role admin; give somebody else that role first", path.display())]
    LastAdmin { path: PathBuf, name: String },
    #[error("{}: read-only (mode {mode:o}), so that tokens can be given and revoked only where it is kept; chmod 600 allows it here", path.display())]
    ReadOnly { path: PathBuf, mode: u32 },
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
        let hash = |user: &User| {
            let hex = &user.token_blake3;
            let expected = "must be a BLAKE3 hash of 64 hexadecimal digits";
            Hash::from_hex(hex).map_err(|_| BadValue::new("user.token_blake3", hex, expected))
        };
        self.user.iter().map(hash).collect()
    }

    /// Adds a person or program to the file, which is made if it is missing, and returns the token.
    ///
    /// # Errors
    /// The name is none or known, or the file cannot be read or written.
    pub fn add(path: &Path, name: &str, role: Role) -> Result<String, UsersError> {
        let letters = |c: char| c.is_alphanumeric() || " -._@".contains(c);
        if name.trim().is_empty() || name.chars().count() > MOST_NAME || !name.chars().all(letters)
        {
            return Err(UsersError::NoName { got: name.into() });
        }
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
        let token = random_token().map_err(failed(path))?;
        users.user.push(User {
            name: name.into(),
            role,
            created: Some(flankscope_foundation::date::now()),
            token_blake3: blake3::hash(token.as_bytes()).to_hex().to_string(),
        });
        users.write(path)?;
        Ok(token)
    }

    /// Removes a person or program from the file: the token is good for nothing any more.
    ///
    /// # Errors
    /// Nobody has this name, it is the last admin's, or the file cannot be read or written.
    pub fn revoke(path: &Path, name: &str) -> Result<(), UsersError> {
        let mut users = Self::read(path)?;
        let (path, name) = (path.to_owned(), name.to_owned());
        let Some(at) = users.user.iter().position(|user| user.name == name) else {
            return Err(UsersError::Unknown { path, name });
        };
        let removed = users.user.remove(at);
        let is_admin = |user: &User| user.role == Role::Admin;
        if is_admin(&removed) && !users.user.iter().any(is_admin) {
            return Err(UsersError::LastAdmin { path, name });
        }
        users.write(&path)
    }

    /// Writes the file whole.
    fn write(&self, path: &Path) -> Result<(), UsersError> {
        // Renaming would replace it all the same.
        if let Ok(meta) = std::fs::metadata(path) {
            let mode = meta.permissions().mode() & 0o777;
            if mode & 0o200 == 0 {
                let path = path.into();
                return Err(UsersError::ReadOnly { path, mode });
            }
        }
        let text = toml::to_string(self)?;
        write_whole_with_mode(path, text.as_bytes(), 0o600).map_err(failed(path))
    }

    /// All of them, in the order in which they were added.
    pub fn all(&self) -> &[User] {
        &self.user
    }

    /// Whose token it is. All are compared, each in constant time.
    pub fn of_token(&self, token: &str) -> Option<&User> {
        let hash = blake3::hash(token.as_bytes());
        let mut found = None;
        for (user, user_hash) in self.user.iter().zip(&self.hashes) {
            if *user_hash == hash {
                found = Some(user);
            }
        }
        found
    }

    /// The person or program of this name.
    pub fn named(&self, name: &str) -> Option<&User> {
        self.user.iter().find(|user| user.name == name)
    }
}

/// The file of users, which is read again whenever it was changed, by whomever: what it says now counts.
#[derive(Debug)]
pub struct UsersFile {
    path: PathBuf,
    read: Mutex<(Version, Arc<Users>)>,
    /// One change at a time.
    change: Mutex<()>,
}

/// Which file it is and when it was last written, moved or given another mode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Version {
    inode: u64,
    changed_s: i64,
    changed_ns: i64,
    bytes: u64,
}

impl Version {
    fn of_file(path: &Path) -> Result<Self, UsersError> {
        let meta = std::fs::metadata(path).map_err(failed(path))?;
        Ok(Self {
            inode: meta.ino(),
            changed_s: meta.ctime(),
            changed_ns: meta.ctime_nsec(),
            bytes: meta.size(),
        })
    }
}

impl UsersFile {
    /// Reads a file with at least one user.
    ///
    /// # Errors
    /// As of [`Users::load`].
    pub fn open(path: &Path) -> Result<Self, UsersError> {
        // The version first: whoever writes between is noticed at the next look.
        let version = Version::of_file(path)?;
        let users = Arc::new(Users::load(path)?);
        Ok(Self {
            path: path.into(),
            read: Mutex::new((version, users)),
            change: Mutex::default(),
        })
    }

    /// The users of the file as it is now.
    ///
    /// # Errors
    /// As of [`Users::load`]: what cannot be read lets nobody in.
    pub fn now(&self) -> Result<Arc<Users>, UsersError> {
        let version = Version::of_file(&self.path)?;
        let mut read = self.read.lock().unwrap_or_else(PoisonError::into_inner);
        if read.0 != version {
            *read = (version, Arc::new(Users::load(&self.path)?));
        }
        Ok(Arc::clone(&read.1))
    }

    /// The first of its users that is meant; none if the file cannot be read, which is logged.
    pub fn find(&self, meant: impl FnOnce(&Users) -> Option<&User>) -> Option<User> {
        match self.now() {
            Ok(users) => meant(&users).cloned(),
            Err(error) => {
                tracing::warn!("nobody comes in: {error}");
                None
            }
        }
    }

    /// Whose token it is.
    pub fn of_token(&self, token: &str) -> Option<User> {
        self.find(|users| users.of_token(token))
    }

    /// Runs what changes the file, given who is in it, while no other change by this process runs.
    ///
    /// # Errors
    /// The file cannot be read, or those of `change`.
    pub fn changed<T, E: From<UsersError>>(
        &self,
        change: impl FnOnce(&Users, &Path) -> Result<T, E>,
    ) -> Result<T, E> {
        let _one = self.change.lock().unwrap_or_else(PoisonError::into_inner);
        let now = self.now()?;
        change(&now, &self.path)
    }
}

fn failed(path: &Path) -> impl Fn(std::io::Error) -> UsersError {
    move |source| UsersError::Io {
        path: path.into(),
        source,
    }
}

/// 256 random bits, in hexadecimal digits.
fn random_token() -> std::io::Result<String> {
    let mut random = [0_u8; 32];
    let mut filled = 0;
    while filled < random.len() {
        let flags = rustix::rand::GetRandomFlags::empty();
        filled += rustix::rand::getrandom(&mut random[filled..], flags)?;
    }
    Ok(Hash::from_bytes(random).to_hex().to_string())
}

/// Refuses a file of secrets that others can read or write.
///
/// # Errors
/// They can, or it is not there.
pub fn require_private(path: &Path) -> Result<(), UsersError> {
    let meta = std::fs::metadata(path).map_err(failed(path))?;
    let mode = meta.permissions().mode() & 0o777;
    match mode & 0o077 {
        0 => Ok(()),
        _ => Err(UsersError::Open {
            path: path.into(),
            mode,
        }),
    }
}
