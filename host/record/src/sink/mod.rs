//! Outputs for results.
//!
//! The history is the only sink that a verdict waits for: a result that cannot be stored is not a "go"
//! (`history::HistoryWriter`). All other sinks (documents, lines, pages) do not affect the verdict. A sink is one file with one
//! `impl`, in the crate that owns its format.

mod document;
mod lines;

use std::path::PathBuf;

pub use document::DocumentFile;
pub use document::document_text;
pub use lines::LinesFile;

/// Takes results of one kind.
pub trait ResultSink<R> {
    /// Writes a result. A sink that the verdict waits for may revoke the verdict; no other changes it.
    ///
    /// # Errors
    /// The result is not written. The verdict stands.
    fn put(&mut self, result: &mut R) -> Result<(), SinkError>;
}

/// `None` discards results.
impl<R, S: ResultSink<R>> ResultSink<R> for Option<S> {
    fn put(&mut self, result: &mut R) -> Result<(), SinkError> {
        self.as_mut().map_or(Ok(()), |sink| sink.put(result))
    }
}

impl<R, S: ResultSink<R>> ResultSink<R> for &mut S {
    fn put(&mut self, result: &mut R) -> Result<(), SinkError> {
        (**self).put(result)
    }
}

/// Why a result was not written.
#[derive(Debug, thiserror::Error)]
pub enum SinkError {
    /// The operating system returned an error.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Reason.
        source: std::io::Error,
    },
    /// The reader of the output closed it.
    #[error("cannot write to standard output: {0}")]
    Output(std::io::Error),
    #[error("the result cannot be written as JSON: {0}")]
    Json(#[from] serde_json::Error),
    /// The result cannot be rendered as a page; the cause is the template engine's.
    #[error("the result cannot be written as a page: {0}")]
    Page(#[source] Box<dyn std::error::Error + Send + Sync>),
}
