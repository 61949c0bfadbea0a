//! Cycles in, checks at the right moment, verdicts out.

use std::path::Path;
use std::sync::mpsc::{Receiver, TryRecvError};
use std::time::Duration;

use flankscope_protocol::{Command, Event, FaultCode, Refusal};
use tokio::time::Instant;

use super::latch::{Latch, Shown};
use crate::controller::{Client, ClientError, ClientSettings};
use crate::history::HistoryError;
use crate::inspection::{InspectError, Inspection, Station};

/// When to check.
#[derive(Clone, Copy, Debug)]
pub struct WatchSettings {
    /// Press cycles from check to check.
    pub every: u32,
    /// Stop after this many cycles; `None`: never.
    pub cycles: Option<u32>,
    /// The press is never held longer than this, by the controller's clock.
    pub hold_limit: Duration,
}

/// One check of the watch.
#[derive(Debug)]
pub struct Checked {
    /// Press cycles when it began.
    pub cycle: u32,
    /// What it found.
    pub inspection: Inspection,
    /// What the press is shown since.
    pub shown: Shown,
    /// Several checks in a row found nothing.
    pub needs_maintenance: bool,
}

/// What the watch tells.
#[derive(Debug)]
pub enum Told {
    /// The press cycled.
    Cycle(u32),
    /// The press is held for a check.
    Checking(u32),
    /// The head was not let in at this cycle, for this reason.
    Missed(u32, FaultCode),
    /// A check is over.
    Checked(Box<Checked>),
    /// The watch goes on where an earlier one ended: this is still shown.
    Resumed(Shown),
    /// Somebody acknowledged.
    Acknowledged,
    /// An acknowledgement could not be noted, and does not count.
    NotAcknowledged(HistoryError),
}

impl Station {
    /// Watches the press until `settings.cycles` have passed or `tell` says stop (false); a message on `acknowledged`
    /// clears a latched no-go, whoever sent it: a name, or nothing. Returns what the press was shown last.
    ///
    /// # Errors
    /// The watch cannot begin, or the link to the controller is gone.
    pub fn watch(
        &mut self,
        port: &Path,
        client: ClientSettings,
        settings: &WatchSettings,
        acknowledged: &Receiver<String>,
        tell: impl FnMut(Told) -> bool,
    ) -> Result<Shown, InspectError> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build();
        let runtime = runtime.map_err(|_| InspectError::Thread { thread: "I/O" })?;
        runtime.block_on(self.keep_watch(port, client, settings, acknowledged, tell))
    }

    async fn keep_watch(
        &mut self,
        port: &Path,
        client: ClientSettings,
        settings: &WatchSettings,
        acknowledged: &Receiver<String>,
        mut tell: impl FnMut(Told) -> bool,
    ) -> Result<Shown, InspectError> {
        let mut client = Client::connect(port, client).await?;
        self.make_ready(&mut client, &mut |_| {}).await?;
        let tool = self.subject.tool.name.clone();
        let mut latch = match &self.keeper {
            Some(keeper) => keeper.latch(&tool)?,
            None => Latch::default(),
        };
        if latch.shown() != Shown::Unchecked && !tell(Told::Resumed(latch.shown())) {
            return Ok(latch.shown());
        }
        let refresh = Duration::from_micros(u64::from(client.identity().verdict_life.get())) / 4;
        let mut cycle = client.status().await?.press.cycles;
        let first = cycle;
        let mut checked_at = cycle;
        let mut next_refresh = Instant::now();
        loop {
            match acknowledged.try_recv() {
                Ok(name) => {
                    let noted = self
                        .keeper
                        .as_mut()
                        .map_or(Ok(()), |keeper| keeper.acknowledge(&tool, &name));
                    let told = match noted {
                        Ok(()) => {
                            latch.acknowledge();
                            checked_at = cycle.wrapping_sub(settings.every); // check again at the next opening
                            Told::Acknowledged
                        }
                        Err(error) => Told::NotAcknowledged(error),
                    };
                    if !tell(told) {
                        return Ok(latch.shown());
                    }
                }
                Err(TryRecvError::Empty | TryRecvError::Disconnected) => {}
            }
            if Instant::now() >= next_refresh {
                // A verdict that is not repeated goes stale, and a stale verdict is a no-go.
                client
                    .order(&Command::ShowVerdict {
                        go: latch.shown().is_go(),
                    })
                    .await?;
                next_refresh = Instant::now() + refresh;
            }
            let patience = next_refresh
                .saturating_duration_since(Instant::now())
                .max(Duration::from_millis(1));
            let mut opened = false;
            match client.event(patience).await {
                Ok(Event::Cycle { count, .. }) => {
                    cycle = count;
                    if !tell(Told::Cycle(count))
                        || settings
                            .cycles
                            .is_some_and(|most| count.wrapping_sub(first) >= most)
                    {
                        return Ok(latch.shown());
                    }
                }
                Ok(Event::PressOpen { open, .. }) => opened = open,
                Ok(_) | Err(ClientError::NoEvent { .. }) => {}
                Err(error) => return Err(error.into()),
            }
            if cycle.wrapping_sub(checked_at) >= settings.every.saturating_mul(2)
                && latch.shown().is_go()
            {
                latch.take("overdue"); // a go that nobody has confirmed for so long is none
                next_refresh = Instant::now();
            }
            let due = cycle.wrapping_sub(checked_at) >= settings.every
                || latch.shown() == Shown::Unchecked;
            if opened && due {
                if !tell(Told::Checking(cycle)) {
                    return Ok(latch.shown());
                }
                let check = self
                    .check(&mut client, Some(settings.hold_limit), &mut |_| {})
                    .await;
                let inspection = match check {
                    // The press was faster than the order: the next opening will do.
                    Err(InspectError::Client(ClientError::Refused(Refusal::Interlock {
                        fault,
                    }))) => {
                        if !tell(Told::Missed(cycle, fault)) {
                            return Ok(latch.shown());
                        }
                        continue;
                    }
                    check => check?,
                };
                cycle = cycle.max(inspection.press_cycles);
                checked_at = inspection.press_cycles;
                let shown = latch.take(&inspection.verdict);
                client
                    .order(&Command::ShowVerdict { go: shown.is_go() })
                    .await?;
                next_refresh = Instant::now() + refresh;
                let needs_maintenance = latch.needs_maintenance();
                if !tell(Told::Checked(Box::new(Checked {
                    cycle: checked_at,
                    inspection,
                    shown,
                    needs_maintenance,
                }))) {
                    return Ok(latch.shown());
                }
            }
        }
    }
}
