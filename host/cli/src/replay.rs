//! `flankscope replay`: computes a stored verdict again.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

use flankscope_jobs::replay::{Replay, ReplayError};
use flankscope_jobs::subject::Subject;
use flankscope_record::history::{Difference, History};
use serde_json::json;

use crate::help;
use crate::inspect::SIMULATED;
use crate::instrument::{self, seals};
use crate::output::{Common, Outcome, say};
use crate::progress::Countdown;

/// Recompute a stored verdict from its phasors and list everything that is not the same to the last bit.
///
/// Tool, head and CAD are read from --tool; teeth, temperature, grid and baseline are those of the check.
#[derive(clap::Args)]
#[command(
    after_help = format!(
        "{}\n\n\
        Exit code: that of the verdict when nothing differs: 0 go, 1 no-go, 2 indeterminate, 4 warn; 2 when something differs, \
    3 could not run: phasors are missing or damaged",
        help::REPLAY_EXAMPLE
    )
)]
pub struct Args {
    /// File that inspect or watch wrote with --history
    file: PathBuf,
    /// Number of the check
    #[arg(required_unless_present = "all")]
    id: Option<i64>,
    /// Verify the whole history: its chain, every row against its document, and every verdict whose phasors are stored
    #[arg(long, conflicts_with = "id")]
    all: bool,
    #[command(flatten)]
    files: CheckFiles,
    #[command(flatten)]
    common: Common,
}

/// The files that a stored check was made with.
#[derive(clap::Args)]
pub struct CheckFiles {
    #[arg(long, value_name = "DIR", help = help::TOOL)]
    tool: Option<PathBuf>,
    /// Head file used for the check, instead of the tool folder's
    #[arg(long, value_name = "HEAD.toml")]
    head: Option<PathBuf>,
    /// Station file used for the check
    #[arg(long, value_name = "STATION.toml")]
    station: Option<PathBuf>,
}

impl CheckFiles {
    /// Tool, head and settings; says which tool is meant if none was named.
    pub fn subject(&self, quiet: bool) -> anyhow::Result<Subject> {
        let Self {
            tool,
            head,
            station,
        } = self;
        let subject = instrument::subject(tool.as_deref(), head.as_deref(), station.as_deref())?;
        if tool.is_none() && !quiet {
            say(&format!(
                "tool     {} (built in); --tool DIR for checks of another die",
                subject.tool.name
            ));
        }
        Ok(subject)
    }
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    let history = History::read(&args.file, &seals()?)?;
    history.verify()?;
    let subject = args.files.subject(args.common.quiet)?;
    let Some(id) = args.id else {
        return all(args, &history, &subject);
    };
    let replay = Replay::of(&history, id, &subject)?;
    let same = replay.differences.is_empty();
    let mut document = serde_json::to_value(&replay)?;
    document["same"] = json!(same);
    args.common.write_json(&document)?;
    if !args.common.quiet && args.common.json.as_deref() != Some(Path::new("-")) {
        print(&replay)?;
    }
    Ok(if same {
        Outcome::Verdict(replay.verdict)
    } else {
        Outcome::INDETERMINATE
    })
}

/// Replays every check; one whose phasors were deleted is only compared with its own row.
fn all(args: &Args, history: &History, subject: &Subject) -> anyhow::Result<Outcome> {
    let (mut replayed, mut given_up) = (0, 0);
    let mut differing = BTreeMap::new();
    let ids = history.ids()?;
    let mut countdown = Countdown::new(args.common.quiet, "checks", ids.len());
    for (done, &id) in ids.iter().enumerate() {
        countdown.step(done);
        let differences = match Replay::of(history, id, subject) {
            Ok(replay) => {
                replayed += 1;
                replay.differences
            }
            Err(ReplayError::History(error)) if history.gave_up_phasors(id, &error)? => {
                given_up += 1;
                history.row_differences(id)?
            }
            Err(error) => return Err(anyhow::Error::from(error).context(format!("check {id}"))),
        };
        if !differences.is_empty() {
            differing.insert(id, differences);
        }
    }
    args.common.write_json(&json!({
        "checks": ids.len(),
        "replayed": replayed,
        "phasors_given_up": given_up,
        "differences": differing,
        "same": differing.is_empty(),
    }))?;
    if args.common.shows_table() {
        let mut out = std::io::stdout().lock();
        for (id, differences) in &differing {
            for Difference { what, stored, now } in differences {
                writeln!(out, "check {id} DIFFERS {what}: stored {stored}, now {now}")?;
            }
        }
        writeln!(
            out,
            "{} checks, chain intact; {replayed} recomputed, {given_up} no longer have phasors; {} differ",
            ids.len(),
            differing.len()
        )?;
    }
    Ok(if differing.is_empty() {
        Outcome::Done
    } else {
        Outcome::INDETERMINATE
    })
}

fn print(replay: &Replay) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    writeln!(
        out,
        "check {}: {} stored, {} from {} captures: {}",
        replay.id, replay.stored_verdict, replay.verdict, replay.captures, replay.reason
    )?;
    if replay.origin.get("simulated") == Some(&json!(true)) {
        writeln!(out, "{SIMULATED}")?;
    }
    for difference in &replay.versions {
        writeln!(
            out,
            "{}: {} then, {} now",
            difference.what, difference.stored, difference.now
        )?;
    }
    for difference in &replay.differences {
        writeln!(
            out,
            "DIFFERS {}: stored {}, now {}",
            difference.what, difference.stored, difference.now
        )?;
    }
    match replay.differences.len() {
        0 => writeln!(out, "every figure is the same to the last bit")?,
        count => writeln!(out, "{count} differences")?,
    }
    let other_files = replay.differences.iter();
    let other_files: Vec<&str> = other_files
        .filter_map(|of| of.what.strip_prefix("hashes."))
        .filter(|what| *what != "recipe")
        .collect();
    if !other_files.is_empty() {
        writeln!(
            out,
            "the check was made with other files than those given ({}): name its own by --tool, --head and --station",
            other_files.join(", ")
        )?;
    }
    Ok(())
}
