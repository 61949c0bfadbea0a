//! `flankscope calibrate`: from captures of a target to a head file.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, bail, ensure};
use flankscope_foundation::date::Date;
use flankscope_frames::SharedRoot;
use flankscope_jobs::calibration::{
    Autofocus, Calibrated, CaptureFolder, CoreSearch, FitnessSurvey, PlateSurvey, ViewReport,
    save_self_test,
};
use flankscope_profilometry::HeadModel;
use flankscope_profilometry::calibrate::{Captures, Target};
use flankscope_profilometry::head::{Arrangements, CalibrationRecord, Judged, SelfTest};
use flankscope_record::seal::{Kind, toml_document};
use serde::Serialize;

use crate::bench_link::{BenchArgs, demo_target};
use crate::calibrate_autofocus;
use crate::calibrate_board::{self, Order};
use crate::calibrate_drawing;
use crate::calibrate_focus::{self, FocusArgs};
use crate::help;
use crate::instrument::{Instrument, fits_bench, scratch, seals};
use crate::interrupt;
use crate::output::{Common, Outcome, say};
use crate::progress::Watcher;
use crate::scene::Scene;
use crate::site::{Made, Place, Site};

#[derive(clap::Args)]
#[command(
    about = "Calibrate the head: capture a target's plates, find cores, lenses, poses and hand-eye, write a head file",
    long_about = format!(
        "Calibrate the head: capture a target's plates, find cores, lenses, poses and hand-eye, write a head file.\n\n\
        The target sits where the die does: plates with printed dots, a blank one beside them. Its folder holds target.toml and \
        head.toml, the values of the drawing to start from.{} Plates that took no part in the adjustment are measured with the \
        result; what they show is in the head file, with the day on which the calibration expires. A self-test on a plane and \
        spheres follows; it is due again every few days, by --check. A check with a head whose calibration expired, or whose \
        self-test failed or is overdue, is indeterminate.",
        help::CALIBRATE_DEFAULT
    ),
    after_help = format!(
        "{}\n\n\
        Exit code: 0 done or fit, 2 not fit, 3 could not run or no calibration",
        help::CALIBRATE_EXAMPLE
    ),
    group(clap::ArgGroup::new("of_board").args(["images", "drawing"]))
)]
pub struct Args {
    #[arg(long, value_name = "DIR", help = help::TARGET)]
    target: Option<PathBuf>,
    /// Folder with images from elsewhere, to use instead of captures; it contains captures.toml and PLAN.toml, or board.toml
    #[arg(long, value_name = "DIR", conflicts_with = "check")]
    images: Option<PathBuf>,
    /// Description of the checkerboard, ChArUco board or circle grid in the images [default: board.toml beside them, if there is one]
    #[arg(
        long,
        value_name = "BOARD.toml",
        requires = "of_board",
        conflicts_with = "target"
    )]
    board: Option<PathBuf>,
    #[command(flatten)]
    focus: FocusArgs,
    #[command(flatten)]
    place: Place,
    /// Write the head file here, its core map and its first self-test beside it
    #[arg(
        long,
        short,
        value_name = "HEAD.toml",
        required_unless_present_any = ["check", "autofocus", "drawing"]
    )]
    output: Option<PathBuf>,
    /// Only test this calibrated head on plane and spheres; the result is written beside it
    #[arg(long, value_name = "HEAD.toml", conflicts_with = "output")]
    check: Option<PathBuf>,
    /// Only draw what is printed on the plates of --target, or the board of --board, for whoever makes them: at scale, with dimensions,
    /// tolerances and a ruler of 100 mm
    #[arg(
        long,
        value_name = "FILE.svg",
        conflicts_with_all = ["output", "check", "images", "autofocus", "focus", "focus_series"]
    )]
    drawing: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
    #[command(flatten)]
    bench: BenchArgs,
}

#[derive(Serialize)]
struct CheckDocument<'a> {
    head: &'a Path,
    #[serde(flatten)]
    made: Made<'a>,
    fit: bool,
    reason: Option<String>,
    self_test: &'a SelfTest,
    /// The quantity nearest to its limit.
    worst: Option<Judged>,
    arrangements: Option<[Arrangements; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    truth: Option<serde_json::Value>,
}

#[derive(Serialize)]
struct Document<'a> {
    head: &'a Path,
    #[serde(flatten)]
    made: Made<'a>,
    calibration: &'a CalibrationRecord,
    self_test: Option<&'a SelfTest>,
    worst: Option<Judged>,
    arrangements: Option<[Arrangements; 3]>,
    cores: Option<usize>,
    views: &'a [ViewReport],
    elapsed_ms: Elapsed,
    #[serde(skip_serializing_if = "Option::is_none")]
    truth: Option<serde_json::Value>,
}

#[derive(Serialize)]
struct Elapsed {
    cores: f64,
    plates: f64,
    self_test: f64,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    interrupt::on_signals()?;
    if let Some(drawing) = &args.drawing {
        let (target, board) = (args.target.as_deref(), args.board.as_deref());
        return calibrate_drawing::run(drawing, target, board, &args.common);
    }
    if let (Some(images), Some(output)) = (&args.images, &args.output)
        && (args.board.is_some() || args.target.is_none() && !images.join(Captures::FILE).is_file())
    {
        args.common.try_json()?;
        can_write(output)?;
        let order = Order {
            images,
            board: args.board.as_deref(),
            output,
        };
        return calibrate_board::run(&order, &args.common);
    }
    if let (Some(series), Some(output), false) =
        (&args.focus.focus_series, &args.output, args.focus.autofocus)
    {
        ensure!(
            args.target.is_none(),
            "--target: nothing is captured to compute a head from --focus-series; leave it out, or add --autofocus"
        );
        args.common.try_json()?;
        can_write(output)?;
        return calibrate_focus::run(&args.focus, series, output, &args.common);
    }
    let passing = scratch()?;
    let folder = match &args.target {
        Some(folder) => folder.clone(),
        None => demo_target(passing.path())?,
    };
    let target = Target::load(&folder.join("target.toml")).context("target")?;
    args.common.try_json()?;
    let of_target = ("--target", args.target.is_some() && args.images.is_none());
    if args.focus.autofocus {
        return autofocus(args, of_target, &folder, &target);
    }
    match (&args.check, &args.output) {
        (Some(head), _) => check(args, of_target, &folder, target, head),
        (None, Some(output)) => {
            can_write(output)?;
            let path = folder.join("head.toml");
            let mut head = HeadModel::load(&path).context("head to start from")?;
            if args.images.is_some() {
                has_one_projector(&head, "--images")?;
            }
            if let Some(setting_dpt) = args.focus.focus {
                let lens = head.lens.with_context(|| {
                    format!(
                        "--focus {setting_dpt}: {} has no [lens], so there is nothing to drive",
                        path.display()
                    )
                })?;
                let lens = lens.driven_to(setting_dpt);
                head.lens = Some(lens.map_err(|bad| bad.in_file(&path, ""))?);
            }
            let job = Job {
                args,
                site: site_of_its_stages(args, &[of_target])?,
                folder: &folder,
                target,
                output,
            };
            match &args.images {
                Some(images) => job.by_images(head, images),
                None => job.by_captures(head),
            }
        }
        (None, None) => bail!("--output or --check is needed"),
    }
}

/// The station, which must move and know the head by its own stages.
fn site_of_its_stages(args: &Args, required: &[(&str, bool)]) -> anyhow::Result<Site> {
    let site = args.place.site(required)?;
    site.with_own_stages("a calibration")?
        .by_its_stages("a calibration finds the head's place on its stages")
}

/// Finds the setting at which the camera is sharp on the target's blank plate, and writes the head for it if requested.
fn autofocus(
    args: &Args,
    of_target: (&str, bool),
    folder: &Path,
    target: &Target,
) -> anyhow::Result<Outcome> {
    let series = args.focus.focus_series.as_deref();
    ensure!(
        args.output.is_some() == series.is_some(),
        "--autofocus writes a head (-o HEAD.toml) by --focus-series FOCUS.toml, and only by that: give both or neither"
    );
    if let Some(output) = &args.output {
        can_write(output)?;
    }
    let head = match &args.focus.head {
        Some(path) => believed(path)?,
        None => HeadModel::load(&folder.join("head.toml")).context("head to start from")?,
    };
    has_one_projector(&head, "--autofocus")?;
    let site = site_of_its_stages(args, &[of_target])?;
    begin(args, &site, target, &head)?;
    let settings = &site.settings;
    let mut search = open(args, &site, folder, |root| {
        Ok(Autofocus::open(head, target, settings, root)?)
    })?;
    let mut watcher = Watcher::new(args.common.quiet, Vec::new());
    let focused = search
        .job
        .search(&search.port, search.settings.clone(), |p| watcher.show(p))?;
    let truth = search.close(args.common.quiet)?;
    let setting_dpt = focused.lens.setting_dpt();
    let written = series.zip(args.output.as_deref());
    let written = written
        .map(|(series, output)| {
            let record = calibrate_focus::write(&args.focus, setting_dpt, series, output)?;
            anyhow::Ok((output, record))
        })
        .transpose()?;
    let written = written.as_ref().map(|(path, record)| (*path, record));
    let made = Made::by(&site.setting, false);
    calibrate_autofocus::conclude(&focused, made, written, truth, &args.common)
}

/// Reads a head file; a calibrated one must have a valid signature.
fn believed(path: &Path) -> anyhow::Result<HeadModel> {
    let head = HeadModel::load(path).context("head")?;
    if head.calibration.is_some() {
        let document = toml_document(path, &flankscope_foundation::files::read_text(path)?)?;
        seals()?.believe(Kind::Head, path, &document)?;
    }
    Ok(head)
}

/// Refuses a head with two projectors for options that know the frames of one only.
pub fn has_one_projector(head: &HeadModel, option: &str) -> anyhow::Result<()> {
    ensure!(
        head.second_projector.is_none(),
        "{option}: the head to start from has a [second_projector], whose frames are not told apart here: take it out for a head with one projector, or calibrate through --link"
    );
    Ok(())
}

/// Checks before any measurement that the head's folder exists.
fn can_write(output: &Path) -> anyhow::Result<()> {
    ensure!(
        output
            .parent()
            .is_none_or(|folder| folder == Path::new("") || folder.is_dir()),
        "cannot write {}: its folder does not exist",
        output.display()
    );
    Ok(())
}

/// Tests a head; one that fails can judge nothing, so the outcome is indeterminate.
fn check(
    args: &Args,
    of_target: (&str, bool),
    folder: &Path,
    target: Target,
    path: &Path,
) -> anyhow::Result<Outcome> {
    let mut head = believed(path)?;
    // A head from the bench is tested on the bench. For any other head, the user names the link.
    let made = head.calibration.as_ref().and_then(|made| made.simulated);
    let of_head = (
        "--check of a head that is not known to be the bench's",
        made != Some(true),
    );
    let site = site_of_its_stages(args, &[of_target, of_head])?;
    let setting = &site.setting;
    site.takes_head(&head)?;
    begin(args, &site, &target, &head)?;
    ensure!(
        !setting.link.is_simulated() || made != Some(false),
        "{}: this head was calibrated at a press ({}); the simulated bench cannot test it: name the press by --link PORT",
        path.display(),
        head.calibration
            .as_ref()
            .and_then(|made| made.link.as_deref())
            .unwrap_or("unknown port")
    );
    let (test, truth) = self_test(args, &site, folder, &head, target)?;
    save_self_test(&test, path)?;
    seals()?.seal_toml(Kind::SelfTest, &SelfTest::path_of(path))?;
    head.self_test = Some(test.clone());
    let unfit = head.fit_on(Date::today()).err();
    args.common.write_json(&CheckDocument {
        head: path,
        made: Made::by(setting, false),
        fit: unfit.is_none(),
        reason: unfit.as_ref().map(ToString::to_string),
        self_test: &test,
        worst: test.worst(),
        arrangements: test.arrangements(),
        truth,
    })?;
    if !args.common.quiet && args.common.json.as_deref() != Some(Path::new("-")) {
        let mut out = std::io::stdout().lock();
        print_self_test(&mut out, &test)?;
        if let Some(unfit) = &unfit {
            writeln!(out, "UNFIT: {unfit}")?;
        }
    }
    Ok(if unfit.is_none() {
        Outcome::Done
    } else {
        Outcome::INDETERMINATE
    })
}

fn self_test(
    args: &Args,
    site: &Site,
    folder: &Path,
    head: &HeadModel,
    target: Target,
) -> anyhow::Result<(SelfTest, Option<serde_json::Value>)> {
    let quiet = args.common.quiet;
    let mut survey = open(args, site, folder, |root| {
        let settings = &site.settings;
        Ok(FitnessSurvey::open(head.clone(), target, settings, root)?)
    })?;
    let mut watcher = Watcher::new(quiet, Vec::new());
    let test = survey
        .job
        .test(&survey.port, survey.settings.clone(), Date::today(), |p| {
            watcher.show(p);
        })?;
    Ok((test, survey.close(quiet)?))
}

/// Settings of a calibration.
struct Job<'a> {
    args: &'a Args,
    site: Site,
    folder: &'a Path,
    target: Target,
    output: &'a Path,
}

/// Durations of each step.
struct Clock {
    begun: Instant,
    cores: Instant,
    plates: Instant,
}

impl Job<'_> {
    /// Calibrates from captures by the instrument.
    fn by_captures(self, mut head: HeadModel) -> anyhow::Result<Outcome> {
        let Self {
            args,
            ref site,
            folder,
            ref target,
            output,
        } = self;
        let settings = &site.settings;
        let quiet = args.common.quiet;
        let begun = Instant::now();
        begin(args, site, target, &head)?;
        if head.core_map.is_none() && head.binning > 1 {
            let mut search = open(args, site, folder, |root| {
                Ok(CoreSearch::open(&head, target, settings, root)?)
            })?;
            let mut watcher = Watcher::new(quiet, Vec::new());
            let map = search
                .job
                .find(&search.port, search.settings.clone(), |p| watcher.show(p))?;
            search.close(true)?;
            head.core_map = Some(map.into());
        }
        let cores = Instant::now();
        let mut survey = open(args, site, folder, |root| {
            let (head, target) = (head.clone(), target.clone());
            Ok(PlateSurvey::open(head, target, settings, root)?)
        })?;
        let mut watcher = Watcher::new(quiet, Vec::new());
        let calibrated = survey
            .job
            .calibrate(&survey.port, survey.settings.clone(), |p| watcher.show(p))?;
        let truth = survey.close(quiet)?;
        let record = calibrated.save(output, Some(site.link()), Date::today())?;
        seals()?.seal_toml(Kind::Head, output)?;
        let plates = Instant::now();
        let tested = if target.sphere.is_some() && target.limits.is_some() {
            let head = HeadModel::load(output)?;
            Some(self_test(args, site, folder, &head, target.clone())?.0)
        } else {
            None
        };
        let clock = Clock {
            begun,
            cores,
            plates,
        };
        self.conclude(&calibrated, &record, tested, truth, &clock)
    }

    /// Calibrates from images that another instrument captured.
    fn by_images(self, head: HeadModel, images: &Path) -> anyhow::Result<Outcome> {
        let quiet = self.args.common.quiet;
        let begun = Instant::now();
        let folder = CaptureFolder::open(images, head, self.target.clone())?;
        let mut folder = folder.with_stages(&self.site.settings.stages);
        let calibrated = folder.calibrate(|view| {
            if !quiet {
                say(&view.display().to_string());
            }
        })?;
        let record = calibrated.save(self.output, None, Date::today())?;
        seals()?.seal_toml(Kind::Head, self.output)?;
        let plates = Instant::now();
        let tested = folder.self_test(&HeadModel::load(self.output)?, Date::today())?;
        let clock = Clock {
            begun,
            cores: begun,
            plates,
        };
        self.conclude(&calibrated, &record, tested, None, &clock)
    }

    fn conclude(
        &self,
        calibrated: &Calibrated,
        record: &CalibrationRecord,
        tested: Option<SelfTest>,
        truth: Option<serde_json::Value>,
        clock: &Clock,
    ) -> anyhow::Result<Outcome> {
        let Self { args, output, .. } = self;
        if let Some(test) = &tested {
            save_self_test(test, output)?;
            seals()?.seal_toml(Kind::SelfTest, &SelfTest::path_of(output))?;
        }
        let milliseconds = |from: Instant, to: Instant| (to - from).as_secs_f64() * 1e3;
        let document = Document {
            head: output,
            made: Made::by(&self.site.setting, args.images.is_some()),
            calibration: record,
            self_test: tested.as_ref(),
            worst: tested.as_ref().and_then(SelfTest::worst),
            arrangements: tested.as_ref().and_then(SelfTest::arrangements),
            cores: calibrated.cores(),
            views: &calibrated.views,
            elapsed_ms: Elapsed {
                cores: milliseconds(clock.begun, clock.cores),
                plates: milliseconds(clock.cores, clock.plates),
                self_test: milliseconds(clock.plates, Instant::now()),
            },
            truth,
        };
        args.common.write_json(&document)?;
        if !args.common.quiet && args.common.json.as_deref() != Some(Path::new("-")) {
            print(calibrated, record, output)?;
            let mut out = std::io::stdout().lock();
            match &tested {
                Some(test) => print_self_test(&mut out, test)?,
                None => writeln!(
                    out,
                    "no self-test yet; checks need one: flankscope calibrate --check {}",
                    output.display()
                )?,
            }
        }
        Ok(Outcome::Done)
    }
}

/// Before anything moves: checks what a real press requires, and prints station, target and head.
fn begin(args: &Args, site: &Site, target: &Target, head: &HeadModel) -> anyhow::Result<()> {
    fits_bench(&args.bench.setup()?, site)?;
    site.demands_target(args.target.as_deref())?;
    if !args.common.quiet {
        let (target, head) = (&target.name, &head.name);
        say(&format!(
            "{}\ntarget   {target}\nhead     {head}",
            site.words()
        ));
    }
    Ok(())
}

fn open<S>(
    args: &Args,
    site: &Site,
    folder: &Path,
    station: impl FnOnce(Arc<SharedRoot>) -> anyhow::Result<S>,
) -> anyhow::Result<Instrument<S>> {
    let scene = Scene {
        target: true,
        ..Scene::default()
    };
    Instrument::before(
        folder,
        site,
        &args.bench.setup()?,
        scene,
        args.common.quiet,
        scratch()?,
        station,
    )
}

fn print(calibrated: &Calibrated, record: &CalibrationRecord, path: &Path) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    writeln!(out)?;
    for view in &calibrated.views {
        writeln!(
            out,
            "plate {} at {:>8.3}° and {:>7.3} mm: {} dots{}",
            view.plate + 1,
            view.rotation_deg,
            view.vertical_mm,
            view.dots,
            if view.kept_aside { ", kept aside" } else { "" }
        )?;
    }
    if let Some(cores) = calibrated.cores() {
        writeln!(out, "\n{cores} cores")?;
    }
    writeln!(
        out,
        "{} dots in {} views, {} left out; residual {:.3} px of the dots, {:.3} px of the fringes",
        record.dots, record.views, record.dropped, record.camera_rms_px, record.projector_rms_px
    )?;
    writeln!(
        out,
        "a point's standard uncertainty by the calibration: {:.1} µm in depth, {:.1} µm across",
        record.depth_sigma_um, record.lateral_sigma_um
    )?;
    let apart = record.second_projector.as_ref();
    let by_second = apart.and_then(|apart| apart.hold_out);
    let plates = [
        ("", &record.hold_out),
        (", by the second projector", &by_second),
        (", without residual fields", &record.without_field),
    ];
    for (with, aside) in plates {
        let Some(aside) = aside else { continue };
        writeln!(
            out,
            "{} plates not used in the adjustment{with}: flat to {:.1} µm rms ({:.0} µm from peak to valley), dots in place to {:.1} µm rms",
            aside.views, aside.flatness_rms_um, aside.flatness_um, aside.dots_rms_um
        )?;
    }
    if let Some(apart) = apart {
        let allowed_um = apart.allowed_um();
        writeln!(
            out,
            "both projectors see 95 % of all points within {allowed_um:.1} µm of each other"
        )?;
    }
    if record.simulated == Some(true) {
        writeln!(out, "SIMULATED BENCH: this head cannot be used at a press")?;
    }
    writeln!(out, "{}: valid until {}", path.display(), record.expires)?;
    Ok(())
}

fn print_self_test(out: &mut impl Write, test: &SelfTest) -> std::io::Result<()> {
    let limits = test.limits;
    let places = test
        .places
        .map_or_else(String::new, |places| format!(", worst of {places} places"));
    for (by, figures) in test.each() {
        writeln!(
            out,
            "self-test{by}{places}: flatness {:.1} µm (limit {}), probing form {:.1} µm (limit {}), probing size {:+.2} µm (limit ±{}){}; counts until {}",
            figures.of_planes.flatness_um,
            limits.flatness_um,
            figures.of_spheres.probing_form_um,
            limits.probing_form_um,
            figures.of_spheres.probing_size_um,
            limits.probing_size_um,
            figures
                .of_spheres
                .sphere_spacing_um
                .map_or_else(String::new, |off_um| {
                    let limit = limits
                        .sphere_spacing_um
                        .map_or_else(|| "no limit".into(), |um| format!("limit ±{um}"));
                    format!(", sphere spacing {off_um:+.2} µm ({limit})")
                }),
            test.due
        )?;
        if let (Some(flatness_um), Some(form_um)) = (
            figures.of_planes.flatness_cells_um,
            figures.of_spheres.probing_form_cells_um,
        ) {
            writeln!(
                out,
                "of means over 0.25 mm, by which wear is judged: flatness {flatness_um:.1} µm, probing form {form_um:.1} µm"
            )?;
        }
    }
    if let Some(arrangements) = test.arrangements() {
        let words =
            arrangements.map(|seen| format!("{} {} of {}", seen.of, seen.measured, seen.asked));
        writeln!(
            out,
            "arrangements measured, of those that VDI/VDE 2634 part 2 asks for: {}",
            words.join(", ")
        )?;
    }
    if let Some(worst) = test.worst() {
        writeln!(
            out,
            "nearest to its limit: {}{}, {:.1} of {} µm",
            worst.what, worst.by, worst.um, worst.limit_um
        )?;
    }
    Ok(())
}
