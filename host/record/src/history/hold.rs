//! One watch at a time holds a die in a store: two would show two presses, or one press, two verdicts.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use rustix::fs::{FlockOperation, flock};
use serde::{Deserialize, Serialize};

use super::error::HistoryError;
use crate::die::DieKey;

/// Who watches, for others to read.
#[derive(Serialize, Deserialize)]
struct Holder {
    tool: String,
    geometry: String,
    serial: Option<String>,
    who: String,
    since: String,
}

/// A die that is held; let go when it is dropped or the process ends, however it ends.
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

/// Holds a die in the history at `history` for `who`.
pub(super) fn hold(history: &Path, die: &DieKey, who: &str) -> Result<Hold, HistoryError> {
    let mut name = history.as_os_str().to_owned();
    name.push(".watches");
    let folder = PathBuf::from(name);
    let failed = |source| HistoryError::Watches {
        path: folder.clone(),
        source,
    };
    match try_hold(&folder, die, who).map_err(failed)? {
        Ok(hold) => Ok(hold),
        Err(by) => Err(HistoryError::Held {
            path: history.to_owned(),
            tool: by.tool,
            who: by.who,
            since: by.since,
        }),
    }
}

fn try_hold(folder: &Path, die: &DieKey, who: &str) -> io::Result<Result<Hold, Holder>> {
    std::fs::create_dir_all(folder)?;
    // As long as this is held, nobody else looks or begins to hold.
    let all = File::open(folder)?;
    flock(&all, FlockOperation::LockExclusive)?;
    for entry in std::fs::read_dir(folder)?.flatten() {
        let Ok(file) = OpenOptions::new().read(true).write(true).open(entry.path()) else {
            continue;
        };
        if flock(&file, FlockOperation::NonBlockingLockExclusive).is_ok() {
            // Its watch is gone.
            std::fs::remove_file(entry.path())?;
            continue;
        }
        let holder = std::fs::read(entry.path())?;
        let Ok(holder) = serde_json::from_slice::<Holder>(&holder) else {
            continue;
        };
        let held = DieKey {
            tool: holder.tool.clone(),
            geometry: holder.geometry.clone(),
            serial: holder.serial.clone(),
        };
        if held.is_same(die) {
            return Ok(Err(holder));
        }
    }
    let mut file = tempfile::Builder::new()
        .prefix("watch-")
        .suffix(".lock")
        .tempfile_in(folder)?;
    flock(file.as_file(), FlockOperation::NonBlockingLockExclusive)?;
    let holder = Holder {
        tool: die.tool.clone(),
        geometry: die.geometry.clone(),
        serial: die.serial.clone(),
        who: format!("{who}, process {}", std::process::id()),
        since: flankscope_foundation::date::now(),
    };
    file.write_all(&serde_json::to_vec(&holder)?)?;
    let (lock, path) = file.keep().map_err(|error| error.error)?;
    Ok(Ok(Hold { path, _lock: lock }))
}
