//! A line to show to a visitor: a simulated press whose die wears, a watch over it, and the page, in a folder that goes with it.

use std::convert::Infallible;
use std::ffi::OsString;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::{env, process};

use anyhow::Context;
use rustix::process::{Pid, Signal, getppid, kill_process, set_parent_process_death_signal};

use crate::access::{Role, Users};
use crate::settings::Settings;

/// Name of the command that runs [`until_parent_ends`].
pub const UNTIL_PARENT_ENDS: &str = "until-parent-ends";

/// Becomes another program that gets a Ctrl-C when the process `parent` ends, however that ends: on SIGKILL nothing of its own runs any
/// more. The kernel keeps the request over `exec`, and a child process that asks for it itself needs no `unsafe`.
///
/// # Errors
/// There is no such program, or `parent` has ended.
pub fn until_parent_ends(parent: i32, program: &[OsString]) -> anyhow::Result<Infallible> {
    set_parent_process_death_signal(Some(Signal::INT))?;
    // It may have ended before the request.
    anyhow::ensure!(
        getppid().is_some_and(|pid| pid.as_raw_nonzero().get() == parent),
        "process {parent}, which started this one, has ended"
    );
    let (name, arguments) = program.split_first().context("no program to become")?;
    let failed = Command::new(name).args(arguments).exec();
    let name = Path::new(name).display();
    Err(failed)
        .with_context(|| format!("{name} (the instrument's program, beside this one or in PATH)"))
}

/// The simulated line. The watch ends with it.
pub struct DemoLine {
    folder: tempfile::TempDir,
    watch: Child,
}

impl Drop for DemoLine {
    fn drop(&mut self) {
        // Ended, not killed: it takes its camera and its press with it.
        let _ = kill_process(Pid::from_child(&self.watch), Signal::INT);
        let _ = self.watch.wait();
    }
}

impl DemoLine {
    /// Starts the watch, and returns the settings of its page and the token for it.
    ///
    /// # Errors
    /// No folder for the line can be made, or no process started.
    pub fn start() -> anyhow::Result<(Self, Settings, String)> {
        let folder = tempfile::Builder::new()
            .prefix("flankscope-demo-line-")
            .tempdir()?;
        let at = folder.path();
        let token = Users::add(&at.join("users.toml"), "visitor", Role::Acknowledge)?;
        let plant = at.join("plant.toml");
        std::fs::write(
            &plant,
            "history = \"press.db\"\nstale_after_s = 120\nreports = \"out\"\n\n\
             [page]\nlisten = \"127.0.0.1:0\"\nusers = \"users.toml\"\n\n[modbus]\nlisten = \"127.0.0.1:0\"\n",
        )?;
        let settings = Settings::load(&plant)?;
        // Through this program: should this process be killed, the watch is told and ends.
        let watch = Command::new(env::current_exe()?)
            .arg(UNTIL_PARENT_ENDS)
            .arg(process::id().to_string())
            .arg(instrument())
            .args(["watch", "--link", "sim", "--every", "5", "--quiet"])
            .args(["--cycles", "3600"])
            // A Ctrl-C at the terminal reaches it once, from this process.
            .process_group(0)
            // A warning after some minutes, a no-go after some more.
            .args(["--wear-rate", "40:left:0.8"])
            .arg("--history")
            .arg(&settings.history)
            .arg("--report")
            .arg(at.join("out"))
            // What is typed here acknowledges nothing; the page does.
            .stdin(Stdio::null())
            .spawn()?;
        Ok((Self { folder, watch }, settings, token))
    }

    /// Folder of the line's files.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }
}

/// The instrument's program: beside this one, or by its name alone.
fn instrument() -> PathBuf {
    let beside = env::current_exe().map(|own| own.with_file_name("flankscope"));
    let beside = beside.ok().filter(|path| path.is_file());
    beside.unwrap_or_else(|| "flankscope".into())
}
