//! A press that checks without an instrument, and the plant's process that follows it.

use std::io::{BufRead, BufReader, Read};
use std::net::TcpListener;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::{Duration, Instant};

use flankscope_metrology::gear::Flank;
use flankscope_metrology::verdict::Word;
use flankscope_record::die::DieKey;
use flankscope_record::document::{
    Feature, FeatureId, FrameCount, Inspection, Pictures, Recipe, Timing,
};
use flankscope_record::history::{History, HistoryWriter, Retention};
use flankscope_record::origin::{HeadId, Origin};
use flankscope_record::seal::Seals;
use flankscope_record::sink::ResultSink;
use flankscope_tests::{Killed, state};

/// Longest time for anything that is waited for.
pub const AT_MOST: Duration = Duration::from_secs(30);

/// A history that grows by checks which nobody made.
pub struct Press {
    writer: HistoryWriter,
    pub made: i64,
}

impl Press {
    pub fn new(history: &Path) -> Self {
        let history = History::open(history, &Seals::open(&state()).unwrap()).unwrap();
        let keep = Retention {
            checks: u32::MAX,
            bytes: u64::MAX,
        };
        Self {
            writer: HistoryWriter::new(history, None, keep, "tester".into()),
            made: 0,
        }
    }

    /// Stores a check of one flank of a tool, with 25.5 µm of wear.
    pub fn check(&mut self, tool: &str, tooth: u32, verdict: Word) {
        self.made += 1;
        let mut check = inspection(tool, tooth, verdict, self.made as u32);
        self.writer.put(&mut check).unwrap();
        assert_eq!(check.id, Some(self.made));
    }
}

fn inspection(tool: &str, tooth: u32, verdict: Word, press_cycles: u32) -> Inspection {
    let id = FeatureId {
        tooth,
        flank: Flank::Left,
        patch: None,
    };
    let feature = Feature {
        id,
        wear_um: Some(25.5),
        u95_um: Some(4.0),
        at_least_um: None,
        mean_um: Some(0.0),
        coverage_ratio: 1.0,
        warn_um: 30.0,
        limit_um: 50.0,
        conformity: Some(1.0),
        detail: None,
        measurements: Vec::new(),
        verdict,
        reason: None,
        code: None,
    };
    Inspection {
        id: None,
        origin: Origin {
            link: "sim".into(),
            simulated: true,
            head: HeadId {
                name: "demo, 20 mm".into(),
                blake3: "ab".repeat(32),
                seal: "signed".into(),
            },
            station: "press 7".into(),
            operator: None,
            recording: None,
        },
        date: "2026-01-31T12:00:00Z".into(),
        verdict,
        reason: "as stated".into(),
        features: vec![feature],
        in_view: Vec::new(),
        missing_teeth: Vec::new(),
        tooth_identity: None,
        timing_ms: Timing::default(),
        frames: FrameCount::default(),
        press_cycles,
        peak_memory_mb: None,
        registration: Vec::new(),
        tool: tool.into(),
        die: DieKey {
            tool: tool.into(),
            geometry: format!("geometry of {tool}"),
            serial: None,
        },
        temperature_degc: None,
        versions: [("host", "0.1.0".to_owned())].into(),
        hashes: [("cad", "0".repeat(64))].into(),
        recipe: Recipe::default(),
        evidence: Vec::new(),
        stopped: None,
        stopped_code: None,
        truth: None,
        phasors: Vec::new(),
        fields: Vec::new(),
        neighbours: Vec::new(),
        poses: Vec::new(),
        pictures: Pictures::default(),
    }
}

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

    /// Waits until it says this, and returns all that it said.
    pub fn says(&mut self, wanted: &str) -> String {
        let mut said = String::new();
        let end = Instant::now() + AT_MOST;
        while !said.contains(wanted) {
            let rest = end.saturating_duration_since(Instant::now());
            match self.words.recv_timeout(rest) {
                Ok(line) => said += &line,
                Err(_) => panic!("no '{wanted}' in {said}"),
            }
        }
        said
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
