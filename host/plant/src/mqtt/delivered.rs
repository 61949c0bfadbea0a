//! How far the broker has the history: a small file, written whole and flushed to the disk after every acknowledgement.

use std::collections::BTreeMap;
use std::path::Path;

use flankscope_foundation::files::write_whole_with_mode;
use flankscope_foundation::textfile::{self, TextFileError};
use serde::{Deserialize, Serialize};

/// The last check that the broker has.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Delivered {
    /// Its number; 0 before the first.
    pub number: i64,
    /// Its id, which tells whether the history is still the one it was of.
    pub id: String,
    /// Number of the last connection, 0 to 255, by which Sparkplug B tells a late death from a current one.
    pub connection: u8,
    /// Messages that the broker retains under each topic below this station's, so that a process that starts anew can take them back.
    #[serde(default)]
    pub retained: BTreeMap<String, String>,
}

/// Largest such file, bytes.
const MOST_BYTES: u64 = 1 << 20;

impl Delivered {
    /// Reads the file; none means that nothing was delivered.
    ///
    /// # Errors
    /// It is there and cannot be read.
    pub fn load(path: &Path) -> Result<Self, TextFileError> {
        match textfile::load_toml(path, MOST_BYTES, |_| Ok(())) {
            Ok((delivered, _)) => Ok(delivered),
            Err(TextFileError::Read { source, .. })
                if source.kind() == std::io::ErrorKind::NotFound =>
            {
                Ok(Self::default())
            }
            Err(error) => Err(error),
        }
    }

    /// Writes the file.
    ///
    /// # Errors
    /// The operating system's.
    pub fn store(&self, path: &Path) -> anyhow::Result<()> {
        use anyhow::Context;
        let text = toml::to_string(self)?;
        write_whole_with_mode(path, text.as_bytes(), 0o640)
            .with_context(|| format!("[mqtt] delivered = \"{}\"", path.display()))
    }
}
