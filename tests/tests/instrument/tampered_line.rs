//! A man in the middle of the serial line: a check of a simulated instrument whose bytes are flipped, dropped, repeated, swapped,
//! replayed and delayed in both directions.
//!
//! ```text
//!  flankscope inspect --link PTY ◄──► proxy ◄──► PTY of the bench's controller
//!                │                 tampers with frames,
//!                │                 notes what was sent
//!                └── frames through shared memory ◄── camera of the bench
//! ```
//! A verdict is the true one or indeterminate, and the controller moves only for orders that the host sent. Frames are not signed: a
//! forged order is obeyed, and the record of the line shows it. Six checks, or 100 with
//! `FLANKSCOPE_TEST_ALL=1`.

use std::collections::BTreeSet;
use std::fs::{File, OpenOptions};
use std::io::{Read, Write};
use std::path::Path;
use std::process::Stdio;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use flankscope_protocol::message::Why;
use flankscope_protocol::{Command, Decoder, Event, Kind, MAX_FRAME_BYTES, encode};
use flankscope_test_requisites::{Random, everything, in_lanes};
use flankscope_tests::{Killed, flankscope, press_tool, pseudo_terminal};
use rustix::process::{Pid, Signal, kill_process};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
use serde_json::Value;

/// Longest time of a check, whatever happens on the line.
const CHECK_ENDS_WITHIN: Duration = Duration::from_secs(120);
/// Time within which the bench has started.
const BENCH_STARTS_WITHIN: Duration = Duration::from_secs(60);
/// Tooth that is checked, and its wear in every second check.
const TOOTH: &str = "40";
const WEAR: &str = "40:left:80";

/// Shares of frames that are damaged, in turn. A check has some 80 frames.
const RATES: [f64; 3] = [0.02, 0.06, 0.2];

/// Kind of damage to a frame.
const DAMAGES: [&str; 8] = [
    "flipped", "dropped", "repeated", "swapped", "replayed", "delayed", "cut", "junk",
];

/// Tampering of the proxy.
#[derive(Clone, Copy, Debug)]
enum Tampering {
    /// Damages this share of the frames.
    Damage(f64),
    /// Orders to home, with a right checksum and the next sequence number, before the host's plan.
    ForgedHome,
}

/// Frames, orders and moves that passed the proxy, as they were before it tampered with them.
#[derive(Debug, Default)]
struct LineRecord {
    /// Frames of both directions.
    frames: usize,
    /// Frames by kind of damage.
    damaged: [usize; DAMAGES.len()],
    /// Sequence numbers of the host's orders to home and to start.
    home_orders: BTreeSet<(u32, u16)>,
    start_orders: BTreeSet<(u32, u16)>,
    /// Number of times that the controller began to home and to start.
    homings: usize,
    starts: usize,
    /// Moves that no order of the host explains.
    unordered: Vec<String>,
}

impl LineRecord {
    /// Notes an undamaged frame of the host or the controller.
    fn note(&mut self, decoder: &mut Decoder, frame: &[u8]) {
        self.frames += 1;
        for &byte in frame {
            let Some(Ok(frame)) = decoder.push(byte) else {
                continue;
            };
            let header = frame.header();
            let order = (header.session, header.sequence);
            match frame.kind() {
                Kind::Command => match frame.message() {
                    Ok(Command::Home) => drop(self.home_orders.insert(order)),
                    Ok(Command::Start { .. }) => drop(self.start_orders.insert(order)),
                    _ => {}
                },
                Kind::Event => {
                    let event = frame.message::<Event>();
                    let why = match &event {
                        Ok(Event::StateChanged { why, .. }) => *why,
                        _ => continue,
                    };
                    self.homings += usize::from(why == Why::Home);
                    self.starts += usize::from(why == Why::Start);
                    if self.homings > self.home_orders.len()
                        || self.starts > self.start_orders.len()
                    {
                        self.unordered.push(format!("{event:?}"));
                    }
                }
                Kind::Reply => {}
            }
        }
    }
}

/// One direction of the line.
struct Direction {
    random: Random,
    tampering: Tampering,
    /// Frames that were sent, for replays.
    sent: Vec<Vec<u8>>,
    /// A frame that the next one overtakes.
    held_back: Option<Vec<u8>>,
}

impl Direction {
    fn below(&mut self, limit: usize) -> usize {
        (self.random.uniform() * limit as f64) as usize
    }

    /// Sends a frame on, or what becomes of it; returns the number of the damage.
    fn send(&mut self, frame: &[u8], to: &mut File) -> std::io::Result<Option<usize>> {
        let rate = match self.tampering {
            Tampering::Damage(rate) => rate,
            Tampering::ForgedHome => {
                to.write_all(&forged_home(frame).unwrap_or_default())?;
                0.0
            }
        };
        let overtaken = self.held_back.take();
        self.sent.push(frame.to_vec());
        let damage = (self.random.uniform() < rate).then(|| self.below(DAMAGES.len()));
        let mut wire = frame.to_vec();
        match damage.map(|damage| DAMAGES[damage]) {
            Some("flipped") => {
                for _ in 0..=self.below(8) {
                    let bit = self.below(8 * wire.len());
                    wire[bit / 8] ^= 1 << (bit % 8);
                }
            }
            Some("dropped") => wire.clear(),
            Some("repeated") => wire.extend_from_slice(frame),
            Some("swapped") => self.held_back = Some(std::mem::take(&mut wire)),
            Some("replayed") => {
                let earlier = self.below(self.sent.len());
                wire.extend_from_slice(&self.sent[earlier]);
            }
            Some("delayed") => {
                let first = self.below(wire.len());
                to.write_all(&wire[..first])?;
                std::thread::sleep(Duration::from_millis(self.below(700) as u64));
                wire.drain(..first);
            }
            Some("cut") => wire.truncate(self.below(frame.len())),
            Some(_junk) => {
                let junk = self.below(400);
                let junk: Vec<u8> = (0..junk).map(|_| self.below(256) as u8).collect();
                wire.splice(0..0, junk);
            }
            None => {}
        }
        wire.extend(overtaken.into_iter().flatten());
        to.write_all(&wire)?;
        Ok(damage)
    }
}

/// An order to home with the sequence number of a plan, if this frame has a plan.
fn forged_home(frame: &[u8]) -> Option<Vec<u8>> {
    let mut decoder = Decoder::new();
    for &byte in frame {
        if let Some(Ok(plan)) = decoder.push(byte)
            && let Ok(Command::LoadPlan(_)) = plan.message()
        {
            let mut wire = vec![0; MAX_FRAME_BYTES];
            let length = encode(plan.header(), &Command::Home, &mut wire).unwrap();
            wire.truncate(length);
            return Some(wire);
        }
    }
    None
}

/// A proxy between two pseudo-terminals, until it is dropped.
struct Proxy {
    record: Arc<Mutex<LineRecord>>,
    is_over: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Proxy {
    fn start(host: File, controller: File, tampering: Tampering, seed: u64) -> Self {
        let record = Arc::new(Mutex::new(LineRecord::default()));
        let is_over = Arc::new(AtomicBool::new(false));
        let ends = [(&host, &controller, seed), (&controller, &host, !seed)];
        let threads = ends.map(|(from, to, seed)| {
            let (mut from, mut to) = (from.try_clone().unwrap(), to.try_clone().unwrap());
            let (record, is_over) = (Arc::clone(&record), Arc::clone(&is_over));
            let mut direction = Direction {
                random: Random(seed),
                tampering,
                sent: Vec::new(),
                held_back: None,
            };
            std::thread::spawn(move || {
                let (mut decoder, mut frame, mut byte) = (Decoder::new(), Vec::new(), [0]);
                while !is_over.load(Ordering::Relaxed) && from.read_exact(&mut byte).is_ok() {
                    frame.push(byte[0]);
                    // A frame begins and ends with a zero.
                    if byte[0] != 0 || frame.len() == 1 {
                        continue;
                    }
                    record.lock().unwrap().note(&mut decoder, &frame);
                    let Ok(damage) = direction.send(&frame, &mut to) else {
                        return;
                    };
                    if let Some(damage) = damage {
                        record.lock().unwrap().damaged[damage] += 1;
                    }
                    frame.clear();
                }
            })
        });
        Self {
            record,
            is_over,
            threads: threads.into(),
        }
    }
}

fn open_raw(port: &Path) -> File {
    let file = OpenOptions::new()
        .read(true)
        .write(true)
        .open(port)
        .unwrap();
    let mut settings = tcgetattr(&file).unwrap();
    settings.make_raw();
    tcsetattr(&file, OptionalActions::Now, &settings).unwrap();
    file
}

/// A check over a tampered line: its exit code and what the proxy saw.
fn check(tool: &str, is_worn: bool, tampering: Tampering, seed: u64) -> (i32, LineRecord) {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let wear: &[&str] = if is_worn { &[WEAR] } else { &[] };
    let bench = serde_json::json!({
        "root": "ROOT", "stands": { "tool": tool }, "teeth": null, "controller": "sim", "checks_every": null,
        "by_hand": false, "rotary_carries": "die",
        "setup": {
            "path": null, "file": {}, "seed": seed, "speed": "1", "wear": wear, "wear_rate": [], "die_mesh": null,
            "surface": "sprayed", "camera": "shared-memory",
        },
    });
    std::fs::write(at("bench.json"), format!("{bench}\n")).unwrap();
    // The bench is the camera process of the station: it is told where the frames go, and ends with its standard input. The host
    // stands still until the bench has a port.
    let script = "kill -STOP $PPID; { sed \"s|ROOT|$3|\" \"$2/bench.json\"; cat; } | \"$1\" bench run > \"$2/hello\"";
    let program = flankscope().get_program().to_owned();
    let command = [
        "/bin/sh",
        "-c",
        script,
        "camera",
        program.to_str().unwrap(),
        folder.path().to_str().unwrap(),
    ];
    let station = format!("[camera]\ncommand = {command:?}\n");
    std::fs::write(at("station.toml"), station).unwrap();
    let (master, port) = pseudo_terminal();
    let host_end = open_raw(&port);
    let mut inspect = flankscope();
    inspect
        .args(["inspect", "--quiet", "--json"])
        .arg(at("check.json"));
    inspect
        .args(["--tool", tool, "--teeth", TOOTH, "--link"])
        .arg(&port);
    inspect.arg("--station").arg(at("station.toml"));
    let messages = File::create(at("messages")).unwrap();
    let inspect = inspect.stdout(Stdio::null()).stderr(messages).spawn();
    let mut inspect = Killed(inspect.unwrap());
    let messages = || std::fs::read_to_string(at("messages")).unwrap();
    let begun = Instant::now();
    let hello: Value = loop {
        let hello = std::fs::read_to_string(at("hello")).unwrap_or_default();
        if let Some((hello, _)) = hello.split_once('\n') {
            break serde_json::from_str(hello).unwrap();
        }
        assert!(begun.elapsed() < BENCH_STARTS_WITHIN, "{}", messages());
        std::thread::sleep(Duration::from_millis(5));
    };
    let controller = open_raw(Path::new(hello["port"].as_str().unwrap()));
    let proxy = Proxy::start(master, controller, tampering, seed);
    kill_process(Pid::from_child(&inspect.0), Signal::CONT).unwrap();
    let code = loop {
        if let Some(status) = inspect.0.try_wait().unwrap() {
            break status
                .code()
                .unwrap_or_else(|| panic!("{status}: {}", messages()));
        }
        assert!(
            begun.elapsed() < CHECK_ENDS_WITHIN,
            "seed {seed}: {}",
            messages()
        );
        std::thread::sleep(Duration::from_millis(20));
    };
    proxy.is_over.store(true, Ordering::Relaxed);
    drop(host_end);
    for thread in proxy.threads {
        thread.join().unwrap();
    }
    let record = std::mem::take(&mut *proxy.record.lock().unwrap());
    let document = std::fs::read(at("check.json")).unwrap_or_default();
    let document: Value = serde_json::from_slice(&document).unwrap_or_default();
    println!(
        "seed {seed}, worn {is_worn}, {tampering:?}: {code} {} {record:?} {}",
        document["reason"],
        messages()
    );
    (code, record)
}

#[test]
fn tampering_with_the_line_makes_no_verdict_and_no_move() {
    let folder = tempfile::tempdir().unwrap();
    let tool = press_tool(folder.path());
    let (checks, lanes) = if everything() { (100, 8) } else { (6, 6) };
    let ended = in_lanes(checks, lanes, |number| {
        let is_worn = number.is_multiple_of(2);
        let rate = match number {
            // The proxy itself makes no difference.
            0 | 1 => 0.0,
            _ => RATES[number % RATES.len()],
        };
        let expected = if is_worn { 1 } else { 0 };
        let mut ended = Vec::new();
        // A busy machine may keep the bench from its real time.
        for attempt in 1..=3 {
            let seed = number as u64 + 1;
            let (code, record) = check(&tool, is_worn, Tampering::Damage(rate), seed);
            assert_eq!(record.unordered, Vec::<String>::new(), "check {number}");
            assert!([expected, 2, 3].contains(&code), "check {number}: {code}");
            let is_complete = rate > 0.0 || code == expected;
            assert!(is_complete || attempt < 3, "undisturbed: {code}");
            ended.push((code, record));
            if is_complete {
                break;
            }
        }
        ended
    });
    let ended: Vec<_> = ended.into_iter().flatten().collect();
    let count = |code: i32| ended.iter().filter(|(ended, _)| *ended == code).count();
    let frames: usize = ended.iter().map(|(_, record)| record.frames).sum();
    let damaged: Vec<_> = (0..DAMAGES.len())
        .map(|n| {
            let count: usize = ended.iter().map(|(_, record)| record.damaged[n]).sum();
            (DAMAGES[n], count)
        })
        .collect();
    println!(
        "{} checks: {} go, {} no-go, {} indeterminate, {} could not run; {frames} frames, of which {damaged:?}",
        ended.len(),
        count(0),
        count(1),
        count(2),
        count(3)
    );
    assert!(!everything() || damaged.iter().all(|(_, count)| *count > 20));
}

#[test]
fn a_forged_order_is_obeyed_and_seen_in_the_record_of_the_line() {
    let folder = tempfile::tempdir().unwrap();
    let tool = press_tool(folder.path());
    let (code, record) = check(&tool, true, Tampering::ForgedHome, 1);
    assert!([1, 2, 3].contains(&code), "{code}");
    assert_eq!((record.home_orders.len(), record.homings), (1, 2));
    assert!(!record.unordered.is_empty());
}
