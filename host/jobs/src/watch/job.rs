//! The watch: follows the press cycles, runs checks when due, and shows verdicts.

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::mpsc::Receiver;
use std::time::Duration;

use flankscope_protocol::{Command, Event, FaultCode, Refusal};
use tokio::time::Instant;

use flankscope_metrology::verdict::{Latch, Shown};
use serde::Serialize;

use crate::inspection::{InspectError, ViewOutcome};
use crate::job::{Job, Source, connect, runtime};
use flankscope_instrument::acquisition::{AcquisitionError, Progress};
use flankscope_instrument::controller::{Client, ClientError, ClientSettings};
use flankscope_record::document::Inspection;
use flankscope_record::history::{HistoryError, HistoryWriter, Hold};

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

/// One check of the watch, serialised as a line of JSON.
#[derive(Debug, Serialize)]
pub struct Checked {
    /// Press cycles when it began.
    pub cycle: u32,
    /// Its result.
    pub inspection: Inspection,
    /// Verdict that the press is shown from then on.
    #[serde(serialize_with = "word")]
    pub shown: Shown,
    /// Several checks in a row gave no result.
    #[serde(skip)]
    pub needs_maintenance: bool,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde calls it so")]
fn word<S: serde::Serializer>(shown: &Shown, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(shown.word())
}

/// Event of a watch, for the caller to print or to log.
#[derive(Debug)]
pub enum WatchEvent {
    /// The press cycled.
    Cycle(u32),
    /// The press is held for a check.
    Checking(u32),
    /// The check goes on.
    Step(Progress),
    /// The press did not let the head in at this cycle, for this reason.
    Missed(u32, FaultCode),
    /// A check has ended.
    Checked(Box<Checked>),
    /// The watch continues an earlier one; this verdict is still shown.
    Resumed(Shown),
    /// No check was made for twice the interval: this is shown from now on instead of a go.
    Expired(Shown),
    /// This verdict was sent to the press again.
    Repeated(Shown),
    /// Somebody wants a check, which is made at the next opening.
    Requested(String),
    /// A verdict was acknowledged.
    Acknowledged,
    /// An acknowledgement could not be stored, and does not count.
    NotAcknowledged(HistoryError),
}

impl Job<ViewOutcome> {
    /// Watches the press until `settings.cycles` have passed or `tell` returns false. A message on `acknowledged` clears a
    /// latched no-go; it is the name of the sender, or empty. Every check waits for `writer`, if there is one. Returns the
    /// verdict shown last.
    ///
    /// # Errors
    /// The watch cannot begin, or the link to the controller is lost.
    pub fn watch(
        &mut self,
        port: &Path,
        client: ClientSettings,
        settings: &WatchSettings,
        writer: Option<&mut HistoryWriter>,
        acknowledged: &Receiver<String>,
        tell: impl FnMut(WatchEvent) -> bool,
    ) -> Result<Shown, WatchError> {
        runtime()?.block_on(async {
            let client = connect(&self.acquisition, port, client, &mut |_| {}).await?;
            let mut watch = Watch::begin(self, client, settings, writer, tell).await?;
            let before = watch.latch.shown();
            if before != Shown::Unchecked && watch.tell(WatchEvent::Resumed(before)).is_break() {
                return Ok(before);
            }
            while watch.step(acknowledged).await?.is_continue() {}
            Ok(watch.latch.shown())
        })
    }
}

/// Why the watch cannot begin, or ended.
#[derive(Debug, thiserror::Error)]
pub enum WatchError {
    /// Controller or camera cannot be used.
    #[error(transparent)]
    Acquisition(#[from] AcquisitionError),
    /// A check could not begin.
    #[error(transparent)]
    Check(#[from] InspectError),
    /// The verdict shown before cannot be read.
    #[error(transparent)]
    History(#[from] HistoryError),
}

impl From<ClientError> for WatchError {
    fn from(error: ClientError) -> Self {
        AcquisitionError::from(error).into()
    }
}

/// State of a watch between two events.
struct Watch<'a, T> {
    job: &'a mut Job<ViewOutcome>,
    client: Client,
    settings: &'a WatchSettings,
    writer: Option<&'a mut HistoryWriter>,
    /// Called with every event; returns false to stop.
    tell: T,
    latch: Latch,
    /// Number of the newest check that this watch told of: what a person at the watch saw. 0 before the first.
    newest_told: i64,
    /// Acknowledgements in the history before the check whose verdict came last; absent if that is not stored.
    acknowledgements: Option<i64>,
    /// Prevents other watches of this die.
    _hold: Option<Hold>,
    /// Press cycles by the controller's counter: when it began, now, and at the last check.
    first: u32,
    cycle: u32,
    checked_at: u32,
    /// Somebody wants a check before it is due.
    is_requested: bool,
    /// Interval of repeating the verdict: without repetition it expires, and the press treats an expired verdict as no-go.
    refresh: Duration,
    next_refresh: Instant,
}

impl<'a, T: FnMut(WatchEvent) -> bool> Watch<'a, T> {
    async fn begin(
        job: &'a mut Job<ViewOutcome>,
        mut client: Client,
        settings: &'a WatchSettings,
        writer: Option<&'a mut HistoryWriter>,
        tell: T,
    ) -> Result<Self, WatchError> {
        let die = job.die();
        let (hold, latch) = match &writer {
            Some(writer) => (writer.hold(&die)?, writer.latch(&die)?),
            None => (None, Latch::default()),
        };
        let cycle = client.status().await?.press.cycles;
        let (acknowledgements, newest_told) = match &writer {
            Some(writer) => (
                Some(writer.acknowledgement_count(&die)?),
                writer.newest_check(&die)?,
            ),
            None => (None, 0),
        };
        Ok(Self {
            job,
            settings,
            writer,
            tell,
            latch,
            newest_told,
            acknowledgements,
            _hold: hold,
            first: cycle,
            cycle,
            checked_at: cycle,
            is_requested: false,
            refresh: Duration::from_micros(u64::from(client.identity().verdict_life.get())) / 4,
            next_refresh: Instant::now(),
            client,
        })
    }

    /// Reports an event; breaks if the caller stops the watch.
    fn tell(&mut self, told: WatchEvent) -> ControlFlow<()> {
        if (self.tell)(told) {
            ControlFlow::Continue(())
        } else {
            ControlFlow::Break(())
        }
    }

    /// Handles one event.
    async fn step(
        &mut self,
        acknowledged: &Receiver<String>,
    ) -> Result<ControlFlow<()>, WatchError> {
        if let Ok(name) = acknowledged.try_recv()
            && self.acknowledge(&name).is_break()
        {
            return Ok(ControlFlow::Break(()));
        }
        if Instant::now() >= self.next_refresh {
            self.show().await?;
            let shown = self.latch.shown();
            if self.tell(WatchEvent::Repeated(shown)).is_break() {
                return Ok(ControlFlow::Break(()));
            }
            if self.is_acknowledged_elsewhere() && self.start_afresh().is_break() {
                return Ok(ControlFlow::Break(()));
            }
            if self.take_request().is_break() {
                return Ok(ControlFlow::Break(()));
            }
        }
        let patience = self
            .next_refresh
            .saturating_duration_since(Instant::now())
            .max(Duration::from_millis(1));
        let mut opened = false;
        let mut interrupt = self.client.interrupt();
        let event = tokio::select! {
            event = self.client.event(patience) => event,
            () = interrupt.requested() => return Ok(ControlFlow::Break(())),
        };
        match event {
            Ok(Event::Cycle { count, .. }) => {
                self.cycle = count;
                let most = self.settings.cycles;
                let over = most.is_some_and(|most| count.wrapping_sub(self.first) >= most);
                if self.tell(WatchEvent::Cycle(count)).is_break() || over {
                    return Ok(ControlFlow::Break(()));
                }
            }
            Ok(Event::PressOpen { open, .. }) => opened = open,
            Ok(_) | Err(ClientError::NoEvent { .. }) => {}
            Err(error) => return Err(error.into()),
        }
        let since = self.cycle.wrapping_sub(self.checked_at);
        if since >= self.settings.every.saturating_mul(2) && self.latch.shown().is_go() {
            self.latch.expire();
            self.next_refresh = Instant::now();
            if self
                .tell(WatchEvent::Expired(self.latch.shown()))
                .is_break()
            {
                return Ok(ControlFlow::Break(()));
            }
        }
        if opened && self.take_request().is_break() {
            return Ok(ControlFlow::Break(()));
        }
        let due = self.is_requested
            || since >= self.settings.every
            || self.latch.shown() == Shown::Unchecked;
        if opened && due {
            return self.check().await;
        }
        Ok(ControlFlow::Continue(()))
    }

    /// Notes a request for a check, if there is one.
    fn take_request(&mut self) -> ControlFlow<()> {
        let writer = self.writer.as_ref();
        match writer.and_then(|writer| writer.take_check_request()) {
            Some(who) => {
                self.is_requested = true;
                self.tell(WatchEvent::Requested(who))
            }
            None => ControlFlow::Continue(()),
        }
    }

    /// Handles an acknowledgement, which counts once it is stored.
    fn acknowledge(&mut self, name: &str) -> ControlFlow<()> {
        let noted = match &mut self.writer {
            Some(writer) => writer.acknowledge(&self.job.die(), self.newest_told, name),
            None => Ok(()),
        };
        match noted {
            Ok(()) => self.start_afresh(),
            Err(error) => self.tell(WatchEvent::NotAcknowledged(error)),
        }
    }

    /// Whether another process stored an acknowledgement of the no-go that is shown, for example the plant's page. A history that
    /// cannot be read acknowledges nothing, and a no-go that could not be stored is acknowledged at this watch alone.
    fn is_acknowledged_elsewhere(&self) -> bool {
        let (Shown::NoGo, Some(writer), Some(before)) =
            (self.latch.shown(), &self.writer, self.acknowledgements)
        else {
            return false;
        };
        let die = self.job.die();
        let is_new = writer
            .acknowledgement_count(&die)
            .is_ok_and(|now| now > before);
        is_new
            && writer
                .latch(&die)
                .is_ok_and(|latch| latch.shown() != Shown::NoGo)
    }

    /// Clears what is latched, and checks again at the next opening.
    fn start_afresh(&mut self) -> ControlFlow<()> {
        self.latch.acknowledge();
        self.checked_at = self.cycle.wrapping_sub(self.settings.every);
        self.tell(WatchEvent::Acknowledged)
    }

    /// Sends the present verdict to the press.
    async fn show(&mut self) -> Result<(), WatchError> {
        let go = self.latch.shown().is_go();
        self.client.order(&Command::ShowVerdict { go }).await?;
        self.next_refresh = Instant::now() + self.refresh;
        Ok(())
    }

    /// Runs a check, stores, latches and shows its result.
    async fn check(&mut self) -> Result<ControlFlow<()>, WatchError> {
        let acknowledged = self.is_acknowledged_elsewhere() && self.start_afresh().is_break();
        if acknowledged || self.tell(WatchEvent::Checking(self.cycle)).is_break() {
            return Ok(ControlFlow::Break(()));
        }
        // Before the check: an acknowledgement of an earlier no-go may come while it runs.
        let acknowledgements = match &self.writer {
            Some(writer) => writer.acknowledgement_count(&self.job.die()).ok(),
            None => None,
        };
        let hold_limit = Some(self.settings.hold_limit);
        let source = Source::Live(&mut self.client);
        // A check that has begun is ended, whatever the caller answers.
        let tell = &mut self.tell;
        let mut step = |progress| {
            tell(WatchEvent::Step(progress));
        };
        let check = self
            .job
            .check(source, hold_limit, &mut self.writer, &mut step)
            .await;
        let inspection = match check {
            // The press closed before the command arrived: the check is made at the next opening.
            Err(InspectError::Acquisition(AcquisitionError::Client(ClientError::Refused(
                Refusal::Interlock { fault },
            )))) => return Ok(self.tell(WatchEvent::Missed(self.cycle, fault))),
            check => check?,
        };
        self.cycle = self.cycle.max(inspection.press_cycles);
        self.checked_at = inspection.press_cycles;
        self.is_requested = false;
        let shown = self.latch.take(inspection.verdict);
        self.newest_told = inspection.id.unwrap_or(self.newest_told);
        self.acknowledgements = acknowledgements.filter(|_| inspection.id.is_some());
        self.show().await?;
        let checked = Checked {
            cycle: self.checked_at,
            inspection,
            shown,
            needs_maintenance: self.latch.needs_maintenance(),
        };
        Ok(self.tell(WatchEvent::Checked(Box::new(checked))))
    }
}
