//! `flankscope patterns`: the pictures that the DMD has to show.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context;
use flankscope_instrument::patterns::{
    Adaptive, CaptureTime, Manifest, Packing, Passes, Region, write, write_adaptive,
};
use flankscope_instrument::settings::Timing;
use flankscope_jobs::plan::ViewPlan;
use flankscope_metrology::tool::Tool;
use flankscope_profilometry::head::{Arrangement, HeadModel, Mirrors};
use flankscope_profilometry::pattern::{NAMED, PatternSet};
use flankscope_profilometry::plan::Plan;

use crate::bench_link::demo_tool;
use crate::help;
use crate::instrument::scratch;
use crate::output::{Common, Outcome, try_folder};

/// How pictures are stored.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Stored {
    /// A grey PNG for each pattern
    Grey,
    /// Three patterns to a 24 bit BMP, as the flash of a DLPC350 takes them
    Dlpc350,
    /// A grey 24 bit BMP for each pattern behind a black one, as the flash of a DLPC900 takes them
    Dlpc900,
}

impl From<Stored> for Packing {
    fn from(stored: Stored) -> Self {
        match stored {
            Stored::Grey => Self::Grey,
            Stored::Dlpc350 => Self::Dlpc350,
            Stored::Dlpc900 => Self::Dlpc900,
        }
    }
}

/// Write the pattern sets as images for the DMD, with a manifest of order, bit planes and LED.
///
/// Each set gets a folder with its images and patterns.json. Size and arrangement of the mirrors are those of the head file
/// (`[mirrors]`, else `[projector]`).
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  flankscope patterns --head head.toml -o patterns\n\
    writes patterns/article8, patterns/insitu12 and every other set the instrument knows\n\n\
    Exit code: 0 done, 3 could not run"
)]
pub struct Args {
    #[arg(long, value_name = "HEAD.toml", help = help::PATTERNS_HEAD)]
    head: Option<PathBuf>,
    /// Only this set: its name, such as insitu12 or high12, or a plan file (.toml) that names it [default: all sets]
    #[arg(long, value_name = "NAME|PLAN.toml")]
    set: Option<String>,
    /// Images for one view of this tool, which light left flanks, right flanks and the rest in passes of their own
    #[arg(long, value_name = "TOOL", requires = "tooth")]
    adaptive: Option<PathBuf>,
    /// Tooth in the middle of that view
    #[arg(long, value_name = "TOOTH", requires = "adaptive")]
    tooth: Option<u32>,
    /// Height of that view, mm [default: the tool file's]
    #[arg(
        long,
        value_name = "MM",
        requires = "adaptive",
        allow_hyphen_values = true
    )]
    height: Option<f64>,
    /// Margin of a pass around its flanks, mm: largest error of the pose before the first frame
    #[arg(
        long,
        value_name = "MM",
        requires = "adaptive",
        default_value_t = 0.1,
        allow_hyphen_values = true
    )]
    margin: f64,
    /// How the images are stored [default: dlpc350 for diamond mirrors, else grey]
    #[arg(long, value_enum, value_name = "HOW")]
    pack: Option<Stored>,
    /// Folder to write into
    #[arg(long, short, value_name = "DIR")]
    output: PathBuf,
    #[command(flatten)]
    common: Common,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    args.common.try_json()?;
    if let (Some(folder), Some(tooth)) = (&args.adaptive, args.tooth) {
        return adaptive(args, folder, tooth);
    }
    let head = args.head()?;
    let mirrors = args.mirrors(&head)?;
    let packing = args
        .pack
        .map_or_else(|| Packing::of(mirrors), Packing::from);
    try_folder(&args.output, &[])?;
    let mut manifests = Vec::new();
    for set in args.sets(&head)? {
        let folder = args.output.join(&set.name);
        let manifest = write(&folder, &set, mirrors, packing)?;
        if args.common.shows_table() {
            let mut out = std::io::stdout().lock();
            writeln!(
                out,
                "{}: {} patterns in {} images and {}",
                folder.display(),
                manifest.patterns.len(),
                manifest.files.len(),
                Manifest::FILE
            )?;
        }
        manifests.push(manifest);
    }
    args.common.write_json(&manifests)?;
    Ok(Outcome::Done)
}

/// Pictures for the passes of one view.
fn adaptive(args: &Args, folder: &Path, tooth: u32) -> anyhow::Result<Outcome> {
    let tool = Tool::load(folder)?;
    let head = args.head()?;
    let packing = args
        .pack
        .map_or_else(|| Packing::of(head.mirrors()), Packing::from);
    args.mirrors(&head)?;
    let set = match &args.set {
        None => head
            .patterns()?
            .context("the head file names no pattern_set: choose one with --set")?,
        Some(_) => args.sets(&head)?.swap_remove(0),
    };
    let mut views = ViewPlan::nominal(&tool, &[tooth])?;
    let mut view = views.swap_remove(0);
    view.vertical_mm = args.height.unwrap_or(view.vertical_mm);
    anyhow::ensure!(
        view.vertical_mm.is_finite(),
        "--height {}: must be a finite height in mm",
        view.vertical_mm
    );
    anyhow::ensure!(
        !head.exposures_us.is_empty(),
        "the head file has no exposures_us, which say how long a view takes"
    );
    let passes = Passes::new(&tool, &head, &view, args.margin)?;
    let time = CaptureTime::of(&set, &head.exposures_us, &Timing::default());
    try_folder(&args.output, &[])?;
    let written = write_adaptive(&args.output, &set, &passes, time, packing)?;
    if args.common.shows_table() {
        told(&written, &args.output)?;
    }
    args.common.write_json(&written)?;
    Ok(Outcome::Done)
}

/// Prints what was written, and the capture time of a view with it.
fn told(written: &Adaptive, output: &Path) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    for pass in &written.passes {
        let folder = output.join(pass.lights.name());
        let lit = 100.0 * pass.lit_ratio;
        let bright = 100.0 * pass.brightness_ratio;
        writeln!(
            out,
            "{}: {lit:.1} % of the mirrors, {bright:.0} % bright",
            folder.display()
        )?;
    }
    let time = &written.time;
    writeln!(
        out,
        "A view takes {} frames in {:.2} s, {} passes; plain {} in {:.2} s",
        time.frames,
        time.seconds,
        Region::ALL.len(),
        time.plain_frames,
        time.plain_seconds
    )?;
    for loading in &written.loading {
        let time = match loading.at_most_s {
            Some(seconds) => format!("at most {seconds:.3} s"),
            None => "not possible, or not known".to_owned(),
        };
        let (controller, note) = (loading.controller, loading.note);
        writeln!(out, "Until {controller} has them: {time}\n    ({note})")?;
    }
    Ok(())
}

impl Args {
    fn head(&self) -> anyhow::Result<HeadModel> {
        let own = scratch()?;
        let path = match (&self.head, &self.adaptive) {
            (Some(path), _) => path.clone(),
            (None, Some(tool)) => tool.join("head.toml"),
            (None, None) => demo_tool(own.path())?.join("head.toml"),
        };
        HeadModel::load(&path).context("head")
    }

    fn mirrors(&self, head: &HeadModel) -> anyhow::Result<Mirrors> {
        let mirrors = head.mirrors();
        anyhow::ensure!(
            !matches!(self.pack, Some(Stored::Dlpc350))
                || mirrors.arrangement == Arrangement::Diamond
                    && (mirrors.columns, mirrors.rows) == (912, 1140),
            "--pack dlpc350: a DLPC350 drives 912 x 1140 diamond mirrors (DLP4500), this head has {} x {} {:?} ones",
            mirrors.columns,
            mirrors.rows,
            mirrors.arrangement
        );
        Ok(mirrors)
    }

    fn sets(&self, head: &HeadModel) -> anyhow::Result<Vec<PatternSet>> {
        let plan = self.set.as_deref().filter(|set| set.ends_with(".toml"));
        if let Some(path) = plan {
            let mut set = Plan::load(Path::new(path))?.patterns;
            if set.name.is_empty() || set.name.contains(['/', '\0']) || set.name.starts_with('.') {
                set.name = "plan".into();
            }
            return Ok(vec![set]);
        }
        let own = head.patterns()?.filter(|_| !head.fringes.is_empty());
        let known = NAMED.iter().map(|(name, _)| PatternSet::named(name));
        Ok(match (&self.set, own) {
            (Some(name), Some(own)) if *name == own.name => vec![own],
            (Some(name), _) => vec![PatternSet::named(name)?],
            (None, own) => own
                .map(Ok)
                .into_iter()
                .chain(known)
                .collect::<Result<_, _>>()?,
        })
    }
}
