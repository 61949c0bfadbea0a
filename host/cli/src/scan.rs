//! `flankscope scan`: the whole die, view by view, to one map.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context;
use flankscope_station::scan::{Grid, Progress, Scan, Scanner};

use crate::instrument::{BenchArgs, Instrument, Scene};
use crate::output::{Common, Outcome, write_whole};

/// Scan the whole die: many views, laid on the CAD together, merged into one map.
///
/// Without options the built-in demo die is scanned on the simulated bench, where it stands eccentric and tilted, with a
/// hand-eye known only roughly. With --session a scan that was killed goes on where it was.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  flankscope scan --views 12x2 --speed max --ovality-um 20 --taper-um 15 --report out\n\
    scans the demo die, 20 um oval and 15 um conical, and writes out/report.html, out/scan.json and out/map.ply\n\n\
    Exit code: 0 go, 1 no-go, 2 indeterminate, 3 could not run, 4 warn"
)]
pub struct Args {
    /// Folder with tool.toml, and head.toml unless the demo head is meant [default: the demo die]
    #[arg(long, value_name = "DIR")]
    tool: Option<PathBuf>,
    /// Controller: `sim` for the simulated bench, else a serial port such as /dev/ttyACM0
    #[arg(long, value_name = "sim|PORT", default_value = "sim")]
    link: String,
    /// Views around the die by layers over its height
    #[arg(long, value_name = "AROUNDxLAYERS", default_value = "84x7")]
    views: Grid,
    /// Keep every view in this folder, and go on with what is there [default: a folder that is gone afterwards]
    #[arg(long, value_name = "DIR")]
    session: Option<PathBuf>,
    /// Write report.html, scan.json and map.ply into this folder
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
    #[command(flatten)]
    bench: BenchArgs,
    #[command(flatten)]
    die: DieArgs,
}

/// The die on the simulated bench.
#[derive(clap::Args, Clone, Debug)]
#[command(next_help_heading = "Simulated bench")]
pub struct DieArgs {
    /// Largest minus smallest radius of the bore, um
    #[arg(
        long,
        value_name = "UM",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    pub ovality_um: f64,
    /// Growth of the bore's radius from bottom to top, um
    #[arg(
        long,
        value_name = "UM",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    pub taper_um: f64,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    let quiet = args.common.quiet;
    if let Some(report) = &args.report {
        // Before anything moves: a scan whose report cannot be written should not begin.
        std::fs::create_dir_all(report)
            .with_context(|| format!("cannot make the report folder {}", report.display()))?;
    }
    let passing = match &args.session {
        Some(_) => None,
        None => Some(tempfile::tempdir().context("cannot make a folder for the views")?),
    };
    let session = args
        .session
        .as_deref()
        .or_else(|| passing.as_ref().map(|folder| folder.path()))
        .unwrap_or(Path::new("."));
    let scene = Scene {
        press: None,
        die: Some(&args.die),
    };
    let mut instrument = Instrument::start(
        args.tool.as_deref(),
        &args.link,
        &args.bench,
        scene,
        quiet,
        |subject, root| Ok(Scanner::open(subject, args.views, session, root)?),
    )?;
    let scan = instrument
        .station
        .scan(&instrument.port, instrument.settings, |progress| {
            if !quiet {
                show(progress);
            }
        })?;
    let mut document = serde_json::to_value(&scan)?;
    if let Some(truth) = instrument.close(quiet)? {
        document["truth"] = truth;
        document["truth"]["ovality_um"] = args.die.ovality_um.abs().into();
        document["truth"]["taper_um"] = args.die.taper_um.into();
    }
    if let Some(report) = &args.report {
        let page = flankscope_station::report::scan_html(&scan)?;
        write_whole(&report.join("report.html"), page.as_bytes())?;
        let text = serde_json::to_string_pretty(&document)?;
        write_whole(&report.join("scan.json"), text.as_bytes())?;
        flankscope_station::files::stream_whole(&report.join("map.ply"), |file| {
            flankscope_station::report::scan_ply(&scan, file)
        })?;
    }
    args.common.write_json(&document)?;
    if !quiet && args.common.json.as_deref() != Some(Path::new("-")) {
        print(&scan, args.report.as_deref())?;
    }
    Ok(Outcome::of_verdict(&scan.verdict))
}

fn show(progress: Progress) {
    match progress {
        Progress::Views {
            done,
            of,
            remaining,
        } => eprintln!(
            "{done:>4} of {of} views, {} s to go",
            remaining.as_secs_f64().round()
        ),
        Progress::Recapture(view) => eprintln!("view {view} is captured again"),
        Progress::Stitching => eprintln!("all views are laid on the CAD together"),
    }
}

fn print(scan: &Scan, report: Option<&Path>) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    let registered = |r: &&flankscope_station::scan::ScanRegistration| r.status == "registered";
    writeln!(
        out,
        "\n{} of {} views, {:.1} % of the bore seen, joint solve in {} rounds",
        scan.registration.iter().filter(registered).count(),
        scan.registration.len(),
        100.0 * scan.coverage_ratio,
        scan.joint.rounds
    )?;
    if let Some(form) = &scan.form {
        writeln!(
            out,
            "ovality {:.1} µm (largest at {:.0}°), taper {:.1} µm",
            form.ovality_um, form.ovality_deg, form.taper_um
        )?;
    }
    writeln!(out, "\n{}: {}", scan.verdict.to_uppercase(), scan.reason)?;
    writeln!(
        out,
        "scan {:.1} s, last view to result {:.1} s, {} of {} frames, {:.0} MB",
        scan.timing_ms.total / 1e3,
        scan.last_view_to_result_ms / 1e3,
        scan.frames.received,
        scan.frames.triggered,
        scan.peak_memory_mb.unwrap_or(f64::NAN),
    )?;
    match report {
        Some(folder) => writeln!(out, "report: {}", folder.join("report.html").display())?,
        None => writeln!(out, "add --report DIR for the map as HTML and PLY")?,
    }
    Ok(())
}
