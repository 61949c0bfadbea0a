//! How often the verdict is right, measured.
//!
//! From the light on the cores over the rendered raw frames to the verdict a capture takes the instrument's own way; what is
//! left out is the way between the processes (controller, shared memory, pairing), which changes no value, and the other
//! teeth. Captures come in blocks of eight: two drawn stage positions, each seen by four drawn calibrations with noise of
//! its own. What such calibrations leave on a master is evaluated first, by draws of its own, and stated to the instrument.
//!
//! ```text
//!  cases ──► scene (die, blocks of captures) ──► capture (frames, decoding, evaluation) ──► tally ──► page (markdown, SVG)
//!                                                                       truth ──────────────┘        ▲
//!  plane ──► staircase (pixel by pixel, core by core) ──────────────────────────────────────────────────┘
//! ```

mod capture;
mod cases;
mod page;
mod scene;
mod staircase;
mod stated;
mod tally;
mod truth;

use std::path::PathBuf;

use flankscope_metrology::tool::Tool;
use flankscope_profilometry::HeadModel;
use rand::RngExt;
use rand_pcg::rand_core::SeedableRng;

use crate::demo;
pub use cases::{Case, Group, cases};
use scene::Scene;
pub use tally::{Cell, Sample};

/// The tooth that is looked at.
const TOOTH: u32 = 40;

/// How large the study is.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// Folder for `README.md`, `study.json` and the plots.
    #[arg(long)]
    pub out: PathBuf,
    /// Captures per row; the rows about single measures take a fifth, those about a baseline half.
    #[arg(long, default_value_t = 200)]
    pub captures: u32,
    /// Seed of all that is drawn: surface, calibrations, stages, noise.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Only rows whose name contains this.
    #[arg(long)]
    pub only: Option<String>,
}

/// Runs every case and writes the page.
///
/// # Errors
/// The bench or the instrument refuses a case, or the folder cannot be written.
pub fn run(args: &Args) -> anyhow::Result<()> {
    std::fs::create_dir_all(&args.out)?;
    let wanted = |case: &Case| {
        args.only
            .as_ref()
            .is_none_or(|text| case.name.contains(text))
    };
    let cases: Vec<Case> = cases().into_iter().filter(wanted).collect();
    anyhow::ensure!(!cases.is_empty(), "no row of the study has such a name");
    let outcome = measure(&cases, args.captures, args.seed, |line| eprintln!("{line}"))?;
    let staircase = staircase::profiles(&demo_head()?)?;
    page::write(&args.out, &outcome, &staircase, args)
}

/// The demo head with its cores.
fn demo_head() -> anyhow::Result<HeadModel> {
    let folder = tempfile::tempdir()?;
    demo::write_tool(folder.path())?;
    Ok(HeadModel::load(&folder.path().join("head.toml"))?)
}

/// What the study found.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// What drawn calibrations leave of a depth on a master, and the head's drift of its difference to a baseline, µm.
    pub stated_um: [f64; 2],
    /// One per case.
    pub cells: Vec<Cell>,
}

/// Measures `captures` captures of each case, of the smaller ones their share.
///
/// # Errors
/// The bench or the instrument refuses a case.
pub fn measure(
    cases: &[Case],
    captures: u32,
    seed: u64,
    mut tell: impl FnMut(&str),
) -> anyhow::Result<Outcome> {
    let folder = tempfile::tempdir()?;
    demo::write_tool(folder.path())?;
    let mut tool = Tool::load(folder.path())?;
    // The bench makes the die of the very facets of its CAD: no chord is off here.
    tool.cad.chord_error_um = 0.0;
    let head = HeadModel::load(&folder.path().join("head.toml"))?;
    let stated_um = stated::on_master_um(&tool, &head, seed)?;
    if let Some(inspect) = &mut tool.inspect {
        inspect.calibration_um = Some(stated_um[0]);
        inspect.drift_um = stated_um[1];
    }
    tell(&format!(
        "on a master, calibrations leave {:.2} µm, drift since a baseline {:.2} µm (root mean square)",
        stated_um[0], stated_um[1]
    ));
    let mut cells: Vec<Option<Cell>> = cases.iter().map(|_| None).collect();
    for together in together(cases) {
        let of_scene: Vec<&Case> = together.iter().map(|&i| &cases[i]).collect();
        let found = Scene::new(&of_scene, &tool, &head, seed)?.cells(captures)?;
        for (i, cell) in together.into_iter().zip(found) {
            tell(&cell.line());
            cells[i] = Some(cell);
        }
    }
    Ok(Outcome {
        stated_um,
        cells: cells.into_iter().flatten().collect(),
    })
}

/// Indices of the cases that are seen in the same captures.
fn together(cases: &[Case]) -> Vec<Vec<usize>> {
    let mut scenes: Vec<Vec<usize>> = Vec::new();
    for (i, case) in cases.iter().enumerate() {
        let joins = |scene: &&mut Vec<usize>| scene.len() == 1 && case.goes_with(&cases[scene[0]]);
        match scenes.iter_mut().find(joins) {
            Some(scene) => scene.push(i),
            None => scenes.push(vec![i]),
        }
    }
    scenes
}

/// Numbers drawn for one purpose.
struct Random(rand_pcg::Pcg64);

impl Random {
    fn new(seed: u64, purpose: u64) -> Self {
        Self(rand_pcg::Pcg64::seed_from_u64(
            seed.wrapping_mul(64).wrapping_add(purpose),
        ))
    }

    fn uniform(&mut self) -> f64 {
        self.0.random()
    }

    /// Standard normal (Box and Muller 1958).
    fn normal(&mut self) -> f64 {
        let (a, b) = (1.0 - self.uniform(), self.uniform());
        (-2.0 * a.ln()).sqrt() * (std::f64::consts::TAU * b).cos()
    }
}
