//! Writes a result as one JSON document.

use std::io::Write;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::{ResultSink, SinkError};
use flankscope_foundation::files::write_whole;

/// A file with the latest result, or standard output.
#[derive(Clone, Debug)]
pub struct DocumentFile(PathBuf);

impl DocumentFile {
    /// Writes to a file atomically; to standard output for `-`.
    #[must_use]
    pub fn new(path: &Path) -> Self {
        Self(path.to_owned())
    }
}

/// The text of a document: keys in alphabetical order, so that two results can be compared line by line.
///
/// # Errors
/// A part of the result cannot be written as JSON.
pub fn document_text(result: &impl Serialize) -> Result<String, SinkError> {
    let document = serde_json::to_value(result)?;
    Ok(serde_json::to_string_pretty(&document)?)
}

impl<R: Serialize> ResultSink<R> for DocumentFile {
    fn put(&mut self, result: &mut R) -> Result<(), SinkError> {
        let text = document_text(result)? + "\n";
        let Self(path) = self;
        if path == Path::new("-") {
            let mut out = std::io::stdout().lock();
            let written = out.write_all(text.as_bytes()).and_then(|()| out.flush());
            return written.map_err(SinkError::Output);
        }
        write_whole(path, text.as_bytes()).map_err(|source| SinkError::Write {
            path: path.clone(),
            source,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_document_is_whole_and_one_that_has_no_place_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("result.json");
        let mut result = std::collections::BTreeMap::from([("b", 1), ("a", 2)]);
        DocumentFile::new(&path).put(&mut result).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert_eq!(text, "{\n  \"a\": 2,\n  \"b\": 1\n}\n");
        let nowhere = folder.path().join("gone/result.json");
        let error = DocumentFile::new(&nowhere).put(&mut result).unwrap_err();
        assert!(error.to_string().contains("gone/result.json"), "{error}");
    }
}
