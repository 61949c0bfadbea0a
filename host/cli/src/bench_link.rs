//! The simulated bench as a process of its own: this very program, started again.

use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{self, Child, ChildStdout, Stdio};
use std::time::Duration;

use anyhow::{Context, bail};
pub use flankscope_bench::config::{BenchArgs, DieArgs, PressArgs};
use flankscope_bench::config::{BenchConfig, ControllerKind, Speed, Stands, SurfaceKind};
use flankscope_bench::link::CameraLink;
use flankscope_bench::process::{Farewell, Hello};
use flankscope_bench::world::Carries;
use flankscope_frames::SharedRoot;
use flankscope_instrument::controller::ClientSettings;
use flankscope_instrument::settings::{Stages, StationSettings};
use flankscope_jobs::scan::{Grid, Scanner};
use flankscope_metrology::kinematics::Moves;
use flankscope_record::origin::Link;

use crate::camera_process::CameraProcess;
use crate::instrument::{Instrument, Scene};
use crate::scan::{on_the_bench, show};
use crate::site::Place;

/// The bench's clock stands while it renders: light over several places takes a busy machine minutes a view. A bench that ends
/// closes its port.
const RENDERING: Duration = Duration::from_secs(600);

/// What the hidden subcommand does: run the bench, or write the demo's files.
#[derive(clap::Subcommand)]
pub enum Command {
    #[command(flatten)]
    Bench(flankscope_bench::process::Command),
    #[command(flatten)]
    Demo(flankscope_demo::Command),
    /// The process of the bench's GigE camera.
    #[cfg(feature = "aravis")]
    #[command(subcommand)]
    Camera(flankscope_camera::command::Camera),
}

/// A scan on the bench, for the article's figures.
#[derive(clap::Args, Clone, Debug)]
pub struct ArticleBench {
    /// Scan on the simulated bench first
    #[arg(long)]
    bench: bool,
    /// Views around the die by layers over its height, with --bench: one layer of 84, of which neighbours overlap by two
    /// thirds, instead of the article's seven
    #[arg(long, value_name = "AROUNDxLAYERS", default_value = "84x1")]
    views: Grid,
    #[command(flatten)]
    args: BenchArgs,
    #[command(flatten)]
    die: DieArgs,
}

impl ArticleBench {
    /// Options of the bench.
    pub fn args(&self) -> &BenchArgs {
        &self.args
    }

    /// Whether a scan on the bench was asked for.
    pub fn is_asked_for(&self) -> bool {
        self.bench
    }

    /// Scans into a folder.
    pub fn scan(
        &self,
        files: [Option<&Path>; 2],
        folder: &Path,
        quiet: bool,
    ) -> anyhow::Result<()> {
        let site = Place::default().site(&[])?;
        let scene = Scene {
            press: None,
            die: Some(&self.die),
            ..Scene::default()
        };
        let mut instrument =
            Instrument::start(files, &site, &self.args, scene, quiet, |subject, root| {
                let of = on_the_bench(site.link(), &self.args, &self.die);
                let setting = site.setting.clone();
                Ok(Scanner::open(
                    subject, setting, self.views, folder, &of, root,
                )?)
            })?;
        let (port, settings) = (&instrument.port, instrument.settings.clone());
        let watch = |progress| {
            if !quiet {
                show(progress);
            }
        };
        instrument.station.scan(port, settings, watch)?;
        instrument.close(quiet)?;
        Ok(())
    }
}

/// Runs the hidden subcommand.
pub fn run(command: &Command) -> anyhow::Result<()> {
    match command {
        Command::Bench(command) => flankscope_bench::process::run(command),
        Command::Demo(command) => flankscope_demo::run(command),
        #[cfg(feature = "aravis")]
        Command::Camera(camera) => flankscope_camera::command::run(camera),
    }
}

/// Seed of everything random.
pub fn seed(args: &BenchArgs) -> u64 {
    args.seed
}

/// Refuses what a real press cannot have.
pub fn fits_real_press(args: &BenchArgs, link: &Link) -> anyhow::Result<()> {
    if let Some(mesh) = &args.die_mesh {
        bail!(
            "--die-mesh {}: only a simulated bench can be given a die; --link {link} has a real one",
            mesh.display()
        );
    }
    Ok(())
}

/// Refuses what recorded frames or clouds cannot have.
pub fn fits_recording(args: &BenchArgs, die: Option<&DieArgs>) -> anyhow::Result<()> {
    let as_drawn = in_words(args, &DieArgs::default());
    let given = [
        (
            "a die on the bench",
            die.is_some_and(|die| in_words(args, die) != as_drawn),
        ),
        ("--wear", !args.wear.is_empty()),
        ("--die-mesh", args.die_mesh.is_some()),
        ("--frame-fault", args.frame_fault.is_some()),
        ("--camera", args.camera != CameraLink::default()),
        ("--gige-trouble", args.gige_trouble.is_some()),
        ("--stage-trouble", args.stage_trouble.is_some()),
        ("--arm", args.arm.is_some()),
        ("--surface", args.surface != SurfaceKind::default()),
        ("--sprayed-above-mm", args.sprayed_above_mm.is_some()),
        ("--bounces", args.bounces.is_some()),
        ("--shiver-um", args.shiver_um != 0.0),
        ("--backlash-mdeg", args.backlash_mdeg != 0.0),
        ("--backlash-um", args.backlash_um != 0.0),
        ("--encoder-saw", args.encoder_saw.is_some()),
        ("--core-drift-px", args.core_drift_px != 0.0),
        ("--vibration-um", args.vibration_um != 0.0),
        ("--lens-error-um", args.lens_error_um != 0.0),
    ];
    for (option, given) in given {
        if given {
            bail!("{option} beside --frames or --clouds: no bench can change what was recorded");
        }
    }
    Ok(())
}

/// What stands on the bench, in words that two runs share only if the same stands there.
pub fn in_words(bench: &BenchArgs, die: &DieArgs) -> String {
    let mut what_stands = format!(
        "seed {}, ovality {} um, taper {} um, turned {} deg and {} teeth, flanks of die {} {} um",
        bench.seed,
        die.ovality_um,
        die.taper_um,
        die.turned_deg,
        die.turned_teeth,
        die.die_seed,
        die.flanks_um
    );
    for (what, um) in [
        ("three lobes", die.three_lobe_um),
        ("barrel", die.barrel_um),
        ("bell mouth", die.bell_mouth_um),
    ] {
        if um != 0.0 {
            what_stands += &format!(", {what} {um} um");
        }
    }
    if let Some(saw) = &bench.encoder_saw {
        what_stands += &format!(", encoder {saw}");
    }
    if let Some(other) = &die.die {
        what_stands += &format!(", die {other}");
    }
    if bench.surface != SurfaceKind::default()
        || bench.sprayed_above_mm.is_some()
        || bench.bounces() > 1
    {
        what_stands += &format!(
            ", surface {:?} in {} bounces, sprayed above {:?} mm",
            bench.surface,
            bench.bounces(),
            bench.sprayed_above_mm
        );
    }
    for wear in &bench.wear {
        what_stands += &format!(", wear {wear}");
    }
    if let Some(mesh) = &bench.die_mesh {
        // Another content under the same name is another die; what cannot be read is refused by the bench.
        let content = std::fs::read(mesh).map(|bytes| flankscope_foundation::files::hash(&bytes));
        what_stands += &format!(", mesh {}", content.unwrap_or_default());
    }
    what_stands
}

/// A running bench.
pub struct Bench {
    child: Child,
    stdout: BufReader<ChildStdout>,
    hello: Hello,
    /// What takes the packets of its GigE camera.
    camera: Option<CameraProcess>,
    /// Whether its clock is that of the world.
    real_time: bool,
}

/// Writes the demo tool's folder and returns it.
pub fn demo_tool(scratch: &Path) -> anyhow::Result<PathBuf> {
    let folder = scratch.join("demo");
    flankscope_demo::write_tool(&folder, None).context("cannot write the demo tool")?;
    Ok(folder)
}

/// Writes the demo calibration target's folder and returns it.
pub fn demo_target(scratch: &Path) -> anyhow::Result<PathBuf> {
    let folder = scratch.join("target");
    flankscope_demo::write_target(&folder, None).context("cannot write the demo target")?;
    Ok(folder)
}

/// Refuses a camera that this build has not, and troubles of another one.
fn has_camera(args: &BenchArgs) -> anyhow::Result<()> {
    if args.camera == CameraLink::Gige && !cfg!(feature = "aravis") {
        bail!(
            "--camera gige: this build speaks no GigE Vision; apt-get install libaravis-dev libusb-1.0-0-dev, then build it with \
             --features aravis"
        );
    }
    if args.camera != CameraLink::Gige && args.gige_trouble.is_some() {
        bail!("--gige-trouble: there is no GigE camera; add --camera gige");
    }
    Ok(())
}

impl Bench {
    /// Starts the bench for the folder of a tool or a target, with its camera sending frames below `root`.
    pub fn start(
        args: &BenchArgs,
        link: &Link,
        scene: Scene<'_>,
        folder: &Path,
        root: &SharedRoot,
        stages: &Stages,
    ) -> anyhow::Result<Self> {
        has_camera(args)?;
        match (stages.moves, &args.arm) {
            (Moves::Outside, None) => bail!(
                "stages.moves = \"outside\": on the bench nobody carries the head; add --arm FILE, which says where an arm holds it"
            ),
            (Moves::Die | Moves::Head, Some(_)) => bail!(
                "--arm: the stages carry head and die; an arm needs a station.toml with stages.moves = \"outside\""
            ),
            _ => {}
        }
        let folder = folder.to_path_buf();
        let config = BenchConfig {
            root: root.path().to_path_buf(),
            stands: if scene.target {
                Stands::Target(folder)
            } else {
                Stands::Tool(folder)
            },
            teeth: scene.teeth.map(<[u32]>::to_vec),
            controller: match link {
                Link::Sim => ControllerKind::Sim,
                Link::Qemu => ControllerKind::Qemu,
                Link::Port(_) | Link::Recorded(_) | Link::Clouds(_) => {
                    bail!("{link} is no simulated bench")
                }
            },
            bench: args.clone(),
            press: scene.press.cloned(),
            die: scene.die.cloned(),
            rotary_carries: match stages.moves {
                Moves::Head => Carries::Head,
                Moves::Die | Moves::Outside => Carries::Die,
            },
            pictures: scene.pictures.map(Path::to_path_buf),
        };
        let program =
            std::env::current_exe().context("cannot find this program to start the bench")?;
        let program = program.display().to_string();
        let mut child = process::Command::new(&program)
            .args(["bench", "run"])
            // Ctrl-C is for the host: it ends the bench when the head is out.
            .process_group(0)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .context("cannot start the bench")?;
        // The bench ends when its standard input does: however this process ends, the bench does not outlive it.
        if let Some(stdin) = &mut child.stdin {
            writeln!(stdin, "{}", serde_json::to_string(&config)?)
                .context("cannot tell the bench what stands on it")?;
        }
        let Some(stdout) = child.stdout.take() else {
            bail!("the bench has no standard output")
        };
        let mut stdout = BufReader::new(stdout);
        let mut line = String::new();
        stdout.read_line(&mut line)?;
        let hello = serde_json::from_str(&line);
        let mut bench = match hello {
            Ok(hello) => Self {
                child,
                stdout,
                hello,
                camera: None,
                real_time: args.speed.value == Speed(1.0),
            },
            Err(_) => {
                // It has said why on standard error.
                let _ = child.wait();
                bail!("the simulated bench did not start");
            }
        };
        if let Some(arguments) = &bench.hello.camera {
            let command = ["bench", "camera", "aravis"].map(String::from);
            let command = [&[program][..], &command, arguments].concat();
            bench.camera = CameraProcess::start(&command, root.path())?;
        }
        if bench.child.try_wait()?.is_some() {
            bail!("the simulated bench ended early");
        }
        Ok(bench)
    }

    /// The controller's port.
    pub fn port(&self) -> &Path {
        &self.hello.port
    }

    /// How patiently to talk to a controller whose clock runs faster.
    pub fn client_settings(&self, settings: &StationSettings) -> ClientSettings {
        ClientSettings {
            heartbeat: Some(self.hello.heartbeat()),
            stall: settings.client().stall.filter(|_| self.real_time),
            silence: RENDERING,
            ..ClientSettings::default()
        }
    }

    /// Ends the bench and takes its truth, and a line for the user if it did not keep up with real time.
    pub fn finish(mut self) -> anyhow::Result<(serde_json::Value, Option<String>)> {
        // The camera does not vanish under whoever takes its frames.
        self.camera = None;
        drop(self.child.stdin.take());
        let mut text = String::new();
        self.stdout.read_to_string(&mut text)?;
        self.child.wait()?;
        let truth: Farewell =
            serde_json::from_str(&text).context("the simulated bench ended without its truth")?;
        Ok((serde_json::to_value(&truth)?, truth.notice()))
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        self.camera = None;
        drop(self.child.stdin.take());
        let _ = self.child.wait();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Given {
        #[command(flatten)]
        bench: BenchArgs,
    }

    /// Without Aravis a GigE camera is refused with how to get it; its troubles are refused without it.
    #[test]
    fn a_camera_that_is_not_there_is_refused_with_the_remedy() {
        let refused = |arguments: &[&str]| {
            let given = Given::parse_from([&["inspect"], arguments].concat());
            has_camera(&given.bench)
                .err()
                .map(|error| error.to_string())
        };
        assert_eq!(refused(&[]), None);
        let without = refused(&["--camera", "gige"]);
        assert_eq!(without.is_none(), cfg!(feature = "aravis"));
        if let Some(words) = without {
            for word in ["--features aravis", "libaravis-dev"] {
                assert!(words.contains(word), "{words}");
            }
        }
        let alone = refused(&["--gige-trouble", "free-runs"]).unwrap();
        assert!(alone.contains("--camera gige"), "{alone}");
    }
}
