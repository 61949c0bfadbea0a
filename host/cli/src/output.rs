//! What every subcommand shares on its way out: the exit code and the `--json` document.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;

/// How a run ended, as the process's exit code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Verdict go, or the requested file was produced.
    Go = 0,
    /// Verdict no-go.
    NoGo = 1,
    /// The instrument cannot tell.
    Indeterminate = 2,
    /// Bad arguments, no link, unreadable file.
    CouldNotRun = 3,
    /// Verdict warn.
    Warn = 4,
}

impl Outcome {
    /// The outcome of a check by the word of its verdict; an unknown word is indeterminate, never go.
    pub fn of_verdict(word: &str) -> Self {
        match word {
            "go" => Self::Go,
            "warn" => Self::Warn,
            "no-go" => Self::NoGo,
            _ => Self::Indeterminate,
        }
    }
}

impl From<Outcome> for ExitCode {
    fn from(outcome: Outcome) -> Self {
        ExitCode::from(outcome as u8)
    }
}

/// Options that every subcommand has.
#[derive(clap::Args, Clone, Debug)]
pub struct Common {
    /// Write the result as JSON to FILE, or to standard output with `-`.
    #[arg(long, value_name = "FILE|-")]
    pub json: Option<PathBuf>,
    /// No progress and no table; errors still go to standard error.
    #[arg(long, short)]
    pub quiet: bool,
}

impl Common {
    /// Writes the JSON document, if one was asked for.
    pub fn write_json<T: serde::Serialize>(&self, document: &T) -> anyhow::Result<()> {
        let Some(path) = &self.json else {
            return Ok(());
        };
        let mut text = serde_json::to_string_pretty(document)?;
        text.push('\n');
        if path == Path::new("-") {
            std::io::stdout().write_all(text.as_bytes())?;
            return Ok(());
        }
        write_whole(path, text.as_bytes())
    }
}

/// Writes a file whole or not at all: beside its place first, then renamed.
///
/// # Errors
/// Names the path when it cannot be written (missing folder, no permission, disk full); the old file, if any, is then untouched.
pub fn write_whole(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    flankscope_station::files::write_whole(path, bytes)
        .with_context(|| format!("cannot write {}", path.display()))
}
