//! `flankscope view`: live view of one tooth for setting up the head at the die, and exposures that suit it.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail, ensure};
use flankscope_instrument::acquisition::Progress;
use flankscope_jobs::calibration::{Autofocus, DieFocus};
use flankscope_jobs::setup_view::{LiveView, write_exposures};
use flankscope_profilometry::Picture;
use flankscope_record::document::{SetupCapture, SetupView};
use flankscope_report::setup_html;
use serde::Serialize;

use crate::bench_link::{BenchSetup, DieArgs};
use crate::calibrate::has_one_projector;
use crate::calibrate_autofocus::Step;
use crate::help;
use crate::inspect::SIMULATED;
use crate::instrument::{Instrument, seals};
use crate::interrupt;
use crate::output::{Common, Outcome, say, try_place, write_whole};
use crate::progress::Watcher;
use crate::scene::Scene;
use crate::site::{Made, Place, Site};
use crate::terminal::Terminal;

/// How often a browser loads the page again, s: a capture takes a few seconds.
const REFRESH_S: u32 = 2;

#[derive(clap::Args)]
#[command(
    about = "Live view of one tooth for setting up the head: levels, saturation, contrast, focus, exposures",
    long_about = help::VIEW,
    after_help = format!(
        "{}\n\nExit code: 0 done, 2 no capture could be used or the view ended early, 3 could not run, 130 interrupted",
        help::VIEW_EXAMPLE
    )
)]
pub struct Args {
    #[arg(long, value_name = "DIR", help = help::TOOL)]
    tool: Option<PathBuf>,
    /// Head file instead of the tool folder's
    #[arg(long, value_name = "HEAD.toml")]
    head: Option<PathBuf>,
    #[command(flatten)]
    place: Place,
    /// Tooth, or number of the patch, to look at [default: the tool file's first]
    #[arg(long, value_name = "N")]
    tooth: Option<u32>,
    /// End after this many captures [default: at Ctrl-C]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    captures: Option<u32>,
    /// Also write picture, histograms and figures as this page after every capture; a browser loads it again by itself
    #[arg(long, value_name = "FILE.html")]
    page: Option<PathBuf>,
    /// Write the proposed exposures into the head file at the end; comments and every other key stay as they are
    #[arg(long, requires = "captures")]
    write_exposures: bool,
    /// Drive the head's liquid lens over its range at the tooth and report the setting at which fringes have most contrast; nothing is
    /// changed
    #[arg(long, conflicts_with_all = ["captures", "page", "write_exposures"])]
    focus: bool,
    #[command(flatten)]
    common: Common,
    #[command(flatten)]
    die: DieArgs,
}

#[derive(Serialize)]
struct Document<'a> {
    #[serde(flatten)]
    view: &'a SetupView,
    /// Head file into which the exposures were written.
    written: Option<&'a Path>,
}

#[derive(Serialize)]
struct FocusDocument<'a> {
    #[serde(flatten)]
    made: Made<'a>,
    tooth: Option<u32>,
    focus: FoundFocus,
}

/// Lens setting at which the fringes on the tooth have most contrast.
#[derive(Serialize)]
struct FoundFocus {
    /// Counts of the driver, and the resulting power.
    counts: u16,
    setting_dpt: f64,
    /// Setting with the largest contrast, its standard uncertainty by the scatter, and that contrast.
    sharpest_dpt: f64,
    sigma_dpt: f64,
    contrast: f64,
    steps: Vec<Step>,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    interrupt::on_signals()?;
    let bench = args.die.setup()?;
    let site = args.place.site(&[("--tool", args.tool.is_some())])?;
    let site = site.with_own_stages("a live view")?;
    args.try_places()?;
    let quiet = args.common.quiet;
    let scene = Scene {
        teeth: args.tooth.as_ref().map(std::slice::from_ref),
        ..Scene::default()
    };
    if args.focus {
        return args.find_focus(&site, &bench, scene);
    }
    let mut head_blake3 = String::new();
    let mut instrument = Instrument::start(
        args.files(),
        &site,
        &bench,
        scene,
        quiet,
        |subject, root| {
            head_blake3 = subject.hashes.get("head").cloned().unwrap_or_default();
            Ok(LiveView::open(
                subject,
                site.setting.clone(),
                args.tooth,
                root,
            )?)
        },
    )?;
    let head_file = instrument.own_head_file().map(Path::to_owned);
    if args.write_exposures {
        let file = head_file.as_deref().context(
            "--write-exposures: the head is the built-in one; name your own by --head HEAD.toml or --tool DIR",
        )?;
        try_place(file).context("--write-exposures")?;
    }
    let mut watcher = Watcher::new(quiet, Vec::new());
    let progress = |progress| match progress {
        Progress::Connected | Progress::Homing | Progress::Recapture(_) => watcher.show(progress),
        _ => {}
    };
    let (port, settings) = (instrument.port.clone(), instrument.settings.clone());
    let mut last_picture = None;
    let ended = instrument
        .job
        .watch(&port, settings, args.captures, progress, |view, picture| {
            last_picture = picture.cloned().or(last_picture.take());
            args.show(view)?;
            args.write_page(view, last_picture.as_ref(), Some(REFRESH_S))
        });
    let view = instrument.job.view().clone();
    args.write_page(&view, last_picture.as_ref(), None)?;
    ended?;
    instrument.close(quiet)?;
    let written = args.write_proposal(&view, head_file.as_deref(), &head_blake3);
    args.common.write_json(&Document {
        view: &view,
        written: written.as_ref().ok().copied().flatten(),
    })?;
    written?;
    if let Some(stopped) = &view.stopped {
        say(&format!("the view ended early: {stopped}"));
    }
    let is_usable = !view.captures.is_empty() && view.stopped.is_none();
    Ok(if is_usable {
        Outcome::Done
    } else {
        Outcome::INDETERMINATE
    })
}

impl Args {
    /// Folder of the tool, and head file instead of the one in it.
    fn files(&self) -> [Option<&Path>; 2] {
        [self.tool.as_deref(), self.head.as_deref()]
    }

    fn find_focus(
        &self,
        site: &Site,
        bench: &BenchSetup,
        scene: Scene<'_>,
    ) -> anyhow::Result<Outcome> {
        let quiet = self.common.quiet;
        let mut search =
            Instrument::start(self.files(), site, bench, scene, quiet, |subject, root| {
                has_one_projector(&subject.head, "--focus")?;
                Ok(Autofocus::at_die(&subject, self.tooth, root)?)
            })?;
        let mut watcher = Watcher::new(quiet, Vec::new());
        let (port, settings) = (search.port.clone(), search.settings.clone());
        let DieFocus { lens, most, steps } =
            search
                .job
                .search_die(&port, settings, |progress| watcher.show(progress))?;
        search.close(quiet)?;
        if self.common.shows_table() {
            let words = format!(
                "the fringes have most contrast, {:.3}, at {:.3} ± {:.3} dpt; the nearest counts are {} ({:.3} dpt). A head file is for \
                 one setting of its lens: for this one, calibrate the head there, or compute it (calibrate --focus-series)",
                most.contrast,
                most.setting_dpt,
                most.sigma_dpt,
                lens.counts,
                lens.setting_dpt()
            );
            writeln!(
                std::io::stdout(),
                "{}",
                Terminal::of_stdout().sentence(&words)
            )?;
        }
        self.common.write_json(&FocusDocument {
            made: Made::by(&site.setting, false),
            tooth: self.tooth,
            focus: FoundFocus {
                counts: lens.counts,
                setting_dpt: lens.setting_dpt(),
                sharpest_dpt: most.setting_dpt,
                sigma_dpt: most.sigma_dpt,
                contrast: most.contrast,
                steps: Step::list(&steps, &lens),
            },
        })?;
        Ok(Outcome::Done)
    }

    fn try_places(&self) -> anyhow::Result<()> {
        self.common.try_json()?;
        let Some(page) = &self.page else {
            return Ok(());
        };
        ensure!(
            page.extension()
                .is_some_and(|is| is == "html" || is == "htm"),
            "--page {}: it is a page, so its name ends in .html",
            page.display()
        );
        try_place(page).context("--page")
    }

    fn write_page(
        &self,
        view: &SetupView,
        picture: Option<&Picture>,
        refresh_s: Option<u32>,
    ) -> anyhow::Result<()> {
        let Some(path) = &self.page else {
            return Ok(());
        };
        write_whole(path, setup_html(view, picture, refresh_s)?.as_bytes())
    }

    /// Prints the last capture.
    fn show(&self, view: &SetupView) -> anyhow::Result<()> {
        if !self.common.shows_table() {
            return Ok(());
        }
        let (captured, lost) = (view.captures.last(), view.lost.last());
        let terminal = Terminal::of_stdout();
        let mut out = std::io::stdout().lock();
        if captured
            .map_or(0, |of| of.number)
            .max(lost.map_or(0, |of| of.number))
            == 1
            && view.origin.simulated
        {
            writeln!(out, "{SIMULATED}")?;
        }
        match (captured, lost) {
            (captured, Some(lost)) if captured.is_none_or(|of| of.number < lost.number) => {
                let words = format!("{:>4}  lost: {}", lost.number, lost.reason);
                writeln!(out, "{}", terminal.sentence(&words))?;
            }
            (Some(capture), _) => {
                writeln!(out, "{}", terminal.text(&line(view, capture)))?;
                for at in &capture.exposures {
                    let most = at.histogram.iter().copied().max().unwrap_or(0).max(1);
                    // Logarithmic, so that a few saturated pixels are seen.
                    let share = |&pixels: &u64| (pixels as f64).ln_1p() / (most as f64).ln_1p();
                    let bars = terminal.bars(at.histogram.iter().map(share));
                    writeln!(out, "      {:>6} ms |{bars}|", milliseconds(at.exposure_us))?;
                }
            }
            (None, _) => {}
        }
        Ok(out.flush()?)
    }

    /// Prints the proposed exposures, and writes them into the head file if that was requested; returns the file.
    fn write_proposal<'a>(
        &self,
        view: &SetupView,
        head_file: Option<&'a Path>,
        head_blake3: &str,
    ) -> anyhow::Result<Option<&'a Path>> {
        let Some(proposal) = &view.proposal else {
            ensure!(
                !self.write_exposures,
                "--write-exposures: no light was seen, so no exposures follow; nothing is written"
            );
            return Ok(None);
        };
        if self.common.shows_table() {
            let terminal = Terminal::of_stdout();
            let mut out = std::io::stdout().lock();
            writeln!(out, "\nproposed for the head file:\n{}", proposal.line)?;
            for reason in &proposal.reasons {
                writeln!(out, "{}", terminal.sentence(reason))?;
            }
        }
        let Some(file) = head_file.filter(|_| self.write_exposures && !interrupt::is_requested())
        else {
            return Ok(None);
        };
        if !proposal.is_final {
            bail!(
                "--write-exposures: {}; nothing is written",
                proposal
                    .reasons
                    .last()
                    .map_or("the light is not known", String::as_str)
            );
        }
        write_exposures(file, head_blake3, &proposal.exposures_us, &seals()?)?;
        if self.common.shows_table() {
            writeln!(std::io::stdout(), "written into {}", file.display())?;
        }
        Ok(Some(file))
    }
}

fn milliseconds(us: u32) -> f64 {
    f64::from(us) / 1000.0
}

/// One capture in one line.
fn line(view: &SetupView, capture: &SetupCapture) -> String {
    let number = |value: Option<f64>, decimals: usize| {
        value.map_or_else(|| "–".into(), |value| format!("{value:.decimals$}"))
    };
    let exposures = capture.exposures.iter().map(|at| {
        format!(
            "{} ms: median {:.0} max {:.0} DN, saturated {:.1} % of pixels {:.1} % of cells, modulation {} DN",
            milliseconds(at.exposure_us),
            at.median_dn,
            at.max_dn,
            100.0 * at.saturated_pixel_ratio,
            100.0 * at.saturated_cell_ratio,
            number(at.modulation_dn, 0),
        )
    });
    let exposures: Vec<String> = exposures.collect();
    let expected = view.expected.contrast.map_or_else(String::new, |contrast| {
        format!(" (head file {contrast:.2})")
    });
    format!(
        "{:>4}  {}; dark {} DN (head file {:.0}), contrast {}{expected}, focus {}, points in {:.0} % of cells",
        capture.number,
        exposures.join("; "),
        number(capture.dark_dn, 0),
        view.expected.dark_dn,
        number(capture.finest_contrast(), 2),
        number(capture.focus_contrast, 3),
        100.0 * capture.point_ratio(),
    )
}
