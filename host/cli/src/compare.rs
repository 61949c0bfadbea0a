//! `flankscope compare`: what changed between two stored checks.

use std::io::Write;
use std::path::PathBuf;

use anyhow::Context;
use flankscope_jobs::replay;
use flankscope_record::document::Comparison;
use flankscope_record::history::History;
use flankscope_report::{Words, comparison_html, expanded_in_words, wear_in_words};

use crate::help;
use crate::inspect::{SIMULATED, widest};
use crate::instrument::seals;
use crate::output::{Common, Outcome, try_place, write_whole};
use crate::replay::CheckFiles;
use crate::terminal::Terminal;

/// Compare two stored checks of a die: what every flank lost from the one to the other, with its uncertainty, and the maps of both.
///
/// The later check is computed again from its phasors with the earlier one as its baseline, so that calibration and form as built
/// cancel. Both must have been made with the same tool, CAD and head file.
#[derive(clap::Args)]
#[command(after_help = help::COMPARE_EXAMPLE)]
pub struct Args {
    /// File that inspect or watch wrote with --history
    file: PathBuf,
    /// Number of the earlier check
    before: i64,
    /// Number of the later check
    after: i64,
    /// Also write table and maps as this page
    #[arg(long, value_name = "FILE.html")]
    page: Option<PathBuf>,
    #[command(flatten)]
    files: CheckFiles,
    #[command(flatten)]
    common: Common,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    args.common.try_json()?;
    if let Some(page) = &args.page {
        try_place(page).context("--page")?;
    }
    let history = History::read(&args.file, &seals()?)?;
    history.verify()?;
    let subject = args.files.subject(args.common.quiet)?;
    let comparison = replay::compare_checks(&history, [args.before, args.after], &subject)?;
    args.common.write_json(&comparison)?;
    if let Some(page) = &args.page {
        write_whole(page, comparison_html(&comparison)?.as_bytes())?;
    }
    if args.common.shows_table() {
        print(&comparison)?;
    }
    Ok(Outcome::Done)
}

fn print(comparison: &Comparison) -> anyhow::Result<()> {
    let on = Terminal::of_stdout();
    let mut out = std::io::stdout().lock();
    if comparison.simulated {
        writeln!(out, "{SIMULATED}")?;
    }
    for (name, check) in [("before", &comparison.before), ("after", &comparison.after)] {
        let line = format!(
            "{name:<7} check {}, {}, {} press cycles",
            check.id, check.date, check.cycles
        );
        writeln!(out, "{}", on.text(&line))?;
    }
    let ids = || comparison.flanks.iter().map(|flank| &flank.id);
    let (words, wide) = (Words::of(ids()), widest(ids()));
    let header = format!(
        "{:>5} {:<wide$} {:>14} {:>14} {:>14}  the loss",
        words.number, words.one, "wear before", "wear after", "lost since"
    );
    writeln!(out, "\n{}", on.text(&header))?;
    for flank in &comparison.flanks {
        let since = &flank.since;
        let line = format!(
            "{:>5} {:<wide$} {:>14} {:>14} {:>14}  ",
            flank.id.tooth,
            flank.id.side(),
            expanded_in_words(flank.before_um),
            expanded_in_words(flank.after_um),
            wear_in_words(since),
        );
        let word = on.in_colour(since.verdict, since.verdict.as_str());
        writeln!(out, "{}{word}", on.text(&line))?;
    }
    writeln!(
        out,
        "{}",
        on.text(
            "µm, each ± U95; the last word judges the loss since the earlier check by the limits"
        )
    )?;
    for flank in &comparison.flanks {
        if let Some(reason) = &flank.since.reason {
            writeln!(out, "{}", on.sentence(&format!("{}: {reason}", flank.id)))?;
        }
    }
    Ok(())
}
