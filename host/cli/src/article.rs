//! `flankscope article`: the article's figures and tables of a scan as one page, with our results for comparison.

use std::path::{Path, PathBuf};

use anyhow::Context;
use flankscope_article::{Article, ArticleSettings, MethodResult};
use flankscope_instrument::acquisition::Recording;
use flankscope_jobs::scan::FinishedScan;
use flankscope_jobs::subject::Subject;
use flankscope_record::sink::ResultSink;
use flankscope_report::ReportFolder;

use crate::article_settings::ArticleSettingsFile;
use crate::geometry::tell;
use crate::help;
use crate::instrument::subject;
use crate::output::{Common, Outcome, say, try_folder, write_whole};
use crate::progress::Countdown;

/// Compute the published article's figures and tables for a scan, by its method and by ours, as one page.
#[derive(clap::Args)]
#[command(after_help = help::ARTICLE_EXAMPLE)]
pub struct Args {
    /// Folder with the views of a scan (scan --session DIR)
    #[arg(long, value_name = "DIR", required_unless_present = "write_settings")]
    scan: Option<PathBuf>,
    /// Write article.html, article.json and first-view.ply into this folder
    #[arg(long, value_name = "DIR", required_unless_present = "write_settings")]
    report: Option<PathBuf>,
    /// Frames that were saved with the scan (scan --save-frames DIR): adds cross-sections of the fringes
    #[arg(long, value_name = "DIR")]
    frames: Option<PathBuf>,
    #[arg(long, value_name = "DIR", help = help::TOOL)]
    tool: Option<PathBuf>,
    /// Head file used for the scan, instead of the tool folder's
    #[arg(long, value_name = "HEAD.toml")]
    head: Option<PathBuf>,
    /// Station file used for the scan, if there was one
    #[arg(long, value_name = "STATION.toml")]
    station: Option<PathBuf>,
    #[command(flatten)]
    article: ArticleSettingsFile,
    /// Seed of the article's random points: that of the scan
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Only write the article's own settings into this file, for --article-settings
    #[arg(long, value_name = "SETTINGS.toml", exclusive = true)]
    write_settings: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    if let Some(file) = &args.write_settings {
        write_whole(file, ArticleSettings::FILE.as_bytes())?;
        return Ok(Outcome::Done);
    }
    let (Some(folder), Some(report)) = (&args.scan, &args.report) else {
        anyhow::bail!("--scan DIR and --report DIR are needed");
    };
    let settings = args.article.load(args.seed)?;
    let recording = args.frames.as_deref().map(Recording::open).transpose()?;
    args.common.try_json()?;
    try_folder(report, ReportFolder::OF_ARTICLE).context("--report")?;
    let subject: Subject = subject(
        args.tool.as_deref(),
        args.head.as_deref(),
        args.station.as_deref(),
    )?;
    if !args.common.quiet {
        say("the views are laid by positions, one on the other, the article's way and ours");
    }
    let settings = match &subject.tool.gear {
        Some(gear) => settings.for_toothing(gear.radial_threshold_mm),
        None => settings,
    };
    let mut finished = FinishedScan::open(subject, folder)?;
    let sections = recording.as_ref().map(|frames| finished.sections(frames));
    let sections = sections.transpose().context("--frames")?;
    let mut countdown = None;
    let mut article = finished.article(&settings, &mut |done, of| {
        let quiet = args.common.quiet;
        countdown
            .get_or_insert_with(|| Countdown::new(quiet, "views laid the article's way", of))
            .step(done);
    })?;
    article.sections = sections;
    let mut report = ReportFolder::new(report);
    report.put(&mut article)?;
    args.common.write_json(&article)?;
    show(&article, &report.article(), &args.common);
    Ok(Outcome::Done)
}

/// Prints a line per method, and the path of the page.
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
