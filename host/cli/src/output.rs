//! Common output of all subcommands: the exit code and the `--json` document.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;
use flankscope_metrology::verdict::Word;
use flankscope_record::sink::{DocumentFile, ResultSink};
use flankscope_report::ReportFolder;

use crate::terminal::Terminal;

/// How a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The requested output was produced; nothing was judged.
    Done,
    /// A verdict was reached.
    Verdict(Word),
    /// Bad arguments, no link, unreadable file.
    CouldNotRun,
}

impl Outcome {
    /// The request has no reliable answer.
    pub const INDETERMINATE: Self = Self::Verdict(Word::Indeterminate);
}

impl From<Outcome> for ExitCode {
    fn from(outcome: Outcome) -> Self {
        match outcome {
            Outcome::Done => Self::SUCCESS,
            Outcome::Verdict(word) => Self::from(word.exit_code()),
            Outcome::CouldNotRun => Self::from(3),
        }
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
    /// Whether a table is printed on standard output.
    pub fn shows_table(&self) -> bool {
        !self.quiet && self.json.as_deref() != Some(Path::new("-"))
    }

    /// Checks before anything moves that the JSON document can be written.
    pub fn try_json(&self) -> anyhow::Result<()> {
        match &self.json {
            Some(path) if path != Path::new("-") => try_place(path).context("--json"),
            _ => Ok(()),
        }
    }

    /// Destination of the JSON document, if one was requested.
    pub fn document(&self) -> Option<DocumentFile> {
        self.json.as_deref().map(DocumentFile::new)
    }

    /// Writes the JSON document, if one was requested.
    pub fn write_json<T: serde::Serialize>(&self, document: &T) -> anyhow::Result<()> {
        let Some(path) = &self.json else {
            return Ok(());
        };
        let mut text = serde_json::to_string_pretty(document)?;
        text.push('\n');
        if path == Path::new("-") {
            let mut out = std::io::stdout().lock();
            return out
                .write_all(text.as_bytes())
                .and_then(|()| out.flush())
                .context("cannot write to standard output");
        }
        write_whole(path, text.as_bytes())
    }
}

/// Writes a file atomically: to a temporary name in its folder first, then renamed.
///
/// # Errors
/// Names the path when it cannot be written (missing folder, no permission, disk full); the old file, if any, is then untouched.
pub fn write_whole(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    flankscope_foundation::files::write_whole(path, bytes)
        .with_context(|| format!("cannot write {}", path.display()))
}

/// Checks before anything moves that a file can be written later; an existing one is not changed.
///
/// # Errors
/// Names the path and why it cannot be written.
pub fn try_place(path: &Path) -> anyhow::Result<()> {
    flankscope_foundation::files::try_place(path)
        .with_context(|| format!("cannot write {}", path.display()))
}

/// Creates a folder for results and checks before anything moves that these files in it can be written.
///
/// # Errors
/// Names the path and why it cannot be made or written.
pub fn try_folder(folder: &Path, files: &[&str]) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    files
        .iter()
        .try_for_each(|file| try_place(&folder.join(file)))
}

/// Creates a folder for reports and checks that its files can be written.
pub fn try_report(folder: &Path, files: &[&str]) -> anyhow::Result<()> {
    try_folder(folder, files)?;
    let pages = folder.join(ReportFolder::PAGES);
    flankscope_foundation::files::make_folder_within(&pages)
        .with_context(|| format!("cannot make the folder {}", pages.display()))?;
    try_place(&pages.join("page.html"))
}

/// An error with its causes, each once: many errors repeat their cause in their own text.
pub fn in_words(error: &anyhow::Error) -> String {
    let mut words = String::new();
    for cause in error.chain().map(ToString::to_string) {
        // A file name may contain line breaks.
        let cause = cause.replace('\n', "\\n");
        if !words.contains(&cause) {
            if !words.is_empty() {
                words += ": ";
            }
            words += &cause;
        }
    }
    words
}

/// Checks a folder for recorded frames or clouds, named by `index`, which must not exist yet or be empty: otherwise one recording
/// would be mistaken for another.
///
/// # Errors
/// As [`try_folder`], or the folder is not empty.
pub fn try_recording(folder: &Path, index: &str) -> anyhow::Result<()> {
    try_folder(folder, &[index])?;
    let mut entries =
        std::fs::read_dir(folder).with_context(|| format!("cannot list {}", folder.display()))?;
    anyhow::ensure!(
        entries.next().is_none(),
        "{} is not empty: a recording is saved into an empty folder, or one that is not there yet",
        folder.display()
    );
    Ok(())
}

/// Prints on standard error; a failure to print is ignored.
pub fn say(text: &str) {
    let _ = writeln!(
        std::io::stderr(),
        "{}",
        Terminal::of_stderr().sentence(text)
    );
}

/// Errors of writing reports after the verdict. They change neither the verdict nor the exit code, and do not prevent further reports.
#[derive(Debug, Default)]
pub struct Complaints(Vec<anyhow::Error>);

impl Complaints {
    /// Collects an error; returns the value of a success.
    pub fn hear<T>(&mut self, result: anyhow::Result<T>) -> Option<T> {
        result.map_err(|error| self.0.push(error)).ok()
    }

    /// Writes a result to a sink and collects its error.
    pub fn hear_of<R>(&mut self, mut sink: impl ResultSink<R>, result: &mut R) {
        self.hear(sink.put(result).map_err(Into::into));
    }

    /// Prints the collected errors on standard error, with the verdict and its reason for users who see only that. Prints in any
    /// case why a verdict could not be printed. Returns the verdict's outcome.
    pub fn end(self, verdict: Word, sentence: &str, quiet: bool) -> Outcome {
        for error in &self.0 {
            say(&format!("error: {}", in_words(error)));
        }
        if !self.0.is_empty() {
            say(&format!("the verdict stands: {sentence}"));
        } else if quiet && verdict == Word::Indeterminate {
            say(sentence);
        }
        Outcome::Verdict(verdict)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_cause_is_said_once() {
        #[derive(Debug)]
        struct Named(std::io::Error);
        impl std::fmt::Display for Named {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                write!(f, "tool.toml: {}", self.0)
            }
        }
        impl std::error::Error for Named {
            fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
                Some(&self.0)
            }
        }
        let missing = || std::io::Error::from_raw_os_error(2);
        let error = anyhow::Error::from(Named(missing())).context("cannot begin");
        let os = missing().to_string();
        assert_eq!(in_words(&error), format!("cannot begin: tool.toml: {os}"));
    }
}
