//! `flankscope scan`: the whole die, view by view, merged into one map.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context;
use flankscope_article::{Article, ArticleSettings, MethodResult, Spread};
use flankscope_foundation::seal::Seal;
use flankscope_instrument::acquisition::{FrameIndex, RecordedIndex, Recording};
use flankscope_jobs::job::{RecordedFrames, recording_id};
use flankscope_jobs::scan::{
    CloudIndex, CloudRecording, CloudScan, Grid, Method, Progress, ScanError, Scanner,
};
use flankscope_jobs::subject::Subject;
use flankscope_metrology::io::points::Format;
use flankscope_metrology::kinematics::Moves;
use flankscope_metrology::multiview::form::Form;
use flankscope_record::document::ViewStatus;
use flankscope_record::document::scan::{Scan, ScanRegistration, percent};
use flankscope_record::origin::Link;
use flankscope_record::seal::Kind;
use flankscope_record::sink::ResultSink;
use flankscope_report::{ReportFolder, figure, scan_mesh};

use crate::article_settings::ArticleSettingsFile;
use crate::bench_link::{BenchSetup, DieArgs, fits_recording, in_words, seed};
use crate::gear::write_evaluation;
use crate::geometry::write_file;
use crate::help;
use crate::inspect::{self, write_origin};
use crate::instrument::{Instrument, recorded_subject, scratch, seals};
use crate::interrupt;
use crate::output::{Common, Complaints, Outcome, say, try_place, try_recording, try_report};
use crate::progress::say_remaining;
use crate::scene::Scene;
use crate::site::{Place, Site};
use crate::terminal::Terminal;

#[derive(clap::Args)]
#[command(
    about = "Scan the whole die: many views, registered to the CAD together and merged into one map",
    long_about = help::SCAN,
    after_help = format!(
        "{}\n\n\
        The verdict covers the teeth and heights of --views and states their share of the bore. If less was measured than requested, it \
        is indeterminate. --tool needs --link.\n\n\
    Exit code: 0 go, 1 no-go, 2 indeterminate, 3 could not run, 4 warn",
        help::SCAN_EXAMPLE
    )
)]
pub struct Args {
    #[arg(long, value_name = "DIR", help = help::TOOL)]
    tool: Option<PathBuf>,
    /// Head file instead of the tool folder's, for example a fresh calibration
    #[arg(long, value_name = "HEAD.toml")]
    head: Option<PathBuf>,
    #[command(flatten)]
    place: Place,
    /// Views around the die by layers over its height
    #[arg(
        long,
        value_name = "AROUNDxLAYERS",
        default_value = "84x7",
        conflicts_with_all = ["frames", "clouds"]
    )]
    views: Grid,
    /// Evaluate the recorded frames in this folder, described by its frames.toml, without controller and camera. The views are
    /// those of the recording
    #[arg(long, value_name = "DIR")]
    frames: Option<PathBuf>,
    /// Evaluate the recorded clouds in this folder, described by its clouds.toml: points of every view in the camera's frame,
    /// without the camera's images. The result is a map; no flank can be go
    #[arg(long, value_name = "DIR", conflicts_with = "frames")]
    clouds: Option<PathBuf>,
    /// Also write the cloud of every view, with the uncertainty of every point, into this folder, for --clouds later
    #[arg(long, value_name = "DIR", conflicts_with_all = ["frames", "clouds"])]
    save_clouds: Option<PathBuf>,
    /// Also write every frame of this scan into this folder, for --frames later: the camera's raw counts, 4.6 MB each
    #[arg(long, value_name = "DIR", conflicts_with_all = ["frames", "clouds"])]
    save_frames: Option<PathBuf>,
    /// Result of an earlier scan of this die (its --json file or report folder): its flanks' deviations show
    /// whether the die was rotated by whole teeth since
    #[arg(long, value_name = "SCAN.json")]
    reference: Option<PathBuf>,
    /// Keep every view in this folder, and continue the scan that is there [default: a temporary folder]
    #[arg(long, value_name = "DIR")]
    session: Option<PathBuf>,
    /// Write report.html, scan.json and map.ply into this folder
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    /// Write the measured surface, with holes where nothing was seen: a coloured PLY mesh, triangles alone (name.stl), or arrays for
    /// NumPy (name.npz)
    #[arg(long, value_name = "FILE")]
    mesh: Option<PathBuf>,
    /// Vertex spacing of that mesh along the profile and the axis [default: that of map.ply]
    #[arg(long, value_name = "MM", requires = "mesh")]
    mesh_mm: Option<f64>,
    /// Write every measured point of every view in its final pose in the tool frame, as a binary PLY, text (name.xyz) or arrays for NumPy
    /// (name.npz): a whole die is 42 million points, 0.8 GB
    #[arg(long, value_name = "FILE")]
    cloud: Option<PathBuf>,
    /// Also evaluate profile, helix and pitch of every tooth (ISO 1328-1) from all points: `gear` in the JSON, gear.csv in the
    /// report
    #[arg(long)]
    gear: bool,
    /// How views are registered: all together to the surface; one after the other by the article's method (a map without a
    /// verdict); or both, the article's figures beside ours
    #[arg(long, value_enum, default_value_t = MethodName::Surface)]
    method: MethodName,
    #[command(flatten)]
    article: ArticleSettingsFile,
    #[command(flatten)]
    common: Common,
    #[command(flatten)]
    die: DieArgs,
}

/// A method by its name.
#[derive(clap::ValueEnum, Clone, Copy, Debug, PartialEq)]
enum MethodName {
    Surface,
    // Its earlier name is understood, too.
    #[value(alias = "paper")]
    Article,
    Both,
}

impl Args {
    /// Stitching method, and the settings of the article's method.
    fn stitching(&self, seed: u64) -> anyhow::Result<(Method, ArticleSettings)> {
        let method = match self.method {
            MethodName::Surface => Method::Surface,
            MethodName::Article => Method::Article,
            MethodName::Both => Method::Both,
        };
        anyhow::ensure!(
            self.article.article_settings.is_none() || method != Method::Surface,
            "--article-settings is for the article's method: add --method article or both"
        );
        Ok((method, self.article.load(seed)?))
    }
}

/// Settings of the simulated bench, which must be the same when a scan is continued.
fn on_the_bench(link: &Link, bench: &BenchSetup) -> BTreeMap<String, String> {
    let what_stands = || (Article::BENCH.to_string(), in_words(bench));
    link.is_simulated().then(what_stands).into_iter().collect()
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    interrupt::on_signals()?;
    let quiet = args.common.quiet;
    let bench = args.die.setup()?;
    let (method, article) = args.stitching(seed(&bench))?;
    if args.gear && method == Method::Article {
        anyhow::bail!(
            "--gear: the article's method claims no uncertainty; --method surface or both does"
        );
    }
    if args.clouds.is_some() && method != Method::Surface {
        anyhow::bail!(
            "--clouds: the article's method masks points by their fringes, which clouds do not have; --method surface does not"
        );
    }
    let recording = args.frames.as_deref().map(Recording::open).transpose()?;
    let clouds = args.clouds.as_deref().map(CloudRecording::open);
    let clouds = clouds.transpose()?;
    let recorded = match (&recording, &clouds) {
        (Some(frames), _) => Some(Link::Recorded(recording_id(frames))),
        (None, Some(clouds)) => Some(Link::Clouds(clouds.id())),
        (None, None) => None,
    };
    let is_live = recorded.is_none();
    if !is_live {
        fits_recording(&bench)?;
    }
    let site = match recorded {
        Some(recorded) => args.place.of_recording(recorded)?,
        None => args.place.site(&[("--tool", args.tool.is_some())])?,
    };
    anyhow::ensure!(
        !is_live || site.settings.stages.moves == Moves::Die,
        "stages.moves is not \"die\": a scan turns the die on its table, where it can be told from the slide's lean; it needs a station \
         with moves = \"die\""
    );
    let site = match is_live {
        true => site.by_its_stages("a scan lays its views together")?,
        false => site,
    };
    args.try_places()?;
    let passing = match &args.session {
        Some(_) => None,
        None => Some(scratch()?),
    };
    let session = args
        .session
        .as_deref()
        .or_else(|| passing.as_ref().map(|folder| folder.path()))
        .unwrap_or(Path::new("."));
    let set_up = |scanner: &mut Scanner| -> anyhow::Result<()> {
        scanner.against(args.reference.as_deref())?;
        if let Some(spacing_mm) = args.mesh_mm {
            scanner.check_spacing(spacing_mm).context("--mesh-mm")?;
        }
        Ok(scanner.by_method(method, article)?)
    };
    let mut scanning = match (&recording, clouds) {
        (Some(recording), _) => args.recorded(recording, &site, session, set_up)?,
        (None, Some(clouds)) => args.of_clouds(clouds, &site, session, set_up)?,
        (None, None) => args.live(&bench, &site, session, set_up)?,
    };
    let watch = |progress| {
        if !quiet {
            show(progress);
        }
    };
    let mut complaints = Complaints::default();
    let mut scan = match &mut scanning {
        Scanning::Recorded(scanner, frames) => scanner.scan_recorded(frames, watch)?,
        Scanning::Clouds(clouds) => clouds.scan(watch)?,
        Scanning::Live(instrument) => {
            let saved = args.begin_saving(instrument)?;
            let (port, settings) = (&instrument.port, instrument.settings.clone());
            let scan = instrument.job.scan(port, settings, watch);
            let scan = scan.map_err(|error| match error {
                ScanError::Interrupted { done, of, .. } if passing.is_some() => anyhow::anyhow!(
                    "interrupted after {done} of {of} views; none was kept; with --session DIR a scan can be continued"
                ),
                error => error.into(),
            })?;
            if let Some((folder, head)) = saved {
                let recorded = instrument.job.record(folder, &head);
                complaints.hear(recorded.map_err(Into::into));
            }
            if let Some(folder) = &args.save_clouds {
                let head = instrument.copy_head(folder)?;
                let saved = instrument.job.save_clouds(folder, &head);
                complaints.hear(saved.map(drop).map_err(Into::into));
            }
            scan
        }
    };
    // The verdict is final; it is printed and returned even if reports cannot be written.
    if args.report.is_some() {
        let compared = scanning.scanner().compare(&mut scan);
        complaints.hear(compared.map_err(Into::into));
    }
    if args.gear {
        let evaluated = scanning.scanner().evaluate_gear(&mut scan);
        complaints.hear(evaluated.map_err(|error| anyhow::Error::from(error).context("--gear")));
    }
    if let Some(cloud) = &args.cloud {
        complaints.hear(args.write_cloud(&scanning, &scan, cloud));
    }
    if let Some(mesh) = &args.mesh {
        complaints.hear(args.write_mesh(&scanning, &scan, mesh));
    }
    if args.common.shows_table() {
        complaints.hear(print(&scan));
    }
    if let Scanning::Live(instrument) = scanning {
        scan.truth = complaints.hear(instrument.close(quiet)).flatten();
    }
    // Signed, because it may be the reference of later scans.
    scan.seal = complaints.hear(seal(&scan));
    complaints.hear_of(args.common.document(), &mut scan);
    complaints.hear(args.write_report(&mut scan));
    Ok(complaints.end(scan.verdict, &scan.sentence(), quiet))
}

fn seal(scan: &Scan) -> anyhow::Result<Seal> {
    Ok(seals()?.seal(Kind::Scan, scan)?)
}

/// Source of the scan.
enum Scanning {
    /// A die in front of the instrument.
    Live(Box<Instrument<Scanner>>),
    /// Recorded frames.
    Recorded(Box<Scanner>, RecordedFrames),
    /// Recorded clouds.
    Clouds(Box<CloudScan>),
}

impl Scanning {
    fn scanner(&self) -> &Scanner {
        match self {
            Self::Live(instrument) => &instrument.job,
            Self::Recorded(scanner, _) => scanner,
            Self::Clouds(clouds) => &clouds.scanner,
        }
    }
}

impl Args {
    fn live(
        &self,
        bench: &BenchSetup,
        site: &Site,
        session: &Path,
        set_up: impl FnOnce(&mut Scanner) -> anyhow::Result<()>,
    ) -> anyhow::Result<Scanning> {
        let scene = Scene {
            by_hand: true,
            ..Scene::default()
        };
        let instrument = Instrument::start(
            [self.tool.as_deref(), self.head.as_deref()],
            site,
            bench,
            scene,
            self.common.quiet,
            |subject, root| {
                let bench = on_the_bench(site.link(), bench);
                let setting = site.setting.clone();
                let mut scanner =
                    Scanner::open(subject, setting, self.views, session, &bench, root)?;
                set_up(&mut scanner)?;
                Ok(scanner)
            },
        )?;
        Ok(Scanning::Live(Box::new(instrument)))
    }

    fn recorded(
        &self,
        recording: &Recording,
        site: &Site,
        session: &Path,
        set_up: impl FnOnce(&mut Scanner) -> anyhow::Result<()>,
    ) -> anyhow::Result<Scanning> {
        let mut subject = self.recorded_subject(recording.head(), site)?;
        subject.temperature_degc = recording.index.tool_temperature_degc;
        let setting = site.setting.clone();
        let (mut scanner, frames) = Scanner::open_recorded(subject, setting, recording, session)?;
        set_up(&mut scanner)?;
        Ok(Scanning::Recorded(Box::new(scanner), frames))
    }

    fn of_clouds(
        &self,
        clouds: CloudRecording,
        site: &Site,
        session: &Path,
        set_up: impl FnOnce(&mut Scanner) -> anyhow::Result<()>,
    ) -> anyhow::Result<Scanning> {
        let subject = self.recorded_subject(clouds.head(), site)?;
        let mut clouds = CloudScan::open(subject, site.setting.clone(), clouds, session)?;
        set_up(&mut clouds.scanner)?;
        Ok(Scanning::Clouds(Box::new(clouds)))
    }

    /// Subject of a recording that names this head.
    fn recorded_subject(&self, head: Option<PathBuf>, site: &Site) -> anyhow::Result<Subject> {
        let files = [self.tool.as_deref(), self.head.as_deref()];
        recorded_subject(files, head, site, self.common.quiet)
    }

    /// Starts writing frames, if requested; returns their folder, and the head file in it.
    fn begin_saving(
        &self,
        instrument: &mut Instrument<Scanner>,
    ) -> anyhow::Result<Option<(&Path, PathBuf)>> {
        let Some(folder) = self.save_frames.as_deref() else {
            return Ok(None);
        };
        let head = instrument.copy_head(folder)?;
        instrument.job.save_frames(folder)?;
        Ok(Some((folder, head)))
    }

    /// Before anything moves: a scan whose results cannot be written should not begin.
    fn try_places(&self) -> anyhow::Result<()> {
        self.common.try_json()?;
        if let Some(folder) = &self.report {
            try_report(folder, ReportFolder::OF_SCAN)?;
        }
        for (folder, index) in [
            (&self.save_frames, FrameIndex::FILE),
            (&self.save_clouds, CloudIndex::FILE),
        ] {
            folder
                .as_deref()
                .map_or(Ok(()), |folder| try_recording(folder, index))?;
        }
        self.cloud.as_deref().map(Format::of_cloud).transpose()?;
        self.mesh.as_deref().map(Format::of_mesh).transpose()?;
        self.cloud.as_deref().map_or(Ok(()), try_place)?;
        self.mesh.as_deref().map_or(Ok(()), try_place)
    }

    fn write_cloud(&self, scanning: &Scanning, scan: &Scan, path: &Path) -> anyhow::Result<()> {
        let format = Format::of_cloud(path)?;
        let mut count = 0;
        write_file(path, |file| {
            count = scanning
                .scanner()
                .write_cloud(scan, format, file)
                .map_err(std::io::Error::other)?;
            Ok(())
        })?;
        self.show(&format!("{count} points: {}", path.display()))
    }

    fn write_mesh(&self, scanning: &Scanning, scan: &Scan, path: &Path) -> anyhow::Result<()> {
        let format = Format::of_mesh(path)?;
        let scanner = scanning.scanner();
        let fine = self
            .mesh_mm
            .map(|spacing_mm| scanner.fine_map(scan, spacing_mm));
        let fine = fine.transpose()?;
        write_file(path, |file| {
            let map = fine.as_ref().unwrap_or(&scan.map);
            scan_mesh(scan, map, format, file)
        })
    }

    fn write_report(&self, scan: &mut Scan) -> anyhow::Result<()> {
        let Some(folder) = &self.report else {
            return self.show("add --report DIR for the map as HTML and PLY");
        };
        let mut folder = ReportFolder::new(folder);
        folder.put(scan)?;
        self.show(&format!("report: {}", folder.page().display()))
    }

    fn show(&self, line: &str) -> anyhow::Result<()> {
        if self.common.shows_table() {
            writeln!(std::io::stdout(), "{line}")?;
        }
        Ok(())
    }
}

fn show(progress: Progress) {
    match progress {
        Progress::Views {
            done,
            of,
            remaining,
        } => say_remaining("views", [done, of], remaining),
        Progress::Recapture(view) => say(&format!("view {} is captured again", view + 1)),
        Progress::Stitching => say("all views are laid on the CAD together"),
    }
}

fn print(scan: &Scan) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    let registered = |r: &&ScanRegistration| r.status == ViewStatus::Registered;
    writeln!(
        out,
        "\n{} of {} views, {} % of the bore seen, {}",
        scan.registration.iter().filter(registered).count(),
        scan.registration.len(),
        percent(scan.coverage_ratio),
        match &scan.adjustment {
            Some(joint) => format!("joint solve in {} rounds", joint.rounds),
            None => "laid on the CAD one by one".into(),
        }
    )?;
    if let Some(form) = &scan.form {
        writeln!(
            out,
            "ovality {:.1} µm (largest at {:.0}°), taper {:.1} µm",
            form.ovality_um, form.ovality_deg, form.taper_um
        )?;
    }
    if let Some(placement) = &scan.placement {
        writeln!(out, "against the earlier scan: {}", placement.reason)?;
    }
    if let [_, _, ..] = &scan.methods[..] {
        print_methods(&mut out, &scan.methods)?;
    }
    if let Some(gear) = &scan.gear {
        writeln!(
            out,
            "\ngear, U95 of a deviation {:.1} µm, of F_p and F_r {:.1} µm:",
            gear.u95_um, gear.cumulative_u95_um
        )?;
        write_evaluation(&mut out, &gear.evaluation)?;
    }
    let reason = scan.reason.to_string();
    let said = inspect::in_words(Terminal::of_stdout(), scan.verdict, &reason);
    writeln!(out, "\n{said}")?;
    write_origin(&mut out, &scan.origin, &scan.date)?;
    writeln!(
        out,
        "scan {:.1} s, last view to result {:.1} s, {} of {} frames, {} MB",
        scan.timing_ms.total / 1e3,
        scan.last_view_to_result_ms / 1e3,
        scan.frames.received,
        scan.frames.triggered,
        figure(scan.peak_memory_mb),
    )?;
    Ok(())
}

fn print_methods(out: &mut impl Write, methods: &[MethodResult]) -> std::io::Result<()> {
    writeln!(
        out,
        "\n{:<8} {:>6} {:>10} {:>9} {:>9} {:>15} {:>15} {:>12} {:>7}",
        "method",
        "views",
        "ovality µm",
        "taper µm",
        "exact µm",
        "one view µm",
        "merged µm",
        "drift µm",
        "time s"
    )?;
    let spread = |of: Option<Spread>| {
        of.map_or("-".into(), |s| {
            format!("{:.1} ± {:.1}", s.mean_um, s.std_um)
        })
    };
    for of in methods {
        let form = |value: fn(&Form) -> f64| {
            of.form
                .as_ref()
                .map_or("-".into(), |form| format!("{:.1}", value(form)))
        };
        writeln!(
            out,
            "{:<8} {:>6} {:>10} {:>9} {:>9} {:>15} {:>15} {:>12} {:>7.1}",
            of.method,
            of.registered_views,
            form(|f| f.ovality_um),
            form(|f| f.taper_um),
            of.exact.map_or("-".into(), |s| format!("{:.1}", s.rms_um)),
            spread(of.one_view),
            spread(of.merged),
            of.drift.largest.map_or("none".into(), |c| format!(
                "{:.0} {}",
                c.trend_um, c.direction
            )),
            of.stitching_ms / 1e3
        )?;
    }
    Ok(())
}
