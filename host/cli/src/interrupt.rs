//! Ctrl-C and SIGTERM. The first signal retracts the head and keeps the measurements; the second ends the program at once.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use anyhow::Context;
use flankscope_instrument::controller::Interrupt;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::iterator::Signals;

use crate::output::say;

/// Exit code of an interrupted program, as shells report SIGINT.
pub const EXIT_CODE: u8 = 130;

static INTERRUPT: OnceLock<Interrupt> = OnceLock::new();
/// Number of [`DeferredExit`]s.
static DEFERRED: AtomicUsize = AtomicUsize::new(0);

/// While one exists, the first signal leaves the program running until measured results are stored, however slow the machine is.
/// No deadline ends it: people are protected by the controller, which retracts by itself when heartbeats stop.
pub struct DeferredExit(());

impl DeferredExit {
    /// Defers the exit until the returned value is dropped.
    #[must_use]
    pub fn until_dropped() -> Self {
        DEFERRED.fetch_add(1, Ordering::SeqCst);
        Self(())
    }
}

impl Drop for DeferredExit {
    fn drop(&mut self) {
        DEFERRED.fetch_sub(1, Ordering::SeqCst);
    }
}

/// Installs the handlers and returns the interrupt that reports the first signal. From here on signals do not end the program by
/// themselves.
pub fn on_signals() -> anyhow::Result<Interrupt> {
    if let Some(interrupt) = INTERRUPT.get() {
        return Ok(interrupt.clone());
    }
    let mut signals = Signals::new([SIGINT, SIGTERM]).context("cannot take signals")?;
    let (interrupter, interrupt) = Interrupt::pair();
    let listen = move || {
        for (number, _) in signals.forever().enumerate() {
            if number > 0 {
                leave("ended at once");
            }
            interrupter.interrupt();
            if DEFERRED.load(Ordering::SeqCst) == 0 {
                leave("ended during an evaluation: what was stored before is kept");
            }
            say(
                "stopping: the head is retracted, and results so far are kept; interrupt again to end at once",
            );
        }
    };
    let thread = thread::Builder::new().name("signals".into()).spawn(listen);
    thread.context("cannot take signals")?;
    Ok(INTERRUPT.get_or_init(|| interrupt).clone())
}

/// Whether a signal was received.
pub fn is_requested() -> bool {
    INTERRUPT.get().is_some_and(Interrupt::is_requested)
}

fn leave(why: &str) -> ! {
    say(why);
    flankscope_frames::remove_run_folders();
    std::process::exit(EXIT_CODE.into())
}
