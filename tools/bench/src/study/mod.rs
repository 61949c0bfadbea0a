//! How often the verdict is right, measured.
//!
//! Every capture draws new stage errors, new noise and, with every second, a new calibration with errors of 0.03 px (a
//! baseline was taken with one that differs by 0.01 px). What such errors do to a depth is evaluated first, by draws of its
//! own, and stated to the instrument. From the light on the cores over the rendered raw frames to the verdict it takes the instrument's own way; what it leaves out is
//! the way between the processes (controller, shared memory, pairing), which changes no value, and the other two views.
//!
//! ```text
//!  cases ──► capture (world, frames, decoding, evaluation) ──► tally ──► page (markdown, SVG)
//! ```

mod capture;
mod page;
mod tally;

use std::path::PathBuf;

use anyhow::Context;
use flankscope_metrology::gear::GearData;
use flankscope_metrology::tool::{Datum, Temperature, Tool};
use flankscope_metrology::wear::Zone;
use flankscope_profilometry::HeadModel;
use flankscope_profilometry::decode::GridKind;
use flankscope_station::baseline::Baseline;
use nalgebra::Vector2;
use rand::RngExt;
use rand_pcg::rand_core::SeedableRng;

use crate::demo;
use crate::world::{FlankId, Wear, WearField, WearKind, World};
use capture::{CALIBRATION_PX, DRIFT_PX, Instrument, Trouble, calibrated, judged};
pub use tally::{Cell, Sample};

/// The tooth that is looked at, and worn on its left flank.
const TOOTH: u32 = 40;
/// Captures per drawn calibration.
const CAPTURES_PER_CALIBRATION: u32 = 2;
/// Steel.
const EXPANSION_PER_K: f64 = 11.5e-6;

/// How large the study is.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// Folder for `README.md`, `study.json` and the plots.
    #[arg(long)]
    pub out: PathBuf,
    /// Captures per cell.
    #[arg(long, default_value_t = 200)]
    pub captures: u32,
    /// Seed of all that is drawn: surface, calibrations, stages, noise.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

/// One cell of the study: a state of die and instrument.
#[derive(Clone, Debug)]
pub struct Case {
    /// Name in the tables.
    pub name: String,
    /// Group of cells that one table shows.
    pub group: Group,
    /// Damage of the left flank.
    pub wear: Option<(WearKind, f64)>,
    /// What the pose rests on.
    pub datum: Datum,
    /// Temperature of the die above that of its CAD, K, and whether the instrument knows it.
    pub warm: Option<(f64, bool)>,
    /// What a point is made of.
    pub grid: GridKind,
    /// Whether the undamaged die was captured before by the same instrument.
    pub baseline: bool,
    /// Light missing or die turned.
    trouble: Trouble,
}

/// What a cell is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Group {
    /// Depth against truth.
    Wear,
    /// Captures that deserve no verdict.
    Spoiled,
    /// One measure taken away.
    Measure,
}

/// All cells of the full study.
#[must_use]
pub fn cases() -> Vec<Case> {
    let worn = |kind: WearKind, um: f64, word: &str| Case {
        name: if um == 0.0 {
            "undamaged".into()
        } else {
            format!("{word} {um} µm")
        },
        group: Group::Wear,
        wear: (um > 0.0).then_some((kind, um)),
        datum: Datum::Neighbours,
        warm: None,
        grid: GridKind::Core,
        baseline: false,
        trouble: Trouble::default(),
    };
    let mut cases = Vec::new();
    for um in [0.0, 3.0, 5.0, 10.0, 20.0, 50.0, 80.0] {
        cases.push(worn(WearKind::Uniform, um, "uniform"));
    }
    for (kind, word) in [
        (WearKind::Tip, "tip"),
        (WearKind::Pit, "pit"),
        (WearKind::Buildup, "built-up"),
    ] {
        for um in [3.0, 5.0, 10.0, 20.0, 50.0, 80.0] {
            cases.push(worn(kind, um, word));
        }
    }
    let spoiled = |name: &str, trouble| Case {
        name: name.into(),
        group: Group::Spoiled,
        trouble,
        ..worn(WearKind::Uniform, 0.0, "")
    };
    cases.push(spoiled(
        "turned by half a pitch",
        Trouble {
            turned_rad: std::f64::consts::PI / 84.0,
            dimmed: 0.0,
        },
    ));
    cases.push(spoiled(
        "turned by a pitch and a quarter",
        Trouble {
            turned_rad: 2.5 * std::f64::consts::PI / 84.0,
            dimmed: 0.0,
        },
    ));
    cases.push(spoiled(
        "0.5 % of the light",
        Trouble {
            turned_rad: 0.0,
            dimmed: 0.995,
        },
    ));
    let measure = |name: &str, datum, warm| Case {
        name: name.into(),
        group: Group::Measure,
        datum,
        warm,
        ..worn(WearKind::Uniform, 20.0, "uniform")
    };
    cases.push(measure(
        "20 µm, pose on neighbours",
        Datum::Neighbours,
        None,
    ));
    cases.push(Case {
        grid: GridKind::Pixel,
        ..measure("20 µm, pixels instead of cores", Datum::Neighbours, None)
    });
    cases.push(measure("20 µm, pose on everything", Datum::All, None));
    cases.push(measure("20 µm, pose on lands", Datum::Lands, None));
    cases.push(measure(
        "20 µm, 40 K warmer, corrected",
        Datum::Neighbours,
        Some((40.0, true)),
    ));
    cases.push(measure(
        "20 µm, 40 K warmer, not known",
        Datum::Neighbours,
        Some((40.0, false)),
    ));
    cases.push(measure(
        "20 µm, lands, 40 K warmer, corrected",
        Datum::Lands,
        Some((40.0, true)),
    ));
    cases.push(measure(
        "20 µm, lands, 40 K warmer, not known",
        Datum::Lands,
        Some((40.0, false)),
    ));
    for um in [0.0, 3.0, 5.0, 20.0] {
        cases.push(Case {
            name: format!("{um} µm, since a baseline"),
            group: Group::Measure,
            baseline: true,
            ..worn(WearKind::Uniform, um, "uniform")
        });
    }
    cases
}

/// Runs every case and writes the page.
///
/// # Errors
/// The bench or the instrument refuses a case, or the folder cannot be written.
pub fn run(args: &Args) -> anyhow::Result<()> {
    std::fs::create_dir_all(&args.out)?;
    let outcome = measure(&cases(), args.captures, args.seed, |line| {
        eprintln!("{line}")
    })?;
    page::write(&args.out, &outcome, args)
}

/// What the study found.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Standard uncertainty of a depth by the drawn calibrations, and by the head's drift since a baseline, µm.
    pub stated_um: [f64; 2],
    /// One per case.
    pub cells: Vec<Cell>,
}

/// Measures `captures` captures of each case.
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
    let mut plain = Tool::load(folder.path())?;
    let head = HeadModel::load(&folder.path().join("head.toml"))?;
    let stated_um = [
        depth_error_um(&plain, &head, CALIBRATION_PX, seed)?,
        depth_error_um(&plain, &head, DRIFT_PX, seed)?,
    ];
    if let Some(inspect) = &mut plain.inspect {
        inspect.calibration_um = Some(stated_um[0]);
        inspect.drift_um = stated_um[1];
    }
    tell(&format!(
        "calibrations move a depth by {:.2} µm, drift by {:.2} µm (standard deviations)",
        stated_um[0], stated_um[1]
    ));
    let mut cells = Vec::new();
    for case in cases {
        let mut tool = plain.clone();
        if let Some(inspect) = &mut tool.inspect {
            inspect.datum = case.datum;
        }
        let (kelvin, known) = case.warm.unwrap_or((0.0, true));
        if case.warm.is_some() && known {
            tool.temperature = Some(Temperature {
                reference_degc: 20.0,
                range_degc: [10.0, 80.0],
                expansion_per_k: EXPANSION_PER_K,
                u_k: 1.0,
            });
        }
        let mut config = demo::world_of(&tool, &head)?;
        config.run_seed = seed;
        config.growth = 1.0 + EXPANSION_PER_K * kelvin;
        config.wear = case
            .wear
            .map(|(kind, um)| Wear {
                tooth: TOOTH,
                flank: flankscope_gear_cad::Flank::Left,
                depth_mm: um * 1e-3,
                kind,
            })
            .into_iter()
            .collect();
        let truth_um = truth_um(&tool, &config.gear, &config.wear)?;
        let world = World::new(&config)?;
        config.wear.clear();
        let fresh = if case.baseline {
            Some(World::new(&config)?)
        } else {
            None
        };
        let mut cell = Cell::new(case, truth_um);
        let mut instrument = None;
        for number in 0..captures {
            if number % CAPTURES_PER_CALIBRATION == 0 {
                let draw = seed * 1_000_003 + u64::from(number / CAPTURES_PER_CALIBRATION) + 1;
                let drawn = calibrated(&head, draw, CALIBRATION_PX);
                let degc = case.warm.map(|_| 20.0 + kelvin);
                let baseline = if let Some(fresh) = &fresh {
                    // Its own stage errors and noise, as on another day.
                    let before = calibrated(&drawn, draw + (1 << 40), DRIFT_PX);
                    let absolute = Instrument::new(&tool, &before, case.grid, degc, None)?;
                    let golden = absolute.capture(fresh, captures + number + 1, case.trouble)?;
                    Some(Baseline {
                        tool: tool.name.clone(),
                        hashes: std::collections::BTreeMap::new(),
                        flanks: golden.fields,
                    })
                } else {
                    None
                };
                instrument = Some(Instrument::new(&tool, &drawn, case.grid, degc, baseline)?);
            }
            let Some(instrument) = &instrument else {
                continue;
            };
            let outcome = instrument.capture(&world, number + 1, case.trouble)?;
            cell.add(&judged(&outcome)?);
        }
        tell(&cell.line());
        cells.push(cell);
    }
    Ok(Outcome { stated_um, cells })
}

/// What calibrations with errors of `sd_px` do to the depth of an undamaged flank, µm: its standard deviation over draws,
/// each with a capture of its own (a Monte Carlo evaluation as in JCGM 101, with the noise of one capture in it). The draws are
/// not those of the cells.
fn depth_error_um(tool: &Tool, head: &HeadModel, sd_px: f64, seed: u64) -> anyhow::Result<f64> {
    const DRAWS: u32 = 40;
    /// Captures beyond those of the cells.
    const FIRST: u32 = 1 << 20;
    let mut config = demo::world_of(tool, head)?;
    config.run_seed = seed;
    let world = World::new(&config)?;
    let depth_um = |head: &HeadModel, number: u32| -> anyhow::Result<f64> {
        let instrument = Instrument::new(tool, head, GridKind::Core, None, None)?;
        let feature = judged(&instrument.capture(&world, number, Trouble::default())?)?;
        feature.wear_um.context("an undamaged flank has no figure")
    };
    let mut depths = Vec::new();
    for number in 0..DRAWS {
        let draw = (seed << 20) + u64::from(number) + (1 << 50);
        depths.push(depth_um(&calibrated(head, draw, sd_px), FIRST + number)?);
    }
    let mean = depths.iter().sum::<f64>() / f64::from(DRAWS);
    let squares: f64 = depths.iter().map(|depth| (depth - mean).powi(2)).sum();
    Ok((squares / f64::from(DRAWS - 1)).sqrt())
}

/// The measurand: the percentile over the zone's cells of the true depth, averaged over each cell; of the height of
/// built-up material for cases with such. From the damage's closed form, not from anything measured.
fn truth_um(
    tool: &Tool,
    gear: &flankscope_gear_cad::GearSpec,
    wear: &[Wear],
) -> anyhow::Result<f64> {
    let (Some(data), Some(zone)) = (&tool.gear, tool.zone()) else {
        anyhow::bail!("the demo tool has no zone");
    };
    let field = WearField::new(gear, wear)?;
    let settings = tool.wear_settings();
    let mut depths = depths_um(data, &zone, &field, settings.cell_mm);
    depths.sort_by(f64::total_cmp);
    let buildup = wear.iter().any(|one| one.kind == WearKind::Buildup);
    let share = if buildup {
        100.0 - settings.percentile
    } else {
        settings.percentile
    } / 100.0;
    let rank = share * (depths.len() - 1) as f64;
    let (low, part) = (rank.floor() as usize, rank.fract());
    let value = depths[low] + part * (depths[(low + 1).min(depths.len() - 1)] - depths[low]);
    Ok(if buildup { -value } else { value })
}

/// True mean depth of each cell of the zone, µm.
fn depths_um(gear: &GearData, zone: &Zone, field: &WearField, cell_mm: f64) -> Vec<f64> {
    /// Samples along each side of a cell.
    const FINE: usize = 12;
    let id = FlankId {
        tooth: TOOTH,
        flank: flankscope_gear_cad::Flank::Left,
    };
    let from = Vector2::new(gear.profile_mm(zone.radius_mm[0]), zone.height_mm[0]);
    let size = Vector2::new(gear.profile_mm(zone.radius_mm[1]), zone.height_mm[1]) - from;
    let count = size.map(|length| (length / cell_mm).floor() as usize);
    let base = gear.base_radius_mm();
    let mut depths = Vec::with_capacity(count.x * count.y);
    for row in 0..count.y {
        for column in 0..count.x {
            let mut sum = 0.0;
            for i in 0..FINE * FINE {
                let inside =
                    Vector2::new((i % FINE) as f64 + 0.5, (i / FINE) as f64 + 0.5) / FINE as f64;
                let cell = Vector2::new(column as f64, row as f64) + inside;
                let at = from
                    + size
                        .component_mul(&cell)
                        .component_div(&count.map(|n| n as f64));
                // Profile length s from the base circle: r2 = rb2 + 2 rb s.
                let radius = (base * base + 2.0 * base * at.x).sqrt();
                sum += field.depth_mm(id, radius, at.y);
            }
            depths.push(1e3 * sum / (FINE * FINE) as f64);
        }
    }
    depths
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
