//! Runs the simulated bench as a separate process of the same program.

use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{self, Child, ChildStdout, Stdio};
use std::time::Duration;

use anyhow::{Context, bail};
use flankscope_bench::bench_file::BenchFile;
pub use flankscope_bench::config::{
    BenchArgs, BenchFileArgs, BenchSetup, CameraArgs, DieArgs, WearRateArgs,
};
use flankscope_bench::config::{BenchConfig, ControllerKind, Speed, Stands, SurfaceKind};
use flankscope_bench::link::CameraLink;
use flankscope_bench::process::{Farewell, Hello};
use flankscope_bench::world::Carries;
use flankscope_frames::SharedRoot;
use flankscope_instrument::controller::ClientSettings;
use flankscope_instrument::settings::Stages;
use flankscope_metrology::kinematics::Moves;
use flankscope_record::origin::Link;

use crate::camera_process::CameraProcess;
use crate::scene::Scene;

/// Longest time without an event of the bench: its clock stops while it renders, and multiple reflections of light take minutes
/// per view on a busy machine. It answers meanwhile.
const RENDERING: Duration = Duration::from_secs(600);

/// Write the demo's files or an example of a bench file; run the simulated bench.
#[derive(clap::Subcommand)]
#[command(
    after_help = "Example:\n  flankscope bench demo-tool --out die\nwrites the demo's tool.toml, head.toml and CAD, to begin one's own with\n\n  \
    flankscope bench example > bench.toml\n  flankscope inspect --bench bench.toml --speed max"
)]
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

/// Runs the subcommand.
pub fn run(command: &Command) -> anyhow::Result<()> {
    match command {
        Command::Bench(command) => flankscope_bench::process::run(command),
        Command::Demo(command) => flankscope_demo::run(command),
        #[cfg(feature = "aravis")]
        Command::Camera(camera) => flankscope_camera::command::run(camera),
    }
}

/// Settings of the bench, with the camera transport of commands that have this option.
pub fn setup_with_camera(die: &DieArgs, camera: &CameraArgs) -> anyhow::Result<BenchSetup> {
    Ok(BenchSetup {
        camera: camera.camera,
        ..die.setup()?
    })
}

/// Settings of the bench with a running press.
pub fn setup_with_press(die: &DieArgs, press: &WearRateArgs) -> anyhow::Result<BenchSetup> {
    Ok(BenchSetup {
        wear_rate: press.wear_rate.clone(),
        ..die.setup()?
    })
}

/// Seed of all random numbers.
pub fn seed(setup: &BenchSetup) -> u64 {
    setup.seed
}

/// Refuses options of the bench that a real press cannot have.
pub fn fits_real_press(setup: &BenchSetup, link: &Link) -> anyhow::Result<()> {
    for (option, file) in [("--die-mesh", &setup.die_mesh), ("--bench", &setup.path)] {
        if let Some(file) = file {
            bail!(
                "{option} {}: this is for the simulated bench; --link {link} is a real press",
                file.display()
            );
        }
    }
    Ok(())
}

/// Refuses options of the bench that recorded frames or clouds cannot have.
pub fn fits_recording(setup: &BenchSetup) -> anyhow::Result<()> {
    let given = [
        ("--bench", setup.path.is_some()),
        ("--wear", !setup.wear.is_empty()),
        ("--die-mesh", setup.die_mesh.is_some()),
        ("--camera", setup.camera != CameraLink::default()),
        ("--surface", setup.surface != SurfaceKind::default()),
    ];
    for (option, given) in given {
        if given {
            bail!("{option} with --frames or --clouds: the bench does not change recorded frames");
        }
    }
    Ok(())
}

/// Describes the settings of the bench; two runs have the same text only if their settings are the same.
pub fn in_words(setup: &BenchSetup) -> String {
    let BenchFile {
        die,
        surface,
        stages,
        ..
    } = &setup.file;
    let mut what_stands = format!(
        "seed {}, ovality {} um, taper {} um, turned {} deg and {} teeth, flanks of die {} {} um",
        setup.seed,
        die.ovality_um,
        die.taper_um,
        die.turned_deg,
        die.turned_teeth,
        die.flanks_seed,
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
    if let Some(saw) = &stages.encoder_saw {
        what_stands += &format!(", encoder {saw}");
    }
    if let Some(other) = &die.other {
        what_stands += &format!(", die {other}");
    }
    if setup.surface != SurfaceKind::default()
        || surface.sprayed_above_mm.is_some()
        || surface.film_um > 0.0
        || setup.bounces() > 1
    {
        what_stands += &format!(
            ", surface {:?} in {} bounces, sprayed above {:?} mm, film {} um",
            setup.surface,
            setup.bounces(),
            surface.sprayed_above_mm,
            surface.film_um
        );
    }
    for wear in &setup.wear {
        what_stands += &format!(", wear {wear}");
    }
    if let Some(mesh) = &setup.die_mesh {
        // A file of the same name with another content is another die; an unreadable file is refused by the bench.
        let content = flankscope_foundation::files::read_regular(
            mesh,
            flankscope_foundation::files::MOST_DATA_BYTES,
        )
        .map(|bytes| flankscope_foundation::files::hash(&bytes));
        what_stands += &format!(", mesh {}", content.unwrap_or_default());
    }
    what_stands
}

/// A running bench.
pub struct Bench {
    child: Child,
    stdout: BufReader<ChildStdout>,
    hello: Hello,
    /// The process that receives the packets of its GigE camera.
    camera: Option<CameraProcess>,
    /// Whether its clock is real time.
    real_time: bool,
    /// Whether its controller is emulated.
    emulated: bool,
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

/// Refuses a camera that this build lacks, and faults of a camera that is not used.
fn has_camera(setup: &BenchSetup) -> anyhow::Result<()> {
    if setup.camera == CameraLink::Gige && !cfg!(feature = "aravis") {
        bail!(
            "--camera gige: this build speaks no GigE Vision; apt-get install libaravis-dev libusb-1.0-0-dev, then build it with \
             --features aravis"
        );
    }
    if setup.camera != CameraLink::Gige && setup.file.camera.gige_trouble.is_some() {
        bail!(
            "[camera] gige_trouble in the bench file: there is no GigE camera; add --camera gige"
        );
    }
    Ok(())
}

impl Bench {
    /// Starts the bench for the folder of a tool or target; its camera writes frames below `root`.
    pub fn start(
        setup: &BenchSetup,
        link: &Link,
        scene: Scene<'_>,
        folder: &Path,
        root: &SharedRoot,
        stages: &Stages,
    ) -> anyhow::Result<Self> {
        has_camera(setup)?;
        match (stages.moves, &setup.file.stages.arm) {
            (Moves::Outside, None) => bail!(
                "stages.moves = \"outside\": the simulated bench has no arm of its own; add [stages] arm = \"FILE\" to the bench file (--bench), which says where an arm \
                 holds it"
            ),
            (Moves::Die | Moves::Head, Some(_)) => bail!(
                "[stages] arm in the bench file: the stages carry head and die; an arm needs a station.toml with stages.moves = \"outside\""
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
            setup: setup.clone(),
            checks_every: scene.checks_every,
            by_hand: scene.by_hand,
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
            // Ctrl-C goes to the host only, which ends the bench once the head is out.
            .process_group(0)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .context("cannot start the bench")?;
        // The bench ends when its standard input is closed, so it does not outlive this process.
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
                real_time: setup.speed.value == Speed(1.0),
                emulated: *link == Link::Qemu,
            },
            Err(_) => {
                // The bench has printed the reason on standard error.
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

    /// Timeouts for a controller whose clock runs faster.
    pub fn client_settings(&self) -> ClientSettings {
        ClientSettings {
            heartbeat: Some(self.hello.heartbeat()),
            stall: ClientSettings::default().stall.filter(|_| self.real_time),
            // An emulated controller stands still, and answers nothing, while the bench renders; a bench that keeps no real time waits
            // for its processor on a busy machine.
            unanswered: if self.emulated || !self.real_time {
                ClientSettings::default().silence
            } else {
                ClientSettings::default().unanswered
            },
            // In real time the bench must keep up as a press does; late messages count as such.
            silence: if self.real_time {
                ClientSettings::default().silence
            } else {
                RENDERING
            },
            ..ClientSettings::default()
        }
    }

    /// Ends the bench and returns its true values, and a line for the user if it did not keep up with real time.
    pub fn finish(mut self) -> anyhow::Result<(serde_json::Value, Option<String>)> {
        // The camera process ends before the bench that it receives from.
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
        die: DieArgs,
        #[command(flatten)]
        camera: CameraArgs,
    }

    /// Without Aravis, a GigE camera is refused with instructions to install it; its faults are refused without such a camera.
    #[test]
    fn a_camera_that_is_not_there_is_refused_with_the_remedy() {
        let refused = |arguments: &[&str], trouble: Option<&str>| {
            let given = Given::parse_from([&["inspect"], arguments].concat());
            let mut setup = setup_with_camera(&given.die, &given.camera).unwrap();
            setup.file.camera.gige_trouble = trouble.map(|text| text.parse().unwrap());
            has_camera(&setup).err().map(|error| error.to_string())
        };
        assert_eq!(refused(&[], None), None);
        let without = refused(&["--camera", "gige"], None);
        assert_eq!(without.is_none(), cfg!(feature = "aravis"));
        if let Some(words) = without {
            for word in ["--features aravis", "libaravis-dev"] {
                assert!(words.contains(word), "{words}");
            }
        }
        let alone = refused(&[], Some("free-runs")).unwrap();
        assert!(alone.contains("--camera gige"), "{alone}");
    }
}
