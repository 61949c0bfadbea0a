//! Where orders are judged: hello, plan, state. Pure, like the sequence behind it.

use crate::interlock::{Change, Head, Interlock, Levels, Orders, Phase, VerdictLamp};
use crate::sequence::{Actions, Input, Sequence};
use crate::session::{Judgement, Session};
use flankscope_protocol::message::Boot;
use flankscope_protocol::stage::STAGE_CONFIG_VERSION;
use flankscope_protocol::{
    Command, Header, Identity, PROTOCOL_VERSION, PressStatus, Refusal, Reply, SCHEMA_HASH,
    StageError, State, Timestamp,
};

/// Firmware release, from the package version.
const FIRMWARE: [u8; 3] = [
    number(env!("CARGO_PKG_VERSION_MAJOR")),
    number(env!("CARGO_PKG_VERSION_MINOR")),
    number(env!("CARGO_PKG_VERSION_PATCH")),
];

/// Decimal digits to a number, at compile time.
const fn number(digits: &str) -> u8 {
    let mut rest = digits.as_bytes();
    let mut value = 0u8;
    while let [digit, tail @ ..] = rest {
        value = value * 10 + (*digit - b'0');
        rest = tail;
    }
    value
}

/// What the link knows and a status repeats.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LinkCounts {
    /// Damaged or foreign frames dropped.
    pub frames_dropped: u32,
    /// Events lost to a full queue.
    pub events_lost: u32,
}

/// The sequence together with the session through which a host commands it.
#[derive(Debug, Clone)]
pub struct CommandHandler {
    pub sequence: Sequence,
    /// The press interlock.
    pub interlock: Interlock,
    /// The verdict at the press.
    pub verdict: VerdictLamp,
    /// A lens driver answered at the start.
    pub lens_fitted: bool,
    /// Projectors fitted at the start.
    pub projectors_fitted: u8,
    session: Session,
    /// The stages were accepted in this session.
    configured: bool,
    boot: Boot,
    orders: Orders,
}

impl CommandHandler {
    /// After power-up.
    #[must_use]
    pub fn new(sequence: Sequence, boot: Boot) -> Self {
        let timing = sequence.config().interlock;
        Self {
            sequence,
            interlock: Interlock::new(timing),
            verdict: VerdictLamp::new(timing),
            lens_fitted: false,
            projectors_fitted: 1,
            session: Session::new(),
            configured: false,
            boot,
            orders: Orders::default(),
        }
    }

    /// Samples the inputs from the press, together with what was ordered since the last time.
    pub fn sample_inputs(&mut self, now: Timestamp, levels: Levels) -> Change {
        let retract = self.sequence.state() == State::Retracting;
        let orders = Orders {
            retract,
            ..core::mem::take(&mut self.orders)
        };
        let head: Head = self.sequence.head(now);
        self.interlock.sample_inputs(now, levels, head, orders)
    }

    /// When the sequence, the interlock or the verdict wants to be looked at.
    #[must_use]
    pub fn deadline(&self, now: Timestamp) -> Option<Timestamp> {
        [
            self.sequence.deadline(),
            self.interlock.deadline(now),
            self.verdict.deadline(),
        ]
        .into_iter()
        .flatten()
        .min()
    }

    /// The open link session.
    pub fn session(&self) -> Option<u32> {
        self.session.id()
    }

    /// Handles one frame's command (`None`: whole frame, unreadable payload) and returns the reply to send.
    ///
    /// A repeated command is answered again and not carried out again. Any frame of the open session counts as a sign
    /// of life of the host.
    pub fn handle(
        &mut self,
        now: Timestamp,
        header: Header,
        command: Option<&Command>,
        link: LinkCounts,
        out: &mut Actions,
    ) -> Reply {
        let hello = matches!(command, Some(Command::Hello { .. }));
        match self.session.judge(header, hello) {
            Judgement::Repeat(reply) => {
                self.sequence.step(now, Input::HostAlive, out);
                reply
            }
            Judgement::Refuse(refusal) => {
                // A flood of strangers must not keep the clock from being looked at.
                self.sequence.step(now, Input::Tick, out);
                Reply::Refused(refusal)
            }
            Judgement::Execute => {
                // Time first: what is overdue happens before what is ordered.
                self.sequence.step(now, Input::HostAlive, out);
                let reply = match command {
                    None => Reply::Refused(Refusal::Unreadable),
                    Some(command) => self
                        .execute(now, header, command, link, out)
                        .unwrap_or_else(Reply::Refused),
                };
                self.session.remember(header, &reply);
                reply
            }
        }
    }

    fn execute(
        &mut self,
        now: Timestamp,
        header: Header,
        command: &Command,
        link: LinkCounts,
        out: &mut Actions,
    ) -> Result<Reply, Refusal> {
        let sequence = &mut self.sequence;
        match command {
            Command::Hello { protocol, schema } => {
                self.greet(header, *protocol, *schema)?;
                return Ok(Reply::Hello(self.identity()));
            }
            Command::Status => {
                let mut status = sequence.status(now);
                (status.frames_dropped, status.events_lost) =
                    (link.frames_dropped, link.events_lost);
                status.press = PressStatus {
                    open: self.interlock.press_open(),
                    head_clear: self.interlock.outputs().head_clear,
                    go: self.verdict.lines(now).go,
                    cycles: self.interlock.cycles(),
                };
                return Ok(Reply::Status(status));
            }
            Command::Heartbeat => {}
            Command::Abort => sequence.abort(now, out),
            // A head that another session sent into the die may come out without further words.
            Command::Retract if !self.configured && !sequence.capturing() => {
                return Err(Refusal::NotConfigured);
            }
            Command::Retract => match sequence.state() {
                State::Unhomed => return Err(Refusal::NotHomed),
                State::Faulted if !sequence.homed() => return Err(Refusal::NotHomed),
                _ => sequence.retract(now, out),
            },
            Command::LoadPlan(plan) => {
                match sequence.state() {
                    State::Unhomed | State::Ready | State::Faulted => {}
                    state => return Err(Refusal::Busy { state }),
                }
                plan.validate(&sequence.plan_limits())?;
                if plan.focus.is_some() && !self.lens_fitted {
                    return Err(Refusal::NoLens);
                }
                let (got, fitted) = (plan.projectors, self.projectors_fitted);
                if got > fitted {
                    return Err(Refusal::TooFewProjectors { got, fitted });
                }
                sequence.store(plan.clone());
            }
            Command::Start { .. } | Command::Home | Command::IdentifyStages if !self.configured => {
                return Err(Refusal::NotConfigured);
            }
            Command::IdentifyStages => match sequence.state() {
                State::Unhomed | State::Ready | State::Faulted => sequence.identify(out),
                state => return Err(Refusal::Busy { state }),
            },
            Command::Start { session } => {
                let got = *session;
                match sequence.state() {
                    State::Ready if sequence.must_home() => return Err(Refusal::NotHomed),
                    State::Ready => {}
                    State::Unhomed => return Err(Refusal::NotHomed),
                    State::Faulted => return Err(faulted(sequence)),
                    state => return Err(Refusal::Busy { state }),
                }
                let want = sequence.plan().ok_or(Refusal::NoPlan)?.session;
                if got != want {
                    return Err(Refusal::WrongPlan { got, want });
                }
                if let Some(fault) = self.interlock.objection() {
                    let fault = fault.code();
                    return Err(Refusal::Interlock { fault });
                }
                self.orders.enter = true;
                sequence.start(now, out);
            }
            Command::Home => match sequence.state() {
                State::Unhomed | State::Ready => {
                    // Somebody at the host wants the instrument to work: power-up is over.
                    self.orders.release = true;
                    sequence.home(now, out);
                }
                State::Faulted => return Err(faulted(sequence)),
                state => return Err(Refusal::Busy { state }),
            },
            Command::AcknowledgeFault => {
                self.orders.release |=
                    matches!(self.interlock.state().phase, Phase::Locked(Some(_)));
                sequence.acknowledge(now, out);
            }
            Command::ShowVerdict { go } => self.verdict.show(now, *go),
            Command::ConfigureStage { version, stage } => {
                match sequence.state() {
                    State::Unhomed | State::Ready | State::Faulted => {}
                    state => return Err(Refusal::Busy { state }),
                }
                if *version != STAGE_CONFIG_VERSION {
                    let (got, want) = (*version, STAGE_CONFIG_VERSION);
                    return Err(StageError::Version { got, want }.into());
                }
                stage.validate(&sequence.config().limits)?;
                sequence.configure(stage);
                self.configured = true;
            }
        }
        Ok(Reply::Accepted)
    }

    fn greet(&mut self, header: Header, protocol: u32, schema: u32) -> Result<(), Refusal> {
        if protocol != PROTOCOL_VERSION {
            return Err(Refusal::ProtocolVersion {
                got: protocol,
                want: PROTOCOL_VERSION,
            });
        }
        if schema != SCHEMA_HASH {
            return Err(Refusal::SchemaHash {
                got: schema,
                want: SCHEMA_HASH,
            });
        }
        self.session.open(header);
        self.configured = false;
        Ok(())
    }

    fn identity(&self) -> Identity {
        let config = self.sequence.config();
        Identity {
            protocol: PROTOCOL_VERSION,
            schema: SCHEMA_HASH,
            firmware: FIRMWARE,
            limits: config.limits,
            host_silence: config.host_silence,
            verdict_life: config.interlock.verdict_life,
            boot: self.boot,
            lens: self.lens_fitted,
            projectors: self.projectors_fitted,
        }
    }
}

fn faulted(sequence: &Sequence) -> Refusal {
    let fault = sequence
        .fault()
        .unwrap_or(flankscope_protocol::Fault::OutOfStep);
    Refusal::Faulted {
        fault: fault.code(),
    }
}
