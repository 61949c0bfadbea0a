//! Only one watch at a time may run on a die in a history: two would show two presses, or give one press two verdicts.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use rustix::fs::{FlockOperation, flock};
use serde::{Deserialize, Serialize};

use super::error::HistoryError;
use crate::die::DieKey;

/// Entry that tells other processes which die is watched by whom. A history is identified by device and inode, whatever its name.
#[derive(Serialize, Deserialize)]
struct Holder {
    device: u64,
    inode: u64,
    #[serde(flatten)]
    die: DieKey,
    who: String,
    since: String,
}

/// A lock on a die, released when it is dropped or the process ends in any way.
#[derive(Debug)]
pub struct Hold {
    path: PathBuf,
    _lock: File,
}

impl Drop for Hold {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.path);
    }
}

/// Locks a die in the history at `history` for `who`. `folder` is where the station keeps these locks, if it keeps any.
pub(super) fn hold(
    folder: Option<PathBuf>,
    history: &Path,
    die: &DieKey,
    who: &str,
) -> Result<Option<Hold>, HistoryError> {
    let Some(folder) = folder else {
        return Ok(None);
    };
    let failed = |source| HistoryError::Watches {
        path: folder.clone(),
        source,
    };
    match try_hold(&folder, history, die, who).map_err(failed)? {
        Ok(hold) => Ok(Some(hold)),
        Err(by) => Err(HistoryError::Held {
            path: history.to_owned(),
            tool: by.die.tool,
            who: by.who,
            since: by.since,
        }),
    }
}

fn try_hold(
    folder: &Path,
    history: &Path,
    die: &DieKey,
    who: &str,
) -> io::Result<Result<Hold, Holder>> {
    let meta = std::fs::metadata(history)?;
    let (device, inode) = (meta.dev(), meta.ino());
    std::fs::create_dir_all(folder)?;
    // While this lock is held, no other process reads or adds entries.
    let all = File::open(folder)?;
    flock(&all, FlockOperation::LockExclusive)?;
    for entry in std::fs::read_dir(folder)?.flatten() {
        let Ok(file) = OpenOptions::new().read(true).write(true).open(entry.path()) else {
            continue;
        };
        if flock(&file, FlockOperation::NonBlockingLockExclusive).is_ok() {
            // The process of this entry has ended.
            std::fs::remove_file(entry.path())?;
            continue;
        }
        let holder = std::fs::read(entry.path())?;
        let Ok(holder) = serde_json::from_slice::<Holder>(&holder) else {
            continue;
        };
        if (holder.device, holder.inode) == (device, inode) && holder.die.is_same(die) {
            return Ok(Err(holder));
        }
    }
    let mut file = tempfile::Builder::new()
        .prefix("watch-")
        .suffix(".lock")
        .tempfile_in(folder)?;
    flock(file.as_file(), FlockOperation::NonBlockingLockExclusive)?;
    let holder = Holder {
        device,
        inode,
        die: die.clone(),
        who: format!("{who}, process {}", std::process::id()),
        since: flankscope_foundation::date::now(),
    };
    file.write_all(&serde_json::to_vec(&holder)?)?;
    let (lock, path) = file.keep().map_err(|error| error.error)?;
    Ok(Ok(Hold { path, _lock: lock }))
}
