//! `flankscope patterns`: the pictures that the DMD has to show.

use std::io::Write;
use std::path::PathBuf;

use anyhow::Context;
use flankscope_profilometry::head::{Arrangement, HeadModel, Mirrors};
use flankscope_profilometry::pattern::{NAMED, PatternSet};
use flankscope_profilometry::plan::Plan;
use flankscope_station::patterns::{Manifest, Packing, write};

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
}

impl From<Stored> for Packing {
    fn from(stored: Stored) -> Self {
        match stored {
            Stored::Grey => Self::Grey,
            Stored::Dlpc350 => Self::Dlpc350,
        }
    }
}

/// Write the pattern sets as images for the DMD's own mirrors, with a manifest of order, bit planes and LED.
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
    /// Only this set, such as insitu12 or high12 [default: all of them]
    #[arg(long, value_name = "NAME")]
    set: Option<String>,
    /// The set of a plan file instead
    #[arg(long, value_name = "PLAN.toml", conflicts_with = "set")]
    plan: Option<PathBuf>,
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
    let mirrors = args.mirrors()?;
    let packing = args
        .pack
        .map_or_else(|| Packing::of(mirrors), Packing::from);
    try_folder(&args.output, &[])?;
    let mut manifests = Vec::new();
    for set in args.sets()? {
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

impl Args {
    fn mirrors(&self) -> anyhow::Result<Mirrors> {
        let own = scratch()?;
        let path = match &self.head {
            Some(path) => path.clone(),
            None => demo_tool(own.path())?.join("head.toml"),
        };
        let head = HeadModel::load(&path).context("head")?;
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

    fn sets(&self) -> anyhow::Result<Vec<PatternSet>> {
        if let Some(path) = &self.plan {
            let mut set = Plan::load(path)?.patterns;
            if set.name.is_empty() || set.name.contains(['/', '\0']) || set.name.starts_with('.') {
                set.name = "plan".into();
            }
            return Ok(vec![set]);
        }
        let known = NAMED.iter().map(|(name, _)| *name);
        let sets: Result<_, _> = match &self.set {
            Some(name) => PatternSet::named(name).map(|set| vec![set]),
            None => known.map(PatternSet::named).collect(),
        };
        Ok(sets?)
    }
}
