//! The bench as a process: `flankscope bench run`, started by the host as a child.
//!
//! It reads a [`BenchConfig`] (one line of JSON) from standard input, writes a greeting with the controller's port to standard
//! output, runs until its standard input ends, and then writes the true values of the captures, and whether it kept up with real
//! time.

use std::io::{BufRead, Read, Write};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, ensure};
use flankscope_frames::{FrameSender, Overflow, SharedRoot};
use nalgebra::{UnitQuaternion, Vector3};
use rustix::process::{Signal, set_parent_process_death_signal};
use serde::{Deserialize, Serialize};

use crate::ageing::Ageing;
use crate::arm::Arm;
use crate::bench_file::{DieTable, EXAMPLE, SurfaceTable};
use crate::camera::{self, Troubles};
use crate::config::{BenchConfig, ControllerKind, Speed, Stands, SurfaceKind};
use crate::devices::press::WaitForHead;
use crate::devices::{self, Controller, InstrumentConfig};
use crate::die_file;
use crate::files::pictures;
use crate::given::Given;
use crate::link::CameraLink;
use crate::qemu::{Figures, Machine, find_image};
use crate::specimen::Specimen;
use crate::truth::{FormTruth, MeshTruth, Truth};
use crate::world::{Form, MAX_SHIFT_PX, Mount, Saw, Wear, World, WorldConfig};

/// Height of the retract switch above the die.
const SWITCH_CLEARANCE_MM: f64 = 14.0;

/// Longest real time for which a press that is faster than real time waits for a check that is due.
const HOST_ANSWERS_WITHIN_S: f64 = 10.0;

/// What the simulated bench does.
#[derive(clap::Subcommand)]
pub enum Command {
    /// Run the bench by the configuration that standard input begins with, until it ends.
    Run,
    /// Write a bench file with every key, its unit and its default to standard output.
    #[command(after_help = "Example: flankscope bench example > bench.toml")]
    Example,
    /// The stage controller alone, on a pseudo-terminal, until standard input ends.
    Esp301(Esp301Args),
}

/// An emulated stage controller for other people's clients.
#[derive(clap::Args)]
#[command(
    after_help = "Example: flankscope bench esp301, then open the printed port at any speed and say 1MO;1PA10;1WS;1TP?"
)]
pub struct Esp301Args {
    /// Virtual seconds per second, or max.
    #[arg(long, default_value = "1")]
    speed: Given<Speed>,
}

/// First line on standard output.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Hello {
    /// The controller's port.
    pub port: PathBuf,
    /// Arguments with which a camera process finds the camera; `None` if frames come through shared memory.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera: Option<Vec<String>>,
    heartbeat_us: u64,
}

impl Hello {
    /// Interval at which the host must send heartbeats, in real time.
    pub fn heartbeat(&self) -> Duration {
        Duration::from_micros(self.heartbeat_us)
    }
}

/// Last line on standard output.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Farewell {
    /// Seed of the run.
    pub seed: u64,
    /// True values of the captures.
    #[serde(flatten)]
    pub truth: Truth,
    /// Virtual time that passed, s.
    pub virtual_s: f64,
    /// Real time during which virtual time was held for rendering, ms.
    pub held_ms: f64,
    /// Real time by which the simulation itself fell behind, ms.
    pub lagged_ms: f64,
    /// Timing accuracy of the emulated controller.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub controller: Option<Figures>,
}

impl Farewell {
    /// A line for the user if the bench did not keep up with real time.
    pub fn notice(&self) -> Option<String> {
        let late_ms = self.held_ms + self.lagged_ms;
        (late_ms > 20.0).then(|| {
            format!(
                "the bench lagged {late_ms:.0} ms behind real time (rendering: {:.0} ms); its clock was paused for that time",
                self.held_ms
            )
        })
    }
}

/// Runs the subcommand.
///
/// # Errors
/// Unreadable files, wear that the die cannot have, no pseudo-terminal, no shared memory.
pub fn run(command: &Command) -> anyhow::Result<()> {
    match command {
        Command::Run => {
            // It also ends with its standard input, but finishes its present step first; this signal does not wait.
            set_parent_process_death_signal(Some(Signal::KILL))?;
            let mut line = String::new();
            std::io::stdin().lock().read_line(&mut line)?;
            let config = serde_json::from_str(&line)
                .context("standard input does not begin with a configuration of the bench")?;
            simulate(&config)
        }
        Command::Example => {
            std::io::stdout().write_all(EXAMPLE.as_bytes())?;
            Ok(())
        }
        Command::Esp301(args) => stages(args),
    }
}

fn stages(args: &Esp301Args) -> anyhow::Result<()> {
    let Speed(speed) = args.speed.value;
    let stages = devices::esp301::run(speed, 1)?;
    let mut out = std::io::stdout();
    writeln!(out, "{}", stages.port().display())?;
    out.flush()?;
    let _ = std::io::stdin().read_to_end(&mut Vec::new());
    Ok(())
}

/// Builds the world by the configuration.
fn apply(
    config: &mut WorldConfig,
    asked: &BenchConfig,
    ageing: &Ageing,
) -> anyhow::Result<Option<MeshTruth>> {
    let bench = &asked.setup;
    let DieTable {
        ovality_um,
        taper_um,
        three_lobe_um,
        barrel_um,
        bell_mouth_um,
        flanks_um,
        flanks_seed,
        turned_deg,
        turned_teeth,
        moved_um,
        ref other,
    } = bench.file.die;
    config.wear = ageing
        .after(0)
        .into_iter()
        .filter(|one| one.depth_mm > 0.0)
        .collect();
    config.run_seed = bench.seed;
    match &asked.stands {
        Stands::Tool(_) => {
            config.surface = bench.surface.surface();
            config.spray_edge = bench.file.surface.spray_edge();
            config.film_um = bench.file.surface.film_um;
            config.bounces = bench.bounces();
        }
        Stands::Target(_) => ensure!(
            bench.surface == SurfaceKind::default()
                && bench.file.surface == SurfaceTable::default()
                && bench.file.die == DieTable::default(),
            "--surface, and [die] and [surface] of a bench file, are for a die; a calibration target stands there, printed on ceramic"
        ),
    }
    config.vibration_um = bench.file.motion.vibration_um;
    config.shiver_um = bench.file.motion.shiver_um;
    let lens_error_um = bench.file.head.lens_error_um;
    if lens_error_um > 0.0 {
        config.optics.make_uneven(lens_error_um, config.head_seed);
        if let Some(head) = &mut config.driven_head {
            head.lens_error_um = lens_error_um;
        }
    }
    config.form = Form {
        ovality_um,
        taper_um,
        three_lobe_um,
        barrel_um,
        bell_mouth_um,
        flanks_um,
        flanks_seed,
    };
    if let Some(other) = other {
        other.value.replace(config)?;
    }
    if asked.by_hand {
        config.mount = Mount::by_hand(bench.seed);
    }
    if asked.by_hand || turned_deg != 0.0 || turned_teeth != 0 {
        let turned_rad =
            turned_deg.to_radians() + f64::from(turned_teeth) * config.gear.pitch_angle_rad();
        config.mount.table_from_die *=
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turned_rad);
    }
    if moved_um > 0.0 {
        config.mount.move_die(moved_um, bench.seed);
    }
    config.mount.rotary_carries = asked.rotary_carries;
    let stages = &bench.file.stages;
    config.mount.saw = stages
        .encoder_saw
        .as_ref()
        .map_or(Saw::default(), |given| given.value.0);
    let Some(path) = &bench.die_mesh else {
        return Ok(None);
    };
    ensure!(
        matches!(asked.stands, Stands::Tool(_)),
        "--die-mesh {}: a calibration target stands there, no die",
        path.display()
    );
    let die = die_file::load(path)?;
    let about = MeshTruth {
        file: path.display().to_string(),
        triangles: die.mesh().triangles.len(),
        degenerate: die.degenerate(),
        closed: die.is_closed(),
    };
    config.die_mesh = Some(Arc::new(die));
    Ok(Some(about))
}

fn simulate(asked: &BenchConfig) -> anyhow::Result<()> {
    let Speed(speed) = asked.setup.speed.value;
    let seed = asked.setup.seed;
    // Must be done before the first thread starts.
    #[cfg(feature = "gige")]
    if asked.setup.camera == CameraLink::Gige {
        crate::gige::network::enter()?;
    }
    // First of all: the emulator must start on the thread that lives longest, and may be missing.
    let controller = match asked.controller {
        ControllerKind::Sim => Controller::InProcess,
        ControllerKind::Qemu if speed != 1.0 => {
            anyhow::bail!(
                "an emulated controller lives in real time: --speed must be 1, not {speed}"
            )
        }
        ControllerKind::Qemu => {
            let machine = Machine::start(&find_image()?)?;
            // The emulator runs in real time and waits for the devices on other threads of this process, so rendering, for which
            // nothing waits, runs at low priority.
            rayon::ThreadPoolBuilder::new()
                .start_handler(|_| camera::give_way())
                .build_global()?;
            Controller::Emulated(machine)
        }
    };
    let gives_way = matches!(controller, Controller::Emulated(_));
    let Specimen {
        mut config,
        mut patterns,
        top_mm,
        judged,
        has_flanks,
    } = match &asked.stands {
        Stands::Tool(path) => Specimen::tool(path, asked.teeth.as_deref())?,
        Stands::Target(folder) => Specimen::target(folder, seed)?,
    };
    let of_teeth = asked.setup.file.die.other.is_some()
        || !asked.setup.wear.is_empty()
        || !asked.setup.wear_rate.is_empty();
    ensure!(
        has_flanks || !of_teeth,
        "--wear, --wear-rate and [die] other are for the teeth of a gear, and the tool has no [gear]; --die-mesh puts any damage there"
    );
    let meant = |given: &[Given<Wear>]| given.iter().map(|wear| wear.value).collect();
    let ageing = Ageing {
        initial: meant(&asked.setup.wear),
        per_cycle: meant(&asked.setup.wear_rate),
    };
    let die_mesh = apply(&mut config, asked, &ageing)?;
    if let Some(folder) = &asked.pictures {
        (patterns, config.passes) = pictures::load(folder, config.optics.projector_size_px)?;
    }
    let world = World::new(&config)?;
    let has_lens = config.driven_head.is_some();
    let has_second_projector = config.optics.second_projector.is_some();
    // A camera in real time never waits for a slow host; one faster than real time would overload any host.
    let overflow = if speed > 1.0 {
        Overflow::Wait
    } else {
        Overflow::Drop
    };
    let file = &asked.setup.file;
    let together_px = file.head.core_drift_px.abs() + file.head.twist_px.abs();
    ensure!(
        together_px <= MAX_SHIFT_PX,
        "[head] core_drift_px and twist_px move the cores' image by up to {together_px} px; together {MAX_SHIFT_PX} px are possible"
    );
    let troubles = Troubles {
        fault: file.camera.frame_fault.as_ref().map(|fault| fault.value),
        core_drift_px: file.head.core_drift_px,
        twist_px: file.head.twist_px,
        twist_loss_ratio: file.head.twist_loss_ratio,
    };
    let arm = file.stages.arm.clone().map(Arm::at);
    let (arguments, (camera_thread, camera)) = match asked.setup.camera {
        CameraLink::SharedMemory => {
            let root = SharedRoot::of_owner(&asked.root)?;
            let open = move || Ok(FrameSender::open(&root, overflow)?);
            let started = camera::start(world, patterns, ageing, troubles, arm, open, gives_way)?;
            (None, started)
        }
        #[cfg(feature = "gige")]
        CameraLink::Gige => {
            let (size_px, sensor) = (world.size_px(), world.sensor().clone());
            let arguments = crate::gige::arguments(&sensor);
            let trouble = file.camera.gige_trouble.as_ref().map(|given| given.value);
            let open = move || crate::gige::GigeCamera::open(size_px, &sensor, trouble);
            let started = camera::start(world, patterns, ageing, troubles, arm, open, gives_way)?;
            (Some(arguments), started)
        }
        #[cfg(not(feature = "gige"))]
        CameraLink::Gige => {
            anyhow::bail!("this bench was built without its GigE camera (feature gige)")
        }
    };

    let mut config = InstrumentConfig::paced(speed);
    config.devices.lens = has_lens;
    config.devices.second_projector = has_second_projector;
    config.devices.seed = seed;
    config.devices.axes.rotation.backlash = 1e-3 * file.stages.backlash_mdeg;
    config.devices.axes.vertical.backlash = 1e-3 * file.stages.backlash_um;
    let axes = &mut config.devices.axes;
    axes.rotation.repeatability = 1e-3 * file.stages.rotation_repeatability_mdeg;
    axes.vertical.repeatability = 1e-3 * file.stages.vertical_repeatability_um;
    if let Some(trouble) = file.stages.trouble {
        trouble.spoil(&mut config.devices.axes);
    }
    if let Some(every) = asked.checks_every {
        config.devices.press.strokes_per_minute = file.press.strokes_per_minute;
        config.devices.press.open_share = file.press.open_share;
        config.devices.press.waits = (speed > 1.0).then_some(WaitForHead {
            every,
            patience_us: (HOST_ANSWERS_WITHIN_S * speed * 1e6) as u64,
        });
    }
    if let Some(top_mm) = top_mm {
        // The switch is placed relative to the die, slightly below the retracted head.
        config.devices.press.switch_mm = top_mm + SWITCH_CLEARANCE_MM;
    }
    let instrument = devices::run_with(config, controller, camera)?;
    // The controller's timeout for a silent host is in virtual time, but the host runs in real time.
    let silence_s = f64::from(config.controller.host_silence.get()) * 1e-6 / speed;
    let heartbeat_us = (silence_s * 1e6 / 3.0) as u64;
    let mut out = std::io::stdout();
    writeln!(
        out,
        "{}",
        serde_json::to_string(&Hello {
            port: instrument.port().to_path_buf(),
            camera: arguments,
            heartbeat_us
        })?
    )?;
    out.flush()?;

    // Input is ignored; only its end matters, which also occurs if the host is killed.
    let _ = std::io::stdin().read_to_end(&mut Vec::new());
    let outcome = instrument.stop().context("the simulation ended early")?;
    let pace = outcome.pace;
    let (mut truth, world) = camera_thread.finish()?;
    if let Some(judged) = &judged {
        truth.compared(&world, judged);
    }
    if !has_flanks {
        truth.flanks.clear();
    }
    truth.die_mesh = die_mesh;
    let die = &file.die;
    let has_form = asked.by_hand || *die != DieTable::default();
    truth.form = has_form.then(|| FormTruth {
        ovality_um: die.ovality_um.abs(),
        taper_um: die.taper_um,
        three_lobe_um: die.three_lobe_um,
        barrel_um: die.barrel_um,
        bell_mouth_um: die.bell_mouth_um,
    });
    let farewell = Farewell {
        seed,
        truth,
        virtual_s: pace.virtual_us as f64 * 1e-6,
        held_ms: pace.held.as_secs_f64() * 1e3,
        lagged_ms: pace.lagged.as_secs_f64() * 1e3,
        controller: outcome.figures,
    };
    writeln!(out, "{}", serde_json::to_string(&farewell)?)?;
    Ok(())
}
