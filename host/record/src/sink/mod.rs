//! Where results go once they are there.
//!
//! The history is the one sink that a verdict waits for: what cannot be stored is no go (`history::HistoryWriter`). All
//! others, documents, lines and pages, leave the verdict as it stands. A sink is one file with one `impl`, wherever what it
//! writes is at home.

mod document;
mod lines;

use std::path::PathBuf;

pub use document::DocumentFile;
pub use document::document_text;
pub use lines::LinesFile;

/// Takes results of one kind.
pub trait ResultSink<R> {
    /// Puts a result where it belongs. A sink that the verdict waits for may take the verdict back; no other changes anything.
    ///
    /// # Errors
    /// It is not written. The verdict stands.
    fn put(&mut self, result: &mut R) -> Result<(), SinkError>;
}

/// Without a sink, a result goes nowhere.
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
#[non_exhaustive]
pub enum SinkError {
    /// The operating system refuses.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Nobody reads on.
    #[error("cannot write to standard output: {0}")]
    Output(std::io::Error),
    /// The result cannot be put into JSON.
    #[error("the result cannot be written as JSON: {0}")]
    Json(#[from] serde_json::Error),
    /// The result cannot be put into a page; the cause is the template engine's.
    #[error("the result cannot be written as a page: {0}")]
    Page(#[source] Box<dyn std::error::Error + Send + Sync>),
}
