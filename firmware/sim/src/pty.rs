//! A pseudo-terminal in front of a virtual UART: the host opens it as it would a real serial port.

use crate::uart::Port;
use embedded_io_async::Read;
use rustix::fs::{Mode, OFlags};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::thread::JoinHandle;

/// An open pseudo-terminal. Dropping it ends its threads.
pub struct Pty {
    path: PathBuf,
    /// Kept open, so that a host coming and going does not hang up the line.
    slave: Arc<OwnedFd>,
    stopping: Arc<AtomicBool>,
    reader: Option<JoinHandle<()>>,
}

impl Pty {
    /// Opens a pseudo-terminal in raw mode and joins it to `port`, with a task on `sim` for the way out.
    ///
    /// # Errors
    /// The system has no pseudo-terminal left, or no thread.
    pub fn open(sim: &crate::Sim, port: Port) -> io::Result<Self> {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY)?;
        grantpt(&master)?;
        unlockpt(&master)?;
        let name = ptsname(&master, Vec::new())?;
        let slave = rustix::fs::open(&name, OFlags::RDWR | OFlags::NOCTTY, Mode::empty())?;
        let mut settings = tcgetattr(&slave)?;
        settings.make_raw();
        tcsetattr(&slave, OptionalActions::Now, &settings)?;
        let path = PathBuf::from(name.to_string_lossy().into_owned());

        let (master, slave) = (Arc::new(master), Arc::new(slave));
        let stopping = Arc::new(AtomicBool::new(false));
        let reader = {
            // The remote tells a stepped simulation that somebody outside may still speak.
            let (master, port, stopping, remote) = (
                Arc::clone(&master),
                port.clone(),
                Arc::clone(&stopping),
                sim.remote(),
            );
            std::thread::Builder::new()
                .name("pty-read".into())
                .spawn(move || {
                    let _remote = remote;
                    let mut buffer = [0u8; 512];
                    while let Ok(count) = read(master.as_fd(), &mut buffer) {
                        if stopping.load(Ordering::Acquire) {
                            break;
                        }
                        port.send(&buffer[..count]);
                    }
                })?
        };
        // A thread does the writing: a host that does not read must not stop virtual time.
        let (outbox, queue) = mpsc::channel::<Vec<u8>>();
        std::thread::Builder::new()
            .name("pty-write".into())
            .spawn(move || {
                for bytes in queue {
                    let mut rest = bytes.as_slice();
                    while let Ok(count @ 1..) = write(master.as_fd(), rest) {
                        rest = &rest[count..];
                        if rest.is_empty() {
                            break;
                        }
                    }
                }
            })?;
        sim.spawn(async move {
            let mut port = port;
            let mut buffer = [0u8; 512];
            loop {
                let Ok(count) = port.read(&mut buffer).await;
                if outbox.send(buffer[..count].to_vec()).is_err() {
                    return;
                }
            }
        });
        Ok(Self {
            path,
            slave,
            stopping,
            reader: Some(reader),
        })
    }

    /// The path a host opens, such as `/dev/pts/3`.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for Pty {
    fn drop(&mut self) {
        self.stopping.store(true, Ordering::Release);
        // A byte from this side ends the reader's blocking read.
        if write(self.slave.as_fd(), b"\0").is_ok()
            && let Some(reader) = self.reader.take()
        {
            let _ended = reader.join();
        }
    }
}

fn read(fd: rustix::fd::BorrowedFd<'_>, buffer: &mut [u8]) -> io::Result<usize> {
    loop {
        match rustix::io::read(fd, &mut *buffer) {
            Err(rustix::io::Errno::INTR) => {}
            other => return Ok(other?),
        }
    }
}

fn write(fd: rustix::fd::BorrowedFd<'_>, bytes: &[u8]) -> io::Result<usize> {
    loop {
        match rustix::io::write(fd, bytes) {
            Err(rustix::io::Errno::INTR) => {}
            other => return Ok(other?),
        }
    }
}
