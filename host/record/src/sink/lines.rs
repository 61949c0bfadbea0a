//! Writes results as JSON lines, one line per result.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::{ResultSink, SinkError};

/// Size from which a file is put aside before the next line: 6 000 checks of six flanks, three weeks of one in five minutes.
const MOST_BYTES: u64 = 100_000_000;

/// A file that results are appended to. A full one is put aside under the extension `old.jsonl`, in place of the one before, so
/// that a watch does not fill the disk.
#[derive(Clone, Debug)]
pub struct LinesFile {
    path: PathBuf,
    most_bytes: u64,
}

impl LinesFile {
    /// Opens the file, creates it if missing.
    ///
    /// # Errors
    /// It cannot be written to.
    pub fn open(path: &Path) -> Result<Self, SinkError> {
        let lines = Self {
            path: path.to_owned(),
            most_bytes: MOST_BYTES,
        };
        lines.add(b"").map(|()| lines)
    }

    fn put_full_aside(&self) -> Result<(), SinkError> {
        let full = std::fs::metadata(&self.path).is_ok_and(|file| file.len() >= self.most_bytes);
        if !full {
            return Ok(());
        }
        let old = self.path.with_extension("old.jsonl");
        std::fs::rename(&self.path, old).map_err(|source| SinkError::Write {
            path: self.path.clone(),
            source,
        })
    }

    /// Appends bytes in one write, so that lines of other processes are not mixed in.
    fn add(&self, bytes: &[u8]) -> Result<(), SinkError> {
        let Self { path, .. } = self;
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
        self.put_full_aside()?;
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

    /// Lines of eight bytes where 16 are full: the file is put aside before the third and the fifth.
    #[test]
    fn a_full_file_is_put_aside_and_the_one_before_goes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("checks.jsonl");
        let mut lines = LinesFile::open(&path).unwrap();
        lines.most_bytes = 16;
        for number in 1..=5 {
            lines.put(&mut format!("line{number}")).unwrap();
        }
        let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
        assert_eq!(read("checks.jsonl"), "\"line5\"\n");
        assert_eq!(read("checks.old.jsonl"), "\"line3\"\n\"line4\"\n");
    }
}
