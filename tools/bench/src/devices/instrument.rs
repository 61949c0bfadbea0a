//! The whole instrument on its own thread: controller, devices, and a pseudo-terminal for the host.

use super::{DeviceConfig, ExposureSink, spawn_all};
use crate::qemu::{self, Figures, Machine};
use flankscope_controller::sequence;
use flankscope_protocol::Microseconds;
use flankscope_sim::{Clock, Edge, Pace, Pty, Remote, Sim, Wiring, spawn_controller};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::thread::JoinHandle;

/// Configuration of a simulated instrument.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InstrumentConfig {
    /// How virtual time passes.
    pub clock: Clock,
    /// The controller's settings; its timeout for a silent host is in virtual time, so raise it with the speed.
    pub controller: sequence::Config,
    /// How the devices behave.
    pub devices: DeviceConfig,
}

impl InstrumentConfig {
    /// Settings for a host in another process, at `speed` virtual seconds per real second.
    ///
    /// The timeout for a silent host is in virtual time, but the host runs in real time, on a machine that is also busy
    /// rendering, so it gets a full real second.
    #[must_use]
    pub fn paced(speed: f64) -> Self {
        let silence_us = (1e6 * speed.max(1.0)).min(f64::from(u32::MAX));
        let host_silence = Microseconds(silence_us as u32);
        Self {
            clock: Clock::Paced { speed },
            controller: sequence::Config {
                host_silence,
                ..sequence::Config::DEFAULT
            },
            ..Self::default()
        }
    }

    /// Settings for a host in another process, as fast as possible: without a timeout for a silent host.
    #[must_use]
    pub fn unpaced() -> Self {
        Self {
            clock: Clock::Stepped,
            ..Self::paced(f64::INFINITY)
        }
    }
}

impl Default for InstrumentConfig {
    /// Real time, with the controller's default settings.
    fn default() -> Self {
        Self {
            clock: Clock::Paced { speed: 1.0 },
            controller: sequence::Config::DEFAULT,
            devices: DeviceConfig::default(),
        }
    }
}

/// Implementation of the controller.
pub enum Controller {
    /// The controller crate in this process, in virtual time.
    InProcess,
    /// The controller's firmware image, in the emulator's time, with its built-in settings.
    Emulated(Machine),
}

/// Record of a finished run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Outcome {
    /// Virtual time reached, and its lag behind real time.
    pub pace: Pace,
    /// Every pin edge, in order.
    pub edges: Vec<Edge>,
    /// Timing accuracy of the controller, if it was emulated.
    pub figures: Option<Figures>,
}

/// A running instrument. Dropping it stops it.
pub struct Instrument {
    port: PathBuf,
    remote: Remote,
    stopping: Arc<AtomicBool>,
    thread: Option<JoinHandle<Outcome>>,
}

impl Instrument {
    /// The serial port for the host to open.
    pub fn port(&self) -> &Path {
        &self.port
    }

    /// Stops and resumes virtual time, for instance while a frame is rendered.
    pub fn remote(&self) -> &Remote {
        &self.remote
    }

    /// Stops the instrument. `None` if its thread panicked.
    #[must_use]
    pub fn stop(mut self) -> Option<Outcome> {
        self.finish()
    }

    fn finish(&mut self) -> Option<Outcome> {
        self.stopping.store(true, Ordering::Release);
        self.remote.wake();
        self.thread.take()?.join().ok()
    }
}

impl Drop for Instrument {
    fn drop(&mut self) {
        let _outcome = self.finish();
    }
}

/// Starts the instrument with the controller in this process and returns once its port can be opened.
///
/// # Errors
/// The system has no thread or no pseudo-terminal left.
pub fn run(
    config: InstrumentConfig,
    sink: impl ExposureSink + Send + 'static,
) -> io::Result<Instrument> {
    run_with(config, Controller::InProcess, sink)
}

/// Starts the instrument with this controller and returns once its port can be opened.
///
/// # Errors
/// The system has no thread, no socket or no pseudo-terminal left.
pub fn run_with(
    config: InstrumentConfig,
    controller: Controller,
    mut sink: impl ExposureSink + Send + 'static,
) -> io::Result<Instrument> {
    let stopping = Arc::new(AtomicBool::new(false));
    let stop = Arc::clone(&stopping);
    let (opened, opening) = mpsc::channel();
    let thread = std::thread::Builder::new()
        .name("instrument".into())
        .spawn(move || {
            let sim = Sim::new(config.clock);
            let wiring = Wiring::new(&sim);
            sink.attach(sim.remote());
            spawn_all(&sim, &wiring, &config.devices, sink);
            let begun = Pty::open(&sim, wiring.host.clone()).and_then(|pty| {
                let emulated = match &controller {
                    Controller::InProcess => {
                        spawn_controller(&sim, &wiring, config.controller);
                        None
                    }
                    Controller::Emulated(machine) => Some(qemu::join(&sim, &wiring, machine)?),
                };
                Ok((pty, emulated))
            });
            let (pty, emulated) = match begun {
                Ok(begun) => begun,
                Err(error) => {
                    let _starter = opened.send(Err(error));
                    return Outcome {
                        pace: sim.pace(),
                        edges: Vec::new(),
                        figures: None,
                    };
                }
            };
            let _starter = opened.send(Ok((pty.path().to_owned(), sim.remote())));
            sim.run_until(|| stop.load(Ordering::Acquire));
            drop(pty);
            drop(controller);
            Outcome {
                pace: sim.pace(),
                edges: sim.edges(),
                figures: emulated.map(|emulated| Figures::of(&emulated.trace())),
            }
        })?;
    let (port, remote) = opening
        .recv()
        .map_err(|_| io::Error::other("the instrument's thread ended early"))??;
    Ok(Instrument {
        port,
        remote,
        stopping,
        thread: Some(thread),
    })
}
