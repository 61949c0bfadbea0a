//! Names of the files beside a history: its own name with something after it.

use std::path::{Path, PathBuf};

/// The history's path with `suffix` after its name.
pub(crate) fn beside(history: &Path, suffix: &str) -> PathBuf {
    let mut name = history.as_os_str().to_owned();
    name.push(suffix);
    name.into()
}
