//! Commands over a bad line: whatever the channel does, each command is carried out once or the host learns that it
//! may not have been.
//!
//! ```text
//! host: command, at most 3 retries ──► channel ──► Decoder ► CommandHandler (the controller's judge) ──► reply
//!       ◄───────────────────────────── channel ◄─────────────────────────────────────────────┘
//! channel: flips, drops, repeats, swaps, cuts and joins frames, adds junk
//! ```
//! Ten million frames, or `LINK_FRAMES`; `-- --nocapture` prints the counts.

use flankscope_controller::command_handler::LinkCounts;
use flankscope_controller::sequence::{Actions, Config};
use flankscope_controller::{CommandHandler, Sequence};
use flankscope_protocol::message::Boot;
use flankscope_protocol::{
    CapturePlan, Command, Decoder, FringeSet, Header, Kind, MAX_FRAME_BYTES, Micrometres,
    Microradians, Microseconds, Milliamps, PROTOCOL_VERSION, Reply, SCHEMA_HASH, Timeouts,
    Timestamp, View, encode,
};
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::collections::VecDeque;

/// Retries of one command after the first try, as the host's client makes them.
const RETRIES: u32 = 3;
const SESSION: u32 = 0xBAD_11E5;

#[derive(Debug, Default)]
struct Counts {
    sent: u64,
    flipped: u64,
    dropped: u64,
    repeated: u64,
    swapped: u64,
    cut: u64,
    joined_junk: u64,
    received_whole: u64,
    refused_by_the_decoder: u64,
    commands: u64,
    carried_out: u64,
    retries: u64,
    faults: u64,
    faults_carried_out: u64,
    longest_resync_frames: u64,
}

/// One direction of the line.
#[derive(Default)]
struct Channel {
    /// Frames still to arrive; a swap lets a later one overtake.
    in_flight: VecDeque<Vec<u8>>,
}

impl Channel {
    /// Sends one frame; returns what arrives.
    fn send(&mut self, frame: &[u8], random: &mut Pcg64Mcg, counts: &mut Counts) -> Vec<u8> {
        counts.sent += 1;
        let mut wire = frame.to_vec();
        match random.random_range(0..100u32) {
            0..=7 => {
                counts.flipped += 1;
                for _ in 0..random.random_range(1..=8) {
                    let bit = random.random_range(0..wire.len() * 8);
                    wire[bit / 8] ^= 1 << (bit % 8);
                }
            }
            8..=13 => {
                counts.dropped += 1;
                wire.clear();
            }
            14..=19 => {
                counts.repeated += 1;
                for _ in 0..random.random_range(1..=3) {
                    wire.extend_from_slice(frame);
                }
            }
            20..=24 => {
                counts.swapped += 1;
                self.in_flight.push_back(core::mem::take(&mut wire));
                self.in_flight.rotate_right(1);
                self.in_flight[0] = frame.to_vec();
            }
            25..=29 => {
                counts.cut += 1;
                let kept = random.random_range(0..wire.len());
                if random.random_bool(0.5) {
                    wire.truncate(kept);
                } else {
                    wire.drain(..kept);
                }
            }
            30..=33 => {
                counts.joined_junk += 1;
                let mut junk = vec![0; random.random_range(1..600)];
                random.fill_bytes(&mut junk);
                if random.random_bool(0.5) {
                    junk.extend_from_slice(&wire);
                    wire = junk;
                } else {
                    wire.extend_from_slice(&junk);
                }
            }
            _ => {}
        }
        // What was held back comes later: behind this frame, or behind one of the next.
        if self.in_flight.len() > 2 || random.random_bool(0.3) {
            for late in self.in_flight.drain(..) {
                wire.extend_from_slice(&late);
            }
        }
        wire
    }
}

fn frame<M: flankscope_protocol::Message>(sequence: u16, ack: u16, message: &M) -> Vec<u8> {
    let header = Header {
        session: SESSION,
        sequence,
        ack,
    };
    let mut wire = [0; MAX_FRAME_BYTES];
    let length = encode(header, message, &mut wire).expect("fits");
    wire[..length].to_vec()
}

/// A plan that carries the command's number, so that what was carried out names the command it came from.
fn plan(number: u32) -> CapturePlan {
    CapturePlan {
        session: number,
        views: [View {
            rotation: Microradians(0),
            vertical: Micrometres(33_000),
        }]
        .into_iter()
        .collect(),
        exposures: [Microseconds(10_000)].into_iter().collect(),
        fringes: [FringeSet {
            periods: 4,
            steps: 4,
        }]
        .into_iter()
        .collect(),
        led: Milliamps(700),
        settle: Microseconds(0),
        dmd_settle: Microseconds(0),
        camera_readout: Microseconds(12_500),
        retract: Micrometres(100_000),
        timeouts: Timeouts::default(),
        focus: None,
        projectors: 1,
    }
}

/// The controller behind the channel: the real decoder and the real judge.
struct Controller {
    handler: CommandHandler,
    decoder: Decoder,
    /// Plans as they were stored, in order: one entry per execution.
    stored: Vec<u32>,
}

impl Controller {
    fn new() -> Self {
        let mut controller = Self {
            handler: CommandHandler::new(Sequence::new(Config::DEFAULT), Boot::PowerUp),
            decoder: Decoder::new(),
            stored: Vec::new(),
        };
        let hello = Command::Hello {
            protocol: PROTOCOL_VERSION,
            schema: SCHEMA_HASH,
        };
        assert_eq!(
            controller
                .receive(&frame(0, 0, &hello), &mut Counts::default())
                .len(),
            1
        );
        controller
    }

    /// Bytes in, replies out.
    fn receive(&mut self, wire: &[u8], counts: &mut Counts) -> Vec<Vec<u8>> {
        let mut replies = Vec::new();
        for &byte in wire {
            let (header, command) = match self.decoder.push(byte) {
                None => continue,
                Some(Ok(frame)) if frame.kind() == Kind::Command => {
                    counts.received_whole += 1;
                    (frame.header(), frame.message::<Command>().ok())
                }
                Some(_) => {
                    counts.refused_by_the_decoder += 1;
                    continue;
                }
            };
            let before = self.handler.sequence.plan().map(|plan| plan.session);
            let mut out = Actions::new();
            let link = LinkCounts::default();
            let reply = self
                .handler
                .handle(Timestamp(1), header, command.as_ref(), link, &mut out);
            let after = self.handler.sequence.plan().map(|plan| plan.session);
            if let Some(number) = after.filter(|_| after != before) {
                self.stored.push(number);
            }
            replies.push(frame(0, header.sequence, &reply));
        }
        replies
    }
}

fn campaign(frames: u64, seed: u64) -> Counts {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut counts = Counts::default();
    let mut controller = Controller::new();
    let (mut there, mut back) = (Channel::default(), Channel::default());
    let mut host = Decoder::new();
    let mut since_damage = 0;
    let mut number = 0u32;
    while counts.sent < frames {
        // Every plan's number is new, and differs from what is stored.
        number += 1;
        let sequence = number as u16;
        counts.commands += 1;
        let command = frame(sequence, 0, &Command::LoadPlan(plan(number)));
        let mut answered = false;
        let begun = controller.stored.len();
        for attempt in 0..=RETRIES {
            counts.retries += u64::from(attempt > 0);
            let wire = there.send(&command, &mut random, &mut counts);
            // In step again: a frame that came through untouched is never lost to what came before it.
            let untouched = wire == command;
            let whole = counts.received_whole;
            let mut arrived = Vec::new();
            for reply in controller.receive(&wire, &mut counts) {
                arrived.extend(back.send(&reply, &mut random, &mut counts));
            }
            if untouched {
                since_damage += u64::from(counts.received_whole == whole);
                counts.longest_resync_frames = counts.longest_resync_frames.max(since_damage);
                if counts.received_whole > whole {
                    since_damage = 0;
                }
            }
            for byte in arrived {
                if let Some(Ok(frame)) = host.push(byte)
                    && frame.header().ack == sequence
                    && frame.header().session == SESSION
                    && let Ok(reply) = frame.message::<Reply>()
                {
                    assert_eq!(reply, Reply::Accepted, "command {number}");
                    answered = true;
                }
            }
            if answered {
                break;
            }
        }
        if !answered {
            // Given up: whether it was carried out is not known, and nothing else is said before the line is empty.
            // (A bare delimiter ends a frame that lacks nothing but its end.)
            let mut late: Vec<u8> = there.in_flight.drain(..).flatten().collect();
            late.push(0);
            controller.receive(&late, &mut counts);
        }
        let done = &controller.stored[begun..];
        // At most this command, at most once. Nothing older, nothing that nobody sent.
        assert!(
            done.is_empty() || *done == [number],
            "{done:?} instead of {number}"
        );
        counts.carried_out += done.len() as u64;
        if answered {
            assert_eq!(*done, [number], "accepted but not carried out");
        } else {
            counts.faults += 1;
            counts.faults_carried_out += done.len() as u64;
        }
        controller.stored.clear();
    }
    counts
}

fn frames() -> u64 {
    std::env::var("LINK_FRAMES")
        .ok()
        .and_then(|text| text.parse().ok())
        .unwrap_or(10_000_000)
}

#[test]
fn no_wrong_command_is_carried_out_and_none_twice() {
    let counts = campaign(frames(), 31);
    println!("{counts:#?}");
    // The decoder opens with a delimiter: at most the frame that is joined to a damaged one is lost.
    assert!(counts.longest_resync_frames <= 1);
    // Each kind of damage was really done.
    for (kind, count) in [
        ("flipped", counts.flipped),
        ("dropped", counts.dropped),
        ("repeated", counts.repeated),
        ("swapped", counts.swapped),
        ("cut", counts.cut),
        ("junk", counts.joined_junk),
        ("refused", counts.refused_by_the_decoder),
        ("retries", counts.retries),
        ("faults", counts.faults),
    ] {
        assert!(count > 100, "{kind}: {count}");
    }
    assert!(counts.retries <= u64::from(RETRIES) * counts.commands);
}

/// The channel is seeded: the same numbers come out.
#[test]
fn the_same_seed_has_the_same_counts() {
    assert_eq!(
        format!("{:?}", campaign(5_000, 7)),
        format!("{:?}", campaign(5_000, 7))
    );
}
