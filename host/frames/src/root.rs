//! The private place of one station's shared memory.

use std::os::unix::fs::MetadataExt;
use std::path::Path;

use rustix::process::getuid;

use crate::node;
use crate::private::{RunFolder, segments};
use crate::root_error::{LONGEST_BASE, RootError};

/// A private folder for the service files and a private prefix for the shared-memory segments.
///
/// A crash at the wrong moment leaves iceoryx2 service files that no later run can open. So no two runs share any:
/// each owner makes a fresh folder (see [`RunFolder`]), whose name is the prefix of its segments.
#[derive(Debug)]
pub struct SharedRoot {
    folder: RunFolder,
    prefix: String,
}

/// A spoiled root is an attack or an accident within microseconds; three in a row are neither.
const TRIES: u32 = 3;

impl SharedRoot {
    /// Makes a fresh root under `base` and sweeps away those of dead owners.
    ///
    /// The library makes the counter that all processes of a root share writable for everybody, and asks nobody. It is made
    /// here, before anything else, and closed to others. Who spoils it within that moment spoils a root of which
    /// nothing is used yet: another one is taken.
    ///
    /// # Errors
    /// The folder cannot be made, or shared memory cannot be used.
    pub fn create(base: &Path) -> Result<Self, RootError> {
        if base.as_os_str().len() > LONGEST_BASE {
            let path = base.to_owned();
            return Err(RootError::Long { path });
        }
        let mut tries = 0;
        loop {
            tries += 1;
            let folder = RunFolder::create(base)?;
            let prefix = folder.name();
            let root = Self { folder, prefix };
            match node::make(root.path(), root.prefix()).map(drop) {
                Ok(()) => {
                    root.close_to_others();
                    return Ok(root);
                }
                Err(error) => {
                    let (reason, culprit) = (error.to_string(), root.open_to_others().join(", "));
                    tracing::warn!(%reason, culprit, "shared memory is spoiled; another name is taken");
                    if tries == TRIES {
                        return Err(RootError::Spoiled {
                            tries,
                            reason,
                            culprit,
                        });
                    }
                }
            }
        }
    }

    /// The root that another process owns, by its folder; it stays while this process works in it.
    ///
    /// # Errors
    /// Its owner is gone.
    pub fn of_owner(path: &Path) -> Result<Self, RootError> {
        let folder = RunFolder::of_owner(path)?;
        let prefix = folder.name();
        Ok(Self { folder, prefix })
    }

    /// The folder of the service files: what the camera process is told.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.folder.path()
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

    fn close_to_others(&self) {
        use std::os::unix::fs::PermissionsExt;
        let closed = std::fs::Permissions::from_mode(0o600);
        for segment in segments(&self.prefix) {
            let _ = std::fs::set_permissions(segment.path(), closed.clone());
        }
    }

    /// Segments of this root that others made or may write to, each with owner and mode.
    fn open_to_others(&self) -> Vec<String> {
        segments(&self.prefix)
            .filter_map(|segment| {
                let meta = segment.metadata().ok()?;
                let open = meta.mode() & 0o022 != 0 || meta.uid() != getuid().as_raw();
                let path = segment.path();
                open.then(|| {
                    format!(
                        "{} (user {}, mode {:o})",
                        path.display(),
                        meta.uid(),
                        meta.mode() & 0o7777
                    )
                })
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::receiver::FrameReceiver;

    #[test]
    fn the_longest_base_works_and_a_longer_one_is_named() {
        let folder = tempfile::tempdir_in("/tmp").unwrap();
        let of_length = |length: usize| {
            let rest = length - folder.path().as_os_str().len() - 1;
            SharedRoot::create(&folder.path().join("x".repeat(rest)))
        };
        let root = of_length(LONGEST_BASE).unwrap();
        FrameReceiver::create(&root).unwrap();
        let error = of_length(LONGEST_BASE + 1).unwrap_err();
        assert!(matches!(error, RootError::Long { .. }), "{error}");
    }

    #[test]
    fn nothing_in_shared_memory_is_open_to_others() {
        let base = tempfile::tempdir().unwrap();
        let root = SharedRoot::create(base.path()).unwrap();
        let receiver = FrameReceiver::create(&root).unwrap();
        assert!(
            segments(root.prefix()).count() >= 3,
            "the test looks at segments"
        );
        assert_eq!(root.open_to_others(), Vec::<String>::new());
        drop(receiver);
        // The test sees what the library leaves by itself.
        let bare = SharedRoot {
            prefix: format!("{}_bare", root.prefix()),
            folder: RunFolder::create(base.path()).unwrap(),
        };
        drop(node::make(bare.path(), bare.prefix()).unwrap());
        let open = bare.open_to_others();
        assert!(
            open.len() == 1 && open[0].contains("global_mgmt"),
            "{open:?}"
        );
        for segment in segments(bare.prefix()) {
            std::fs::remove_file(segment.path()).unwrap();
        }
    }
}
