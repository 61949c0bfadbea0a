//! `flankscope article`: the article's figures and tables of a scan, ours beside them, as one page.

use std::path::{Path, PathBuf};

use anyhow::Context;
use flankscope_instrument::acquisition::Recording;
use flankscope_jobs::scan::{Article, FinishedScan, MethodResult};
use flankscope_jobs::subject::Subject;
use flankscope_record::sink::ResultSink;
use flankscope_report::ReportFolder;

use crate::bench_link::{ArticleBench, seed};
use crate::geometry::tell;
use crate::help;
use crate::instrument::{scratch, subject};
use crate::output::{Common, Outcome, say, try_folder};
use crate::paper::PaperOptions;

/// The article's figures and tables of a scan, made by its method and by ours, as one page.
#[derive(clap::Args)]
#[command(after_help = help::ARTICLE_EXAMPLE)]
pub struct Args {
    /// Folder that a scan kept its views in (scan --session DIR)
    #[arg(long, value_name = "DIR")]
    scan: Option<PathBuf>,
    /// Write article.html, article.json and first-view.ply into this folder
    #[arg(long, value_name = "DIR")]
    report: PathBuf,
    /// Frames that were saved with the scan (scan --save-frames DIR): adds cross-sections of the fringes
    #[arg(long, value_name = "DIR")]
    frames: Option<PathBuf>,
    #[arg(long, value_name = "DIR", help = help::TOOL)]
    tool: Option<PathBuf>,
    /// Head file instead of the tool folder's: the one that was scanned with
    #[arg(long, value_name = "HEAD.toml")]
    head: Option<PathBuf>,
    /// The station's file, if it was scanned with one
    #[arg(long, value_name = "STATION.toml")]
    station: Option<PathBuf>,
    #[command(flatten)]
    paper: PaperOptions,
    /// Share of the pairs that count where a view is laid on the one before, without CAD [default: nine tenths of the
    /// points that both have, at most --inlier-ratio; the article names none, and its 0.8 is of views on CAD]
    #[arg(long, value_name = "RATIO")]
    serial_inlier_ratio: Option<f64>,
    #[command(flatten)]
    common: Common,
    #[command(flatten)]
    bench: ArticleBench,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    let settings = args.paper.settings(seed(args.bench.args()))?;
    if let Some(ratio) = args.serial_inlier_ratio {
        anyhow::ensure!(
            (0.01..=1.0).contains(&ratio),
            "--serial-inlier-ratio {ratio}: 0.01 to 1 of the pairs are possible"
        );
    }
    let recording = args.frames.as_deref().map(Recording::open).transpose()?;
    args.common.try_json()?;
    try_folder(&args.report, ReportFolder::OF_ARTICLE).context("--report")?;
    let passing = scratch()?;
    let folder = match (&args.scan, args.bench.is_asked_for()) {
        (Some(folder), false) => folder.clone(),
        (None, true) => {
            let folder = passing.path().join("scan");
            let files = [args.tool.as_deref(), args.head.as_deref()];
            args.bench.scan(files, &folder, args.common.quiet)?;
            folder
        }
        (Some(_), true) => {
            anyhow::bail!("--scan and --bench: one of them says whose views these are")
        }
        (None, false) => anyhow::bail!(help::ARTICLE_NEEDS),
    };
    let subject: Subject = subject(
        args.tool.as_deref(),
        args.head.as_deref(),
        args.station.as_deref(),
    )?;
    if !args.common.quiet {
        say("the views are laid by positions, one on the other, the article's way and ours");
    }
    let mut finished = FinishedScan::open(subject, &folder)?;
    let sections = recording.as_ref().map(|frames| finished.sections(frames));
    let sections = sections.transpose().context("--frames")?;
    let mut article = finished.article(&settings, args.serial_inlier_ratio)?;
    article.sections = sections;
    let mut report = ReportFolder::new(&args.report);
    report.put(&mut article)?;
    args.common.write_json(&article)?;
    show(&article, &report.article(), &args.common);
    Ok(Outcome::Done)
}

/// A line per method, and where the page is.
fn show(article: &Article, page: &Path, common: &Common) {
    tell(common, || {
        let line = |of: &MethodResult| {
            let rms_um = of.exact.map_or(f64::NAN, |spread| spread.rms_um);
            format!(
                "{:<8} {} views, {rms_um:.1} um RMS to the surface\n",
                of.method, of.registered_views
            )
        };
        let lines: String = article.methods.iter().map(line).collect();
        format!("{lines}report: {}", page.display())
    });
}
