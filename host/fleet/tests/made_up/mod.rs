//! Lakes with the wear that a test or an example asks for, put as files of the lake without a history.

use std::collections::BTreeMap;

use flankscope_fleet::file::LakeFile;
use flankscope_fleet::lake::Lake;
use flankscope_fleet::name::Range;
use flankscope_fleet::rows::{LakeCheck, Level, Stream, Value, columns_of};
use flankscope_fleet::ship::put_all;
use flankscope_record::seal::Seals;
use jiff::Timestamp;

use crate::histories::{Station, run};

/// A check of some flanks.
#[derive(Clone)]
pub struct MadeUp {
    pub station: String,
    pub serial: Option<String>,
    pub head: String,
    /// Minutes since 1 March 2001.
    pub minute: i64,
    pub strokes: i64,
    /// Wear of each flank; a check without any has none.
    pub wear_um: Vec<Option<f64>>,
}

/// Writes made-up checks.
pub struct Maker {
    model: LakeCheck,
    flank: Vec<Option<Value>>,
    seals: Seals,
    numbers: BTreeMap<String, i64>,
    /// Verdict of the checks that are put from now on.
    pub verdict: &'static str,
    /// Which of a station's histories they are stored in.
    pub history: u32,
}

impl Maker {
    pub fn new() -> Self {
        let station = Station::new("model");
        station.store(1);
        let stream = Stream::of(&station.read()).unwrap();
        let linked = station.read().linked_checks(1..=1, 0).unwrap();
        let model = LakeCheck::new(&stream, &linked[0]).unwrap();
        Self {
            flank: model.flanks[0].clone(),
            model,
            seals: Seals::passing().unwrap(),
            numbers: BTreeMap::new(),
            verdict: "go",
            history: 1,
        }
    }

    /// Puts the checks of one station and day, in the order of time.
    #[allow(dead_code)]
    pub fn put(&mut self, lake: &Lake, checks: &[MadeUp]) -> LakeFile {
        self.put_changed(lake, checks, |_, _| {})
    }

    /// The same with each check changed, by its place among them.
    pub fn put_changed(
        &mut self,
        lake: &Lake,
        checks: &[MadeUp],
        change: impl Fn(usize, &mut LakeCheck),
    ) -> LakeFile {
        let station = checks[0].station.clone();
        let name = match self.history {
            1 => station.clone(),
            further => format!("{station} {further}"),
        };
        let history = blake3::hash(name.as_bytes()).to_hex()[..32].to_owned();
        let next = self.numbers.entry(name).or_insert(1);
        let first = *next;
        *next += checks.len() as i64;
        let last = *next - 1;
        let stream = Stream {
            history,
            epoch: "0".repeat(8),
        };
        let at = |check: &MadeUp| 983_404_800_000 + check.minute * 60_000;
        let date = Timestamp::from_millisecond(at(&checks[0])).unwrap();
        let range = Range {
            first,
            last,
            date: date.strftime("%Y-%m-%d").to_string(),
            stream: stream.clone(),
            station,
        };
        let rows = (0..).zip(checks).map(|(place, made)| {
            let number = first + place as i64;
            let mut check = self.check(&stream, number, made, at(made));
            change(place, &mut check);
            check
        });
        let file = LakeFile::sealed(range, rows.collect(), &self.seals);
        run(put_all(lake, std::iter::once(Ok(file.clone())))).unwrap();
        file
    }

    fn check(&self, stream: &Stream, number: i64, made: &MadeUp, at_ms: i64) -> LakeCheck {
        let mut check = self.model.clone();
        check.set("history", Value::from(&stream.history[..]));
        check.set("check_number", number.into());
        check.set("chain_link", number.into());
        check.set("stored_at", at_ms.into());
        let digest = blake3::hash(format!("{} {number}", made.station).as_bytes());
        check.set("chain_digest", Value::from(&digest.to_hex()[..]));
        check.set("tool_cycles", made.strokes.into());
        check.set("check_verdict", Value::from(self.verdict));
        check.set("head_blake3", Value::from(&made.head[..]));
        let serial = columns_of(Level::Check)
            .position(|column| column.name == "serial")
            .unwrap();
        check.values[serial] = made.serial.as_deref().map(Value::from);
        let flanks = (1_i64..).zip(&made.wear_um).map(|(tooth, wear_um)| {
            let mut flank = self.flank.clone();
            for (column, value) in columns_of(Level::Flank).zip(&mut flank) {
                match column.name {
                    "tooth" => *value = Some(tooth.into()),
                    "wear_um" => *value = wear_um.map(Value::from),
                    "u95_um" => *value = Some(4.0.into()),
                    _ => {}
                }
            }
            flank
        });
        check.flanks = flanks.collect();
        check
    }
}
