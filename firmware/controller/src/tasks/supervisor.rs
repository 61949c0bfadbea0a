//! The supervisor: feeds the watchdog while every other task shows life.

use super::Mailboxes;
use crate::liveness::{BEAT, Watchdog};
use embassy_time::Timer;

/// Feeds the watchdog for ever, as long as every task shows life.
pub async fn supervise(mut watchdog: impl Watchdog, mail: &Mailboxes) -> ! {
    loop {
        if mail.liveness.all() {
            watchdog.feed();
        }
        Timer::after(BEAT).await;
    }
}
