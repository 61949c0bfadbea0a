//! `flankscope inspect`: the in-situ check of the critical teeth.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context;
use flankscope_station::baseline::Baseline;
use flankscope_station::inspection::{Inspection, Progress};
use flankscope_station::report::figure;

use crate::instrument::{BenchArgs, Instrument, Source};
use crate::output::{Common, Outcome, write_whole};

/// The example, and what the figures are.
static AFTER_HELP: std::sync::LazyLock<String> = std::sync::LazyLock::new(|| {
    format!(
        "Example:\n  flankscope inspect --wear 40:left:80 --report out\n\
        checks the demo die with 80 um worn off the left flank of tooth 40 and writes out/report.html\n\n\
        Exit code: 0 go, 1 no-go, 2 indeterminate, 3 could not run, 4 warn\n\n{}",
        flankscope_station::report::DEFINITIONS
    )
});

/// Check the critical teeth now: position, capture, register, judge.
///
/// Without options the built-in demo die is checked on the simulated bench.
#[derive(clap::Args)]
#[command(
    after_help = AFTER_HELP.as_str()
)]
pub struct Args {
    #[command(flatten)]
    source: Source,
    /// Write report.html and inspection.json into this folder
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    /// Write this check of a new tool as the baseline of later ones; only a go is one
    #[arg(long, value_name = "FILE")]
    record_baseline: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
    #[command(flatten)]
    bench: BenchArgs,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    let quiet = args.common.quiet;
    if let Some(report) = &args.report {
        // Before anything moves: a check whose report cannot be written should not begin.
        std::fs::create_dir_all(report)
            .with_context(|| format!("cannot make the report folder {}", report.display()))?;
    }
    let mut instrument = Instrument::open(&args.source, &args.bench, None, quiet)?;
    let mut watcher = Watcher::new(quiet);
    let inspection =
        instrument
            .station
            .inspect(&instrument.port, instrument.settings, |progress| {
                watcher.show(progress);
            })?;
    watcher.finish();
    let mut document = serde_json::to_value(&inspection)?;
    if let Some(truth) = instrument.close(quiet)? {
        document["truth"] = truth;
    }
    if let Some(path) = &args.record_baseline {
        Baseline::of(&inspection)?.save(path)?;
    }
    if let Some(report) = &args.report {
        let page = flankscope_station::report::html(&inspection)?;
        write_whole(&report.join("report.html"), page.as_bytes())?;
        write_whole(
            &report.join("inspection.json"),
            serde_json::to_string_pretty(&document)?.as_bytes(),
        )?;
    }
    args.common.write_json(&document)?;
    if !quiet && args.common.json.as_deref() != Some(Path::new("-")) {
        print_table(&inspection, args.report.as_deref())?;
    }
    Ok(Outcome::of_verdict(&inspection.verdict))
}

/// Tells on standard error how far the check is.
pub struct Watcher {
    quiet: bool,
    start: Instant,
    open_line: bool,
}

impl Watcher {
    /// Silent if `quiet`.
    pub fn new(quiet: bool) -> Self {
        Self {
            quiet,
            start: Instant::now(),
            open_line: false,
        }
    }

    /// Tells of a step.
    pub fn show(&mut self, progress: Progress) {
        if self.quiet {
            return;
        }
        let line = match progress {
            Progress::Connected => "controller answered".to_string(),
            Progress::Homing => "stages reference".to_string(),
            Progress::Moving(view, views) => format!("head moves to view {} of {views}", view + 1),
            Progress::Exposed(_, frame, frames) => {
                // One line per view, drawn as it grows: a mark for every frame.
                if frame == 0 {
                    self.begin_line("LED on, frames ");
                }
                eprint!("{}", if frame == 0 { '.' } else { '|' });
                if frame + 1 == frames {
                    eprintln!(" {frames}");
                    self.open_line = false;
                }
                let _ = std::io::stderr().flush();
                return;
            }
            Progress::Recapture(view) => format!("view {} is captured again", view + 1),
            Progress::Repeat(view) => {
                format!(
                    "view {} is too near to a limit, it is measured again",
                    view + 1
                )
            }
            Progress::Retracting => "head retracts".to_string(),
            Progress::Evaluated(view) => format!("view {} evaluated", view + 1),
        };
        self.begin_line(&line);
        eprintln!();
        self.open_line = false;
    }

    fn begin_line(&mut self, text: &str) {
        self.finish();
        eprint!("{:6.2} s  {text}", self.start.elapsed().as_secs_f64());
        self.open_line = true;
    }

    /// Ends the open line.
    pub fn finish(&mut self) {
        if std::mem::take(&mut self.open_line) {
            eprintln!();
        }
    }
}

fn print_table(inspection: &Inspection, report: Option<&Path>) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    writeln!(
        out,
        "\ntooth  flank   wear/um   ±U95  mean/um  proud/um  cell/um  tip/mm  detects/um  warn  stop  seen  verdict"
    )?;
    for f in &inspection.features {
        let detail = f.detail.as_ref();
        let tip = detail.and_then(|d| d.tip_edge_radius_mm);
        writeln!(
            out,
            "{:>5}  {:<6} {:>8} {:>6} {:>8} {:>9} {:>8} {:>7} {:>11} {:>5.0} {:>5.0} {:>4.0}%  {}{}",
            f.tooth,
            f.flank,
            figure(f.wear_um),
            figure(f.u95_um),
            figure(f.mean_um),
            figure(detail.map(|d| d.proud_um.value)),
            figure(detail.and_then(|d| d.cell_um).map(|cell| cell.value)),
            tip.map_or_else(|| "–".into(), |tip| format!("{:.2}", tip.value)),
            figure(detail.map(|d| d.detection_limit_um)),
            f.warn_um,
            f.limit_um,
            100.0 * f.coverage_ratio,
            f.verdict,
            f.reason
                .as_ref()
                .map(|reason| format!(": {reason}"))
                .unwrap_or_default(),
        )?;
    }
    let timing = inspection.timing_ms;
    let frames = inspection.frames;
    writeln!(
        out,
        "\n{}: {}",
        inspection.verdict.to_uppercase(),
        inspection.reason
    )?;
    writeln!(
        out,
        "check {:.2} s (positioning {:.2} s, exposure {:.2} s), last exposure to verdict {:.0} ms, {} of {} frames, {} bytes copied, {:.0} MB",
        timing.total / 1000.0,
        timing.positioning / 1000.0,
        timing.exposure / 1000.0,
        timing.last_exposure_to_verdict,
        frames.received,
        frames.triggered,
        frames.bytes_copied,
        inspection.peak_memory_mb.unwrap_or(f64::NAN),
    )?;
    match report {
        Some(folder) => writeln!(out, "report: {}", folder.join("report.html").display())?,
        None => writeln!(
            out,
            "add --report DIR for maps, histogram and timeline as one HTML file"
        )?,
    }
    Ok(())
}
