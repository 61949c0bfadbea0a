//! How often the verdict is right, measured.
//!
//! From the light on the cores over the rendered raw frames to the verdict a capture takes the instrument's own way; what is
//! left out is the way between the processes (controller, shared memory, pairing), which changes no value. What errors share
//! is drawn once for a *block*: a head with its own cores and lenses, calibrated on the bench by the instrument's own
//! calibration; a die with form errors of its own; a tooth and a height. Intervals of rates count blocks, not captures.
//!
//! ```text
//!  cases ──► block (calibration, die, place) ──► capture (frames, decoding, evaluation) ──► tally ──► page (markdown, SVG)
//!                              truth (closed form of the damage) ───────────────────────────┘        ▲
//!  plane ──► staircase (pixel by pixel, core by core) ───────────────────────────────────────────────┘
//!  campaign: random damage against exact distances, for the tests
//!  structure ──► stand (a calibrated head before meshes) ──► resolution (width by depth), families (drawn at random), press (all teeth)
//! ```

mod block;
mod calibration;
mod campaign;
mod capture;
mod cases;
mod characteristic;
mod chart;
mod families;
mod page;
mod press;
mod resolution;
mod runs;
mod setup;
mod staircase;
mod stand;
mod structure;
mod tally;
mod truth;

use std::path::PathBuf;

use block::Measured;
pub use block::{BlockReport, PointSigma};
pub use campaign::{Judgement, random_damages};
pub use cases::{Case, Damaged, Depth, Group, Right, cases};
pub use families::{Draw, Family, draws};
use flankscope_bench::config::SurfaceKind;
use flankscope_bench::files::MadeHead;
use flankscope_foundation::files::write_whole;
use setup::{Setup, on_all_cores};
pub use tally::{Cell, Figure, Sample};

/// What is studied.
#[derive(clap::ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Subject {
    /// How often the verdict is right: rows of damage.
    #[default]
    Verdicts,
    /// The smallest openings that are seen: width by depth.
    Resolution,
    /// How often dies of families drawn at random are passed.
    Families,
    /// Dies whose teeth all wear: how often the verdict is right, with a baseline, with a datum band, and without.
    Press,
}

/// How large the study is.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// What is studied.
    #[arg(value_enum, default_value_t)]
    pub subject: Subject,
    /// Folder for `README.md`, `study.json` and the plots.
    #[arg(long)]
    pub out: PathBuf,
    /// Blocks: heads with calibrations of their own, each before a die of its own.
    #[arg(long, default_value_t = 16)]
    pub blocks: u32,
    /// Captures per row and block.
    #[arg(long, default_value_t = 1)]
    pub captures: u32,
    /// Seed of all that is drawn: heads, targets, dies, damage, stages, noise [default: from --commit]
    #[arg(long)]
    pub seed: Option<u64>,
    /// Head before them: 10mm, 20mm, or an optics.toml [default: 20mm]
    #[arg(long, value_name = "NAME|FILE")]
    pub head: Option<MadeHead>,
    /// Surface of the dies.
    #[arg(long, value_enum, default_value_t)]
    pub surface: SurfaceKind,
    /// Pattern set that is thrown on them [default: that of the head]
    #[arg(long)]
    pub patterns: Option<String>,
    /// Folder that keeps finished blocks of damage rows, so that a run that was ended goes on where it was.
    #[arg(long)]
    pub keep: Option<PathBuf>,
    /// Only rows whose name contains this.
    #[arg(long)]
    pub only: Option<String>,
    /// The commit that is studied: its hash, 40 digits.
    #[arg(long, default_value = "unknown")]
    pub commit: String,
    /// Log that this run is appended to.
    #[arg(long, value_name = "CSV", requires = "why")]
    pub log: Option<PathBuf>,
    /// Why it is run, for the log.
    #[arg(long, value_name = "TEXT")]
    pub why: Option<String>,
}

/// Runs every case and writes the page.
///
/// # Errors
/// The bench or the instrument refuses a case, or the folder cannot be written.
pub fn run(args: &Args) -> anyhow::Result<()> {
    std::fs::create_dir_all(&args.out)?;
    match args.subject {
        Subject::Verdicts => {}
        Subject::Resolution => return resolution::run(args),
        Subject::Families => return families::run(args),
        Subject::Press => return press::run(args),
    }
    let wanted = |case: &Case| {
        args.only
            .as_ref()
            .is_none_or(|text| case.name.contains(text))
    };
    let cases: Vec<Case> = cases().into_iter().filter(wanted).collect();
    anyhow::ensure!(!cases.is_empty(), "no row of the study has such a name");
    let patterns = args.patterns.as_deref();
    let setup = Setup::load(args.head.as_ref())?.with_surface(args.surface, patterns);
    let kept = Kept::new(args)?;
    let outcome = measure_with(&setup, &cases, args.captures, &kept, |line| {
        eprintln!("{line}");
    })?;
    let staircase = staircase::profiles(Setup::load(None)?.head())?;
    page::write(&args.out, &outcome, &staircase, args)
}

impl Args {
    /// The seed: that which was chosen, else what follows from the commit.
    ///
    /// # Errors
    /// None was chosen, and the commit is no hash.
    pub fn seed(&self) -> anyhow::Result<u64> {
        self.seed.map_or_else(|| runs::seed_of(&self.commit), Ok)
    }
}

/// What the study found.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Name of the head, and of the pattern set that was thrown on the dies.
    pub head: String,
    pub patterns: String,
    /// What blocks were made of.
    pub blocks: Vec<BlockReport>,
    /// One per row.
    pub cells: Vec<Cell>,
}

/// Blocks to measure, and where finished ones are kept.
struct Kept {
    folder: Option<PathBuf>,
    blocks: u32,
    seed: u64,
}

impl Kept {
    /// Blocks of another run are never taken for those of `args`: what determines them names the folder.
    fn new(args: &Args) -> anyhow::Result<Self> {
        let seed = args.seed()?;
        let determines = format!(
            "{} {seed} {} {:?} {:?} {:?} {:?}",
            args.commit,
            args.captures,
            args.head.as_ref().map(|head| &head.given),
            args.surface,
            args.patterns,
            args.only
        );
        let name = flankscope_foundation::files::hash(determines.as_bytes());
        let folder = args.keep.as_ref().map(|keep| keep.join(&name[..16]));
        if let Some(folder) = &folder {
            std::fs::create_dir_all(folder)?;
        }
        Ok(Self {
            folder,
            blocks: args.blocks,
            seed,
        })
    }

    /// The kept block, else that which `measure` finds, which is kept.
    fn block(
        &self,
        number: u32,
        measure: impl FnOnce() -> anyhow::Result<Measured>,
    ) -> anyhow::Result<Measured> {
        let file = self
            .folder
            .as_ref()
            .map(|of| of.join(format!("block-{number}.json")));
        let kept = file.as_ref().and_then(|file| std::fs::read(file).ok());
        if let Some(kept) = kept {
            return Ok(serde_json::from_slice(&kept)?);
        }
        let measured = measure()?;
        if let Some(file) = file {
            write_whole(&file, &serde_json::to_vec(&measured)?)?;
        }
        Ok(measured)
    }
}

/// Captures each case `captures` times in each of `blocks` blocks.
///
/// # Errors
/// The bench or the instrument refuses a case.
pub fn measure(
    cases: &[Case],
    blocks: u32,
    captures: u32,
    seed: u64,
    tell: impl Fn(&str) + Sync,
) -> anyhow::Result<Outcome> {
    let none = Kept {
        folder: None,
        blocks,
        seed,
    };
    measure_with(&Setup::load(None)?, cases, captures, &none, tell)
}

fn measure_with(
    setup: &Setup,
    cases: &[Case],
    captures: u32,
    kept: &Kept,
    tell: impl Fn(&str) + Sync,
) -> anyhow::Result<Outcome> {
    let found = on_all_cores(kept.blocks, |number| {
        let measured = kept.block(number, || {
            block::measured(setup, (number, kept.seed), cases, captures)
        })?;
        let BlockReport {
            place,
            calibrated,
            refused,
        } = &measured.report;
        let head = match calibrated {
            Some(sigma) => format!(
                "calibrated to {:.2} µm along and {:.2} µm across the view",
                sigma.depth_sigma_um, sigma.lateral_sigma_um
            ),
            None => format!(
                "calibration refused: {}",
                refused.as_deref().unwrap_or_default()
            ),
        };
        let (tooth, height_mm) = (place.tooth, place.height_mm);
        tell(&format!(
            "block {}: tooth {tooth} at {height_mm} mm, {head}",
            number + 1
        ));
        Ok(measured)
    })?;
    let mut rows: Vec<[Option<Cell>; 2]> = cases
        .iter()
        .map(|case| {
            let other = match &case.right {
                Right::Row(name) => Some(Cell::new(name.clone(), case.group)),
                Right::Ignored | Right::Same => None,
            };
            [Some(Cell::new(case.name.clone(), case.group)), other]
        })
        .collect();
    let mut reports = Vec::new();
    for measured in found {
        reports.push(measured.report);
        for one in measured.found {
            let [same, other] = &mut rows[one.case];
            let row = match other {
                Some(other) if one.is_right => Some(other),
                _ => same.as_mut(),
            };
            if let Some(row) = row {
                row.add(one);
            }
        }
    }
    let cells: Vec<Cell> = rows.into_iter().flatten().flatten().collect();
    for cell in &cells {
        tell(&cell.line());
    }
    Ok(Outcome {
        head: setup.made.name.clone(),
        patterns: setup.patterns().to_owned(),
        blocks: reports,
        cells,
    })
}
