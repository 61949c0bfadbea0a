//! The instrument behind a real pseudo-terminal, driven the way a host drives hardware.

mod common;

use flankscope_bench::devices::{Exposure, ExposureSink, InstrumentConfig, run};
use flankscope_instrument::controller::{Client, ClientSettings};
use flankscope_protocol::*;
use std::io::{Read, Write};
use std::sync::mpsc::{Sender, channel};
use std::time::Duration;

struct Counted(Sender<Exposure>);

impl ExposureSink for Counted {
    fn exposed(&mut self, exposure: Exposure) {
        let _listener = self.0.send(exposure);
    }
}

#[test]
fn a_host_captures_a_view_through_a_serial_port() {
    capture(InstrumentConfig::paced(20.0));
}

#[test]
fn a_host_captures_a_view_as_fast_as_possible() {
    capture(InstrumentConfig::unpaced());
}

fn capture(config: InstrumentConfig) {
    let (sender, exposures) = channel();
    let instrument = run(config, Counted(sender)).expect("a pseudo-terminal");
    let path = instrument.port().to_string_lossy().into_owned();
    let mut port = serialport::new(path, Line::HOST.baud)
        .timeout(Duration::from_secs(5))
        .open()
        .expect("the port opens");

    let mut plan = common::plan();
    plan.views.truncate(1);
    plan.exposures.truncate(1);
    let commands = [
        Command::Hello {
            protocol: PROTOCOL_VERSION,
            schema: SCHEMA_HASH,
        },
        common::stages(),
        Command::Home,
        Command::LoadPlan(plan),
        Command::Start { session: 5 },
    ];
    let mut decoder = Decoder::new();
    let mut triggered = Vec::new();
    for (n, command) in commands.iter().enumerate() {
        let mut wire = [0; MAX_FRAME_BYTES];
        let header = Header {
            session: 1,
            sequence: n as u16 + 1,
            ack: 0,
        };
        let length = encode(header, command, &mut wire).expect("fits");
        port.write_all(&wire[..length]).expect("written");
        let (mut replied, mut done) = (false, false);
        while !(replied && done) {
            let mut byte = [0];
            port.read_exact(&mut byte).expect("an answer in time");
            let Some(frame) = decoder.push(byte[0]) else {
                continue;
            };
            let frame = frame.expect("undamaged");
            if frame.kind() == Kind::Reply {
                let reply: Reply = frame.message().expect("a reply");
                assert!(
                    !matches!(reply, Reply::Refused(_)),
                    "{command:?}: {reply:?}"
                );
                replied = true;
                // Home and start are done when an event says so.
                done = !matches!(command, Command::Home | Command::Start { .. });
                continue;
            }
            match frame.message().expect("an event") {
                Event::StateChanged {
                    prev: State::Homing,
                    next: State::Ready,
                    ..
                }
                | Event::CaptureDone { .. } => {
                    done = true;
                }
                Event::Triggered(trigger) => triggered.push(trigger),
                Event::Fault { fault, .. } => panic!("{fault}"),
                _ => {}
            }
        }
    }
    let outcome = instrument.stop().expect("no panic");
    let exposures: Vec<_> = exposures.iter().collect();
    assert_eq!((triggered.len(), exposures.len()), (13, 13));
    // Pulses keep their width to the microsecond, however the host's scheduler treats the simulation.
    for exposure in exposures {
        assert_eq!(exposure.end_us - exposure.start_us, 10_000);
    }
    println!("{:?}", outcome.pace);
    assert!(outcome.pace.virtual_us > 1_000_000);
}

#[test]
fn held_time_is_counted_and_does_not_pass_for_the_instrument() {
    struct Slow(Option<flankscope_sim::Remote>);
    impl ExposureSink for Slow {
        fn attach(&mut self, remote: flankscope_sim::Remote) {
            self.0 = Some(remote);
        }
        fn exposed(&mut self, _: Exposure) {}
    }
    let config = InstrumentConfig::paced(1.0);
    let instrument = run(config, Slow(None)).expect("a pseudo-terminal");
    let began = std::time::Instant::now();
    let hold = instrument.remote().hold();
    std::thread::sleep(Duration::from_millis(50));
    drop(hold);
    let total = began.elapsed();
    let outcome = instrument.stop().expect("no panic");
    assert!(
        outcome.pace.held >= Duration::from_millis(50) && outcome.pace.held <= total,
        "{:?}",
        outcome.pace
    );
}

/// Rendering takes longer than the host waits for an answer, and begins while the controller selects the next pattern.
#[test]
fn the_controller_answers_while_time_is_held() {
    struct Renders(Option<flankscope_sim::Remote>);
    impl ExposureSink for Renders {
        fn attach(&mut self, remote: flankscope_sim::Remote) {
            self.0 = Some(remote);
        }
        fn exposed(&mut self, exposure: Exposure) {
            let hold = self.0.as_ref().filter(|_| exposure.counter == 3);
            if let Some(hold) = hold.map(flankscope_sim::Remote::hold) {
                std::thread::spawn(move || {
                    std::thread::sleep(Duration::from_secs(3));
                    drop(hold);
                });
            }
        }
    }
    let instrument = run(InstrumentConfig::paced(1.0), Renders(None)).expect("a pseudo-terminal");
    let mut plan = common::plan();
    plan.views.truncate(1);
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .expect("a runtime");
    let captured = runtime.block_on(async {
        let mut client = Client::connect(instrument.port(), ClientSettings::default()).await?;
        client.configure(&StageConfig::DEFAULT).await?;
        for (order, last) in [(Command::Home, State::Ready), (Command::LoadPlan(plan), State::Ready), (Command::Start { session: 5 }, State::Retracting)] {
            let waits = !matches!(order, Command::LoadPlan(_));
            client.order(&order).await?;
            while waits
                && !matches!(client.event(Duration::from_secs(20)).await?, Event::StateChanged { next, .. } if next == last)
            {}
        }
        client.status().await
    });
    captured.expect("never silent");
    let outcome = instrument.stop().expect("no panic");
    assert!(
        outcome.pace.held > Duration::from_millis(2900),
        "{:?}",
        outcome.pace
    );
}
