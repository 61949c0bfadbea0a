//! Answers are what was made up: by closed forms, by the station's own forecast, and by DuckDB with the same SQL.
#![cfg(feature = "query")]

mod histories;
mod made_up;

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use flankscope_fleet::compact::{Compaction, compact};
use flankscope_fleet::lake::Lake;
use flankscope_fleet::query::{Form, QUESTIONS_SQL, ask, questions};
use flankscope_record::history::{Check, Forecast, series};
use flankscope_test_requisites::{Random, lake_readers};
use histories::{LATER, Station, fleet, minute_of_march, run};
use made_up::{MadeUp, Maker};
use serde_json::{Value, json};

const DAY: i64 = 1440;

fn answer(lake: &Lake, question: &str) -> Result<Vec<Value>, String> {
    let answer = run(ask(lake, question)).map_err(|error| error.to_string())?;
    let mut text = Vec::new();
    answer.write(Form::Json, &mut text).unwrap();
    Ok(serde_json::from_slice(&text).unwrap())
}

fn empty_lake() -> (tempfile::TempDir, Lake) {
    let folder = tempfile::tempdir().unwrap();
    let lake = Lake::open(folder.path().to_str().unwrap()).unwrap();
    (folder, lake)
}

fn number(row: &Value, name: &str) -> f64 {
    row[name]
        .as_f64()
        .unwrap_or_else(|| panic!("{name} of {row}"))
}

/// So many checks of one die at one station, a day in a file, from a minute and a number of strokes on; a check every 30 strokes and
/// 30 minutes, whose flanks have the wear that is drawn at their strokes.
struct Shift<'a> {
    station: &'a str,
    serial: Option<&'a str>,
    head: &'a str,
    day: i64,
    strokes: i64,
    checks: i64,
}

impl Shift<'_> {
    fn put(
        &self,
        maker: &mut Maker,
        lake: &Lake,
        mut wear_um: impl FnMut(f64) -> Vec<Option<f64>>,
    ) {
        let mut days: BTreeMap<i64, Vec<MadeUp>> = BTreeMap::new();
        for n in 0..self.checks {
            let minute = self.day * DAY + n * 30;
            let strokes = self.strokes + n * 30;
            days.entry(minute / DAY).or_default().push(MadeUp {
                station: self.station.into(),
                serial: self.serial.map(Into::into),
                head: self.head.into(),
                minute,
                strokes,
                wear_um: wear_um(strokes as f64),
            });
        }
        for checks in days.values() {
            maker.put(lake, checks);
        }
    }
}

const SHIFT: Shift<'_> = Shift {
    station: "press 1",
    serial: Some("A 1"),
    head: "h1",
    day: 0,
    strokes: 1_000_000,
    checks: 240,
};

#[test]
fn a_line_without_scatter_gives_strokes_left_as_by_hand() {
    let (_folder, lake) = empty_lake();
    let slope = |flank: f64| 0.002 * (1.0 + flank);
    let line = |strokes: f64| {
        (0..3)
            .map(|f| Some(3.0 + slope(f64::from(f)) * (strokes - 1e6)))
            .collect()
    };
    SHIFT.put(&mut Maker::new(), &lake, line);
    let rows = answer(&lake, "dies-by-strokes-left").unwrap();
    assert_eq!(rows.len(), 1);
    let (row, last) = (&rows[0], 239.0 * 30.0);
    assert_eq!(
        (&row["tooth"], &row["limit_um"], &row["why_not"]),
        (&json!(3), &json!(50.0), &Value::Null)
    );
    let now_um = 3.0 + slope(2.0) * last;
    let left = (50.0 - now_um) / slope(2.0);
    assert!(
        (number(row, "strokes_left") - left).abs() < 1e-6 * left,
        "{row}"
    );
    // At least: found by halving, from the least scatter of a nanometre.
    let mean = last / 2.0;
    let spread: f64 = (0..240).map(|n| (f64::from(n) * 30.0 - mean).powi(2)).sum();
    let (u_slope, u_um) = (1e-3 / spread.sqrt(), 4.0 / 1.959_963_985);
    let reaches = |x: f64| {
        slope(2.0) * x + 1.644_853_627 * (u_um * u_um + (u_slope * x).powi(2)).sqrt()
            >= 50.0 - now_um
    };
    let (mut low, mut high) = (0.0, left);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if reaches(middle) {
            high = middle
        } else {
            low = middle
        }
    }
    assert!(
        (number(row, "at_least") - low).abs() < 1e-5 * low,
        "{row}, {low}"
    );
    let rows = answer(&lake, "wear-per-thousand-strokes").unwrap();
    for (row, flank) in rows.iter().zip([2.0, 1.0, 0.0]) {
        assert!(
            (number(row, "um_per_1000") - 1000.0 * slope(flank)).abs() < 1e-6,
            "{row}"
        );
    }
}

#[test]
fn drawn_slopes_come_back_within_their_uncertainty() {
    let (_folder, lake) = empty_lake();
    let mut random = Random(11);
    let slopes: Vec<f64> = (0..100).map(|_| 0.001 + 0.004 * random.uniform()).collect();
    let line = |strokes: f64| {
        slopes
            .iter()
            .map(|slope| Some(slope * (strokes - 1e6) + 0.5 * random.normal()))
            .collect()
    };
    SHIFT.put(&mut Maker::new(), &lake, line);
    let rows = answer(&lake, "wear-per-thousand-strokes").unwrap();
    assert_eq!(rows.len(), slopes.len());
    let within = |k: f64| {
        let near = |row: &&Value| {
            let drawn = 1000.0 * slopes[row["tooth"].as_u64().unwrap() as usize - 1];
            (number(row, "um_per_1000") - drawn).abs()
                < 0.5 * k * number(row, "expanded_um_per_1000")
        };
        rows.iter().filter(near).count()
    };
    // Of a hundred, 68 and 95 are expected; four standard deviations off.
    assert!(
        (50..=86).contains(&within(1.0)) && within(2.0) >= 87,
        "{} {}",
        within(1.0),
        within(2.0)
    );
}

#[test]
fn strokes_left_agree_with_the_stations_own_forecast() {
    let station = Station::new("press 7");
    station.store(356);
    station.date(|id| minute_of_march(id * 12));
    let lake = station.lake();
    station.ship(&lake, LATER).unwrap();
    let linked = station.read().linked_checks(1..=i64::MAX, 0).unwrap();
    let checks: Vec<Check> = linked.into_iter().map(|linked| linked.check).collect();
    let own: Vec<Forecast> = series(&checks).into_iter().map(Forecast::of).collect();
    let first = own
        .iter()
        .min_by(|a, b| {
            a.remaining_cycles
                .q05
                .unwrap()
                .total_cmp(&b.remaining_cycles.q05.unwrap())
        })
        .unwrap();
    assert!(first.changes.is_empty());
    let rows = answer(&lake, "dies-by-strokes-left").unwrap();
    assert_eq!(rows.len(), 1);
    let (left, at_least) = (
        number(&rows[0], "strokes_left"),
        number(&rows[0], "at_least"),
    );
    let (q05, q50) = (
        first.remaining_cycles.q05.unwrap(),
        first.remaining_cycles.q50.unwrap(),
    );
    // The station's line is one of medians: each figure is within the uncertainty of the other.
    assert!(at_least < q50 && q05 < left, "{rows:?} {q05} {q50}");
    assert!(
        (left - q50).abs() < (left - at_least).min(q50 - q05),
        "{rows:?} {q05} {q50}"
    );
    let trend = first.trend.unwrap();
    let of_flanks = answer(&lake, "wear-per-thousand-strokes").unwrap();
    for row in &of_flanks {
        assert_eq!(row["points"], json!(trend.points));
        let off = number(row, "um_per_1000") - 1000.0 * trend.rate_um;
        assert!(
            off.abs() < number(row, "expanded_um_per_1000"),
            "{row} {trend:?}"
        );
    }
}

#[test]
fn a_line_that_cannot_tell_says_why_and_no_strokes() {
    let (_folder, lake) = empty_lake();
    let mut maker = Maker::new();
    let mut random = Random(3);
    let mut put = |shift: Shift<'_>, wear_um: &mut dyn FnMut(f64) -> Option<f64>| {
        shift.put(&mut maker, &lake, |strokes| vec![wear_um(strokes - 1e6)]);
    };
    put(
        Shift {
            serial: Some("few"),
            checks: 4,
            ..SHIFT
        },
        &mut |x| Some(0.01 * x),
    );
    put(
        Shift {
            serial: Some("flat"),
            station: "press 2",
            ..SHIFT
        },
        &mut |_| Some(5.0 + random.normal()),
    );
    // Wears four times as fast on the last of its five days.
    let mut random = Random(5);
    put(
        Shift {
            serial: Some("faster"),
            station: "press 3",
            ..SHIFT
        },
        &mut |x| Some(0.001 * x + 0.003 * (x - 5760.0).max(0.0) * 2.0 + 0.3 * random.normal()),
    );
    put(
        Shift {
            serial: Some("unmeasured"),
            station: "press 4",
            ..SHIFT
        },
        &mut |_| None,
    );
    put(
        Shift {
            serial: None,
            station: "press 5",
            ..SHIFT
        },
        &mut |x| Some(0.001 * x),
    );
    // Another life, in which the die has not worn yet: the old one's line tells nothing.
    put(
        Shift {
            serial: Some("ground"),
            station: "press 6",
            ..SHIFT
        },
        &mut |x| Some(0.001 * x),
    );
    put(
        Shift {
            serial: Some("ground"),
            station: "press 6",
            day: 6,
            strokes: 0,
            checks: 3,
            ..SHIFT
        },
        &mut |_| Some(0.1),
    );
    let rows = answer(&lake, "dies-by-strokes-left").unwrap();
    let why: BTreeMap<&str, &str> = rows
        .iter()
        .map(|row| {
            (
                row["serial"].as_str().unwrap_or(""),
                row["why_not"].as_str().unwrap_or(""),
            )
        })
        .collect();
    let few = "fewer than five values";
    let expected = [
        ("few", few),
        ("flat", "no wear beyond its uncertainty"),
        ("faster", "the last day left the line"),
        ("unmeasured", few),
        ("", ""),
        ("ground", few),
    ];
    assert_eq!(why, BTreeMap::from(expected));
    for row in &rows {
        assert_eq!(
            row["strokes_left"].is_null(),
            !row["serial"].is_null(),
            "{row}"
        );
        assert_eq!(row["at_least"].is_null(), !row["serial"].is_null(), "{row}");
    }
}

/// One die after the other at three stations, of which one measures 2 µm too much; and one that has never left.
fn ring(lake: &Lake, scatter_um: f64) {
    let mut maker = Maker::new();
    let mut random = Random(17);
    for die in 0..4 {
        for (at, station) in ["press 1", "press 2", "press 3"].into_iter().enumerate() {
            let serial = format!("R {die}");
            let shift = Shift {
                station,
                serial: Some(&serial),
                day: 5 * (3 * die + at as i64),
                strokes: 1_000_000 + 7200 * at as i64,
                ..SHIFT
            };
            let off_um = if station == "press 2" { 2.0 } else { 0.0 };
            shift.put(&mut maker, lake, |strokes| {
                let mut flank = |rate: f64| {
                    Some(1.0 + off_um + rate * (strokes - 1e6) + scatter_um * random.normal())
                };
                vec![flank(0.001), flank(0.0013)]
            });
        }
    }
    Shift {
        station: "press 4",
        serial: Some("home"),
        ..SHIFT
    }
    .put(&mut maker, lake, |x| vec![Some(0.001 * (x - 1e6))]);
}

#[test]
fn a_station_that_measures_unlike_the_others_is_found() {
    let (_folder, lake) = empty_lake();
    ring(&lake, 0.5);
    let rows = answer(&lake, "stations-unlike-the-others").unwrap();
    let found: BTreeMap<&str, &Value> = rows
        .iter()
        .map(|row| (row["station"].as_str().unwrap(), row))
        .collect();
    assert_eq!(found.len(), 3);
    for (station, off_um) in [("press 1", -1.0), ("press 2", 2.0), ("press 3", -1.0)] {
        let row = found[station];
        assert_eq!((&row["dies"], &row["flanks"]), (&json!(4), &json!(8)));
        let (got, expanded) = (number(row, "difference_um"), number(row, "expanded_um"));
        assert!((got - off_um).abs() < 1.5 * expanded, "{row}");
        // 240 values of 0.5 µm, four dies of two flanks; the common slope carries over 7200 strokes.
        assert!((0.02..0.3).contains(&expanded), "{row}");
        assert_eq!(row["beyond_u95"], json!(false));
    }
    assert_eq!(found["press 2"]["beyond_expanded"], json!(true));
}

#[test]
fn what_another_head_and_another_die_changed_comes_back() {
    let (_folder, lake) = empty_lake();
    let mut maker = Maker::new();
    let mut random = Random(23);
    let mut put = |shift: Shift<'_>, step_um: f64, rate: f64| {
        shift.put(&mut maker, &lake, |strokes| {
            vec![Some(step_um + rate * strokes + 0.3 * random.normal())]
        });
    };
    let first = Shift {
        strokes: 0,
        ..SHIFT
    };
    put(first, 0.0, 0.002);
    put(
        Shift {
            head: "h2",
            day: 6,
            strokes: 7200,
            ..SHIFT
        },
        1.5,
        0.002,
    );
    // Coated: wears half as fast.
    put(
        Shift {
            head: "h2",
            day: 12,
            strokes: 0,
            serial: Some("A 2"),
            ..SHIFT
        },
        0.0,
        0.001,
    );
    let rows = answer(&lake, "changes").unwrap();
    let changed: Vec<&str> = rows
        .iter()
        .map(|row| row["changed"].as_str().unwrap())
        .collect();
    assert_eq!(changed, ["die", "head"]);
    let near = |row: &Value, name, expanded, truth: f64| {
        assert!(
            (number(row, name) - truth).abs() < 1.5 * number(row, expanded),
            "{name} {truth} {row}"
        );
    };
    near(&rows[0], "before_um_per_1000", "expanded_before", 2.0);
    near(&rows[0], "after_um_per_1000", "expanded_after", 1.0);
    near(&rows[0], "change_um_per_1000", "expanded_change", -1.0);
    near(&rows[1], "change_um_per_1000", "expanded_change", 0.0);
    near(&rows[1], "step_um", "expanded_step", 1.5);
    assert_eq!(
        (&rows[0]["other_rate"], &rows[0]["step_um"]),
        (&json!(true), &Value::Null)
    );
    assert_eq!(rows[1]["other_level"], json!(true));
}

/// A text of numbers, texts and dates without the two engines' own ways to write them.
fn assert_same(ours: &Value, duckdb: &Value, name: &str) {
    match (ours, duckdb) {
        (Value::Array(ours), Value::Array(duckdb)) => {
            assert_eq!(ours.len(), duckdb.len(), "{name}");
            for (ours, duckdb) in ours.iter().zip(duckdb) {
                assert_same(ours, duckdb, name);
            }
        }
        (Value::Object(ours), Value::Object(duckdb)) => {
            assert_eq!(ours.len(), duckdb.len());
            for (column, value) in duckdb {
                assert_same(
                    &ours[&column.to_lowercase()],
                    value,
                    &format!("{name} {column}"),
                );
            }
        }
        (Value::Number(ours), Value::Number(duckdb)) => {
            let (ours, duckdb) = (ours.as_f64().unwrap(), duckdb.as_f64().unwrap());
            assert!(
                (ours - duckdb).abs() <= 1e-6 * duckdb.abs().max(1e-3),
                "{name}: {ours} {duckdb}"
            );
        }
        (Value::String(ours), Value::String(duckdb)) => {
            assert_eq!(
                ours.replace('T', " ").replace('Z', "+00"),
                *duckdb,
                "{name}"
            );
        }
        _ => assert_eq!(ours, duckdb, "{name}"),
    }
}

#[test]
fn duckdb_answers_the_named_questions_alike_by_the_same_sql() {
    let Some(python) = lake_readers() else {
        return;
    };
    let (folder, lake) = empty_lake();
    ring(&lake, 0.5);
    let mut maker = Maker::new();
    let mut random = Random(29);
    for (day, head, strokes) in [(0, "h1", 0), (6, "h2", 7200), (12, "h2", 0)] {
        let shift = Shift {
            station: "press 9",
            serial: None,
            head,
            day,
            strokes,
            ..SHIFT
        };
        shift.put(&mut maker, &lake, |x| match random.uniform() {
            none if none < 0.02 => vec![],
            none if none < 0.05 => vec![None, Some(f64::NAN)],
            _ => vec![
                Some(0.002 * x + random.normal()),
                Some(0.004 * x + random.normal()),
            ],
        });
    }
    let out = tempfile::tempdir().unwrap();
    let files = run(lake.list(None)).unwrap().files;
    let listing: String = files
        .iter()
        .map(|file| format!("{}/{}\n", folder.path().display(), file.name))
        .collect();
    std::fs::write(out.path().join("files.txt"), listing).unwrap();
    std::fs::write(out.path().join("questions.sql"), QUESTIONS_SQL).unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/questions_in_duckdb.py");
    let arguments = ["files.txt", "questions.sql", "."];
    let done = Command::new(python)
        .arg(script)
        .args(arguments)
        .current_dir(out.path())
        .output()
        .unwrap();
    assert!(
        done.status.success(),
        "{}",
        String::from_utf8_lossy(&done.stderr)
    );
    for question in questions() {
        let text = std::fs::read(out.path().join(format!("{}.json", question.name))).unwrap();
        let ours = answer(&lake, question.name).unwrap();
        assert!(!ours.is_empty(), "{}", question.name);
        assert_same(
            &Value::Array(ours),
            &serde_json::from_slice(&text).unwrap(),
            question.name,
        );
    }
}

#[test]
fn joined_files_beside_their_parts_count_each_check_once() {
    let station = Station::new("press 7/ä");
    station.store(300);
    station.date(|id| minute_of_march(id * 12));
    let lake = station.lake();
    station.ship(&lake, LATER).unwrap();
    let sql = "SELECT station, CAST(date AS VARCHAR) AS date, count(*) AS rows, count(DISTINCT check_number) AS checks, sum(wear_um) AS wear_um \
        FROM checks GROUP BY ALL ORDER BY date";
    let before = answer(&lake, sql).unwrap();
    let linked = station.read().linked_checks(1..=300, 0).unwrap();
    let rows: usize = linked
        .iter()
        .map(|linked| linked.check.flanks.len().max(1))
        .sum();
    assert_eq!(
        before.iter().map(|row| number(row, "rows")).sum::<f64>(),
        rows as f64
    );
    assert_eq!(
        before.iter().map(|row| number(row, "checks")).sum::<f64>(),
        300.0
    );
    assert_eq!(
        (&before[0]["station"], &before[0]["date"]),
        (&json!("press 7/ä"), &json!("2001-03-01"))
    );
    let what = Compaction::of_days(1, None, Duration::from_secs(3600), jiff::Timestamp::now());
    assert_eq!(run(compact(&lake, &what)).unwrap().into, 3);
    assert_same(
        &json!(answer(&lake, sql).unwrap()),
        &json!(before),
        "joined",
    );
}

#[test]
fn a_damaged_file_is_named_and_gives_no_answer_but_to_those_who_do_not_need_it() {
    let (folder, lake) = empty_lake();
    SHIFT.put(&mut Maker::new(), &lake, |x| vec![Some(0.001 * x)]);
    let files = run(lake.list(None)).unwrap().files;
    let mut names = files.into_iter().map(|file| file.name);
    let victim = names.find(|name| name.range.date == "2001-03-03").unwrap();
    let path = folder.path().join(victim.to_string());
    let whole = std::fs::read(&path).unwrap();
    for bytes in [0, 7, whole.len() / 2, whole.len() - 1] {
        std::fs::write(&path, &whole[..bytes]).unwrap();
        for question in [
            "dies-by-strokes-left",
            "SELECT count(*) FROM checks",
            "SELECT * FROM checks",
        ] {
            let error = answer(&lake, question).unwrap_err();
            assert!(
                error.contains(&victim.to_string()),
                "{bytes} {question}: {error}"
            );
        }
        let other =
            "SELECT count(*) AS n FROM checks WHERE date = '2001-03-01' AND station LIKE 'press%'";
        assert_eq!(answer(&lake, other).unwrap(), [json!({ "n": 48 })]);
    }
    // The same checks with other content: none is believed.
    std::fs::write(&path, &whole).unwrap();
    let mut other = victim.clone();
    other.digest = "0".repeat(32);
    std::fs::write(folder.path().join(other.to_string()), &whole).unwrap();
    let error = answer(&lake, "SELECT 1 AS one").unwrap_err();
    assert!(
        error.contains("the same checks") && error.contains(&victim.to_string()),
        "{error}"
    );
}

#[test]
fn nothing_but_reading_is_done() {
    let (folder, lake) = empty_lake();
    SHIFT.put(&mut Maker::new(), &lake, |x| vec![Some(0.001 * x)]);
    let outside = tempfile::tempdir().unwrap();
    let out = outside.path().join("out.csv");
    std::fs::write(&out, "a\n1\n").unwrap();
    let out = out.to_str().unwrap();
    for statement in [
        &format!("COPY checks TO '{out}' STORED AS CSV")[..],
        &format!("EXPLAIN ANALYZE COPY checks TO '{out}' STORED AS CSV"),
        &format!("CREATE EXTERNAL TABLE other STORED AS CSV LOCATION '{out}'"),
        &format!("SELECT * FROM '{out}'"),
        "INSERT INTO checks SELECT * FROM checks",
        "DELETE FROM checks",
        "UPDATE checks SET tool = 'a'",
        "CREATE TABLE other AS SELECT 1",
        "CREATE VIEW other AS SELECT 1",
        "DROP TABLE checks",
        "DROP VIEW lines",
        "SET datafusion.execution.batch_size = 1",
        "SELECT 1; DROP TABLE checks",
        "dies-by-stroke-left",
    ] {
        let error = answer(&lake, statement).unwrap_err();
        assert!(!error.is_empty(), "{statement}");
    }
    assert_eq!(std::fs::read_to_string(out).unwrap(), "a\n1\n");
    assert_eq!(std::fs::read_dir(outside.path()).unwrap().count(), 1);
    assert_eq!(run(lake.list(None)).unwrap().files.len(), 5);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    for allowed in [
        "EXPLAIN SELECT * FROM checks",
        "SHOW TABLES",
        "DESCRIBE checks",
        "SHOW COLUMNS FROM lines",
    ] {
        assert!(!answer(&lake, allowed).unwrap().is_empty(), "{allowed}");
    }
}

#[test]
fn figures_that_are_no_numbers_are_shown_but_do_not_count() {
    let (_folder, lake) = empty_lake();
    let mut maker = Maker::new();
    let mut n = 0;
    SHIFT.put(&mut maker, &lake, |x| {
        n += 1;
        let odd = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];
        vec![Some(odd.get(n % 7).copied().unwrap_or(0.002 * (x - 1e6)))]
    });
    let rows = answer(&lake, "wear-per-thousand-strokes").unwrap();
    assert!(
        (number(&rows[0], "um_per_1000") - 2.0).abs() < 1e-9,
        "{rows:?}"
    );
    let count = "SELECT count(*) AS n FROM checks WHERE isnan(wear_um) OR abs(wear_um) > 1e300";
    assert_eq!(
        answer(&lake, count).unwrap()[0]["n"],
        json!(240 - rows[0]["points"].as_i64().unwrap())
    );
}

#[test]
fn an_empty_lake_has_empty_answers() {
    let (_folder, lake) = empty_lake();
    for question in questions() {
        assert_eq!(answer(&lake, question.name).unwrap(), Vec::<Value>::new());
        assert!(question.sentence.ends_with('.'), "{question:?}");
    }
    assert_eq!(
        answer(&lake, "SELECT count(*) AS n FROM checks").unwrap(),
        [json!({ "n": 0 })]
    );
}

#[test]
fn the_command_answers_in_every_form() {
    let station = Station::new("press 7");
    station.store(40);
    station.ship(&station.lake(), LATER).unwrap();
    let folder = station.lake_folder();
    let lake = folder.to_str().unwrap();
    let said = |arguments: &[&str]| {
        let output = fleet!(station, arguments).output().unwrap();
        (
            output.status.code(),
            output.stdout,
            String::from_utf8(output.stderr).unwrap(),
        )
    };
    let sql = "SELECT check_number, operator, wear_um, chain_digest, stored_at, date FROM checks WHERE tooth = 12 ORDER BY check_number, flank";
    let (code, table, _) = said(&["query", "--lake", lake, sql]);
    assert_eq!(code, Some(0));
    assert_eq!(String::from_utf8(table).unwrap().lines().count(), 80 + 4);
    let (_, csv, error) = said(&["query", "--lake", lake, sql, "--as", "csv"]);
    let csv = String::from_utf8(csv).unwrap();
    assert!(
        csv.starts_with("check_number,operator,wear_um,chain_digest,stored_at,date\n1,Ada,"),
        "{csv} {error}"
    );
    assert_eq!(csv.lines().count(), 81);
    let (_, parquet, _) = said(&["query", "--lake", lake, sql, "--as", "parquet"]);
    assert!(parquet.starts_with(b"PAR1") && parquet.ends_with(b"PAR1"));
    let (_, list, _) = said(&["query", "--list"]);
    assert_eq!(
        String::from_utf8(list).unwrap().lines().count(),
        questions().count()
    );
    let (code, nothing, error) = said(&["query", "--lake", lake, "dies-by-stroke-left"]);
    assert!(
        code == Some(3) && nothing.is_empty() && error.contains("dies-by-strokes-left"),
        "{error}"
    );
}
