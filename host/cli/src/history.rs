//! `flankscope history`: the wear trend of a tool.

use std::io::{StdoutLock, Write};
use std::path::{Path, PathBuf};

use anyhow::Context;
use flankscope_foundation::display::plain;
use flankscope_foundation::files::stream_whole;
use flankscope_foundation::normal::COVERAGE_95;
use flankscope_record::history::{
    Check, Forecast, History, LEAST_POINTS, clock_set_back, csv, series, sides,
};
use flankscope_report::{Words, figure, history_html, rate, remaining};
use serde_json::json;

use crate::help;
use crate::inspect::{widest, write_origin};
use crate::instrument::seals;
use crate::output::{Common, Outcome, write_whole};

/// Show how the flanks of a tool wore, how fast they wear, and how many cycles are left.
#[derive(clap::Args)]
#[command(
    after_help = format!(
        "{}\n\n\
        The history may be read while a watch writes to it.\n\n\
    Exit code: 0 done, 3 could not run",
        help::HISTORY_EXAMPLE
    )
)]
pub struct Args {
    /// File that inspect or watch wrote with --history
    file: PathBuf,
    /// Tool to show [default: the one checked last]
    #[arg(long, value_name = "NAME")]
    tool: Option<String>,
    /// Write history.html into this folder
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    /// Write every figure as comma-separated values to FILE
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Write every figure as an Apache Parquet file
    #[cfg(feature = "parquet")]
    #[arg(long, value_name = "FILE")]
    parquet: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    let history = History::read(&args.file, &seals()?)?;
    history.verify()?;
    let tools = history.tools()?;
    let tool = match &args.tool {
        Some(name) => {
            anyhow::ensure!(
                tools.contains(name),
                "--tool {name}: the history has checks of {}",
                listed(&tools)
            );
            name
        }
        None => tools
            .first()
            .with_context(|| format!("history {} has no check yet", args.file.display()))?,
    };
    let checks = history.checks(tool)?;
    let acknowledgements = history.acknowledgements(tool)?;
    let series = series(&checks);
    let sides = sides(&series)
        .into_iter()
        .map(|(mean, worst)| (Forecast::of(mean), worst.id.tooth))
        .collect::<Vec<_>>();
    let forecasts: Vec<Forecast> = series.into_iter().map(Forecast::of).collect();
    if let Some(path) = &args.csv {
        stream_whole(path, |out| csv(&checks, out))
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    #[cfg(feature = "parquet")]
    if let Some(path) = &args.parquet {
        write_whole(path, &flankscope_record::history::parquet(&checks)?)?;
    }
    if let Some(folder) = &args.report {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("cannot make {}", folder.display()))?;
        let page = history_html(tool, &checks, &acknowledgements, &forecasts)?;
        write_whole(&folder.join("history.html"), page.as_bytes())?;
    }
    args.common.write_json(&json!({
        "tool": tool,
        "simulated": history.kind()?.map(|(simulated, _)| simulated),
        "tools": tools,
        "checks": checks.len(),
        "last": checks.last(),
        "flanks": forecasts,
        "acknowledgements": acknowledgements,
        "clock_set_back": clock_set_back(&checks),
    }))?;
    if !args.common.quiet && args.common.json.as_deref() != Some(Path::new("-")) {
        print_table(tool, &checks, &sides, &forecasts, args)?;
    }
    Ok(Outcome::Done)
}

fn listed(tools: &[String]) -> String {
    if tools.is_empty() {
        "no tool".into()
    } else {
        tools.join(", ")
    }
}

fn print_table(
    tool: &str,
    checks: &[Check],
    sides: &[(Forecast, u32)],
    forecasts: &[Forecast],
    args: &Args,
) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    if let Some(last) = checks.last() {
        writeln!(
            out,
            "{}: {} checks, the last (number {}) at {} after {} cycles: {}",
            plain(tool),
            checks.len(),
            last.id,
            last.at,
            last.tool_cycles,
            last.verdict.as_str().to_uppercase()
        )?;
        write_origin(&mut out, &last.origin, &last.at)?;
        writeln!(out)?;
        for said in clock_set_back(checks) {
            writeln!(out, "{said}")?;
        }
    }
    let words = Words::of(forecasts.iter().map(|of| &of.id));
    let wide = widest(forecasts.iter().map(|of| &of.id));
    writeln!(
        out,
        "{:>5}  {:<wide$}  figures  wear/um   ±U95  um per 1000 cycles (95 %)   cycles left, at least (95 %)    changes at check",
        words.number, words.one
    )?;
    let row = |out: &mut StdoutLock<'_>, number: &str, o: &Forecast, remark: &str| {
        let last = o.points.last();
        writeln!(
            out,
            "{number:>5}  {:<wide$} {:>8} {:>8} {:>6}  {:<27} {:<31} {remark}",
            plain(o.id.side()),
            o.points.len(),
            figure(last.map(|p| p.wear_um)),
            figure(last.map(|p| COVERAGE_95 * p.u_um)),
            rate(o),
            remaining(o),
        )
    };
    for (mean, worst) in sides {
        row(&mut out, "mean", mean, &format!("most at tooth {worst}"))?;
    }
    for o in forecasts {
        let changes: Vec<String> = o.changes.iter().map(i64::to_string).collect();
        row(&mut out, &o.id.tooth.to_string(), o, &changes.join(", "))?;
    }
    if forecasts.iter().any(|o| o.trend.is_none()) {
        writeln!(
            out,
            "\na trend needs {LEAST_POINTS} figures since the last change, with cycles in between"
        )?;
    }
    match &args.report {
        Some(folder) => writeln!(out, "\nplots: {}", folder.join("history.html").display())?,
        None => writeln!(
            out,
            "\nadd --report DIR for plots, --csv FILE for every figure"
        )?,
    }
    Ok(())
}
