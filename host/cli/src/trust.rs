//! `flankscope trust`: declares a file trusted that this station did not sign, in the name of a person.

use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use flankscope_foundation::display::{is_command, plain};
use flankscope_foundation::files::{open_regular, read_text};
use flankscope_record::history::History;
use flankscope_record::seal::{Kind, Seals, toml_document};
use serde_json::{Value, json};

use crate::instrument::seals;
use crate::output::{Common, Outcome};

/// Accept a file, by name, that this station did not sign or that was changed since.
///
/// Baselines, calibrated heads, self-tests, scans and scan sessions are accepted with their present content; any later change needs a
/// new acceptance. All rows of a history are chained anew, and the acceptance is stored as its last row. If the file of a history is
/// missing, a new one may be started under its path. Without FILE: the station's id and the files that it accepts.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  flankscope trust new-head/head.toml --name Ada\n  flankscope trust\n\n\
    Exit code: 0 done, 3 could not run"
)]
pub struct Args {
    /// Baseline, head file, self-test, scan, session manifest or history
    #[arg(requires = "name")]
    files: Vec<PathBuf>,
    /// Name of the person who accepts the files; every result states it
    #[arg(long, value_name = "WHO")]
    name: Option<String>,
    #[command(flatten)]
    common: Common,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    let seals = seals()?;
    let name = args.name.as_deref().unwrap_or_default().trim();
    for file in &args.files {
        if name.is_empty() {
            bail!("--name is empty: who says so?");
        }
        if name.contains(is_command) {
            bail!("--name {name:?}: right would be a name on one line, without control characters");
        }
        let what = trust(&seals, file, name)?;
        if args.common.shows_table() {
            let mut out = std::io::stdout().lock();
            writeln!(
                out,
                "{}: this {what} is accepted as it is, by {name}",
                plain(&file.to_string_lossy())
            )?;
        }
    }
    let trusted = seals.all_trusted()?;
    args.common
        .write_json(&json!({ "station": seals.station(), "trusted": trusted }))?;
    if args.files.is_empty() && args.common.shows_table() {
        let mut out = std::io::stdout().lock();
        writeln!(out, "station {}", seals.station())?;
        for entry in trusted {
            let said = format!(
                "{} {}, says {} since {}",
                entry.what,
                entry.file.display(),
                entry.by,
                entry.date
            );
            writeln!(out, "{}", plain(&said))?;
        }
    }
    Ok(Outcome::Done)
}

fn trust(seals: &Seals, path: &Path, name: &str) -> anyhow::Result<&'static str> {
    let mut start = [0; 16];
    let whole = match open_regular(path) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => None,
        file => Some(file.with_context(|| format!("cannot read {}", path.display()))?),
    };
    let is_history = match whole {
        None => true,
        Some(mut file) => file.read_exact(&mut start).is_ok() && &start == b"SQLite format 3\0",
    };
    if is_history {
        History::trust(path, seals, name)?;
        return Ok("history");
    }
    let text = read_text(path).with_context(|| format!("cannot read {}", path.display()))?;
    let json: Option<Value> = serde_json::from_str(&text).ok();
    let document = match json {
        Some(document) => document,
        None => toml_document(path, &text)?,
    };
    let has = |keys: &[&str]| keys.iter().all(|key| document.get(key).is_some());
    let kinds: [(Kind, &[&str]); 5] = [
        (Kind::Baseline, &["tool", "hashes", "flanks", "poses"]),
        (
            Kind::Scan,
            &["features", "hashes", "verdict", "registration"],
        ),
        (Kind::Session, &["format", "of", "views"]),
        (Kind::SelfTest, &["geometry_blake3", "due"]),
        (Kind::Head, &["camera", "projector"]),
    ];
    let Some((kind, _)) = kinds.into_iter().find(|(_, keys)| has(keys)) else {
        bail!(
            "{}: neither baseline, head file, self-test, scan, session manifest nor history; what a user writes needs no \
             trust",
            path.display()
        );
    };
    seals.trust(kind, path, &document, name)?;
    Ok(kind.word())
}
