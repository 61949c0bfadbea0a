//! A press that checks without an instrument.

use std::path::Path;

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
use flankscope_tests::state;

/// A history that grows by checks which nobody made.
pub struct Press {
    writer: HistoryWriter,
    pub made: i64,
}

impl Press {
    pub fn new(history: &Path) -> Self {
        Self::of_station(history, &state())
    }

    /// A press whose station keeps its key in this folder.
    pub fn of_station(history: &Path, state: &Path) -> Self {
        let history = History::open(history, &Seals::open(state).unwrap()).unwrap();
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
    #[allow(dead_code)]
    pub fn check(&mut self, tool: &str, tooth: u32, verdict: Word) {
        let cycles = self.made as u32 + 1;
        self.store(inspection(tool, tooth, verdict, cycles));
    }

    /// Stores such a check with this moment as its time.
    #[allow(dead_code)]
    pub fn check_now(&mut self, tool: &str, tooth: u32, verdict: Word) {
        let mut check = inspection(tool, tooth, verdict, self.made as u32 + 1);
        check.date = flankscope_foundation::date::now();
        self.store(check);
    }

    /// Stores a check.
    pub fn store(&mut self, check: Inspection) {
        self.made += 1;
        assert_eq!(self.put(check), self.made);
    }

    /// Stores a check, whatever the history holds already, and returns its number.
    pub fn put(&mut self, mut check: Inspection) -> i64 {
        self.writer.put(&mut check).unwrap();
        check.id.unwrap_or_else(|| panic!("{}", check.reason))
    }
}

/// A check of one flank of a tool on the simulated bench, with 25.5 µm of wear.
pub fn inspection(tool: &str, tooth: u32, verdict: Word, press_cycles: u32) -> Inspection {
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
        last_exposure: None,
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
        approaches: None,
        pictures: Pictures::default(),
    }
}
