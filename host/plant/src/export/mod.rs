//! Writes the checks of a period as files for metrologists' programs: one QIF and one DFQ file for each check, one table for the
//! period. The fields are listed in docs/formats/metrology-files.md.
//!
//! | file | holds |
//! |---|---|
//! | `period` | from when, until when |
//! | `xml` | an XML document's text |
//! | `qif` | QIF 3.0 results |
//! | `dfq` | the Q-DAS ASCII transfer format |

mod dfq;
mod period;
mod qif;
mod xml;

use std::path::{Path, PathBuf};

use anyhow::Context;
use flankscope_foundation::display::{is_command, plain};
use flankscope_foundation::files::{make_folder_within, stream_whole, write_whole};
use flankscope_record::history::{Check, FlankRow, History, csv};
use flankscope_record::seal::Seals;
use jiff::Timestamp;

use crate::history::check_id;
use period::{Bound, Period};

/// Which checks, as what, and where to.
#[derive(clap::Args)]
pub struct Args {
    /// History that `flankscope inspect` or `watch` writes
    history: PathBuf,
    /// Folder for the files; made if missing
    folder: PathBuf,
    /// Formats, separated by commas
    #[arg(long = "as", value_enum, value_delimiter = ',', required = true)]
    formats: Vec<Format>,
    /// Only checks of this tool
    #[arg(long, value_name = "NAME")]
    tool: Option<String>,
    /// Only checks stored on or after this day or moment; UTC unless it names a zone
    #[arg(long, value_name = "2026-11-01")]
    since: Option<Bound>,
    /// Only checks stored until the end of this day, or until this moment; UTC unless it names a zone
    #[arg(long, value_name = "2026-11-30")]
    until: Option<Bound>,
}

/// Format of the files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    /// QIF 3.0 (ISO 23952), one file for each check
    Qif,
    /// Q-DAS ASCII transfer format, one file for each check
    Dfq,
    /// Comma-separated values, one file
    Csv,
    /// Apache Parquet, one file
    Parquet,
}

/// A check with what the files state about it beyond its row.
struct ExportedCheck {
    check: Check,
    /// What identifies it in all histories.
    id: String,
    /// When it was stored.
    at: Timestamp,
}

/// Writes the files.
///
/// # Errors
/// The history cannot be read or was changed by others, nothing lies in the period, or a file cannot be written.
pub fn run(args: &Args, seals: &Seals) -> anyhow::Result<()> {
    anyhow::ensure!(
        cfg!(feature = "parquet") || !args.formats.contains(&Format::Parquet),
        "--as parquet: this program was built without Parquet: cargo install --path host/plant --features parquet"
    );
    let period = Period::new(args.since, args.until)?;
    let history = History::read(&args.history, seals)?;
    history.verify()?;
    let checks = checks(&history, args.tool.as_deref(), &period)?;
    let (Some(first), Some(last)) = (checks.first(), checks.last()) else {
        anyhow::bail!(
            "{}: no check {}was stored in this period",
            args.history.display(),
            args.tool
                .as_ref()
                .map_or_else(String::new, |tool| format!("of {tool} "))
        );
    };
    let folder = &args.folder;
    make_folder_within(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    let of_period = |extension: &str| {
        let tool = args.tool.as_deref().map_or_else(String::new, |tool| {
            format!("{}-", crate::percent::encoded(tool))
        });
        let (first, last) = (day(first.at), day(last.at));
        folder.join(format!("checks-{tool}{first}-{last}.{extension}"))
    };
    for format in &args.formats {
        match format {
            Format::Qif => of_each(folder, "qif", &checks, |check| Some(qif::document(check)))?,
            Format::Dfq => of_each(folder, "dfq", &checks, dfq::file)?,
            Format::Csv => {
                let path = of_period("csv");
                let rows = rows(&checks);
                stream_whole(&path, |out| csv(&rows, out))
                    .with_context(|| format!("cannot write {}", path.display()))?;
                println!("csv      {} ({} checks)", path.display(), rows.len());
            }
            Format::Parquet => write_parquet(&of_period("parquet"), &checks)?,
        }
    }
    Ok(())
}

/// The checks of a period, in the order in which they were stored.
fn checks(
    history: &History,
    tool: Option<&str>,
    period: &Period,
) -> anyhow::Result<Vec<ExportedCheck>> {
    let tools = history.tools()?;
    let stored_tools = || match tools.is_empty() {
        true => "no check yet".into(),
        false => format!("checks of {}", tools.join(", ")),
    };
    if let Some(tool) = tool {
        anyhow::ensure!(
            tools.iter().any(|stored_tool| stored_tool == tool),
            "--tool {tool}: the history has {}",
            stored_tools()
        );
    }
    let mut exported = Vec::new();
    for stored_tool in tools
        .iter()
        .filter(|stored_tool| tool.is_none_or(|tool| tool == *stored_tool))
    {
        for check in history.checks(stored_tool)? {
            let at: Timestamp = check.at.parse().with_context(|| {
                format!("check {}: '{}' is no time of ISO 8601", check.id, check.at)
            })?;
            if period.holds(at) {
                let id = check_id(&check, &history.document(check.id)?);
                exported.push(ExportedCheck { check, id, at });
            }
        }
    }
    exported.sort_by_key(|exported_check| exported_check.check.id);
    Ok(exported)
}

/// Writes a file for each check, named by its id.
fn of_each(
    folder: &Path,
    extension: &str,
    checks: &[ExportedCheck],
    content: impl Fn(&ExportedCheck) -> Option<String>,
) -> anyhow::Result<()> {
    let mut written = 0;
    for check in checks {
        let Some(content) = content(check) else {
            // A check that ended before it looked at a flank has no characteristic.
            let number = check.check.id;
            eprintln!("check {number} has no flank: no .{extension} of it");
            continue;
        };
        let path = folder.join(format!("{}.{extension}", check.id));
        write_whole(&path, content.as_bytes())
            .with_context(|| format!("cannot write {}", path.display()))?;
        written += 1;
    }
    println!("{extension}      {} ({written} files)", folder.display());
    Ok(())
}

fn rows(checks: &[ExportedCheck]) -> Vec<Check> {
    checks
        .iter()
        .map(|exported| exported.check.clone())
        .collect()
}

#[cfg(feature = "parquet")]
fn write_parquet(path: &Path, checks: &[ExportedCheck]) -> anyhow::Result<()> {
    let rows = rows(checks);
    let bytes = flankscope_record::history::parquet(&rows)?;
    write_whole(path, &bytes).with_context(|| format!("cannot write {}", path.display()))?;
    println!("parquet  {} ({} checks)", path.display(), rows.len());
    Ok(())
}

#[cfg(not(feature = "parquet"))]
fn write_parquet(_: &Path, _: &[ExportedCheck]) -> anyhow::Result<()> {
    // Refused before anything is read.
    Ok(())
}

/// The day of a moment, UTC.
fn day(at: Timestamp) -> String {
    at.strftime("%Y-%m-%d").to_string()
}

/// Said of a check of the simulated bench, in every file of it.
const SIMULATED: &str = "SIMULATED BENCH: no real die was looked at";

/// Decimal places of lengths in millimetres: nanometres, below anything that is measured.
const DECIMALS: usize = 6;

/// A length in millimetres, without an exponent.
fn millimetres(um: f64) -> String {
    format!("{:.DECIMALS$}", um / 1000.0)
}

/// A measured length, if it was measured.
fn measured(flank: &FlankRow) -> Option<f64> {
    flank.wear_um.filter(|wear_um| wear_um.is_finite())
}

/// What one flank is called in the files, the same in all of them.
fn designation(flank: &FlankRow) -> String {
    match &flank.id.patch {
        Some(patch) => patch.clone(),
        None => format!("{} {}", flank.id.tooth, flank.id.flank),
    }
}

/// What is measured on a flank, in words.
fn characteristic(flank: &FlankRow) -> String {
    match &flank.id.patch {
        Some(patch) => format!("wear of {patch}"),
        None => format!("wear of tooth {}, {} flank", flank.id.tooth, flank.id.flank),
    }
}

/// A text on one line.
fn one_line(text: &str) -> String {
    let words = text.replace(|c: char| c.is_whitespace() && is_command(c), " ");
    plain(&words).into_owned()
}
