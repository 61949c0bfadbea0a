//! The private place of one station's shared memory.

use std::io::Write;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

use rustix::process::getuid;

use crate::node;
use crate::private::{RunFolder, SHM_FOLDER, private_file, segments};
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

/// What the library calls the counter that all processes of a root share, behind the root's prefix.
const COUNTER: &str = "9204dd183d1c4d8e1ff592a30766ffa6765aa8b5_node.0_10_0.global_mgmt";
/// Its content: the library's version 0.10.0, then the count and padding.
const COUNTER_START: [u8; 16] = [0, 0, 10, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];

/// Fresh names that are tried: what made one unusable cannot have foreseen the next.
const TRIES: u32 = 3;

impl SharedRoot {
    /// Makes a fresh root under `base` and sweeps away those of dead owners.
    ///
    /// The library would make the counter writable for everybody, and whoever opened it then could spoil it for as long as they
    /// like. It takes one that is there already: it is made here, for this user alone from the first moment.
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
            let Err(reason) = root.begin() else {
                return Ok(root);
            };
            let culprit = root.open_to_others().join(", ");
            tracing::warn!(
                reason,
                culprit,
                "shared memory cannot be used; another name is taken"
            );
            if tries == TRIES {
                return Err(RootError::Spoiled {
                    tries,
                    reason,
                    culprit,
                });
            }
        }
    }

    /// Makes the counter, and sees that the library uses it; otherwise says why not.
    fn begin(&self) -> Result<(), String> {
        let counter = Path::new(SHM_FOLDER).join(format!("{}{COUNTER}", self.prefix));
        let made = private_file().create_new(true).open(&counter);
        made.and_then(|mut file| file.write_all(&COUNTER_START))
            .map_err(|error| format!("{}: {error}", counter.display()))?;
        node::make(self.path(), self.prefix()).map_err(|error| error.to_string())?;
        match std::fs::read(&counter) {
            Ok(now) if now != COUNTER_START => Ok(()),
            _ => Err(format!(
                "{} is not what the library counts with",
                counter.display()
            )),
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
        let counter = Path::new(SHM_FOLDER).join(format!("{}{COUNTER}", bare.prefix()));
        assert!(
            open.len() == 1 && open[0].starts_with(&*counter.to_string_lossy()),
            "{open:?}"
        );
        // It counts one node.
        let mut content = std::fs::read(&counter).unwrap();
        content[8] -= 1;
        assert_eq!(content, COUNTER_START);
        for segment in segments(bare.prefix()) {
            std::fs::remove_file(segment.path()).unwrap();
        }
    }
}
