//! A press that checks without an instrument.

use std::path::Path;

use flankscope_metrology::gear::Flank;
use flankscope_metrology::verdict::Word;
use flankscope_record::die::DieKey;
use flankscope_record::document::Inspection;
use flankscope_record::history::{History, HistoryWriter, Retention};
use flankscope_record::seal::Seals;
use flankscope_record::sink::ResultSink;
use flankscope_tests::state;

#[path = "../../../record/tests/inspections/mod.rs"]
mod inspections;

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
    pub fn store(&mut self, mut check: Inspection) {
        self.made += 1;
        self.writer.put(&mut check).unwrap();
        assert_eq!(check.id, Some(self.made), "{}", check.reason);
    }
}

/// A check of one flank of a tool on the simulated bench, with 25.5 µm of wear.
pub fn inspection(tool: &str, tooth: u32, verdict: Word, press_cycles: u32) -> Inspection {
    Inspection {
        features: vec![inspections::feature(tooth, Flank::Left, 25.5, verdict)],
        tool: tool.into(),
        die: DieKey {
            tool: tool.into(),
            geometry: format!("geometry of {tool}"),
            serial: None,
        },
        evidence: Vec::new(),
        phasors: Vec::new(),
        ..inspections::inspection(press_cycles, verdict, "as stated")
    }
}
