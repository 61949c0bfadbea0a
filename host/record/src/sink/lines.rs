//! Writes results as JSON lines, one line per result.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::{ResultSink, SinkError};

/// A file that results are appended to.
#[derive(Clone, Debug)]
pub struct LinesFile(PathBuf);

impl LinesFile {
    /// Opens the file, creates it if missing.
    ///
    /// # Errors
    /// It cannot be written to.
    pub fn open(path: &Path) -> Result<Self, SinkError> {
        let lines = Self(path.to_owned());
        lines.add(b"").map(|()| lines)
    }

    /// Appends bytes in one write, so that lines of other processes are not mixed in.
    fn add(&self, bytes: &[u8]) -> Result<(), SinkError> {
        let Self(path) = self;
        let add = || -> io::Result<()> {
            let mut options = std::fs::OpenOptions::new();
            let mut file = options.append(true).create(true).open(path)?;
            file.write_all(bytes)
        };
        add().map_err(|source| SinkError::Write {
            path: path.clone(),
            source,
        })
    }
}

impl<R: Serialize> ResultSink<R> for LinesFile {
    fn put(&mut self, result: &mut R) -> Result<(), SinkError> {
        let line = serde_json::to_value(result)?;
        self.add(format!("{line}\n").as_bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_result_is_one_more_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("results.jsonl");
        LinesFile::open(&path).unwrap().put(&mut 1).unwrap();
        LinesFile::open(&path).unwrap().put(&mut "two").unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "1\n\"two\"\n");
        assert!(
            LinesFile::open(folder.path()).is_err(),
            "a folder is no file"
        );
    }
}
