//! A line to show to a visitor: a simulated press whose die wears, a watch over it, and the page, in a folder that goes with it.

use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use anyhow::Context;
use rustix::process::{Pid, Signal, kill_process};

use crate::access::{Role, Users};
use crate::settings::Settings;

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
    /// There is no `flankscope` beside this program or in `PATH`, or no folder for the line can be made.
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
        let watch = Command::new(instrument())
            .args(["watch", "--link", "sim", "--every", "5", "--quiet"])
            // Should this process be killed, the watch ends with the visit.
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
            .spawn()
            .context("no flankscope beside this program or in PATH")?;
        Ok((Self { folder, watch }, settings, token))
    }

    /// Folder of the line's files.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }
}

/// The instrument's program: beside this one, or by its name alone.
fn instrument() -> PathBuf {
    let beside = std::env::current_exe().map(|own| own.with_file_name("flankscope"));
    let beside = beside.ok().filter(|path| path.is_file());
    beside.unwrap_or_else(|| "flankscope".into())
}
