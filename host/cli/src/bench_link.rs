//! The simulated bench as a process of its own: this very program, started again.

use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};

use anyhow::{Context, bail};
use flankscope_bench::process::{Farewell, Hello};
use flankscope_frames::SharedRoot;
use flankscope_station::controller::ClientSettings;

use crate::instrument::{BenchArgs, Scene};

/// A running bench.
pub struct Bench {
    child: Child,
    stdout: BufReader<ChildStdout>,
    hello: Hello,
}

/// Writes the demo tool's folder and returns it.
pub fn demo_tool(scratch: &Path) -> anyhow::Result<PathBuf> {
    let folder = scratch.join("demo");
    if !folder.join("tool.toml").exists() {
        flankscope_bench::demo::write_tool(&folder).context("cannot write the demo tool")?;
    }
    Ok(folder)
}

/// Writes the demo calibration target's folder and returns it.
pub fn demo_target(scratch: &Path) -> anyhow::Result<PathBuf> {
    let folder = scratch.join("target");
    flankscope_bench::demo::write_target(&folder).context("cannot write the demo target")?;
    Ok(folder)
}

impl Bench {
    /// Starts the bench for the folder of a tool or a target, with its camera sending frames below `root`.
    ///
    /// `controller` is `sim` for the controller in the bench's own process, `qemu` for its image in the emulator.
    pub fn start(
        args: &BenchArgs,
        controller: &str,
        scene: Scene<'_>,
        folder: &Path,
        root: &SharedRoot,
    ) -> anyhow::Result<Self> {
        let program =
            std::env::current_exe().context("cannot find this program to start the bench")?;
        let mut command = Command::new(program);
        command
            .arg("bench")
            .arg("run")
            .arg("--root")
            .arg(root.path())
            .arg(if scene.target { "--target" } else { "--tool" })
            .arg(folder)
            .args(["--controller", controller]);
        command.args(["--seed", &args.seed.to_string(), "--speed", &args.speed]);
        command.args(["--vibration-um", &args.vibration_um.to_string()]);
        command.args(["--lens-error-um", &args.lens_error_um.to_string()]);
        for wear in &args.wear {
            command.args(["--wear", wear]);
        }
        if let Some(mesh) = &args.die_mesh {
            command.arg("--die-mesh").arg(mesh);
        }
        if let Some(teeth) = scene.teeth {
            let teeth: Vec<String> = teeth.iter().map(u32::to_string).collect();
            command.args(["--teeth", &teeth.join(",")]);
        }
        if let Some(fault) = &args.frame_fault {
            command.args(["--frame-fault", fault]);
        }
        if let Some(die) = scene.die {
            command.arg("--by-hand");
            command.args(["--ovality-um", &die.ovality_um.to_string()]);
            command.args(["--taper-um", &die.taper_um.to_string()]);
            command.args(["--turned-deg", &die.turned_deg.to_string()]);
            command.args(["--turned-teeth", &die.turned_teeth.to_string()]);
            command.args(["--flanks-um", &die.flanks_um.to_string()]);
            command.args(["--die-seed", &die.die_seed.to_string()]);
            if let Some(other) = &die.die {
                command.args(["--die", other]);
            }
        }
        if let Some(press) = scene.press {
            command.args([
                "--strokes-per-minute",
                &press.strokes_per_minute.to_string(),
            ]);
            command.args(["--open-share", &press.open_share.to_string()]);
            for rate in &press.wear_rate {
                command.args(["--wear-rate", rate]);
            }
        }
        // The bench ends when its standard input does: however this process ends, the bench does not outlive it.
        let mut child = command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .context("cannot start the bench")?;
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
            },
            Err(_) => {
                // It has said why on standard error.
                let _ = child.wait();
                bail!("the simulated bench did not start");
            }
        };
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
    pub fn client_settings(&self) -> ClientSettings {
        ClientSettings {
            heartbeat: Some(self.hello.heartbeat()),
            ..ClientSettings::default()
        }
    }

    /// Ends the bench and takes its truth.
    pub fn finish(mut self) -> anyhow::Result<Farewell> {
        drop(self.child.stdin.take());
        let mut text = String::new();
        self.stdout.read_to_string(&mut text)?;
        self.child.wait()?;
        serde_json::from_str(&text).context("the simulated bench ended without its truth")
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        drop(self.child.stdin.take());
        let _ = self.child.wait();
    }
}
