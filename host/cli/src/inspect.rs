//! `flankscope inspect`: the in-situ check of the critical teeth.

use std::io::Write;
use std::path::PathBuf;

use flankscope_foundation::display::plain;
use flankscope_instrument::acquisition::{FrameIndex, RecordedIndex, Recording};
use flankscope_jobs::job::recording_id;
use flankscope_jobs::readiness::repeatability;
use flankscope_metrology::verdict::Word;
use flankscope_record::document::{Feature, FeatureId, FlankInView, Inspection};
use flankscope_record::origin::{Link, Origin};
use flankscope_record::sink::ResultSink;
use flankscope_report::{ReportFolder, Words, figure};

use crate::bench_link::{BenchSetup, CameraArgs, DieArgs, setup_with_camera};
use crate::help;
use crate::instrument::{Instrument, Source, recorded_check, seals};
use crate::interrupt::{self, DeferredExit};
use crate::output::{Common, Complaints, Outcome, say, try_place, try_recording, try_report};
use crate::progress::Watcher;
use crate::site::Site;
use crate::terminal::Terminal;

/// The example, and the definitions of the results.
static AFTER_HELP: std::sync::LazyLock<String> = std::sync::LazyLock::new(|| {
    format!(
        "{}\n\n\
        The exit code is that of the verdict, even if the report cannot be written, which is reported on standard error.\n\
        Exit code: 0 go, 1 no-go, 2 indeterminate, 3 could not run, 4 warn\n\n{}",
        help::INSPECT_EXAMPLE,
        flankscope_report::DEFINITIONS
    )
});

#[derive(clap::Args)]
#[command(
    about = "Check the critical teeth now: position, capture, register, judge",
    long_about = help::INSPECT,
    after_help = AFTER_HELP.as_str()
)]
pub struct Args {
    #[command(flatten)]
    source: Source,
    /// Evaluate the recorded frames in this folder, described by its frames.toml, without controller and camera. The teeth are those
    /// of the recording, or those of --teeth among them
    #[arg(long, value_name = "DIR")]
    frames: Option<PathBuf>,
    /// Also write every frame of this check into this folder, for a later --frames: raw counts, 4.6 MB per frame
    #[arg(long, value_name = "DIR", conflicts_with = "frames")]
    save_frames: Option<PathBuf>,
    /// Write report.html and inspection.json into this folder
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    /// Write this check of a new tool as the baseline for later checks; nothing is written unless it is go
    #[arg(long, value_name = "FILE")]
    record_baseline: Option<PathBuf>,
    /// Approach each view of a baseline so often, with a homing in between: the scatter tells how well the stages repeat
    #[arg(long, value_name = "N", default_value_t = 5, requires = "record_baseline", conflicts_with = "frames", value_parser = clap::value_parser!(u32).range(1..=100))]
    approaches: u32,
    #[command(flatten)]
    common: Common,
    #[command(flatten)]
    die: DieArgs,
    #[command(flatten)]
    camera: CameraArgs,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    interrupt::on_signals()?;
    let _results_are_stored = DeferredExit::until_dropped();
    let quiet = args.common.quiet;
    let bench = setup_with_camera(&args.die, &args.camera)?;
    let recording = args.frames.as_deref().map(Recording::open).transpose()?;
    let site = match &recording {
        Some(recording) => {
            let link = Link::Recorded(recording_id(recording));
            args.source.place.of_recording(link)?
        }
        None => args.source.site()?,
    };
    let report = args
        .report
        .as_ref()
        .or(site.settings.report.folder.as_ref());
    args.try_places(report)?;
    anyhow::ensure!(
        args.save_frames.is_none() || !site.settings.stages.poses.is_some(),
        "--save-frames with [stages.poses]: a recording contains positions of the stages, but no poses of the camera from elsewhere"
    );
    let seals = seals()?;
    let mut complaints = Complaints::default();
    let (mut inspection, instrument) = match &recording {
        Some(recording) => (args.check_recorded(recording, &site, &bench)?, None),
        None => {
            let (inspection, instrument) = args.check_live(&site, &bench, &mut complaints)?;
            (inspection, Some(instrument))
        }
    };
    // The verdict is final and stored; it is printed and returned even if reports cannot be written.
    if args.common.shows_table() {
        complaints.hear(print_table(&inspection));
    }
    if let Some(instrument) = instrument {
        inspection.truth = complaints.hear(instrument.close(quiet)).flatten();
    }
    complaints.hear_of(args.common.document(), &mut inspection);
    complaints.hear(args.write_report(report, &mut inspection));
    if let Some(path) = &args.record_baseline {
        let recorded = inspection
            .baseline()
            .and_then(|baseline| baseline.save(path, &seals));
        if complaints.hear(recorded.map_err(Into::into)).is_some() && !quiet {
            say(&match &inspection.approaches {
                Some(measured) => repeatability(measured, &site.settings.stages).line(),
                None => "one approach of each view: how well the stages repeat was not measured (--approaches)".into(),
            });
        }
    }
    if interrupt::is_requested() {
        say(&what_is_kept(&inspection));
    }
    Ok(complaints.end(inspection.verdict, &inspection.sentence(), quiet))
}

/// What is kept of an interrupted check.
fn what_is_kept(inspection: &Inspection) -> String {
    let seen = inspection.registration.len();
    let of = inspection.recipe.teeth.len();
    let kept = match inspection.id {
        Some(id) => format!("it is check {id} of the history, {}", inspection.verdict),
        None => "no history keeps it (--history FILE)".into(),
    };
    format!("interrupted after {seen} of {of} views; {kept}")
}

impl Args {
    /// Approaches of each view; a head that something else than the stages moves is not sent back.
    fn approaches_of(&self, site: &Site) -> u32 {
        match self.record_baseline.is_some() && !site.settings.stages.poses.is_some() {
            true => self.approaches,
            false => 1,
        }
    }

    fn check_live(
        &self,
        site: &Site,
        bench: &BenchSetup,
        complaints: &mut Complaints,
    ) -> anyhow::Result<(Inspection, Instrument)> {
        let quiet = self.common.quiet;
        let (mut instrument, mut writer) =
            Instrument::open(&self.source, site, bench, None, quiet)?;
        let mut saved = None;
        if let Some(folder) = &self.save_frames {
            saved = Some((folder, instrument.copy_head(folder)?));
            instrument.job.save_frames(folder)?;
        }
        let mut watcher = Watcher::new(quiet, instrument.job.view_names());
        let inspection = instrument.job.inspect(
            &instrument.port,
            instrument.settings.clone(),
            self.approaches_of(site),
            &mut writer,
            |progress| watcher.show(progress),
        )?;
        if let Some((folder, head)) = saved {
            let recorded = instrument.job.record_check(&inspection, folder, &head);
            complaints.hear(recorded.map_err(Into::into));
        }
        Ok((inspection, instrument))
    }

    fn check_recorded(
        &self,
        recording: &Recording,
        site: &Site,
        bench: &BenchSetup,
    ) -> anyhow::Result<Inspection> {
        let quiet = self.common.quiet;
        let (mut check, mut frames, mut writer) =
            recorded_check(&self.source, recording, bench, site, quiet)?;
        let mut watcher = Watcher::new(quiet, check.view_names());
        let watch = |progress| watcher.show(progress);
        Ok(check.inspect_recorded(&mut frames, &mut writer, watch)?)
    }

    /// Before anything moves: a check whose results cannot be written should not begin.
    fn try_places(&self, report: Option<&PathBuf>) -> anyhow::Result<()> {
        self.common.try_json()?;
        if let Some(folder) = report {
            try_report(folder, ReportFolder::OF_CHECK)?;
        }
        if let Some(folder) = &self.save_frames {
            try_recording(folder, FrameIndex::FILE)?;
        }
        self.record_baseline.as_deref().map_or(Ok(()), try_place)
    }

    fn write_report(
        &self,
        report: Option<&PathBuf>,
        inspection: &mut Inspection,
    ) -> anyhow::Result<()> {
        let Some(folder) = report else {
            return self.show("add --report DIR for maps, histogram and timeline as one HTML file");
        };
        let mut folder = ReportFolder::new(folder);
        folder.put(inspection)?;
        self.show(&format!("report: {}", folder.page().display()))
    }

    fn show(&self, line: &str) -> anyhow::Result<()> {
        if self.common.shows_table() {
            writeln!(std::io::stdout(), "{line}")?;
        }
        Ok(())
    }
}

/// Stated with every result of the simulated bench.
pub const SIMULATED: &str = "SIMULATED BENCH: no real die was looked at";

/// Writes a line with the origin of a result, below its verdict.
pub fn write_origin(out: &mut impl Write, origin: &Origin, date: &str) -> std::io::Result<()> {
    if origin.simulated {
        writeln!(out, "{SIMULATED}")?;
    }
    let particulars = origin.particulars().into_iter();
    let named: Vec<String> = particulars
        .map(|(name, what)| format!("{name} {}", plain(&what)))
        .collect();
    let said = format!("{date}, {}", named.join(", "));
    writeln!(out, "{}", Terminal::of_stdout().sentence(&said))
}

/// Width of a column with the sides or names of parts.
pub fn widest<'a>(parts: impl Iterator<Item = &'a FeatureId>) -> usize {
    parts
        .map(|id| id.side().chars().count())
        .max()
        .unwrap_or(0)
        .max(6)
}

/// Prints the results of every flank, within 80 columns; then the reasons of those that are not "go", and what else is in view.
pub fn print_flanks(
    out: &mut impl Write,
    features: &[Feature],
    in_view: &[FlankInView],
) -> std::io::Result<()> {
    let terminal = Terminal::of_stdout();
    let words = Words::of(features.iter().map(|f| &f.id));
    let wide = widest(features.iter().map(|f| &f.id));
    let header = format!(
        "{:>5} {:<wide$}  wear  ±U95  mean proud  cell  tip/mm  detects  seen  verdict",
        words.number, words.one
    );
    writeln!(out, "\n{}", terminal.text(&header))?;
    for f in features {
        let detail = f.detail.as_ref();
        let tip = detail.and_then(|d| d.tip_edge_radius_mm);
        let line = format!(
            "{:>5} {:<wide$} {:>5} {:>5} {:>5} {:>5} {:>5} {:>7} {:>8} {:>4.0}%  ",
            f.id.tooth,
            f.id.side(),
            f.at_least_um
                .map_or_else(|| figure(f.wear_um), |um| format!("≥{um:.1}")),
            figure(f.u95_um),
            figure(f.mean_um),
            figure(detail.map(|d| d.proud_um.value)),
            figure(detail.and_then(|d| d.cell_um).map(|cell| cell.value)),
            tip.map_or_else(|| "–".into(), |tip| format!("{:.2}", tip.value)),
            figure(detail.map(|d| d.detection_limit_um)),
            100.0 * f.coverage_ratio,
        );
        let verdict = terminal.in_colour(f.verdict, f.verdict.as_str());
        writeln!(out, "{}{verdict}", terminal.text(&line))?;
    }
    if let Some(f) = features.first() {
        let units = format!(
            "wear and what follows in µm unless said otherwise; warn {:.0} µm, stop {:.0} µm",
            f.warn_um, f.limit_um
        );
        writeln!(out, "{}", terminal.text(&units))?;
    }
    for f in features {
        if let Some(reason) = &f.reason {
            let why = format!("{}: {reason}", f.id);
            writeln!(out, "{}", terminal.sentence(&why))?;
        }
    }
    for f in in_view {
        let figures = format!("{} ± {} um", figure(f.wear_um), figure(f.u95_um));
        let seen = format!("{:.0} % seen", 100.0 * f.coverage_ratio);
        let beside = format!("{}, not asked for: {figures}, {seen}: {}", f.id, f.verdict);
        writeln!(out, "{}", terminal.sentence(&beside))?;
    }
    Ok(())
}

fn print_table(inspection: &Inspection) -> anyhow::Result<()> {
    let terminal = Terminal::of_stdout();
    let mut out = std::io::stdout().lock();
    print_flanks(&mut out, &inspection.features, &inspection.in_view)?;
    if let Some(identity) = &inspection.tooth_identity {
        writeln!(out, "{}", terminal.sentence(&identity.reason))?;
    }
    writeln!(
        out,
        "\n{}",
        in_words(terminal, inspection.verdict, &inspection.reason.to_string())
    )?;
    write_origin(&mut out, &inspection.origin, &inspection.date)?;
    if let Some(id) = inspection.id {
        writeln!(out, "stored as check {id} of its history")?;
    }
    let (timing, frames) = (inspection.timing_ms, inspection.frames);
    writeln!(
        out,
        "check {:.2} s (positioning {:.2} s, exposure {:.2} s), \
         last exposure to verdict {:.0} ms\n{} of {} frames, {} bytes copied, {} MB",
        timing.total / 1000.0,
        timing.positioning / 1000.0,
        timing.exposure / 1000.0,
        timing.last_exposure_to_verdict,
        frames.received,
        frames.triggered,
        frames.bytes_copied,
        figure(inspection.peak_memory_mb),
    )?;
    Ok(())
}

/// A verdict and its reason, as the terminal can display them.
pub fn in_words(terminal: Terminal, verdict: Word, reason: &str) -> String {
    let word = verdict.as_str().to_uppercase();
    let said = terminal.sentence(&format!("{word}: {reason}"));
    // Wrapped without colour codes, which take no column.
    said.replacen(&word, &terminal.in_colour(verdict, &word), 1)
}
