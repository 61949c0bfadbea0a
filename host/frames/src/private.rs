//! Folders of one run, in a place where nobody else can have made anything, and the sweeping away of what a killed run left.
//!
//! The protocol, for any number of processes of one user:
//!
//! * A folder is made, and its lock file in it locked, while the base's own lock is held.
//! * Whoever works in a folder, its maker and the processes that it started, holds a shared lock on its lock file. Locks end
//!   with their process, however that ends.
//! * The sweep holds the base's lock. A folder whose lock file it can lock exclusively, or that has none, is nobody's: it goes,
//!   with the shared memory of its name. As long as the sweep holds both locks, nobody can begin to work in it.

use std::ffi::OsStr;
use std::fs::{DirBuilder, DirEntry, File, Metadata, OpenOptions, Permissions};
use std::io;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, OnceLock};
use std::time::{Duration, Instant};

use rustix::fs::{FlockOperation, OFlags, flock};
use rustix::process::getuid;

use crate::root_error::RootError;

/// Where the kernel shows POSIX shared memory.
pub(crate) const SHM_FOLDER: &str = "/dev/shm";
/// What every folder of a run is called, before what is drawn.
const PREFIX: &str = "flankscope_";
const LOCK_FILE: &str = "owner.lock";
const BASE_LOCK: &str = ".lock";
/// Making and sweeping take milliseconds; who waits longer for the base's lock waits for a process that stands still.
const PATIENCE: Duration = Duration::from_secs(20);

/// The folders that this process has made and not removed yet.
static MADE: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// A folder of this run alone, with a lock on it; gone when the run ends, or swept away by the next one's start.
#[derive(Debug)]
pub struct RunFolder {
    path: PathBuf,
    /// Held while somebody works in it.
    _lock: File,
    /// Whether this is its maker, who removes it.
    made: bool,
}

impl RunFolder {
    /// Makes a fresh folder below `base`, which must be nobody else's, and sweeps away those of dead owners.
    ///
    /// # Errors
    /// The base is not private, or nothing can be made there.
    pub fn create(base: &Path) -> Result<Self, RootError> {
        let failed = |source| RootError::Folder {
            path: base.to_owned(),
            source,
        };
        make_private(base).map_err(failed)?;
        let _base = lock_of_base(base)?;
        sweep(base);
        // An unused name that nobody can foresee: nobody can have prepared shared memory of that name.
        let folder = tempfile::Builder::new()
            .prefix(PREFIX)
            .rand_bytes(6)
            .permissions(Permissions::from_mode(0o700))
            .tempdir_in(base)
            .map_err(failed)?;
        let lock = private_file()
            .create_new(true)
            .open(folder.path().join(LOCK_FILE))
            .map_err(failed)?;
        flock(&lock, FlockOperation::NonBlockingLockShared).map_err(|e| failed(e.into()))?;
        let path = folder.keep();
        if let Ok(mut made) = MADE.lock() {
            made.push(path.clone());
        }
        Ok(Self {
            path,
            _lock: lock,
            made: true,
        })
    }

    /// The folder that another process made, while it lives: it is not swept away as long as this one works in it.
    ///
    /// # Errors
    /// The folder is not there, or its owner is gone.
    pub fn of_owner(path: &Path) -> Result<Self, RootError> {
        let failed = |source| RootError::Gone {
            path: path.to_owned(),
            source,
        };
        let lock = private_file().open(path.join(LOCK_FILE)).map_err(failed)?;
        flock(&lock, FlockOperation::NonBlockingLockShared).map_err(|e| failed(e.into()))?;
        Ok(Self {
            path: path.to_owned(),
            _lock: lock,
            made: false,
        })
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Its own name, as a prefix of everything outside the folder that goes with it.
    pub(crate) fn name(&self) -> String {
        let name = self.path.file_name().map(OsStr::to_string_lossy);
        name.unwrap_or_default().into_owned()
    }
}

impl Drop for RunFolder {
    fn drop(&mut self) {
        if self.made {
            remove(&self.path, &self.name());
            if let Ok(mut made) = MADE.lock() {
                made.retain(|path| *path != self.path);
            }
        }
    }
}

/// Removes the folders that this process has made, and their shared memory: for one that ends at once. Whoever still works in
/// them gets errors.
pub fn remove_run_folders() {
    let Ok(mut made) = MADE.lock() else { return };
    for path in made.drain(..) {
        let name = path.file_name().map(OsStr::to_string_lossy);
        remove(&path, &name.unwrap_or_default());
    }
}

/// The base of this user's run folders: `flankscope` in the user's runtime folder, else `flankscope-UID` in the temporary
/// folder; where somebody else has that name, one that nobody could foresee. Looked for once in a process, and said once.
///
/// # Errors
/// Anybody may exchange folders in the temporary folder, or nothing can be made there.
pub fn default_base() -> Result<PathBuf, RootError> {
    static BASE: OnceLock<PathBuf> = OnceLock::new();
    if let Some(base) = BASE.get() {
        return Ok(base.clone());
    }
    let base = look_for_base()?;
    Ok(BASE.get_or_init(|| base).clone())
}

fn look_for_base() -> Result<PathBuf, RootError> {
    let runtime = std::env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from);
    base_of(runtime.as_deref(), &std::env::temp_dir())
}

fn base_of(runtime: Option<&Path>, temporary: &Path) -> Result<PathBuf, RootError> {
    let Some(runtime) = runtime.filter(|runtime| is_private(runtime)) else {
        return base_in(temporary);
    };
    let name = name_in_temporary();
    sweep_free(&temporary.join(&name));
    fallbacks(temporary, &name).for_each(|fallback| sweep_free(&fallback));
    Ok(runtime.join("flankscope"))
}

fn name_in_temporary() -> String {
    format!("flankscope-{}", getuid().as_raw())
}

/// Bases of this user that earlier starts made because somebody else had the usual one's name.
fn fallbacks(temporary: &Path, name: &str) -> impl Iterator<Item = PathBuf> {
    let beginning = format!("{name}-");
    let entries = std::fs::read_dir(temporary).into_iter().flatten().flatten();
    let others = entries.filter(move |entry| {
        let other = entry.file_name();
        other.to_string_lossy().starts_with(&beginning)
    });
    others
        .map(|entry| entry.path())
        .filter(|path| is_private(path))
}

/// Sweeps a base in which perhaps nobody starts ever again.
fn sweep_free(base: &Path) {
    if is_private(base)
        && let Ok(_base) = lock_of_base(base)
    {
        sweep(base);
    }
}

fn base_in(temporary: &Path) -> Result<PathBuf, RootError> {
    let failed = |source| RootError::Folder {
        path: temporary.to_owned(),
        source,
    };
    let meta = std::fs::metadata(temporary).map_err(failed)?;
    let open_to_others = meta.mode() & 0o022 != 0;
    let of_stranger = ![0, getuid().as_raw()].contains(&meta.uid());
    if of_stranger || open_to_others && meta.mode() & 0o1000 == 0 {
        return Err(RootError::Exchangeable {
            path: temporary.to_owned(),
            uid: meta.uid(),
            mode: meta.mode() & 0o7777,
        });
    }
    let name = name_in_temporary();
    let usual = temporary.join(&name);
    match make_private(&usual) {
        Ok(()) => {
            fallbacks(temporary, &name).for_each(|fallback| sweep_free(&fallback));
            return Ok(usual);
        }
        Err(error) => {
            tracing::warn!(%error, "somebody else may write to {}: another folder is taken", usual.display());
        }
    }
    // One that is there, so that there are not ever more of them.
    if let Some(mine) = fallbacks(temporary, &name).next() {
        return Ok(mine);
    }
    let fresh = tempfile::Builder::new()
        .prefix(&format!("{name}-"))
        .rand_bytes(4)
        .permissions(Permissions::from_mode(0o700))
        .tempdir_in(temporary)
        .map_err(failed)?;
    Ok(fresh.keep())
}

/// Whether a path is a folder, no link to one, that only this user may write to.
fn is_private(path: &Path) -> bool {
    let mine = |meta: &Metadata| meta.uid() == getuid().as_raw() && meta.mode() & 0o022 == 0;
    std::fs::symlink_metadata(path).is_ok_and(|meta| meta.is_dir() && mine(&meta))
}

/// Makes a folder for this user alone, or takes one that only this user can have written to.
fn make_private(path: &Path) -> io::Result<()> {
    if let Err(error) = DirBuilder::new().mode(0o700).recursive(false).create(path)
        && error.kind() != io::ErrorKind::AlreadyExists
    {
        return Err(error);
    }
    let meta = std::fs::symlink_metadata(path)?;
    if !is_private(path) {
        let what = if meta.is_dir() {
            "folder"
        } else {
            "file or link"
        };
        return Err(io::Error::new(
            io::ErrorKind::PermissionDenied,
            format!(
                "the {what} {} is of user {} with mode {:o}; it must be a folder of user {} that nobody else may write to",
                path.display(),
                meta.uid(),
                meta.mode() & 0o7777,
                getuid().as_raw()
            ),
        ));
    }
    // One that was made otherwise is closed to others.
    if meta.mode() & 0o077 != 0 {
        std::fs::set_permissions(path, Permissions::from_mode(0o700))?;
    }
    Ok(())
}

/// Opens for reading and writing, never through a link, for this user alone where it is made.
pub(crate) fn private_file() -> OpenOptions {
    let mut options = OpenOptions::new();
    options
        .read(true)
        .write(true)
        .mode(0o600)
        .custom_flags(OFlags::NOFOLLOW.bits() as i32);
    options
}

fn lock_of_base(base: &Path) -> Result<File, RootError> {
    let path = base.join(BASE_LOCK);
    let failed = |source| RootError::Folder {
        path: path.clone(),
        source,
    };
    let file = private_file()
        .create(true)
        .truncate(false)
        .open(&path)
        .map_err(failed)?;
    let end = Instant::now() + PATIENCE;
    loop {
        match flock(&file, FlockOperation::NonBlockingLockExclusive) {
            Ok(()) => return Ok(file),
            Err(rustix::io::Errno::WOULDBLOCK) if Instant::now() < end => {
                std::thread::sleep(Duration::from_millis(5));
            }
            Err(error) => return Err(failed(error.into())),
        }
    }
}

/// Removes the folders that nobody works in. The base's lock is held.
fn sweep(base: &Path) {
    for entry in std::fs::read_dir(base).into_iter().flatten().flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let path = entry.path();
        if !name.starts_with(PREFIX) || !is_private(&path) {
            continue;
        }
        let lock = private_file().open(path.join(LOCK_FILE));
        let free = match &lock {
            Ok(lock) => flock(lock, FlockOperation::NonBlockingLockExclusive).is_ok(),
            // Its maker, or an earlier sweep, was killed before or after there was one.
            Err(error) => error.kind() == io::ErrorKind::NotFound,
        };
        if free {
            tracing::info!(folder = %path.display(), "removing what a killed run left");
            remove(&path, &name);
        }
    }
}

/// The shared-memory segments with a prefix, as the kernel shows them.
pub(crate) fn segments(prefix: &str) -> impl Iterator<Item = DirEntry> {
    let all = std::fs::read_dir(SHM_FOLDER)
        .into_iter()
        .flatten()
        .flatten();
    all.filter(move |segment| segment.file_name().to_string_lossy().starts_with(prefix))
}

/// Segments first: what is left of a removal that is cut short still has its folder, and goes with the next sweep.
fn remove(path: &Path, prefix: &str) {
    for segment in segments(prefix) {
        let _ = std::fs::remove_file(segment.path());
    }
    let _ = std::fs::remove_dir_all(path);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mode(path: &Path) -> u32 {
        std::fs::symlink_metadata(path).unwrap().mode() & 0o7777
    }

    #[test]
    fn a_live_folder_stays_and_a_dead_one_goes_with_its_shared_memory() {
        let base = tempfile::tempdir().unwrap();
        let alive = RunFolder::create(base.path()).unwrap();
        // Two dead owners: one left a lock file that nobody holds, one was killed before it had made it.
        let mut segments = Vec::new();
        for (name, locked) in [("flankscope_0_0_", true), ("flankscope_dead_", false)] {
            let dead = base.path().join(name);
            std::fs::create_dir(&dead).unwrap();
            if locked {
                std::fs::write(dead.join(LOCK_FILE), "").unwrap();
            }
            let segment = Path::new(SHM_FOLDER).join(format!("{name}{}", std::process::id()));
            std::fs::write(&segment, "left over").unwrap();
            segments.push((dead, segment));
        }
        let other = RunFolder::create(base.path()).unwrap();
        assert!(alive.path().exists() && other.path().exists());
        for (dead, segment) in segments {
            assert!(!dead.exists() && !segment.exists(), "{}", dead.display());
        }
        let path = other.path().to_path_buf();
        drop(other);
        assert!(!path.exists(), "an owner cleans up after itself");
    }

    #[test]
    fn a_folder_in_which_a_child_still_works_stays_though_its_maker_is_gone() {
        let base = tempfile::tempdir().unwrap();
        let mut maker = RunFolder::create(base.path()).unwrap();
        let child = RunFolder::of_owner(maker.path()).unwrap();
        let path = maker.path().to_path_buf();
        // Killed: it removes nothing, and its lock is gone.
        maker.made = false;
        drop(maker);
        drop(RunFolder::create(base.path()).unwrap());
        assert!(path.exists());
        drop(child);
        drop(RunFolder::create(base.path()).unwrap());
        assert!(!path.exists());
        assert!(matches!(
            RunFolder::of_owner(&path),
            Err(RootError::Gone { .. })
        ));
    }

    #[test]
    fn nobody_else_may_look_into_it() {
        let temporary = tempfile::tempdir().unwrap();
        let base = base_in(temporary.path()).unwrap();
        let folder = RunFolder::create(&base).unwrap();
        assert_eq!([mode(&base), mode(folder.path())], [0o700; 2]);
        // One that others may read is closed.
        std::fs::set_permissions(&base, Permissions::from_mode(0o755)).unwrap();
        let again = RunFolder::create(&base).unwrap();
        assert_eq!(mode(&base), 0o700);
        assert_eq!(mode(&again.path().join(LOCK_FILE)), 0o600);
    }

    #[test]
    fn what_somebody_else_may_have_made_is_not_taken() {
        let temporary = tempfile::tempdir().unwrap();
        let mine = getuid().as_raw();
        let usual = temporary.path().join(format!("flankscope-{mine}"));
        let elsewhere = temporary.path().join("elsewhere");
        std::fs::create_dir(&elsewhere).unwrap();
        let taken = |prepare: &dyn Fn()| {
            prepare();
            let base = base_in(temporary.path()).unwrap();
            let again = base_in(temporary.path()).unwrap();
            assert_eq!(base, again, "not one more with every start");
            assert_eq!(mode(&base), 0o700);
            base
        };
        // Open to everybody; then a link; then another user's.
        let open = taken(&|| {
            std::fs::create_dir(&usual).unwrap();
            std::fs::set_permissions(&usual, Permissions::from_mode(0o777)).unwrap();
        });
        let link = taken(&|| {
            std::fs::remove_dir(&usual).unwrap();
            std::os::unix::fs::symlink(&elsewhere, &usual).unwrap();
        });
        assert!(open != usual && link == open, "{}", open.display());
        // What a killed run left there goes once the usual name is free.
        let leave = |base: &Path| {
            let left = base.join("flankscope_0_0_");
            std::fs::create_dir(&left).unwrap();
            std::fs::write(left.join(LOCK_FILE), "").unwrap();
            left
        };
        let left = leave(&open);
        std::fs::remove_file(&usual).unwrap();
        assert_eq!(base_in(temporary.path()).unwrap(), usual);
        assert!(!left.exists());
        // So does what was left in either, once there is a folder of the session.
        let left = [leave(&open), leave(&usual)];
        let runtime = tempfile::tempdir().unwrap();
        let base = base_of(Some(runtime.path()), temporary.path()).unwrap();
        assert!(base.starts_with(runtime.path()));
        assert!(left.iter().all(|left| !left.exists()), "{left:?}");
        std::fs::remove_dir_all(&usual).unwrap();
        std::os::unix::fs::symlink(&elsewhere, &usual).unwrap();
        if mine == 0 {
            let foreign = taken(&|| {
                std::fs::remove_file(&usual).unwrap();
                std::fs::create_dir(&usual).unwrap();
                std::os::unix::fs::chown(&usual, Some(65_534), None).unwrap();
            });
            assert_eq!(foreign, open);
        } else {
            eprintln!("SKIPPED: another user's folder, only root can make one");
        }
        assert_eq!(std::fs::read_dir(&elsewhere).unwrap().count(), 0);
    }

    #[test]
    fn a_temporary_folder_in_which_anybody_may_exchange_folders_is_refused() {
        let temporary = tempfile::tempdir().unwrap();
        let open = |mode| {
            std::fs::set_permissions(temporary.path(), Permissions::from_mode(mode)).unwrap();
            base_in(temporary.path())
        };
        let error = open(0o777).unwrap_err();
        assert!(matches!(error, RootError::Exchangeable { .. }), "{error}");
        assert!(open(0o1777).is_ok());
    }
}
