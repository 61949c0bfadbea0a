//! A scripted controller behind a pseudo-terminal: what the host waits for, and for how long.

use std::io::{Read, Write};
use std::path::PathBuf;
use std::time::{Duration, Instant};

use flankscope_instrument::controller::{Client, ClientError, ClientSettings};
use flankscope_protocol::{
    Command, Decoder, Event, Header, Identity, Limits, MAX_FRAME_BYTES, Message, Microseconds,
    PROTOCOL_VERSION, Reply, SCHEMA_HASH, Timestamp, encode, message::Boot,
};
use serialport::{SerialPort, TTYPort};

/// What the controller sends for a command: the number of the event before a reply.
#[derive(Clone, Copy)]
enum Says {
    Reply(u16),
    Event(u16),
    /// Of another session.
    Foreign(u16),
}

/// A controller that says hello, and then what `script` says to each command. Its port ends with the thread.
fn controller(mut script: impl FnMut(Command) -> Vec<Says> + Send + 'static) -> PathBuf {
    let (mut master, slave) = TTYPort::pair().unwrap();
    let path = slave.name().unwrap().into();
    std::thread::spawn(move || {
        let _open_while_nobody_has_opened_it = slave;
        master.set_timeout(Duration::from_secs(30)).unwrap();
        let mut decoder = Decoder::new();
        let mut byte = [0];
        while master.read_exact(&mut byte).is_ok() {
            let Some(Ok(frame)) = decoder.push(byte[0]) else {
                continue;
            };
            let (to, command) = (frame.header(), frame.message::<Command>().unwrap());
            let mut send = |says: Says, hello: bool| {
                let header = |sequence| Header {
                    sequence,
                    ack: to.sequence,
                    ..to
                };
                let wire = match says {
                    Says::Reply(sequence) if hello => wire(header(sequence), &hello_reply()),
                    Says::Reply(sequence) => wire(header(sequence), &Reply::Accepted),
                    Says::Event(sequence) | Says::Foreign(sequence) => wire(
                        Header {
                            session: to.session ^ u32::from(matches!(says, Says::Foreign(_))) << 1,
                            ..header(sequence)
                        },
                        &Event::Cycle {
                            count: 1,
                            at: Timestamp(0),
                        },
                    ),
                };
                let _host_has_gone = master.write_all(&wire);
            };
            if matches!(command, Command::Hello { .. }) {
                send(Says::Reply(0), true);
            } else {
                script(command)
                    .into_iter()
                    .for_each(|says| send(says, false));
            }
        }
    });
    path
}

fn hello_reply() -> Reply {
    Reply::Hello(Identity {
        protocol: PROTOCOL_VERSION,
        schema: SCHEMA_HASH,
        firmware: [0; 3],
        limits: Limits::DEFAULT,
        host_silence: Microseconds(300_000),
        verdict_life: Microseconds(1_000_000),
        boot: Boot::PowerUp,
        lens: false,
        projectors: 1,
    })
}

fn wire(header: Header, message: &impl Message) -> Vec<u8> {
    let mut wire = [0; MAX_FRAME_BYTES];
    let length = encode(header, message, &mut wire).unwrap();
    wire[..length].to_vec()
}

/// What becomes of a client's command and its wait for an event, and how long both took.
fn outcome(
    port: PathBuf,
    command: Option<Command>,
    patience: Duration,
) -> (Result<Event, ClientError>, Duration) {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    runtime.block_on(async {
        let mut client = Client::connect(&port, ClientSettings::default())
            .await
            .unwrap();
        let begun = Instant::now();
        let result = async {
            if let Some(command) = command {
                client.order(&command).await?;
            }
            client.event(patience).await
        };
        (result.await, begun.elapsed())
    })
}

/// Far more than the client should wait, for a busy machine; far less than it used to.
const SOON: Duration = Duration::from_secs(8);

#[test]
fn a_controller_that_answers_no_more_is_given_up_after_two_seconds() {
    for command in [None, Some(Command::Home)] {
        let (result, took) = outcome(controller(|_| vec![]), command, Duration::from_secs(600));
        let error = result.unwrap_err();
        assert!(
            matches!(error, ClientError::Silent { waited_ms: 2000 }),
            "{error}"
        );
        assert!(
            took >= Duration::from_millis(1900) && took < SOON,
            "{took:?}"
        );
    }
}

/// A controller that was kept from running, as a simulated one on a busy machine is, answers late and is still there.
#[test]
fn a_controller_that_stood_still_for_a_second_is_not_lost() {
    let mut stands = true;
    let late = move |_| {
        if core::mem::take(&mut stands) {
            std::thread::sleep(Duration::from_millis(1200));
        }
        vec![Says::Reply(0)]
    };
    let order = Some(Command::ShowVerdict { go: true });
    let (result, took) = outcome(controller(late), order, Duration::from_millis(10));
    assert!(
        matches!(result, Err(ClientError::NoEvent { .. })),
        "{result:?}"
    );
    assert!(took > Duration::from_millis(1200), "{took:?}");
}

#[test]
fn a_last_event_that_was_lost_is_missed_at_the_next_answer() {
    let one_more = |_| vec![Says::Reply(1)];
    let (result, took) = outcome(controller(one_more), None, Duration::from_secs(600));
    let error = result.unwrap_err();
    assert!(
        matches!(error, ClientError::EventsMissing { missing: 1, .. }),
        "{error}"
    );
    assert!(took < SOON, "{took:?}");
    // So is the first one.
    let second = |_| vec![Says::Event(2)];
    let (result, _) = outcome(controller(second), None, Duration::from_secs(600));
    assert!(matches!(
        result,
        Err(ClientError::EventsMissing {
            missing: 1,
            sequence: 2
        })
    ));
}

#[test]
fn a_busy_controller_that_answers_is_waited_for() {
    let mut heartbeats = 0;
    let busy = move |_| {
        heartbeats += 1;
        // Every second answer is lost, and one comes again that belongs before the event.
        match heartbeats {
            40 => vec![
                Says::Foreign(9),
                Says::Event(1),
                Says::Reply(0),
                Says::Reply(1),
            ],
            odd if odd % 2 == 1 => vec![],
            _ => vec![Says::Reply(0)],
        }
    };
    let (result, took) = outcome(controller(busy), None, Duration::from_secs(600));
    assert!(
        matches!(result, Ok(Event::Cycle { count: 1, .. })),
        "{result:?}"
    );
    assert!(
        took > Duration::from_millis(2500),
        "longer than any silence: {took:?}"
    );
}
