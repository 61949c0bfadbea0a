//! A broker of other people, what its clients hear, and a cable that breaks.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::path::PathBuf;
use std::process::{ChildStdin, Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::Receiver;
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Instant;

use flankscope_test_requisites::{Random, mqtt_peers, workspace};
use flankscope_tests::Killed;
use serde_json::Value;

use crate::process::{AT_MOST, Plant, free_port, lines_of, wait_for};

/// A folder with a history, a broker, and the settings of a plant that sends to it.
pub struct Station {
    pub folder: tempfile::TempDir,
    pub port: u16,
    python: PathBuf,
    _broker: Killed,
}

impl Station {
    /// With a broker that takes whatever its further settings let it take; none where the peers are missing.
    pub fn new(broker: &str) -> Option<Self> {
        let (mosquitto, python) = mqtt_peers()?;
        let folder = tempfile::tempdir().unwrap();
        let port = free_port();
        let file = folder.path().join("broker.conf");
        // Started as root it would become a user who cannot read this folder.
        let settings = format!("user root\nlistener {port} 127.0.0.1\nlog_dest none\n{broker}\n");
        let settings = settings.replace("FOLDER", folder.path().to_str().unwrap());
        std::fs::write(&file, settings).unwrap();
        let broker = Command::new(mosquitto)
            .arg("-c")
            .arg(&file)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        Some(Self {
            folder,
            port,
            python,
            _broker: Killed(broker),
        })
    }

    pub fn history(&self) -> PathBuf {
        self.folder.path().join("press.db")
    }

    pub fn file(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// A plant with these lines in `[mqtt]` beside broker, name and file.
    pub fn plant(&self, port: u16, stale_after_s: u32, more: &str) -> Plant {
        let settings = format!(
            "history = \"press.db\"\nstale_after_s = {stale_after_s}\n[mqtt]\nbroker = \"localhost:{port}\"\nname = \"press7\"\n\
             delivered = \"delivered.toml\"\n{more}\n"
        );
        let file = self.file("plant.toml");
        std::fs::write(&file, settings).unwrap();
        Plant::start(&file)
    }

    /// What a client of other people hears from now on.
    pub fn hear(&self, language: &str) -> Heard {
        // It may still be starting.
        wait_for(|| TcpStream::connect(("127.0.0.1", self.port)).ok());
        let mut command = Command::new(&self.python);
        command.arg(workspace().join("tools/peers/mqtt_clients.py"));
        command.args([language, &self.port.to_string()]);
        command.arg(workspace().join("docs/formats/plant-mqtt.schema.json"));
        let child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn();
        let mut child = child.unwrap();
        let lines = lines_of(child.stdout.take().unwrap());
        let mut heard = Heard {
            lines,
            commands: child.stdin.take().unwrap(),
            _process: Killed(child),
        };
        heard.until(|message| message["ready"] == true);
        heard
    }

    /// Number of the last check of which the plant says that the broker has it.
    pub fn delivered(&self) -> i64 {
        let text = std::fs::read_to_string(self.file("delivered.toml")).unwrap_or_default();
        let line = text.lines().find_map(|line| line.strip_prefix("number = "));
        line.map_or(0, |number| number.parse().unwrap())
    }
}

/// What a client hears.
pub struct Heard {
    lines: Receiver<String>,
    commands: ChildStdin,
    _process: Killed,
}

impl Heard {
    /// All messages up to the first one like this.
    pub fn until(&mut self, like: impl Fn(&Value) -> bool) -> Vec<Value> {
        let mut heard = Vec::new();
        let end = Instant::now() + AT_MOST;
        loop {
            let remaining = end.saturating_duration_since(Instant::now());
            let Ok(line) = self.lines.recv_timeout(remaining) else {
                let last = heard.len().saturating_sub(5);
                panic!("not heard; the last messages were {:#?}", &heard[last..]);
            };
            let message: Value = serde_json::from_str(&line).unwrap();
            let found = like(&message);
            heard.push(message);
            if found {
                return heard;
            }
        }
    }

    pub fn command(&mut self, line: &str) {
        writeln!(self.commands, "{line}").unwrap();
    }
}

/// A connection to the broker that breaks after so many bytes, at random, until it is told not to.
pub struct Cable {
    pub port: u16,
    cuts: Arc<AtomicUsize>,
    whole: Arc<AtomicUsize>,
}

impl Cable {
    /// Breaks after up to `most_bytes` in both directions together; every other connection only after what the plant was just sending
    /// has arrived, so that the answer to it is lost.
    pub fn to(broker: u16, seed: u64, most_bytes: usize) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let cable = Self {
            port: listener.local_addr().unwrap().port(),
            cuts: Arc::default(),
            whole: Arc::default(),
        };
        let (cuts, whole) = (Arc::clone(&cable.cuts), Arc::clone(&cable.whole));
        let random = Mutex::new(Random(seed));
        thread::spawn(move || {
            for near in listener.incoming().map_while(Result::ok) {
                let Ok(far) = TcpStream::connect(("127.0.0.1", broker)) else {
                    continue;
                };
                let bytes = (random.lock().unwrap().uniform() * most_bytes as f64) as usize;
                let remaining = Arc::new(AtomicUsize::new(1 + bytes));
                let arrives = random.lock().unwrap().uniform() < 0.5;
                let ways = [
                    (near.try_clone().unwrap(), far.try_clone().unwrap(), arrives),
                    (far, near, false),
                ];
                for (from, to, arrives) in ways {
                    let (remaining, cuts, whole) = (
                        Arc::clone(&remaining),
                        Arc::clone(&cuts),
                        Arc::clone(&whole),
                    );
                    thread::spawn(move || carry(from, to, arrives, &remaining, &cuts, &whole));
                }
            }
        });
        cable
    }

    pub fn cuts(&self) -> usize {
        self.cuts.load(Ordering::SeqCst)
    }

    /// Connections hold from now on.
    pub fn mend(&self) {
        self.whole.store(1, Ordering::SeqCst);
    }
}

/// Carries bytes as far as the rest of both ways allows; what exceeds it is carried, too, if it `arrives`.
fn carry(
    mut from: TcpStream,
    mut to: TcpStream,
    arrives: bool,
    remaining: &AtomicUsize,
    cuts: &AtomicUsize,
    whole: &AtomicUsize,
) {
    let mut bytes = [0; 4096];
    while let Ok(got @ 1..) = from.read(&mut bytes) {
        let take = |remaining: usize| Some(remaining.saturating_sub(got));
        let before = remaining.fetch_update(Ordering::SeqCst, Ordering::SeqCst, take);
        let before = before.unwrap_or(0);
        let breaks = before < got && whole.load(Ordering::SeqCst) == 0;
        let carried = match breaks && !(arrives && before > 0) {
            true => before,
            false => got,
        };
        if to.write_all(&bytes[..carried]).is_err() {
            break;
        }
        if breaks {
            if before > 0 {
                cuts.fetch_add(1, Ordering::SeqCst);
            }
            break;
        }
    }
    // Nothing comes back; what was carried arrives.
    let _ = from.shutdown(Shutdown::Both);
    let _ = to.shutdown(Shutdown::Both);
}
