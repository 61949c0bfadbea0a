//! The station's key: 32 random bytes, readable by its user only, created at first use.

use std::fs::{DirBuilder, Permissions};
use std::io::{self, Read, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};

use flankscope_foundation::files::read_regular;

use super::SealError;

const FILE: &str = "station.key";
/// Number of characters of a station's id and of a digest in files.
const ID_CHARACTERS: usize = 16;

#[derive(Clone)]
pub(super) struct Key([u8; 32]);

/// Never printed.
impl std::fmt::Debug for Key {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Key({})", self.id())
    }
}

impl Key {
    /// Reads the key in a folder; creates folder and key if missing.
    pub fn open(folder: &Path) -> Result<Self, SealError> {
        let path = folder.join(FILE);
        let failed = |source| SealError::Key {
            path: path.clone(),
            source,
        };
        DirBuilder::new()
            .recursive(true)
            .mode(0o700)
            .create(folder)
            .map_err(failed)?;
        private(folder)?;
        if !path.exists() {
            make(folder, &path).map_err(failed)?;
        }
        Self::existing(folder)
    }

    /// Reads the key in a folder.
    pub fn existing(folder: &Path) -> Result<Self, SealError> {
        let path = folder.join(FILE);
        let failed = |source| SealError::Key {
            path: path.clone(),
            source,
        };
        private(folder)?;
        private(&path)?;
        let mut key = [0; 32];
        let bytes = read_regular(&path, 1 << 10).map_err(failed)?;
        if bytes.len() != key.len() {
            let what = format!("{} bytes, a key has {}", bytes.len(), key.len());
            return Err(failed(io::Error::new(io::ErrorKind::InvalidData, what)));
        }
        key.copy_from_slice(&bytes);
        Ok(Self(key))
    }

    /// A temporary key for this process only.
    pub fn passing() -> io::Result<Self> {
        random().map(Self)
    }

    /// Public id of the key, which does not reveal it.
    pub fn id(&self) -> String {
        let mut id = self.digest("id", [&b""[..]]);
        id.truncate(ID_CHARACTERS);
        id
    }

    /// Keyed BLAKE3 of a kind and of parts with their lengths, so that parts cannot run together.
    pub fn digest<'a>(&self, kind: &'a str, parts: impl IntoIterator<Item = &'a [u8]>) -> String {
        let mut hasher = blake3::Hasher::new_keyed(&self.0);
        for part in std::iter::once(kind.as_bytes()).chain(parts) {
            hasher.update(&(part.len() as u64).to_le_bytes());
            hasher.update(part);
        }
        hasher.finalize().to_hex().to_string()
    }
}

fn random() -> io::Result<[u8; 32]> {
    let mut key = [0; 32];
    std::fs::File::open("/dev/urandom")?.read_exact(&mut key)?;
    Ok(key)
}

/// Creates the key file atomically, readable by its user only; if two processes create it at the same time, the first one's is kept.
fn make(folder: &Path, path: &Path) -> io::Result<()> {
    let mut file = tempfile::Builder::new()
        .permissions(Permissions::from_mode(0o600))
        .tempfile_in(folder)?;
    file.write_all(&random()?)?;
    file.as_file().sync_all()?;
    match file.persist_noclobber(path) {
        Err(error) if error.error.kind() != io::ErrorKind::AlreadyExists => Err(error.error),
        _ => std::fs::File::open(folder)?.sync_all(),
    }
}

/// Checks that no other user may read or write the key, because it distinguishes this station's files from others'.
fn private(path: &Path) -> Result<(), SealError> {
    let meta = std::fs::symlink_metadata(path).map_err(|source| SealError::Key {
        path: path.to_owned(),
        source,
    })?;
    let mine = meta.uid() == rustix::process::geteuid().as_raw();
    if mine && meta.mode() & 0o077 == 0 && !meta.is_symlink() {
        return Ok(());
    }
    Err(SealError::KeyOpen {
        path: path.to_owned(),
        uid: meta.uid(),
        mode: meta.mode() & 0o7777,
    })
}

/// Folder of the station's key and memory: `FLANKSCOPE_STATE`, else `flankscope` in `XDG_STATE_HOME` or `~/.local/state`.
///
/// # Errors
/// None of these variables is set.
pub(super) fn default_folder() -> Result<PathBuf, SealError> {
    let of = |name: &str| {
        let value = std::env::var_os(name).filter(|value| !value.is_empty());
        value.map(PathBuf::from)
    };
    of("FLANKSCOPE_STATE")
        .or_else(|| Some(of("XDG_STATE_HOME")?.join("flankscope")))
        .or_else(|| Some(of("HOME")?.join(".local/state/flankscope")))
        .ok_or(SealError::NoPlace)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_made_once_for_one_user_alone_and_an_open_one_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path().join("state/flankscope");
        let key = Key::open(&at).unwrap();
        let path = at.join(FILE);
        let mode = |path: &Path| std::fs::metadata(path).unwrap().mode() & 0o7777;
        assert_eq!([mode(&at), mode(&path)], [0o700, 0o600]);
        assert_eq!(Key::open(&at).unwrap().id(), key.id());
        assert_eq!(Key::existing(&at).unwrap().id(), key.id());
        assert!(Key::existing(&folder.path().join("other")).is_err());
        let other = Key::open(&folder.path().join("other")).unwrap();
        assert_ne!(other.id(), key.id());
        assert_ne!(other.digest("a", [&b"b"[..]]), key.digest("a", [&b"b"[..]]));
        assert_ne!(
            key.digest("a", [&b"bc"[..], b"d"]),
            key.digest("a", [&b"b"[..], b"cd"])
        );
        for open in [&path, &at] {
            let was = mode(open);
            std::fs::set_permissions(open, Permissions::from_mode(0o755)).unwrap();
            let error = Key::open(&at).unwrap_err();
            assert!(matches!(error, SealError::KeyOpen { .. }), "{error}");
            std::fs::set_permissions(open, Permissions::from_mode(was)).unwrap();
        }
        std::fs::write(&path, "short").unwrap();
        assert!(Key::open(&at).unwrap_err().to_string().contains("5 bytes"));
    }
}
