//! Ctrl-C and SIGTERM. The first signal retracts the head and keeps the measurements; the second ends the program at once.

use std::sync::OnceLock;
use std::thread;
use std::time::Duration;

use anyhow::Context;
use flankscope_instrument::controller::Interrupt;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::iterator::Signals;

use crate::output::say;

/// Exit code of an interrupted program, as shells report SIGINT.
pub const EXIT_CODE: u8 = 130;
/// A head takes a second to retract, and a view as long to be evaluated. The program then ends even if that is not complete:
/// without heartbeats, the controller retracts by itself.
const PATIENCE: Duration = Duration::from_millis(2500);

static INTERRUPT: OnceLock<Interrupt> = OnceLock::new();

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
            say(
                "stopping: the head is retracted, and results so far are kept; interrupt again to end at once",
            );
            interrupter.interrupt();
            thread::spawn(|| {
                thread::sleep(PATIENCE);
                leave("ended during an evaluation: what was stored before is kept");
            });
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
