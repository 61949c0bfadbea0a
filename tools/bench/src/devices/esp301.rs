//! The emulated stage controller alone, on a pseudo-terminal, for any ESP301 or ESP300 client.

use super::stage::{AxisModels, serve};
use super::{Faults, StageModel};
use flankscope_sim::{Clock, Port, Pty, Remote, Sim};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::thread::JoinHandle;

/// A running stage controller. Dropping it stops it.
pub struct Stages {
    port: PathBuf,
    remote: Remote,
    stopping: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Stages {
    /// The serial port to open.
    pub fn port(&self) -> &Path {
        &self.port
    }
}

impl Drop for Stages {
    fn drop(&mut self) {
        self.stopping.store(true, Ordering::Release);
        self.remote.wake();
        if let Some(thread) = self.thread.take() {
            let _ended = thread.join();
        }
    }
}

/// Starts it, `speed` virtual seconds per real second.
///
/// # Errors
/// The system has no thread or no pseudo-terminal left.
pub fn run(speed: f64, seed: u64) -> io::Result<Stages> {
    let stopping = Arc::new(AtomicBool::new(false));
    let stop = Arc::clone(&stopping);
    let (opened, opening) = mpsc::channel();
    let thread = std::thread::Builder::new()
        .name("stages".into())
        .spawn(move || {
            let sim = Sim::new(Clock::Paced { speed });
            let (device, host) = Port::pair();
            let pty = match Pty::open(&sim, host) {
                Ok(pty) => pty,
                Err(error) => {
                    let _starter = opened.send(Err(error));
                    return;
                }
            };
            let _starter = opened.send(Ok((pty.path().to_owned(), sim.remote())));
            let model = std::rc::Rc::new(std::cell::RefCell::new(StageModel::new(
                AxisModels::default(),
                seed,
            )));
            sim.spawn(async move { serve(device, &model, &Faults::default(), |_| {}).await });
            sim.run_until(|| stop.load(Ordering::Acquire));
            drop(pty);
        })?;
    let (port, remote) = opening
        .recv()
        .map_err(|_| io::Error::other("the stages' thread ended early"))??;
    Ok(Stages {
        port,
        remote,
        stopping,
        thread: Some(thread),
    })
}
