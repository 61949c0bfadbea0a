//! A host inside the simulation, and a sink that only notes what was exposed.
#![allow(dead_code)] // each test binary uses its part

pub mod script;

use embassy_futures::select::{Either, select};
use embassy_time::{Duration, Instant, Timer};
use embedded_io_async::{Read, Write};
use flankscope_bench::devices::{Exposure, ExposureSink, Lost, TruePose};
use flankscope_protocol::*;
use flankscope_sim::Port;
use std::cell::RefCell;
use std::rc::Rc;

/// The order that says which stages these are.
pub fn stages() -> Command {
    Command::ConfigureStage {
        version: flankscope_protocol::stage::STAGE_CONFIG_VERSION,
        stage: StageConfig::DEFAULT,
    }
}

/// `insitu12` at two exposures, three views.
pub fn plan() -> CapturePlan {
    CapturePlan {
        session: 5,
        views: [0, 74_800, 149_600]
            .map(|rotation| View {
                rotation: Microradians(rotation),
                vertical: Micrometres(33_000),
            })
            .into_iter()
            .collect(),
        exposures: [10_000, 30_000].map(Microseconds).into_iter().collect(),
        fringes: [
            FringeSet {
                periods: 4,
                steps: 4,
            },
            FringeSet {
                periods: 48,
                steps: 8,
            },
        ]
        .into_iter()
        .collect(),
        led: Milliamps(700),
        settle: Microseconds(50_000),
        dmd_settle: Microseconds(300),
        camera_readout: Microseconds(12_500),
        retract: Micrometres(100_000),
        timeouts: Timeouts::default(),
        focus: None,
        projectors: 1,
    }
}

/// What the camera did.
#[derive(Debug, Clone, Default)]
pub struct Notes {
    pub exposures: Vec<Exposure>,
    pub read_out: Vec<(u32, u64)>,
    pub lost: Vec<(u32, Lost)>,
    pub destinations: Vec<TruePose>,
    pub focused: Vec<Option<u16>>,
}

impl Notes {
    /// Destinations other than where the stages stood when the controller, at its start, stopped them.
    pub fn moves(&self) -> usize {
        let stood = self.destinations.first();
        self.destinations
            .iter()
            .filter(|to| Some(*to) != stood)
            .count()
    }
}

#[derive(Clone, Default)]
pub struct Notebook(pub Rc<RefCell<Notes>>);

impl ExposureSink for Notebook {
    fn moving_to(&mut self, pose: TruePose) {
        self.0.borrow_mut().destinations.push(pose);
    }
    fn focused(&mut self, counts: Option<u16>) {
        self.0.borrow_mut().focused.push(counts);
    }
    fn exposed(&mut self, exposure: Exposure) {
        self.0.borrow_mut().exposures.push(exposure);
    }
    fn read_out(&mut self, counter: u32) {
        self.0
            .borrow_mut()
            .read_out
            .push((counter, flankscope_sim::now_us()));
    }
    fn lost(&mut self, counter: u32, why: Lost) {
        self.0.borrow_mut().lost.push((counter, why));
    }
}

/// A host on the far end of the in-memory UART.
pub struct Host {
    port: Port,
    decoder: Decoder,
    sequence: u16,
    /// Every event received, with its sequence number.
    pub events: Vec<(u16, Event)>,
    /// The controller was reset: the end of a frame that this cut off may still be on its way.
    cut_off: bool,
}

const SESSION: u32 = 0xC0FFEE;
const HEARTBEAT: Duration = Duration::from_millis(30);

impl Host {
    pub fn new(port: Port) -> Self {
        Self {
            port,
            decoder: Decoder::new(),
            sequence: 0,
            events: Vec::new(),
            cut_off: false,
        }
    }

    /// Sends a frame as it is.
    pub async fn send(&mut self, session: u32, sequence: u16, command: &Command) {
        let wire = Self::wire(session, sequence, command);
        self.port.write_all(&wire).await.expect("in memory");
    }

    fn wire(session: u32, sequence: u16, command: &Command) -> Vec<u8> {
        let header = Header {
            session,
            sequence,
            ack: 0,
        };
        let mut wire = [0; MAX_FRAME_BYTES];
        let length = encode(header, command, &mut wire).expect("fits");
        wire[..length].to_vec()
    }

    /// Sends a new command and waits for its reply.
    pub async fn order(&mut self, command: Command) -> Reply {
        self.sequence = self.sequence.wrapping_add(1);
        let sequence = self.sequence;
        self.send(SESSION, sequence, &command).await;
        loop {
            let damaged = self.cut_off;
            for reply in self.receive().await {
                if let (ack, reply) = reply
                    && ack == sequence
                {
                    return reply;
                }
            }
            if damaged && !self.cut_off {
                // The reply may have been what the cut frame ran into: a host asks again.
                self.send(SESSION, sequence, &command).await;
            }
        }
    }

    /// Waits for bytes and returns the replies in them; events are kept.
    pub async fn receive(&mut self) -> Vec<(u16, Reply)> {
        let mut bytes = [0; 256];
        let count = self.port.read(&mut bytes).await.expect("in memory");
        let mut replies = Vec::new();
        for &byte in &bytes[..count] {
            let Some(frame) = self.decoder.push(byte) else {
                continue;
            };
            let frame = match frame {
                Ok(frame) => frame,
                Err(_) if self.cut_off => {
                    self.cut_off = false;
                    continue;
                }
                Err(error) => panic!("a damaged frame: {error}"),
            };
            match frame.kind() {
                Kind::Reply => {
                    replies.push((frame.header().ack, frame.message().expect("a reply")))
                }
                Kind::Event => self
                    .events
                    .push((frame.header().sequence, frame.message().expect("an event"))),
                Kind::Command => panic!("the controller gave an order"),
            }
        }
        replies
    }

    /// Hello, stages, home, load.
    pub async fn prepare(&mut self, plan: CapturePlan) {
        let hello = Command::Hello {
            protocol: PROTOCOL_VERSION,
            schema: SCHEMA_HASH,
        };
        let Reply::Hello(_) = self.order(hello).await else {
            panic!("refused")
        };
        assert_eq!(self.order(stages()).await, Reply::Accepted);
        assert_eq!(self.order(Command::Home).await, Reply::Accepted);
        self.until(|event| {
            matches!(
                event,
                Event::StateChanged {
                    next: State::Ready,
                    ..
                }
            )
        })
        .await;
        assert_eq!(self.order(Command::LoadPlan(plan)).await, Reply::Accepted);
    }

    /// Sends a new command without waiting for its reply.
    pub async fn tell(&mut self, command: &Command) {
        self.sequence = self.sequence.wrapping_add(1);
        self.send(SESSION, self.sequence, command).await;
    }

    /// Sends the first half of a command's frame.
    pub async fn tell_in_part(&mut self, command: &Command) {
        self.sequence = self.sequence.wrapping_add(1);
        let wire = Self::wire(SESSION, self.sequence, command);
        self.scribble(&wire[..wire.len() / 2]);
    }

    /// Sends the last command again, under the same number.
    pub async fn repeat(&mut self, command: &Command, times: u32) {
        for _ in 0..times {
            self.send(SESSION, self.sequence, command).await;
        }
    }

    /// Sends bytes as they are.
    pub fn scribble(&mut self, bytes: &[u8]) {
        self.port.send(bytes);
    }

    /// Takes what arrives for a while; replies are dropped.
    pub async fn listen(&mut self, time_ms: u64) {
        let end = Instant::now() + Duration::from_millis(time_ms);
        while let Either::First(_) = select(self.receive(), Timer::at(end)).await {}
    }

    /// Forgets what arrived in part before a reset; what arrives of it later may damage one frame.
    pub fn forget(&mut self) {
        let _bytes = self.port.take();
        self.decoder = Decoder::new();
        self.cut_off = true;
    }

    /// Sends heartbeats for a while, whether they are answered or not.
    pub async fn keep_company(&mut self, time_ms: u64) {
        let end = Instant::now() + Duration::from_millis(time_ms);
        while Instant::now() < end {
            self.sequence = self.sequence.wrapping_add(1);
            self.send(SESSION, self.sequence, &Command::Heartbeat).await;
            let next = end.min(Instant::now() + HEARTBEAT);
            while let Either::First(_) = select(self.receive(), Timer::at(next)).await {}
        }
    }

    /// Keeps the controller company until an event.
    pub async fn until(&mut self, last: impl Fn(&Event) -> bool) {
        let mut seen = self.events.len();
        let mut heartbeat = Instant::now();
        loop {
            if let Either::Second(()) = select(self.receive(), Timer::at(heartbeat)).await {
                heartbeat += HEARTBEAT;
                self.order(Command::Heartbeat).await;
            }
            if self.events[seen..].iter().any(|(_, event)| last(event)) {
                return;
            }
            seen = self.events.len();
        }
    }
}
