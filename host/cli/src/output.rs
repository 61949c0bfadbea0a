//! What every subcommand shares on its way out: the exit code and the `--json` document.

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
    /// What was asked for was produced; nothing was judged.
    Done,
    /// Something was judged.
    Verdict(Word),
    /// Bad arguments, no link, unreadable file.
    CouldNotRun,
}

impl Outcome {
    /// What was asked for has no sound answer.
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
    /// Whether a table goes to standard output.
    pub fn shows_table(&self) -> bool {
        !self.quiet && self.json.as_deref() != Some(Path::new("-"))
    }

    /// Tries whether the JSON document will have a place, before anything moves.
    pub fn try_json(&self) -> anyhow::Result<()> {
        match &self.json {
            Some(path) if path != Path::new("-") => try_place(path).context("--json"),
            _ => Ok(()),
        }
    }

    /// Where the JSON document of a result goes, if one was asked for.
    pub fn document(&self) -> Option<DocumentFile> {
        self.json.as_deref().map(DocumentFile::new)
    }

    /// Writes the JSON document, if one was asked for.
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

/// Writes a file whole or not at all: beside its place first, then renamed.
///
/// # Errors
/// Names the path when it cannot be written (missing folder, no permission, disk full); the old file, if any, is then untouched.
pub fn write_whole(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    flankscope_foundation::files::write_whole(path, bytes)
        .with_context(|| format!("cannot write {}", path.display()))
}

/// Tries whether a file can be written later, before anything moves; an older one there stays as it is.
///
/// # Errors
/// Names the path and why it cannot be written.
pub fn try_place(path: &Path) -> anyhow::Result<()> {
    flankscope_foundation::files::try_place(path)
        .with_context(|| format!("cannot write {}", path.display()))
}

/// Makes a folder for results and tries whether these files of it can be written, before anything moves.
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

/// Makes a folder for reports and tries its places.
///
/// # Errors
/// As [`try_folder`].
pub fn try_report(folder: &Path, files: &[&str]) -> anyhow::Result<()> {
    try_folder(folder, files)?;
    let pages = folder.join(ReportFolder::PAGES);
    flankscope_foundation::files::make_folder_within(&pages)
        .with_context(|| format!("cannot make the folder {}", pages.display()))?;
    try_place(&pages.join("page.html"))
}

/// An error with its causes, each once: many name their cause themselves.
pub fn in_words(error: &anyhow::Error) -> String {
    let mut words = String::new();
    for cause in error.chain().map(ToString::to_string) {
        // A file's name may have lines of its own.
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

/// Tries a folder for recorded frames or clouds, named by `index`, which must not hold any: one recording would be read as the
/// other.
///
/// # Errors
/// As [`try_folder`], or there is something in it.
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

/// Says something on standard error; that nobody can hear it stops nothing.
pub fn say(text: &str) {
    let _ = writeln!(
        std::io::stderr(),
        "{}",
        Terminal::of_stderr().sentence(text)
    );
}

/// What went wrong on paper once a verdict stood. It changes neither the verdict nor the exit code, and keeps no other
/// paper back.
#[derive(Debug, Default)]
pub struct Complaints(Vec<anyhow::Error>);

impl Complaints {
    /// Keeps what went wrong; hands over what did not.
    pub fn hear<T>(&mut self, result: anyhow::Result<T>) -> Option<T> {
        result.map_err(|error| self.0.push(error)).ok()
    }

    /// Hands a result to a sink.
    pub fn hear_of<R>(&mut self, mut sink: impl ResultSink<R>, result: &mut R) {
        self.hear(sink.put(result).map_err(Into::into));
    }

    /// Complains on standard error, with the verdict and its reason for those who have only that; why nothing can be said is
    /// said in any case. Returns the verdict's outcome.
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
