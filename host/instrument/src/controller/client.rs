//! Commands with a reply, events in order, and a heartbeat while the client waits for either.

use std::collections::VecDeque;
use std::path::Path;
use std::time::Duration;

use flankscope_protocol::stage::STAGE_CONFIG_VERSION;
use flankscope_protocol::{
    Command, Event, FaultCode, Header, Identity, PROTOCOL_VERSION, Refusal, Reply, SCHEMA_HASH,
    StageConfig, StageName, Status,
};
use tokio::time::{Instant, timeout_at};

use super::interrupt::Interrupt;
use super::link::{Incoming, Link, LinkError};

/// Distances of event numbers from here on lie behind, not ahead (serial number arithmetic, RFC 1982).
const BEHIND: u16 = 0x8000;

/// Timeouts of the client.
#[derive(Clone, Debug)]
pub struct ClientSettings {
    /// Wait for an answer before the same command is sent again.
    pub answer: Duration,
    /// Time between heartbeats; `None`: a third of what the controller allows.
    pub heartbeat: Option<Duration>,
    /// Largest delay of triggers and frames relative to the clock of the device that reports them; `None`: the controller's clock
    /// is not real time.
    pub stall: Option<Duration>,
    /// Longest wait for any answer, to commands and heartbeats alike, before the link counts as lost.
    pub unanswered: Duration,
    /// Longest time without an event of a busy controller that answers.
    pub silence: Duration,
    /// Signals that the operator wants the run to end.
    pub interrupt: Interrupt,
}

impl Default for ClientSettings {
    /// Answer: 250 ms, a hundred times a frame's time on the wire. Stall and unanswered: 2 s; threads of a busy host wait for a
    /// tenth of that. Silence: 15 s, the longest move by a plan's timeouts, and a margin.
    fn default() -> Self {
        Self {
            answer: Duration::from_millis(250),
            heartbeat: None,
            stall: Some(Duration::from_secs(2)),
            unanswered: Duration::from_secs(2),
            silence: Duration::from_secs(15),
            interrupt: Interrupt::never(),
        }
    }
}

/// Why the controller cannot be used. Link errors, refusals and invalid replies are told apart.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// The link failed.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// Neither commands nor heartbeats are answered.
    #[error(
        "the port answers nothing for {waited_ms} ms (is it the controller's port, is the firmware running?)"
    )]
    Silent {
        /// Longest wait for an answer, ms.
        waited_ms: u128,
    },
    #[error(
        "bytes come from the port, but no answer: {damaged} damaged messages in {waited_ms} ms (another speed, another device, or noise on the line?)"
    )]
    Noise {
        /// Messages that could not be read.
        damaged: u64,
        /// Longest wait for an answer, ms.
        waited_ms: u128,
    },
    /// The controller refused the command.
    #[error("the controller refuses: {0}")]
    Refused(#[from] Refusal),
    /// The reply is of another kind than the command expects.
    #[error("the controller gave an answer that does not fit the command")]
    Unfitting,
    /// Protocol versions differ.
    #[error(
        "the controller speaks protocol {controller} (layout {controller_schema:#010x}), this host {host} (layout {host_schema:#010x}): install matching releases"
    )]
    Version {
        /// Controller's version.
        controller: u32,
        /// Controller's layout.
        controller_schema: u32,
        /// Host's version.
        host: u32,
        /// Host's layout.
        host_schema: u32,
    },
    /// An event is missing from the record.
    #[error("{missing} event(s) before number {sequence} are missing")]
    EventsMissing {
        missing: u16,
        /// Number of the event after the gap.
        sequence: u16,
    },
    /// An event was received twice, or after a later one.
    #[error(
        "event number {sequence} came after number {last}: it was doubled on the line, or is of another controller"
    )]
    EventRepeated {
        sequence: u16,
        /// Number of the latest event before it.
        last: u16,
    },
    /// No event within the time allowed.
    #[error("no event within {timeout_ms} ms")]
    NoEvent {
        /// Longest wait, ms.
        timeout_ms: u128,
    },
}

/// A session with the controller.
#[derive(Debug)]
pub struct Client {
    link: Link,
    settings: ClientSettings,
    identity: Identity,
    session: u32,
    sequence: u16,
    heartbeat: Duration,
    next_heartbeat: Instant,
    events: VecDeque<Event>,
    /// Number of the latest event; those of a session count from 1.
    last_event: u16,
    /// Time waited since the controller was last heard.
    unheard: Duration,
    /// Frames that arrived damaged since the last answer.
    dropped_unheard: u64,
}

impl Client {
    /// Opens the port and says hello.
    ///
    /// # Errors
    /// No port, no answer, or a controller of another version.
    pub async fn connect(port: &Path, settings: ClientSettings) -> Result<Self, ClientError> {
        let link = Link::open(port)?;
        // A session number that an earlier run of the host is unlikely to have used: replies to its commands are then
        // told from replies to ours.
        let session = flankscope_frames::monotonic_ns() as u32 | 1;
        let mut client = Self {
            link,
            identity: Identity {
                protocol: PROTOCOL_VERSION,
                schema: SCHEMA_HASH,
                firmware: [0; 3],
                limits: flankscope_protocol::Limits::DEFAULT,
                host_silence: flankscope_protocol::Microseconds(0),
                verdict_life: flankscope_protocol::Microseconds(0),
                boot: flankscope_protocol::message::Boot::PowerUp,
                lens: false,
                projectors: 1,
            },
            session,
            sequence: 0,
            heartbeat: settings.answer,
            next_heartbeat: Instant::now() + settings.answer,
            settings,
            events: VecDeque::new(),
            last_event: 0,
            unheard: Duration::ZERO,
            dropped_unheard: 0,
        };
        let hello = Command::Hello {
            protocol: PROTOCOL_VERSION,
            schema: SCHEMA_HASH,
        };
        client.identity = match client.request(&hello).await {
            Ok(Reply::Hello(identity)) => identity,
            Ok(_) => return Err(ClientError::Unfitting),
            Err(ClientError::Refused(Refusal::ProtocolVersion { want, .. })) => {
                return Err(version_error(want, SCHEMA_HASH));
            }
            Err(ClientError::Refused(Refusal::SchemaHash { want, .. })) => {
                return Err(version_error(PROTOCOL_VERSION, want));
            }
            Err(error) => return Err(error),
        };
        if (client.identity.protocol, client.identity.schema) != (PROTOCOL_VERSION, SCHEMA_HASH) {
            return Err(version_error(
                client.identity.protocol,
                client.identity.schema,
            ));
        }
        let allowed = Duration::from_micros(u64::from(client.identity.host_silence.get()));
        client.heartbeat = client
            .settings
            .heartbeat
            .unwrap_or(allowed / 3)
            // Several of them must be lost before the link counts as lost.
            .min(client.settings.unanswered / 4)
            .max(Duration::from_millis(1));
        client.next_heartbeat = Instant::now() + client.heartbeat;
        Ok(client)
    }

    /// Identity and limits that the controller reported.
    pub fn identity(&self) -> &Identity {
        &self.identity
    }

    /// Sends a command that is answered by "accepted".
    ///
    /// # Errors
    /// Refused, or no answer.
    pub async fn order(&mut self, command: &Command) -> Result<(), ClientError> {
        match self.request(command).await? {
            Reply::Accepted => Ok(()),
            _ => Err(ClientError::Unfitting),
        }
    }

    /// Sends the configuration of the stages; from here on the controller checks plans against their travel.
    ///
    /// # Errors
    /// The controller refuses them, or no answer.
    pub async fn configure(&mut self, stage: &StageConfig) -> Result<(), ClientError> {
        let command = Command::ConfigureStage {
            version: STAGE_CONFIG_VERSION,
            stage: *stage,
        };
        self.order(&command).await?;
        self.identity.limits = self.identity.limits.within(stage);
        Ok(())
    }

    /// Models that the stages report, rotation and vertical; nothing moves. Needs [`Client::configure`] before.
    ///
    /// # Errors
    /// Refused, or no answer of the controller.
    pub async fn identify_stages(
        &mut self,
    ) -> Result<[Result<StageName, FaultCode>; 2], ClientError> {
        /// More than the time that both axes may take to answer.
        const PATIENCE: Duration = Duration::from_secs(3);
        self.order(&Command::IdentifyStages).await?;
        let mut answers = Vec::new();
        loop {
            if let Event::StageIdentity { answer, .. } = self.event(PATIENCE).await? {
                answers.push(answer);
            }
            if let [rotation, vertical] = answers[..] {
                return Ok([rotation, vertical]);
            }
        }
    }

    /// Present state of the controller.
    ///
    /// # Errors
    /// No answer.
    pub async fn status(&mut self) -> Result<Status, ClientError> {
        match self.request(&Command::Status).await? {
            Reply::Status(status) => Ok(status),
            _ => Err(ClientError::Unfitting),
        }
    }

    /// Signals that the operator wants the run to end.
    pub fn interrupt(&self) -> Interrupt {
        self.settings.interrupt.clone()
    }

    /// Longest silence before the link counts as lost.
    pub fn silence(&self) -> Duration {
        self.settings.silence
    }

    /// Largest delay allowed of triggers and frames; `None` if the controller's clock is not real time.
    pub fn stall_limit(&self) -> Option<Duration> {
        self.settings.stall
    }

    /// The next event, in order; heartbeats go out meanwhile.
    ///
    /// # Errors
    /// None within `patience`, a hole in the events' numbers, or no link.
    pub async fn event(&mut self, patience: Duration) -> Result<Event, ClientError> {
        let end = Instant::now() + patience;
        loop {
            if let Some(event) = self.events.pop_front() {
                return Ok(event);
            }
            if Instant::now() >= self.next_heartbeat {
                // The reply is not waited for: a lost heartbeat is followed by the next one.
                self.sequence = self.sequence.wrapping_add(1);
                self.link.send(self.header(), &Command::Heartbeat)?;
                self.next_heartbeat = Instant::now() + self.heartbeat;
            }
            match self.incoming(end.min(self.next_heartbeat)).await? {
                // Only events are wanted here; of replies to heartbeats, only that they come, and after which event.
                Some(incoming) => {
                    self.sort(incoming)?;
                }
                None if Instant::now() < end => {}
                None => {
                    return Err(ClientError::NoEvent {
                        timeout_ms: patience.as_millis(),
                    });
                }
            }
        }
    }

    /// Drops the events that arrived before the next command.
    pub fn forget_events(&mut self) {
        self.events.clear();
    }

    /// Sends a command until it is answered: a retry repeats the sequence number, so it is never carried out twice.
    async fn request(&mut self, command: &Command) -> Result<Reply, ClientError> {
        self.sequence = self.sequence.wrapping_add(1);
        let header = self.header();
        let answer_ms = self.settings.answer.as_millis().max(1);
        let attempts = self.settings.unanswered.as_millis().div_ceil(answer_ms);
        for attempt in 0..attempts {
            if attempt > 0 {
                tracing::warn!(attempt, ?command, "no answer, sending again");
            }
            self.link.send(header, command)?;
            self.next_heartbeat = Instant::now() + self.heartbeat;
            let end = Instant::now() + self.settings.answer;
            while let Some(incoming) = self.incoming(end).await? {
                match self.sort(incoming)? {
                    Some((ack, Reply::Refused(refusal))) if ack == header.sequence => {
                        return Err(refusal.into());
                    }
                    Some((ack, reply)) if ack == header.sequence => return Ok(reply),
                    _ => {} // an event, or the answer to an earlier heartbeat
                }
            }
        }
        Err(self.silent())
    }

    /// The next message, `None` if none comes before `end`.
    async fn incoming(&mut self, end: Instant) -> Result<Option<Incoming>, ClientError> {
        let planned = end.saturating_duration_since(Instant::now());
        if let Ok(incoming) = timeout_at(end, self.link.receive()).await {
            return Ok(Some(incoming?));
        }
        // Counted as planned: if this host was itself kept from running meanwhile, the controller has not been silent longer.
        self.unheard += planned;
        if self.unheard < self.settings.unanswered {
            Ok(None)
        } else {
            Err(self.silent())
        }
    }

    fn silent(&self) -> ClientError {
        let waited_ms = self.settings.unanswered.as_millis();
        match self.dropped_unheard {
            0 => ClientError::Silent { waited_ms },
            damaged => ClientError::Noise { damaged, waited_ms },
        }
    }

    fn header(&self) -> Header {
        Header {
            session: self.session,
            sequence: self.sequence,
            ack: self.last_event,
        }
    }

    /// Queues events, counts dropped frames, returns replies of this session.
    fn sort(&mut self, incoming: Incoming) -> Result<Option<(u16, Reply)>, ClientError> {
        match incoming {
            Incoming::Reply(header, reply) if header.session == self.session => {
                self.unheard = Duration::ZERO;
                self.dropped_unheard = 0;
                // It names the event before it. Of an earlier answer that came twice, that is an earlier event.
                match header.sequence.wrapping_sub(self.last_event) {
                    0 | BEHIND.. => {}
                    missing => {
                        return Err(ClientError::EventsMissing {
                            missing,
                            sequence: header.sequence.wrapping_add(1),
                        });
                    }
                }
                return Ok(Some((header.ack, reply)));
            }
            Incoming::Reply(..) => {}
            Incoming::Event(header, event) if header.session == self.session => {
                self.unheard = Duration::ZERO;
                self.dropped_unheard = 0;
                let (sequence, last) = (header.sequence, self.last_event);
                match sequence.wrapping_sub(last).wrapping_sub(1) {
                    0 => {}
                    BEHIND.. => return Err(ClientError::EventRepeated { sequence, last }),
                    missing => return Err(ClientError::EventsMissing { missing, sequence }),
                }
                self.last_event = sequence;
                self.events.push_back(event);
            }
            Incoming::Event(..) => {}
            Incoming::Dropped(reason) => {
                self.dropped_unheard += 1;
                tracing::warn!(%reason, "dropped a damaged frame");
            }
            Incoming::Gone(reason) => return Err(LinkError::Gone { reason }.into()),
        }
        Ok(None)
    }
}

fn version_error(controller: u32, controller_schema: u32) -> ClientError {
    ClientError::Version {
        controller,
        controller_schema,
        host: PROTOCOL_VERSION,
        host_schema: SCHEMA_HASH,
    }
}
