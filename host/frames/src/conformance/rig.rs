//! How the suite handles a camera process.

use std::ffi::OsString;
use std::io::{self, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Starts, triggers and ends a camera process.
pub trait Rig {
    /// Starts it, with its frames going to the host that owns this root.
    ///
    /// # Errors
    /// It does not start.
    fn start(&mut self, root: &Path) -> io::Result<()>;

    /// Fires one exposure.
    ///
    /// # Errors
    /// The camera cannot be triggered.
    fn trigger(&mut self, exposure_us: u32) -> io::Result<()>;

    /// Asks it to end; `false` if it does not within `patience`.
    ///
    /// # Errors
    /// The operating system refuses.
    fn stop(&mut self, patience: Duration) -> io::Result<bool>;

    /// Ends it without a chance to tidy up, if it runs.
    ///
    /// # Errors
    /// The operating system refuses.
    fn kill(&mut self) -> io::Result<()>;
}

/// A camera process by its command, triggered by software.
#[derive(Debug)]
pub struct CommandRig {
    program: OsString,
    arguments: Vec<OsString>,
    variables: Vec<(OsString, OsString)>,
    child: Option<Child>,
}

impl CommandRig {
    /// A program and what comes before the root's folder on its command line.
    pub fn new(
        program: impl Into<OsString>,
        arguments: impl IntoIterator<Item = impl Into<OsString>>,
    ) -> Self {
        Self {
            program: program.into(),
            arguments: arguments.into_iter().map(Into::into).collect(),
            variables: Vec::new(),
            child: None,
        }
    }

    /// With an environment variable.
    #[must_use]
    pub fn with(mut self, name: impl Into<OsString>, value: impl Into<OsString>) -> Self {
        self.variables.push((name.into(), value.into()));
        self
    }
}

impl Rig for CommandRig {
    fn start(&mut self, root: &Path) -> io::Result<()> {
        self.kill()?;
        let child = Command::new(&self.program)
            .args(&self.arguments)
            .arg(root)
            .envs(self.variables.iter().map(|(name, value)| (name, value)))
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .spawn()?;
        self.child = Some(child);
        Ok(())
    }

    fn trigger(&mut self, exposure_us: u32) -> io::Result<()> {
        let stdin = self.child.as_mut().and_then(|child| child.stdin.as_mut());
        writeln!(stdin.ok_or(io::ErrorKind::NotConnected)?, "{exposure_us}")
    }

    fn stop(&mut self, patience: Duration) -> io::Result<bool> {
        let Some(child) = self.child.as_mut() else {
            return Ok(true);
        };
        drop(child.stdin.take());
        let end = Instant::now() + patience;
        while child.try_wait()?.is_none() {
            if Instant::now() > end {
                return Ok(false);
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        self.child = None;
        Ok(true)
    }

    fn kill(&mut self) -> io::Result<()> {
        if let Some(mut child) = self.child.take() {
            child.kill()?;
            child.wait()?;
        }
        Ok(())
    }
}

impl Drop for CommandRig {
    fn drop(&mut self) {
        let _ = self.kill();
    }
}
