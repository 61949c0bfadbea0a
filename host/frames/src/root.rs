//! The private place of one station's shared memory, and the cleaning up after a killed one.

use std::fs::{DirEntry, File};
use std::io;
use std::path::{Path, PathBuf};

use rustix::fs::{FlockOperation, flock};

/// A private folder for the service files and a private prefix for the shared-memory segments.
///
/// A crash at the wrong moment leaves iceoryx2 service files that no later run can open. So no two runs share any:
/// each owner makes a fresh folder, holds a lock on it while it lives, and sweeps away those whose lock is free.
#[derive(Debug)]
pub struct SharedRoot {
    path: PathBuf,
    prefix: String,
    /// Held by the owner only; the lock goes with the process, however it ends.
    lock: Option<File>,
}

/// Why there is no private place.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RootError {
    /// The folder cannot be made or cleaned.
    #[error(
        "cannot prepare the shared-memory folder {}: {source} (choose another with TMPDIR)", path.display()
    )]
    Folder {
        /// The folder.
        path: PathBuf,
        /// The operating system's word.
        source: io::Error,
    },
}

/// Where the kernel shows POSIX shared memory.
const SHM_FOLDER: &str = "/dev/shm";
const LOCK_FILE: &str = "owner.lock";

impl SharedRoot {
    /// Makes a fresh root under `base` and sweeps away those of dead owners.
    ///
    /// # Errors
    /// The folder cannot be made.
    pub fn create(base: &Path) -> Result<Self, RootError> {
        let failed = |path: &Path| {
            let path = path.to_path_buf();
            move |source| RootError::Folder { path, source }
        };
        std::fs::create_dir_all(base).map_err(failed(base))?;
        // Names are unique while their owner lives: the process id, and a count for several roots of one process.
        static COUNT: std::sync::atomic::AtomicU32 = std::sync::atomic::AtomicU32::new(0);
        sweep(base);
        loop {
            let count = COUNT.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            let prefix = format!("flankscope_{}_{count}_", std::process::id());
            let path = base.join(&prefix);
            match std::fs::create_dir(&path) {
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => continue,
                made => made.map_err(failed(&path))?,
            }
            let lock = File::create(path.join(LOCK_FILE)).map_err(failed(&path))?;
            flock(&lock, FlockOperation::NonBlockingLockExclusive)
                .map_err(|e| failed(&path)(e.into()))?;
            return Ok(Self {
                path,
                prefix,
                lock: Some(lock),
            });
        }
    }

    /// The root that another process owns, by its folder.
    #[must_use]
    pub fn of_owner(path: &Path) -> Self {
        let prefix = path
            .file_name()
            .map(|name| name.to_string_lossy().into_owned())
            .unwrap_or_default();
        Self {
            path: path.to_path_buf(),
            prefix,
            lock: None,
        }
    }

    /// The folder of the service files: what the camera process is told.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Prefix of every shared-memory segment.
    #[must_use]
    pub fn prefix(&self) -> &str {
        &self.prefix
    }

    /// Bytes of all shared-memory segments with its prefix.
    pub(crate) fn segment_bytes(&self) -> u64 {
        segments(&self.prefix)
            .filter_map(|segment| Some(segment.metadata().ok()?.len()))
            .sum()
    }

    /// The default base folder: in the user's runtime folder, else the user's own one in the temporary folder.
    #[must_use]
    pub fn default_base() -> PathBuf {
        std::env::var_os("XDG_RUNTIME_DIR").map_or_else(
            || {
                std::env::temp_dir()
                    .join(format!("flankscope-{}", rustix::process::getuid().as_raw()))
            },
            |runtime| PathBuf::from(runtime).join("flankscope"),
        )
    }
}

impl Drop for SharedRoot {
    fn drop(&mut self) {
        if self.lock.is_some() {
            remove(&self.path, &self.prefix);
        }
    }
}

/// Removes the roots whose owner is gone: their lock is free.
fn sweep(base: &Path) {
    let Ok(entries) = std::fs::read_dir(base) else {
        return;
    };
    for entry in entries.flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        if !name.starts_with("flankscope_") {
            continue;
        }
        // No lock file yet: an owner between making its folder and locking it. Leave it alone.
        let Ok(lock) = File::open(entry.path().join(LOCK_FILE)) else {
            continue;
        };
        if flock(&lock, FlockOperation::NonBlockingLockExclusive).is_ok() {
            tracing::warn!(root = %entry.path().display(), "removing what a killed run left");
            remove(&entry.path(), &name);
        }
    }
}

/// The shared-memory segments with a prefix, as the kernel shows them.
fn segments(prefix: &str) -> impl Iterator<Item = DirEntry> {
    let all = std::fs::read_dir(SHM_FOLDER)
        .into_iter()
        .flatten()
        .flatten();
    all.filter(move |segment| segment.file_name().to_string_lossy().starts_with(prefix))
}

fn remove(path: &Path, prefix: &str) {
    for segment in segments(prefix) {
        let _ = std::fs::remove_file(segment.path());
    }
    let _ = std::fs::remove_dir_all(path);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_live_root_stays_and_a_dead_one_goes() {
        let base = tempfile::tempdir().unwrap();
        let alive = SharedRoot::create(base.path()).unwrap();
        // A dead owner: folder and lock file, nobody holds the lock; and a segment with its prefix.
        let dead = base.path().join("flankscope_0_0_");
        std::fs::create_dir(&dead).unwrap();
        std::fs::write(dead.join(LOCK_FILE), "").unwrap();
        let segment = Path::new(SHM_FOLDER).join(format!("flankscope_0_0_{}", std::process::id()));
        std::fs::write(&segment, "left over").unwrap();
        let other = SharedRoot::create(base.path()).unwrap();
        assert!(alive.path().exists() && other.path().exists());
        assert!(
            !dead.exists() && !segment.exists(),
            "the dead owner's folder and segment are gone"
        );
        let path = other.path().to_path_buf();
        drop(other);
        assert!(!path.exists(), "an owner cleans up after itself");
    }
}
