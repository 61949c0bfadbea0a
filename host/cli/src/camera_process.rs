//! The camera process, started and ended together with the instrument.

use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::Context;

/// A camera process ends when its standard input is closed; if it does not, it is killed after this time.
const PATIENCE: Duration = Duration::from_secs(2);

/// A running camera process.
pub struct CameraProcess(Child);

impl CameraProcess {
    /// Starts it with the folder of the shared memory as its last argument; `None` without a command.
    pub fn start(command: &[String], root: &Path) -> anyhow::Result<Option<Self>> {
        let [program, arguments @ ..] = command else {
            return Ok(None);
        };
        let child = Command::new(program)
            .args(arguments)
            .arg(root)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .spawn()
            .with_context(|| {
                format!("cannot start the camera process {program} (camera.command)")
            })?;
        Ok(Some(Self(child)))
    }
}

impl Drop for CameraProcess {
    fn drop(&mut self) {
        drop(self.0.stdin.take());
        let end = Instant::now() + PATIENCE;
        while matches!(self.0.try_wait(), Ok(None)) {
            if Instant::now() > end {
                let _ = self.0.kill();
            }
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}
