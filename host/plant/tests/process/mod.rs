//! The plant's process, what it says, and what a test waits for.

use std::io::{BufRead, BufReader, Read};
use std::net::TcpListener;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::{Duration, Instant};

use flankscope_tests::{Killed, state};
use rustix::process::{Pid, Signal, kill_process};

/// Longest time for anything that is waited for.
pub const AT_MOST: Duration = Duration::from_secs(30);

/// The plant's process and what it says.
pub struct Plant {
    words: Receiver<String>,
    process: Killed,
}

impl Plant {
    pub fn start(settings: &Path) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_flankscope-plant"))
            .env("FLANKSCOPE_STATE", state())
            .arg("serve")
            .arg(settings)
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        Self {
            words: lines_of(child.stderr.take().unwrap()),
            process: Killed(child),
        }
    }

    /// Stops it, without ending its connections.
    #[allow(dead_code)]
    pub fn stop(&self) {
        kill_process(Pid::from_child(&self.process.0), Signal::STOP).unwrap();
    }

    /// Waits until it says this, and returns all that it said.
    pub fn says(&mut self, wanted: &str) -> String {
        let mut printed = String::new();
        let end = Instant::now() + AT_MOST;
        while !printed.contains(wanted) {
            let remaining = end.saturating_duration_since(Instant::now());
            match self.words.recv_timeout(remaining) {
                Ok(line) => printed += &line,
                Err(_) => panic!("no '{wanted}' in {printed}"),
            }
        }
        printed
    }

    pub fn lives(&mut self) -> bool {
        self.process.0.try_wait().unwrap().is_none()
    }
}

/// Lines that a process prints, as they come.
pub fn lines_of(from: impl Read + Send + 'static) -> Receiver<String> {
    let (send, lines) = channel();
    thread::spawn(move || {
        let lines = BufReader::new(from).lines();
        lines
            .map_while(Result::ok)
            .all(|line| send.send(line).is_ok())
    });
    lines
}

pub fn free_port() -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    listener.local_addr().unwrap().port()
}

/// Waits until there is such a thing.
pub fn wait_for<T>(mut found: impl FnMut() -> Option<T>) -> T {
    let end = Instant::now() + AT_MOST;
    loop {
        if let Some(found) = found() {
            return found;
        }
        assert!(Instant::now() < end, "waited in vain");
        thread::sleep(Duration::from_millis(50));
    }
}
