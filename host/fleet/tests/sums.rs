//! Answers from daily sums are the answers from rows, whatever the lake holds; and sums that are stale, cut short, edited or half written
//! are not believed.
#![cfg(feature = "query")]

mod histories;
mod made_up;
mod same_rows;

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::process::Stdio;
use std::time::{Duration, Instant};

use flankscope_fleet::compact::{Compacted, Compaction, compact};
use flankscope_fleet::lake::Lake;
use flankscope_fleet::query::{Form, ask, questions};
use flankscope_fleet::rows::{LakeCheck, Level, Value as LakeValue, columns_of};
use flankscope_fleet::sums::{SumsName, days};
use flankscope_fleet::verify::{Finding, Verifier};
use flankscope_test_requisites::{Random, everything};
use histories::{Station, fleet, run};
use jiff::Timestamp;
use made_up::{MadeUp, Maker};
use serde_json::Value;

const DAY: i64 = 1440;
const DAYS_DRAWN: i64 = 5;
const DAYS_OF_ROWS: &str = include_str!("days_by_rows.sql");
const DAYS_IN_ORDER: &str = "ORDER BY date, simulated, tool, serial, place, life, station, baseline, head_blake3, tooth, flank, patch";

fn lake() -> (tempfile::TempDir, Lake) {
    let folder = tempfile::tempdir().unwrap();
    let lake = Lake::open(folder.path().to_str().unwrap()).unwrap();
    (folder, lake)
}

/// Long after every day of the lake.
fn compacted(lake: &Lake, retire: Option<u32>) -> Compacted {
    let now: Timestamp = "2001-04-01T12:00:00Z".parse().unwrap();
    let what = Compaction::of_days(1, retire, Duration::ZERO, now);
    run(compact(lake, &what)).unwrap()
}

fn answer(lake: &Lake, question: &str) -> Vec<Value> {
    let mut text = Vec::new();
    let answer = run(ask(lake, question)).unwrap_or_else(|error| panic!("{question}: {error}"));
    answer.write(Form::Json, &mut text).unwrap();
    serde_json::from_slice(&text).unwrap()
}

/// All named questions, and the days that most of them are made of.
fn answers(lake: &Lake) -> BTreeMap<String, Vec<Value>> {
    let mut asked: Vec<String> = questions().map(|q| q.name.to_owned()).collect();
    asked.push(format!("SELECT * FROM days {DAYS_IN_ORDER}"));
    let answered = asked.into_iter().map(|asked| {
        let answer = answer(lake, &asked);
        (asked, answer)
    });
    answered.collect()
}

/// A machine alone adds up the same rows, by days first.
fn assert_same(found: &Value, expected: &Value, what: &str) {
    same_rows::assert_same(found, expected, |value| 1e-9 * value.abs().max(1.0), what);
}

fn assert_all_same(
    one: &BTreeMap<String, Vec<Value>>,
    other: &BTreeMap<String, Vec<Value>>,
    what: &str,
) {
    for (question, rows) in one {
        let (rows, others) = (
            Value::Array(rows.clone()),
            Value::Array(other[question].clone()),
        );
        assert_same(&rows, &others, &format!("{what}: {question}"));
    }
}

fn below(random: &mut Random, limit: usize) -> usize {
    (random.uniform() * limit as f64) as usize
}

/// What a check has beyond [`MadeUp`].
#[derive(Clone)]
struct Beside {
    baseline: Option<&'static str>,
    simulated: bool,
    limit_um: f64,
    flanks: Vec<(
        Option<&'static str>,
        &'static str,
        Option<&'static str>,
        f64,
    )>,
}

impl Beside {
    fn draw(random: &mut Random, baseline: Option<&'static str>, flanks: usize) -> Self {
        let verdicts = [
            ("go", None),
            ("go", None),
            ("warn", None),
            ("indeterminate", Some("undecidable")),
            ("indeterminate", Some("hidden")),
        ];
        let flank = |random: &mut Random| {
            let (verdict, code) = verdicts[below(random, verdicts.len())];
            let u95_um = 2.0 + 4.0 * random.uniform();
            (None, verdict, code, u95_um)
        };
        let mut flanks: Vec<_> = (0..flanks).map(|_| flank(random)).collect();
        // The last one is a patch in one check of two, whose number says nothing.
        if let Some(last) = flanks.last_mut().filter(|_| random.uniform() < 0.5) {
            last.0 = Some("root");
        }
        Self {
            baseline,
            simulated: random.uniform() < 0.05,
            limit_um: [40.0, 50.0][below(random, 2)],
            flanks,
        }
    }

    fn set(&self, check: &mut LakeCheck) {
        let at = |name| {
            columns_of(Level::Check)
                .position(|column| column.name == name)
                .unwrap()
        };
        check.values[at("baseline")] = self.baseline.map(LakeValue::from);
        check.values[at("simulated")] = Some(LakeValue::Boolean(self.simulated));
        for (flank, (patch, verdict, code, u95_um)) in check.flanks.iter_mut().zip(&self.flanks) {
            for (column, value) in columns_of(Level::Flank).zip(flank) {
                match column.name {
                    "patch" => *value = patch.map(LakeValue::from),
                    "verdict" => *value = Some(LakeValue::from(*verdict)),
                    "code" => *value = code.map(LakeValue::from),
                    "u95_um" => *value = Some((*u95_um).into()),
                    "limit_um" => *value = Some(self.limit_um.into()),
                    _ => {}
                }
            }
        }
    }
}

/// A die wherever it is put in, whose strokes fall back now and then, within a day and between days.
struct Die {
    serial: Option<&'static str>,
    station: usize,
    strokes: i64,
    rate_um: f64,
}

/// Five days of three stations and four dies that go from one to another; often two stations check at one time.
fn draw(lake: &Lake, random: &mut Random) {
    let mut maker = Maker::new();
    let mut dies: Vec<Die> = [Some("A 1"), Some("A 2"), Some("A 3"), None]
        .into_iter()
        .map(|serial| Die {
            serial,
            station: below(random, 3),
            strokes: below(random, 2_000_000) as i64,
            rate_um: 0.0005 + 0.002 * random.uniform(),
        })
        .collect();
    let mut heads = [1, 2, 3];
    let mut baselines = [None, Some("b1"), Some("b1")];
    for day in 0..DAYS_DRAWN {
        let mut of_stations: Vec<Vec<(MadeUp, Beside)>> = vec![Vec::new(); 3];
        // Minutes are few, so that times and numbers of checks are often the same.
        for minute in (0..DAY).step_by(60) {
            for die in &mut dies {
                die.strokes += below(random, 3000) as i64;
                match below(random, 60) {
                    0 => die.strokes = below(random, 1000) as i64,
                    1 => die.strokes -= die.strokes.min(500),
                    2 | 3 => die.station = below(random, 3),
                    4..12 => continue,
                    _ => {}
                }
                match below(random, 200) {
                    0 => heads[die.station] += 3,
                    1 => baselines[die.station] = [None, Some("b2")][below(random, 2)],
                    _ => {}
                }
                let flanks = below(random, 4);
                let wear = |random: &mut Random| match below(random, 15) {
                    0 => None,
                    1 => Some(f64::NAN),
                    _ => Some(die.rate_um * die.strokes as f64 + random.normal()),
                };
                let made = MadeUp {
                    station: format!("press {}", die.station),
                    serial: die.serial.map(Into::into),
                    head: format!("h{}", heads[die.station]),
                    minute: day * DAY + minute,
                    strokes: die.strokes,
                    wear_um: (0..flanks).map(|_| wear(random)).collect(),
                };
                of_stations[die.station]
                    .push((made, Beside::draw(random, baselines[die.station], flanks)));
            }
        }
        for checks in of_stations.iter().filter(|checks| !checks.is_empty()) {
            // In two files, as a station ships them.
            let (one, two) = checks.split_at(below(random, checks.len()));
            for part in [one, two].into_iter().filter(|part| !part.is_empty()) {
                let made: Vec<MadeUp> = part.iter().map(|(made, _)| made.clone()).collect();
                maker.put_changed(lake, &made, |place, check| part[place].1.set(check));
            }
        }
    }
}

#[test]
fn days_and_answers_are_the_same_from_rows_and_from_sums() {
    let mut lives = BTreeSet::new();
    for seed in 0..if everything() { 60 } else { 6 } {
        let (folder, lake) = lake();
        let mut random = Random(seed);
        draw(&lake, &mut random);
        let rows = answers(&lake);
        let by_definition = answer(&lake, &format!("{DAYS_OF_ROWS} {DAYS_IN_ORDER}"));
        let days = &rows[&format!("SELECT * FROM days {DAYS_IN_ORDER}")];
        lives.extend(days.iter().map(|day| day["life"].as_i64().unwrap()));
        let what = format!("lake {seed}, by definition");
        assert_same(
            &Value::Array(days.clone()),
            &Value::Array(by_definition),
            &what,
        );
        let done = compacted(&lake, None);
        assert_eq!((done.summed, done.sums_removed), (DAYS_DRAWN as u64, 0));
        assert_all_same(&rows, &answers(&lake), &format!("lake {seed}, all days"));
        // Some days by sums, others by rows.
        for sums in run(lake.list(None)).unwrap().sums {
            if random.uniform() < 0.5 {
                std::fs::remove_file(folder.path().join(sums.to_string())).unwrap();
            }
        }
        assert_all_same(&rows, &answers(&lake), &format!("lake {seed}, some days"));
    }
    assert!(lives.len() > 5, "dies of several lives: {lives:?}");
}

/// A drawn lake with all its sums; what is answered by rows.
fn summed() -> (tempfile::TempDir, Lake, BTreeMap<String, Vec<Value>>) {
    let (folder, lake) = lake();
    draw(&lake, &mut Random(77));
    let rows = answers(&lake);
    assert_eq!(compacted(&lake, None).summed, DAYS_DRAWN as u64);
    // What was joined is removed.
    std::thread::sleep(Duration::from_millis(5));
    let now = Timestamp::now();
    let done = run(compact(
        &lake,
        &Compaction::of_days(1, None, Duration::ZERO, now),
    ))
    .unwrap();
    assert!(done.removed > 0 && done.left.is_empty(), "{done:?}");
    (folder, lake, rows)
}

/// The sums, each of which is of the files that count now.
fn valid(lake: &Lake) -> Vec<SumsName> {
    let listing = run(lake.list(None)).unwrap();
    let current = listing.cover().current;
    let days = days(&current);
    let is_of = |name: &&SumsName| days[&name.date[..]].source == name.source;
    assert_eq!(
        listing.sums.iter().filter(is_of).count(),
        listing.sums.len()
    );
    listing.sums
}

fn path(folder: &tempfile::TempDir, name: &impl std::fmt::Display) -> PathBuf {
    folder.path().join(name.to_string())
}

#[test]
fn sums_stand_for_rows_that_are_then_not_read() {
    let (folder, lake, rows) = summed();
    assert_eq!(valid(&lake).len(), DAYS_DRAWN as usize);
    assert_eq!(compacted(&lake, None), Compacted::default());
    let files = run(lake.list(None)).unwrap().files;
    for file in &files {
        std::fs::write(path(&folder, &file.name), "damaged").unwrap();
    }
    let answered = run(ask(&lake, "SELECT count(*) FROM checks"));
    assert!(answered.is_err());
    for question in [
        "dies-by-strokes-left",
        "wear-per-thousand-strokes",
        "stations-unlike-the-others",
        "changes",
    ] {
        let (rows, now) = (rows[question].clone(), answer(&lake, question));
        assert!(!rows.is_empty(), "{question}");
        assert_same(&rows.into(), &now.into(), question);
    }
}

#[test]
fn sums_that_are_cut_short_or_edited_are_named_not_believed_and_made_anew() {
    let (folder, lake, rows) = summed();
    let victim = valid(&lake).remove(2);
    let victim_path = path(&folder, &victim);
    let whole = std::fs::read(&victim_path).unwrap();
    let mut edited: Vec<Vec<u8>> = [0, 1, whole.len() / 2, whole.len() - 1]
        .map(|at| whole[..at].to_vec())
        .into();
    let mut random = Random(5);
    for _ in 0..20 {
        let mut bytes = whole.clone();
        bytes[below(&mut random, whole.len())] ^= 1 << below(&mut random, 8);
        edited.push(bytes);
    }
    for (n, bytes) in edited.into_iter().enumerate() {
        std::fs::write(&victim_path, bytes).unwrap();
        let question = ["dies-by-strokes-left", "stations-unlike-the-others"][n % 2];
        let (rows, now) = (rows[question].clone(), answer(&lake, question));
        assert_same(&rows.into(), &now.into(), &format!("edit {n}, {question}"));
    }
    let station = Station::new("reads");
    let arguments = [
        "query",
        "--lake",
        folder.path().to_str().unwrap(),
        "changes",
    ];
    let output = fleet!(station, &arguments).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(
        output.status.success() && said.contains(&victim.to_string()),
        "{said}"
    );
    let done = compacted(&lake, None);
    assert_eq!((done.summed, done.sums_removed), (1, 1));
    assert_eq!(std::fs::read(&victim_path).unwrap(), whole);
    // With a right name, but of another release, which had other columns.
    let other = SumsName::new(&victim.date, &victim.source, b"PAR1 of another release");
    std::fs::remove_file(&victim_path).unwrap();
    std::fs::write(path(&folder, &other), "PAR1 of another release").unwrap();
    assert_all_same(&rows, &answers(&lake), "other release");
}

#[test]
fn a_day_whose_files_change_is_read_by_rows_until_its_sums_are_made_anew() {
    let (folder, lake, rows) = summed();
    // A file is late.
    let listing = run(lake.list(None)).unwrap();
    let late = &listing.files[3].name;
    let late_path = path(&folder, late);
    let bytes = std::fs::read(&late_path).unwrap();
    std::fs::remove_file(&late_path).unwrap();
    let without = answers(&lake);
    assert!(without != rows);
    let done = compacted(&lake, None);
    assert_eq!((done.summed, done.sums_removed), (1, 1));
    assert_all_same(&without, &answers(&lake), "without it");
    std::fs::write(&late_path, &bytes).unwrap();
    assert_all_same(&rows, &answers(&lake), "when it has come");
    // Until it is as its name says, its day has no sums.
    std::fs::write(&late_path, &bytes[..bytes.len() - 1]).unwrap();
    let done = compacted(&lake, None);
    assert_eq!((done.summed, done.sums_removed, done.left.len()), (0, 1, 1));
    assert_eq!(done.left[0].0, *late);
    std::fs::write(&late_path, &bytes).unwrap();
    assert_eq!(compacted(&lake, None).summed, 1);
    assert_all_same(&rows, &answers(&lake), "made anew");
    // Given up: sums of a day that lost files are made anew, those of a day that is gone are removed.
    let done = compacted(&lake, Some(29));
    assert!(done.retired > 0 && done.sums_removed >= 2, "{done:?}");
    let dates: BTreeSet<String> = run(lake.list(None))
        .unwrap()
        .files
        .into_iter()
        .map(|file| file.name.range.date)
        .collect();
    let of_sums: Vec<String> = valid(&lake).into_iter().map(|name| name.date).collect();
    assert!(dates.iter().eq(&of_sums), "{dates:?} {of_sums:?}");
    let by_sums = answers(&lake);
    std::fs::remove_dir_all(folder.path().join(SumsName::FOLDER)).unwrap();
    assert_all_same(&answers(&lake), &by_sums, "after days were given up");
}

#[test]
fn sums_that_nobody_summed_up_are_found_by_verify() {
    let (folder, lake, _) = summed();
    let found = || run(Verifier::new(&lake, &[]).run(None)).unwrap().findings;
    assert_eq!(found(), Vec::new());
    let names = valid(&lake);
    // The sums of another day, with a right name.
    let bytes = std::fs::read(path(&folder, &names[1])).unwrap();
    let forged = SumsName::new(&names[0].date, &names[0].source, &bytes);
    std::fs::remove_file(path(&folder, &names[0])).unwrap();
    std::fs::write(path(&folder, &forged), &bytes).unwrap();
    std::fs::write(path(&folder, &names[2]), &bytes).unwrap();
    let is_found = |finding: &Finding| match finding {
        Finding::Sums { name, why } => (name.clone(), *why),
        other => panic!("{other}"),
    };
    let expected = [
        (forged, "its sums are not those of the rows"),
        (names[2].clone(), "it was cut short or edited"),
    ];
    assert_eq!(found().iter().map(is_found).collect::<Vec<_>>(), expected);
}

#[test]
fn a_compaction_that_is_killed_leaves_whole_sums_or_none() {
    let (folder, lake, rows) = summed();
    let station = Station::new("compacts");
    let arguments = ["compact", "--lake", folder.path().to_str().unwrap()];
    let mut random = Random(41);
    let begun = Instant::now();
    let renew = || std::fs::remove_dir_all(folder.path().join(SumsName::FOLDER)).unwrap();
    renew();
    assert!(fleet!(station, &arguments).status().unwrap().success());
    let whole_time = begun.elapsed();
    let mut left: BTreeSet<usize> = BTreeSet::new();
    for kill in 0..if everything() { 100 } else { 12 } {
        renew();
        let mut process = fleet!(station, &arguments)
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        std::thread::sleep(whole_time.mul_f64(random.uniform()));
        process.kill().unwrap();
        process.wait().unwrap();
        let names = valid(&lake);
        for name in &names {
            assert!(run(lake.read_sums(name)).unwrap().is_some(), "{name}");
        }
        left.insert(names.len());
        std::fs::create_dir_all(folder.path().join(SumsName::FOLDER)).unwrap();
        let (rows, now) = (rows["changes"].clone(), answer(&lake, "changes"));
        assert_same(&rows.into(), &now.into(), &format!("kill {kill}"));
    }
    assert!(left.len() > 1, "killed between days: {left:?}");
    assert!(fleet!(station, &arguments).status().unwrap().success());
    assert_eq!(valid(&lake).len(), DAYS_DRAWN as usize);
}
