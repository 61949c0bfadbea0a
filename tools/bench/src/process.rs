//! The bench as a process: `flankscope bench run`, started by the host as a child.
//!
//! It says hello on standard output (where the controller's port is), runs until its standard input ends, and says
//! farewell there (what was really photographed, and how well the bench kept up).

use std::io::{Read, Write};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use flankscope_frames::{Overflow, SharedRoot};
use flankscope_gear_cad::Flank;
use flankscope_metrology::tool::Tool;
use flankscope_profilometry::calibrate::Target;
use flankscope_profilometry::{HeadModel, PatternSet};
use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use crate::ageing::Ageing;
use crate::camera::{self, FrameFault};
use crate::demo::{self, OtherDie};
use crate::devices::{self, Controller, InstrumentConfig};
use crate::die_file;
use crate::qemu::{Figures, Machine, find_image};
use crate::truth::{MeshTruth, Truth};
use crate::world::{FlankId, Form, Mount, PatternSpec, Wear, World, WorldConfig};
use crate::zones::Judged;

/// Virtual seconds per real second at `--speed max`; rendering holds the clock, so this is reached only between frames.
const MAX_SPEED: f64 = 50.0;

/// The retract switch stands this far above the die.
const SWITCH_CLEARANCE_MM: f64 = 14.0;

/// The simulated bench.
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Run the bench until standard input ends.
    Run(Box<RunArgs>),
    /// The stage controller alone, on a pseudo-terminal, until standard input ends.
    Esp301(Esp301Args),
    /// Measure how often the verdict is right; write tables and plots.
    Study(crate::study::Args),
    /// Write the demo calibration target's folder: target.toml, and head.toml with the drawing's values.
    DemoTarget {
        /// Folder to write into.
        #[arg(long, short)]
        out: PathBuf,
    },
    /// Write captures of the demo target as `calibrate --images` takes them: 20 views, 0.6 GB of images.
    DemoCaptures {
        /// Folder to write into.
        #[arg(long, short)]
        out: PathBuf,
        /// Seed of stage and plate errors, surface grain and noise.
        #[arg(long, default_value_t = 1)]
        seed: u64,
    },
    /// Write the demo tool's folder: CAD, tool.toml, head.toml.
    DemoTool {
        /// Folder to write into.
        #[arg(long, short)]
        out: PathBuf,
    },
}

/// An emulated stage controller for other people's clients.
#[derive(clap::Args)]
#[command(
    after_help = "Example: flankscope bench esp301, then open the printed port at any speed and say 1MO;1PA10;1WS;1TP?"
)]
struct Esp301Args {
    /// Seed of the stage errors.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Virtual seconds per second, or max.
    #[arg(long, default_value = "1")]
    speed: Speed,
}

/// What is on the bench.
#[derive(clap::Args)]
struct RunArgs {
    /// The host's shared-memory root.
    #[arg(long)]
    root: PathBuf,
    /// Tool folder; its head.toml, else the demo head.
    #[arg(long, required_unless_present = "target")]
    tool: Option<PathBuf>,
    /// Folder of a calibration target instead of a tool; before the demo head, whatever the folder says of one.
    #[arg(long, conflicts_with = "tool")]
    target: Option<PathBuf>,
    /// Seed of stage errors, surface grain and noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Damage: TOOTH:FLANK:DEPTH_UM, a kind may follow.
    #[arg(long)]
    wear: Vec<Wear>,
    /// This mesh stands there instead of the CAD: PLY or STL, mm, in the CAD's frame.
    #[arg(long, conflicts_with_all = ["target", "wear", "wear_rate", "die"])]
    die_mesh: Option<PathBuf>,
    /// Teeth that are judged, for the truth, instead of the tool file's.
    #[arg(long, value_delimiter = ',')]
    teeth: Option<Vec<u32>>,
    /// Virtual seconds per second, or max.
    #[arg(long, default_value = "1")]
    speed: Speed,
    /// Who drives the pins: the controller crate in this process, or its image in QEMU.
    #[arg(long, default_value = "sim")]
    controller: ControllerKind,
    /// Damage that each press cycle adds: TOOTH:FLANK:DEPTH_UM.
    #[arg(long)]
    wear_rate: Vec<Wear>,
    /// Strokes per minute of the press; 0: it stands open.
    #[arg(long, default_value_t = 0.0, value_parser = strokes_per_minute)]
    strokes_per_minute: f64,
    /// Share of a stroke during which the press counts as open.
    #[arg(long, default_value_t = 0.4, value_parser = open_share)]
    open_share: f64,
    /// A camera that misbehaves: lose|repeat|extra:FRAME, `:once` may follow.
    #[arg(long)]
    frame_fault: Option<FrameFault>,
    /// Die eccentric and tilted, hand-eye off, encoder with harmonics, axes not parallel; drawn from the seed.
    #[arg(long)]
    by_hand: bool,
    /// Head and die shift against each other from frame to frame: standard deviation, µm.
    #[arg(long, default_value_t = 0.0)]
    vibration_um: f64,
    /// Both lenses lead light astray by this beyond their distortion: root mean square along each axis, µm.
    #[arg(long, default_value_t = 0.0, value_parser = lens_error_um)]
    lens_error_um: f64,
    /// Another die than the tool file's: TEETHxMODULE_MM.
    #[arg(long)]
    die: Option<OtherDie>,
    /// The die is put down turned by this, degrees.
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    turned_deg: f64,
    /// The die is put down turned by so many teeth, beside that.
    #[arg(long, default_value_t = 0, allow_negative_numbers = true)]
    turned_teeth: i32,
    /// Largest minus smallest radius of the bore, µm.
    #[arg(long, default_value_t = 0.0)]
    ovality_um: f64,
    /// Growth of the bore's radius from bottom to top, µm.
    #[arg(long, default_value_t = 0.0)]
    taper_um: f64,
    /// What every flank stands off by, standard deviation, µm.
    #[arg(long, default_value_t = 0.0)]
    flanks_um: f64,
    /// Which die: draws its flanks.
    #[arg(long, default_value_t = 1)]
    die_seed: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum ControllerKind {
    Sim,
    Qemu,
}

/// How fast virtual time runs.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Speed(f64);

impl std::str::FromStr for Speed {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "max" {
            return Ok(Self(MAX_SPEED));
        }
        match text.parse::<f64>() {
            Ok(speed) if (0.1..=MAX_SPEED).contains(&speed) => Ok(Self(speed)),
            _ => Err(format!("{text} is no speed; 0.1 to {MAX_SPEED} or max is")),
        }
    }
}

fn strokes_per_minute(text: &str) -> Result<f64, String> {
    within(text, 0.0, 300.0)
}

fn open_share(text: &str) -> Result<f64, String> {
    within(text, 0.1, 0.9)
}

fn lens_error_um(text: &str) -> Result<f64, String> {
    within(text, 0.0, 10.0)
}

fn within(text: &str, least: f64, most: f64) -> Result<f64, String> {
    match text.parse() {
        Ok(number) if (least..=most).contains(&number) => Ok(number),
        _ => Err(format!(
            "{text} is out of range; a number from {least} to {most} is needed"
        )),
    }
}

/// First line on standard output.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Hello {
    /// The controller's port.
    pub port: PathBuf,
    heartbeat_us: u64,
}

impl Hello {
    /// How often the host must speak, in real time.
    #[must_use]
    pub fn heartbeat(&self) -> Duration {
        Duration::from_micros(self.heartbeat_us)
    }
}

/// Last line on standard output.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Farewell {
    /// Seed of the run.
    pub seed: u64,
    /// What was photographed.
    #[serde(flatten)]
    pub truth: Truth,
    /// Virtual time that passed, s.
    pub virtual_s: f64,
    /// Real time during which virtual time was held for rendering, ms.
    pub held_ms: f64,
    /// Real time by which the simulation itself fell behind, ms.
    pub lagged_ms: f64,
    /// How punctual the emulated controller was.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub controller: Option<Figures>,
}

impl Farewell {
    /// A line for the user when the bench did not keep up with real time.
    #[must_use]
    pub fn notice(&self) -> Option<String> {
        let late_ms = self.held_ms + self.lagged_ms;
        (late_ms > 20.0).then(|| {
            format!(
                "the bench lagged {late_ms:.0} ms behind real time (its rendering {:.0} ms); its clock stood still meanwhile",
                self.held_ms
            )
        })
    }
}

/// Runs the subcommand.
///
/// # Errors
/// Unreadable files, wear that the die cannot have, no pseudo-terminal, no shared memory.
pub fn run(args: &Args) -> anyhow::Result<()> {
    match &args.command {
        Command::Run(args) => simulate(args),
        Command::Esp301(args) => stages(args),
        Command::Study(args) => crate::study::run(args),
        Command::DemoTarget { out } => Ok(demo::write_target(out)?),
        Command::DemoCaptures { out, seed } => {
            let target = demo::target();
            let mut config = demo::target_world(&target, *seed);
            config.run_seed = *seed;
            let views = demo::target_views(&target, *seed, &demo::AROUND);
            demo::write_captures(out, &config, &views)
        }
        Command::DemoTool { out } => Ok(demo::write_tool(out)?),
    }
}

fn stages(args: &Esp301Args) -> anyhow::Result<()> {
    let Speed(speed) = args.speed;
    let stages = devices::esp301::run(speed, args.seed)?;
    let mut out = std::io::stdout();
    writeln!(out, "{}", stages.port().display())?;
    out.flush()?;
    let _ = std::io::stdin().read_to_end(&mut Vec::new());
    Ok(())
}

/// What stands before which head.
struct Exhibit {
    config: WorldConfig,
    head: HeadModel,
    /// How high it reaches.
    top_mm: Option<f64>,
    /// What is judged of it.
    judged: Option<Judged>,
}

fn exhibit(args: &RunArgs) -> anyhow::Result<Exhibit> {
    if let Some(folder) = &args.target {
        let target = Target::load(&folder.join("target.toml"))?;
        return Ok(Exhibit {
            config: demo::target_world(&target, args.seed),
            head: demo::head(),
            top_mm: None,
            judged: None,
        });
    }
    let Some(path) = &args.tool else {
        anyhow::bail!("--tool or --target is needed")
    };
    let tool = Tool::load(path)?;
    let beside = if path.is_dir() {
        path.join("head.toml")
    } else {
        path.with_file_name("head.toml")
    };
    let head = if beside.exists() {
        HeadModel::load(&beside)?
    } else {
        demo::head()
    };
    let config = demo::world_of(&tool, &head)?;
    Ok(Exhibit {
        judged: judged(&tool, &config, args.teeth.as_deref()),
        config,
        head,
        top_mm: tool.gear.as_ref().map(|gear| gear.height_mm[1]),
    })
}

/// The zones that a check of the tool judges, on its drawing; teeth that it does not have are left out.
fn judged(tool: &Tool, config: &WorldConfig, teeth: Option<&[u32]>) -> Option<Judged> {
    let (zone, inspect) = (tool.zone()?, tool.inspect.as_ref()?);
    let mut teeth = teeth.unwrap_or(&inspect.teeth).to_vec();
    teeth.sort_unstable();
    teeth.dedup();
    let flanks = teeth
        .into_iter()
        .filter(|tooth| (1..=config.gear.teeth).contains(tooth))
        .flat_map(|tooth| [Flank::Left, Flank::Right].map(|flank| FlankId { tooth, flank }))
        .collect();
    Some(Judged {
        cad: config.cad.clone(),
        gear: config.gear.clone(),
        flanks,
        radius_mm: zone.radius_mm,
        height_mm: zone.height_mm,
        disc_area_mm2: wear_area_mm2(tool),
    })
}

/// Area of the disc whose mean loss is the wear depth of a zone.
fn wear_area_mm2(tool: &Tool) -> f64 {
    tool.wear_settings().area_mm2
}

fn simulate(args: &RunArgs) -> anyhow::Result<()> {
    let Speed(speed) = args.speed;
    // Before anything else: the emulator must start on the thread that lives longest, and may be missing.
    let controller = match args.controller {
        ControllerKind::Sim => Controller::InProcess,
        ControllerKind::Qemu if speed != 1.0 => {
            anyhow::bail!(
                "an emulated controller lives in real time: --speed must be 1, not {speed}"
            )
        }
        ControllerKind::Qemu => {
            let machine = Machine::start(&find_image()?)?;
            // The emulator lives in real time and waits for the devices on this process's other threads: rendering,
            // which waits for nobody, gives way.
            rayon::ThreadPoolBuilder::new()
                .start_handler(|_| camera::give_way())
                .build_global()?;
            Controller::Emulated(machine)
        }
    };
    let gives_way = matches!(controller, Controller::Emulated(_));
    let Exhibit {
        mut config,
        head,
        top_mm,
        judged,
    } = exhibit(args)?;
    let ageing = Ageing {
        initial: args.wear.clone(),
        per_cycle: args.wear_rate.clone(),
    };
    config.wear = ageing
        .after(0)
        .into_iter()
        .filter(|one| one.depth_mm > 0.0)
        .collect();
    config.run_seed = args.seed;
    config.vibration_um = args.vibration_um;
    if args.lens_error_um > 0.0 {
        config
            .optics
            .make_uneven(args.lens_error_um, config.head_seed);
    }
    config.form = Form {
        ovality_um: args.ovality_um,
        taper_um: args.taper_um,
        flanks_um: args.flanks_um,
        flanks_seed: args.die_seed,
    };
    if let Some(other) = args.die {
        other.replace(&mut config)?;
    }
    if args.by_hand {
        config.mount = Mount::by_hand(args.seed);
    }
    let turned_rad =
        args.turned_deg.to_radians() + f64::from(args.turned_teeth) * config.gear.pitch_angle_rad();
    config.mount.table_from_die *= UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turned_rad);
    let die_mesh = match &args.die_mesh {
        Some(path) => {
            let die = die_file::load(path)?;
            let about = MeshTruth {
                file: path.display().to_string(),
                triangles: die.mesh().triangles.len(),
                degenerate: die.degenerate(),
                closed: die.is_closed(),
            };
            config.die_mesh = Some(Arc::new(die));
            Some(about)
        }
        None => None,
    };
    let world = World::new(&config)?;
    let set = PatternSet::named(head.pattern_set.as_deref().unwrap_or("insitu12"))?;
    let sets: Vec<(f64, u32)> = set
        .sets
        .iter()
        .map(|set| (set.periods, set.steps))
        .collect();
    let patterns = PatternSpec::sequence(&sets);
    // A camera in real time never waits for a slow host; one that runs ahead of real time would drown any host.
    let overflow = if speed > 1.0 {
        Overflow::Wait
    } else {
        Overflow::Drop
    };
    let (camera_thread, camera) = camera::start(
        world,
        patterns,
        ageing,
        args.frame_fault,
        SharedRoot::of_owner(&args.root),
        overflow,
        gives_way,
    )?;

    let mut config = InstrumentConfig::paced(speed);
    config.devices.seed = args.seed;
    config.devices.press.strokes_per_minute = args.strokes_per_minute;
    config.devices.press.open_share = args.open_share;
    if let Some(top_mm) = top_mm {
        // The switch is set up with the die, a little below where the head retracts to.
        config.devices.press.switch_mm = top_mm + SWITCH_CLEARANCE_MM;
    }
    let instrument = devices::run_with(config, controller, camera)?;
    // The controller counts the host's silence in virtual time, the host lives in real time.
    let silence_s = f64::from(config.controller.host_silence.get()) * 1e-6 / speed;
    let heartbeat_us = (silence_s * 1e6 / 3.0) as u64;
    let mut out = std::io::stdout();
    writeln!(
        out,
        "{}",
        serde_json::to_string(&Hello {
            port: instrument.port().to_path_buf(),
            heartbeat_us
        })?
    )?;
    out.flush()?;

    // Whatever comes is ignored; the end counts, and it comes even when the host is killed.
    let _ = std::io::stdin().read_to_end(&mut Vec::new());
    let outcome = instrument.stop().context("the simulation ended early")?;
    let pace = outcome.pace;
    let (mut truth, world) = camera_thread.finish()?;
    if let Some(judged) = &judged {
        truth.compared(&world, judged);
    }
    truth.die_mesh = die_mesh;
    let farewell = Farewell {
        seed: args.seed,
        truth,
        virtual_s: pace.virtual_us as f64 * 1e-6,
        held_ms: pace.held.as_secs_f64() * 1e3,
        lagged_ms: pace.lagged.as_secs_f64() * 1e3,
        controller: outcome.figures,
    };
    writeln!(out, "{}", serde_json::to_string(&farewell)?)?;
    Ok(())
}
