//! The controller answers in every interleaving of its thread with others: those that write to its line and those that hold its
//! time.
//!
//! `cargo test -p flankscope-sim --features shuttle --test interleavings`. The scheduler (random, and probabilistic concurrency
//! testing after Burckhardt et al., ASPLOS 2010) switches threads at each lock. Virtual time nearly stands still, and no wait
//! ends by itself: an answer that depended on a deadline, or on a wake that was lost, would never come.

use flankscope_controller::Config;
use flankscope_protocol::{
    Command, Decoder, Header, Kind, MAX_FRAME_BYTES, PROTOCOL_VERSION, SCHEMA_HASH, encode,
};
use flankscope_sim::{Clock, Port, Sim, Wiring, spawn_controller};
use shuttle::thread::{spawn, yield_now};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

const INTERLEAVINGS: usize = 10_000;
const HOLDS: u32 = 6;
/// Virtual seconds per second: no deadline is reached during a test.
const STANDS_STILL: f64 = 1e-9;

/// Opens a session and shows two verdicts, each frame in two pieces as a serial port may deliver it.
fn speak(host: &Port) {
    let hello = Command::Hello {
        protocol: PROTOCOL_VERSION,
        schema: SCHEMA_HASH,
    };
    let verdicts = [true, false].map(|go| Command::ShowVerdict { go });
    let mut decoder = Decoder::new();
    for (sequence, command) in (1..).zip([hello].into_iter().chain(verdicts)) {
        let mut wire = [0; MAX_FRAME_BYTES];
        let header = Header {
            session: 1,
            sequence,
            ack: 0,
        };
        let length = encode(header, &command, &mut wire).expect("fits");
        let (first, second) = wire[..length].split_at(length / 2);
        host.send(first);
        host.send(second);
        while !replied(&mut decoder, &host.take(), sequence) {
            yield_now();
        }
    }
}

fn replied(decoder: &mut Decoder, bytes: &[u8], to: u16) -> bool {
    let mut replied = false;
    for &byte in bytes {
        let Some(frame) = decoder.push(byte) else {
            continue;
        };
        let frame = frame.expect("undamaged");
        replied |= frame.kind() == Kind::Reply && frame.header().ack == to;
    }
    replied
}

fn conversation() {
    let sim = Sim::new(Clock::Paced {
        speed: STANDS_STILL,
    });
    let wiring = Wiring::new(&sim);
    spawn_controller(&sim, &wiring, Config::DEFAULT);
    let (held, woken, host) = (sim.remote(), sim.remote(), wiring.host.clone());
    let over = Arc::new(AtomicBool::new(false));
    let holding = spawn(move || {
        for _ in 0..HOLDS {
            let hold = held.hold();
            yield_now();
            drop(hold);
        }
    });
    let speaking = {
        let over = Arc::clone(&over);
        spawn(move || {
            speak(&host);
            over.store(true, Ordering::Release);
            woken.wake();
        })
    };
    sim.run_until(|| over.load(Ordering::Acquire));
    speaking.join().expect("no panic");
    holding.join().expect("no panic");
}

#[test]
fn every_command_is_answered_whatever_thread_comes_first() {
    shuttle::check_random(conversation, INTERLEAVINGS);
    shuttle::check_pct(conversation, INTERLEAVINGS, 4);
}
