//! QEMU as a child process, connected by sockets in a private folder.

use std::io::{self, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Signal, set_parent_process_death_signal};

/// Program of the emulator.
const PROGRAM: &str = "qemu-system-arm";
/// Path of the image that `cargo xtask firmware` builds, relative to the repository.
const IMAGE: &str =
    "firmware/mps2-an386/target/thumbv7em-none-eabihf/release/flankscope-mps2-an386";
/// QEMU connects within milliseconds of its start.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(20);

/// Why the emulated controller cannot run.
#[derive(Debug, thiserror::Error)]
pub enum EmulatorError {
    #[error(
        "{PROGRAM} is missing; get it from your distribution, on Debian by: apt-get install qemu-system-arm"
    )]
    NoEmulator,
    /// The image does not exist.
    #[error(
        "the controller's image {} is missing; build it by: cargo xtask firmware (or name one in FLANKSCOPE_IMAGE)", path.display()
    )]
    NoImage {
        /// Path that was searched.
        path: PathBuf,
    },
    /// QEMU ended before connecting.
    #[error("{PROGRAM} ended at once ({status}); it has said why above")]
    Ended { status: ExitStatus },
    /// QEMU did not connect.
    #[error("{PROGRAM} did not connect its ports within {} s", CONNECT_TIMEOUT.as_secs())]
    Silent,
    /// Sockets or threads could not be created.
    #[error("cannot run {PROGRAM}")]
    Io(#[from] io::Error),
}

/// Path of the image: FLANKSCOPE_IMAGE, else what `cargo xtask firmware` built in the repository that contains this program or
/// the current folder, or that this program was built from.
///
/// # Errors
/// No image was found.
pub fn find_image() -> Result<PathBuf, EmulatorError> {
    if let Some(path) = std::env::var_os("FLANKSCOPE_IMAGE").map(PathBuf::from) {
        return if path.is_file() {
            Ok(path)
        } else {
            Err(EmulatorError::NoImage { path })
        };
    }
    let program = std::env::current_exe().unwrap_or_default();
    let here = std::env::current_dir().unwrap_or_default();
    program
        .ancestors()
        .chain(here.ancestors())
        // The program may have been built elsewhere (CARGO_TARGET_DIR) and run anywhere, so its source repository is searched too.
        .chain(Path::new(env!("CARGO_MANIFEST_DIR")).ancestors())
        .map(|folder| folder.join(IMAGE))
        .find(|path| path.is_file())
        .ok_or(EmulatorError::NoImage { path: IMAGE.into() })
}

/// A running emulator. It is killed when this is dropped, and by the system when this process dies.
pub struct Machine {
    child: Child,
    pub(super) link: UnixStream,
    pub(super) pins: UnixStream,
    pub(super) stage: UnixStream,
    monitor: UnixStream,
}

impl Machine {
    /// Starts QEMU with `image`.
    ///
    /// Must be called on a thread that lives as long as the machine: the system kills the machine with it.
    ///
    /// # Errors
    /// QEMU is missing, or ends, or does not connect.
    pub fn start(image: &Path) -> Result<Self, EmulatorError> {
        let folder = tempfile::Builder::new()
            .prefix("flankscope-qemu-")
            .tempdir()?;
        let mut command = Command::new(PROGRAM);
        command.args([
            "-no-user-config",
            "-machine",
            "mps2-an386",
            "-cpu",
            "cortex-m4",
        ]);
        // 2^0 ns per instruction: 1000 million per second, the order of the real board's Cortex-M7 at 400 MHz (rated
        // 856 DMIPS). Asleep, its time is real time.
        command.args(["-icount", "shift=0"]);
        command.args(["-display", "none", "-monitor", "none"]);
        let mut listeners = Vec::new();
        for name in ["link", "pins", "stage", "monitor"] {
            let path = folder.path().join(name);
            let listener = UnixListener::bind(&path)?;
            listener.set_nonblocking(true)?;
            listeners.push(listener);
            command.arg("-chardev");
            command.arg(format!("socket,id={name},path={}", path.display()));
            if name == "monitor" {
                command.args(["-mon", "chardev=monitor,mode=control"]);
            } else {
                command.args(["-serial", &format!("chardev:{name}")]);
            }
        }
        command.arg("-kernel").arg(image);
        command.stdin(Stdio::null()).stdout(Stdio::null());
        // SAFETY: between fork and exec only one system call is made.
        unsafe {
            command.pre_exec(|| Ok(set_parent_process_death_signal(Some(Signal::KILL))?));
        }
        let mut child = command.spawn().map_err(|error| match error.kind() {
            io::ErrorKind::NotFound => EmulatorError::NoEmulator,
            _ => EmulatorError::Io(error),
        })?;
        let mut accept = |child: &mut Child| {
            let listener = listeners.remove(0);
            accept(&listener, child)
        };
        let connected = (|| {
            Ok((
                accept(&mut child)?,
                accept(&mut child)?,
                accept(&mut child)?,
                accept(&mut child)?,
            ))
        })();
        match connected {
            // Connected sockets need no name, so the folder is removed now and cannot be left behind.
            Ok((link, pins, stage, monitor)) => {
                (&monitor).write_all(b"{\"execute\":\"qmp_capabilities\"}\n")?;
                drain(monitor.try_clone()?)?;
                Ok(Self {
                    child,
                    link,
                    pins,
                    stage,
                    monitor,
                })
            }
            Err(error) => {
                let _ = child.kill();
                let _ = child.wait();
                Err(error)
            }
        }
    }

    /// Returns a function that stops and resumes the processor and its clock; for other threads.
    ///
    /// # Errors
    /// The system has no file descriptor left.
    pub(super) fn brake(&self) -> io::Result<impl Fn(bool) + Send + Sync + 'static> {
        let monitor = self.monitor.try_clone()?;
        Ok(move |held: bool| {
            let order: &[u8] = if held {
                b"{\"execute\":\"stop\"}\n"
            } else {
                b"{\"execute\":\"cont\"}\n"
            };
            // A machine that has ended need not be stopped.
            let _ = (&monitor).write_all(order);
        })
    }
}

impl Drop for Machine {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn accept(listener: &UnixListener, child: &mut Child) -> Result<UnixStream, EmulatorError> {
    let start = Instant::now();
    loop {
        match listener.accept() {
            Ok((stream, _)) => {
                stream.set_nonblocking(false)?;
                return Ok(stream);
            }
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
            Err(error) => return Err(error.into()),
        }
        if let Some(status) = child.try_wait()? {
            return Err(EmulatorError::Ended { status });
        }
        if start.elapsed() > CONNECT_TIMEOUT {
            return Err(EmulatorError::Silent);
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Discards the monitor's output, so that the monitor never blocks.
fn drain(monitor: UnixStream) -> io::Result<()> {
    std::thread::Builder::new()
        .name("qemu-monitor".into())
        .spawn(move || {
            let _ = io::copy(&mut { monitor }, &mut io::sink());
        })?;
    Ok(())
}
