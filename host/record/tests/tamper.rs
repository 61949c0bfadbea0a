//! A history that somebody else changed: whatever is changed, added or removed is found, and no no-go becomes a go.

mod inspections;

use std::path::{Path, PathBuf};

use flankscope_metrology::verdict::{Shown, Word};
use flankscope_record::die::DieKey;
use flankscope_record::document::Inspection;
use flankscope_record::history::{History, HistoryError, HistoryWriter, Retention};
use flankscope_record::sink::ResultSink;
use inspections::{inspection, seals};
use rusqlite::types::Value;
use rusqlite::{Connection, params_from_iter};

/// A history with a row of everything, in which a no-go stands.
fn written(folder: &Path) -> PathBuf {
    let path = folder.join("press.db");
    let mut history = History::open(&path, &seals()).unwrap();
    history.audit("Ada", "open", "flankscope").unwrap();
    history.keep_baseline("abc", "die", "{}").unwrap();
    let go = |cycles, reason| Inspection {
        die: die(),
        ..inspection(cycles, Word::Go, reason)
    };
    history.record(&go(1, "all is well"), None).unwrap();
    history.acknowledge(&die(), "Ada").unwrap();
    let mut worn = inspection(2, Word::NoGo, "worn");
    worn.die = die();
    worn.hashes.insert("baseline", "abc".into());
    history.record(&worn, None).unwrap();
    history.record(&go(3, "all is well again"), None).unwrap();
    drop(history);
    path
}

fn keep() -> Retention {
    Retention {
        checks: 3,
        bytes: 10_000_000_000,
    }
}

fn die() -> DieKey {
    DieKey {
        tool: "die".into(),
        geometry: "0123".into(),
        serial: Some("A 7".into()),
    }
}

/// What a watch would begin with: what stands at the press, or why it does not begin.
fn shown_at_start(path: &Path, die: &DieKey) -> Result<Shown, HistoryError> {
    let history = History::open(path, &seals())?;
    history.verify()?;
    let verdicts = history.open_verdicts(die)?;
    Ok(flankscope_metrology::verdict::Latch::resumed(&verdicts).shown())
}

/// A way around the triggers, as anybody with the file has it.
fn changed(from: &Path, to: &Path, change: impl FnOnce(&Connection)) {
    for suffix in ["", "-wal", "-shm"] {
        let name = |path: &Path| PathBuf::from(format!("{}{suffix}", path.display()));
        let _ = std::fs::remove_file(name(to));
        let _ = std::fs::copy(name(from), name(to));
    }
    let connection = Connection::open(to).unwrap();
    let triggers: Vec<String> = connection
        .prepare("SELECT name FROM sqlite_schema WHERE type = 'trigger'")
        .unwrap()
        .query_map([], |row| row.get(0))
        .unwrap()
        .collect::<rusqlite::Result<_>>()
        .unwrap();
    connection
        .execute_batch("PRAGMA ignore_check_constraints = ON; PRAGMA foreign_keys = OFF;")
        .unwrap();
    for trigger in triggers {
        connection
            .execute_batch(&format!("DROP TRIGGER {trigger}"))
            .unwrap();
    }
    change(&connection);
}

const TABLES: [&str; 8] = [
    "identity",
    "kind",
    "baseline",
    "inspection",
    "flank",
    "acknowledgement",
    "audit",
    "chain",
];

fn columns(connection: &Connection, table: &str) -> Vec<String> {
    let statement = connection
        .prepare(&format!("SELECT * FROM {table}"))
        .unwrap();
    statement.column_names().map(str::to_owned).collect()
}

/// The same size and kind, another value.
fn other(value: &Value) -> Value {
    match value {
        Value::Null => Value::Text("go".into()),
        Value::Integer(number) => Value::Integer(number ^ 1),
        Value::Real(number) => Value::Real(number + 0.5),
        Value::Text(text) if text == "no-go" => Value::Text("go".into()),
        Value::Text(text) if text == "go" => Value::Text("warn".into()),
        Value::Text(text) if text == "left" => Value::Text("right ".trim().into()),
        Value::Text(text) => Value::Text(format!("{text}.")),
        Value::Blob(_) => Value::Null,
    }
}

#[test]
fn every_value_of_every_row_is_held_by_the_chain() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path());
    let copy = folder.path().join("copy/press.db");
    std::fs::create_dir(copy.parent().unwrap()).unwrap();
    // Another place, which this station never wrote to: the chain alone must tell.
    let untouched = || changed(&path, &copy, |_| {});
    untouched();
    assert_eq!(shown_at_start(&copy, &die()).unwrap(), Shown::NoGo);
    let connection = Connection::open(&path).unwrap();
    let (mut tampered, mut removed) = (0, 0);
    for table in TABLES {
        let names = columns(&connection, table);
        let count: i64 = connection
            .query_row(&format!("SELECT count(*) FROM {table}"), [], |row| {
                row.get(0)
            })
            .unwrap();
        assert!(count > 0, "{table} has a row to tamper with");
        let place = |row: i64, all: &str| {
            let order = names[..names.len().min(3)].join(", ");
            format!("SELECT {all} FROM {table} ORDER BY {order} LIMIT 1 OFFSET {row}")
        };
        for row in 0..count {
            let values: Vec<Value> = connection
                .query_row(&place(row, "*"), [], |row| {
                    (0..names.len()).map(|at| row.get(at)).collect()
                })
                .unwrap();
            // A row is found again by all that it says.
            let same: Vec<String> = (1..)
                .zip(&names)
                .map(|(at, name)| format!("{name} IS ?{at}"))
                .collect();
            let this = same.join(" AND ");
            for (name, value) in names.iter().zip(&values) {
                let mut all = values.clone();
                all.push(other(value));
                let sql = format!("UPDATE {table} SET {name} = ?{} WHERE {this}", all.len());
                let mut done = 0;
                changed(&path, &copy, |connection| {
                    done = connection.execute(&sql, params_from_iter(all)).unwrap_or(0);
                });
                if done == 0 {
                    // Its type or key forbids the other value.
                    continue;
                }
                tampered += 1;
                let found = shown_at_start(&copy, &die());
                assert!(found.is_err(), "{table}.{name} of row {row}: {found:?}");
            }
            changed(&path, &copy, |connection| {
                let sql = format!("DELETE FROM {table} WHERE {this}");
                assert_eq!(
                    connection.execute(&sql, params_from_iter(&values)).unwrap(),
                    1
                );
            });
            let last = table == "chain" && row + 1 == count;
            let found = shown_at_start(&copy, &die());
            assert!(found.is_err(), "{table} without row {row}: {found:?}{last}");
            removed += 1;
        }
    }
    println!("{tampered} values changed, {removed} rows removed, none believed");
    assert!(tampered > 200 && removed > 30, "{tampered} {removed}");
}

/// Elsewhere than where the station wrote it, a history whose layout says something else is refused, too.
#[test]
fn another_layout_frees_nobody_from_the_chain() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path());
    let copy = folder.path().join("copy.db");
    for layout in [-1, 0, 2] {
        changed(&path, &copy, |connection| {
            connection
                .pragma_update(None, "user_version", layout)
                .unwrap();
            let edit = "UPDATE inspection SET verdict = 'go', reason = 'all is well'";
            connection.execute_batch(edit).unwrap();
        });
        for found in [
            History::read(&copy, &seals()),
            History::open(&copy, &seals()),
        ] {
            let error = found.expect_err("refused").to_string();
            assert!(error.contains("reads and writes layout 1"), "{error}");
        }
    }
}

/// The column says go, the document no-go; the chain apart, a replay compares them.
#[test]
fn a_row_that_says_otherwise_than_its_document_is_a_difference() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path());
    let of = |path: &Path| {
        History::read(path, &seals())
            .unwrap()
            .row_differences(2)
            .unwrap()
    };
    assert_eq!(of(&path), []);
    let copy = folder.path().join("copy.db");
    for (sql, named) in [
        (
            "UPDATE inspection SET verdict = 'go' WHERE id = 2",
            "column verdict",
        ),
        (
            "UPDATE inspection SET serial = 'A 8' WHERE id = 2",
            "column serial",
        ),
        (
            "UPDATE flank SET wear_um = 0 WHERE inspection = 2 AND tooth = 40 AND flank = 'left'",
            "column wear_um of tooth 40 left",
        ),
        (
            "DELETE FROM flank WHERE inspection = 2 AND tooth = 40 AND flank = 'left'",
            "column flanks",
        ),
    ] {
        changed(&path, &copy, |connection| {
            assert_eq!(connection.execute(sql, []).unwrap(), 1, "{sql}");
        });
        let found = of(&copy);
        assert_eq!(found.len(), 1, "{found:?}");
        assert_eq!(found[0].what, named);
    }
}

#[test]
fn rows_that_are_cut_off_with_their_links_are_missed() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path());
    let older = folder.path().join("older.db");
    changed(&path, &older, |_| {});
    let mut history = History::open(&path, &seals()).unwrap();
    history
        .record(&inspection(9, Word::NoGo, "worn"), None)
        .unwrap();
    drop(history);
    // The file as it was before the no-go, whole in itself.
    changed(&older, &path, |_| {});
    for opened in [
        History::open(&path, &seals()),
        History::read(&path, &seals()),
    ] {
        let error = opened.unwrap_err();
        assert!(
            matches!(error, HistoryError::Broken { .. })
                && error.to_string().contains("an older copy"),
            "{error}"
        );
    }
    // Another file in its place.
    let another = folder.path().join("another.db");
    drop(History::open(&another, &seals()).unwrap());
    changed(&another, &path, |_| {});
    assert!(History::open(&path, &seals()).is_err());
    // Nothing at all: the no-go that stood is missed, unless somebody answers for it.
    for suffix in ["", "-wal", "-shm"] {
        let _ = std::fs::remove_file(format!("{}{suffix}", path.display()));
    }
    let error = History::open(&path, &seals()).unwrap_err();
    assert!(matches!(error, HistoryError::Gone { .. }), "{error}");
    assert!(!path.exists(), "and none is made");
    History::trust(&path, &seals(), "Ada").unwrap();
    assert!(History::open(&path, &seals()).is_ok());
    // Where nothing stood, a history may go and begin anew.
    std::fs::remove_file(&another).unwrap();
    assert!(History::open(&another, &seals()).is_ok());
}

#[test]
fn a_broken_or_foreign_history_counts_again_once_somebody_answers_for_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path());
    let broken = folder.path().join("broken.db");
    changed(&path, &broken, |connection| {
        let sql = "UPDATE inspection SET tool_cycles = tool_cycles + 1";
        connection.execute(sql, []).unwrap();
    });
    let error = shown_at_start(&broken, &die()).unwrap_err().to_string();
    assert!(
        error.contains("inspection 1") && error.contains("flankscope trust"),
        "{error}"
    );
    History::trust(&broken, &seals(), "Ada").unwrap();
    assert_eq!(shown_at_start(&broken, &die()).unwrap(), Shown::NoGo);
    // Another station's, by its own id.
    let other = flankscope_record::seal::Seals::open(&folder.path().join("other")).unwrap();
    let history = History::read(&path, &other).unwrap();
    let error = history.verify().unwrap_err().to_string();
    assert!(
        error.contains(&seals().station()) && error.contains(&other.station()),
        "{error}"
    );
    History::trust(&path, &other, "Bob").unwrap();
    History::read(&path, &other).unwrap().verify().unwrap();
    let said: Vec<String> = Connection::open(&path)
        .unwrap()
        .prepare("SELECT who FROM audit WHERE what = 'trust'")
        .unwrap()
        .query_map([], |row| row.get(0))
        .unwrap()
        .collect::<rusqlite::Result<_>>()
        .unwrap();
    assert_eq!(said, ["Bob"]);
}

#[test]
fn a_no_go_stands_against_the_die_whatever_its_tool_file_calls_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("press.db");
    let mut history = History::open(&path, &seals()).unwrap();
    let mut worn = inspection(1, Word::NoGo, "worn");
    let known = |tool: &str, geometry: &str, serial: &str| DieKey {
        tool: tool.into(),
        geometry: geometry.into(),
        serial: (!serial.is_empty()).then(|| serial.into()),
    };
    worn.die = known("die", "g", "");
    history.record(&worn, None).unwrap();
    let stands =
        |history: &History, die: &DieKey| history.open_verdicts(die).unwrap() == [Word::NoGo];
    for same in [
        known("die", "g", ""),
        known("another name", "g", ""),
        known("die", "another CAD", ""),
        known("die", "g", "A 7"),
    ] {
        assert!(stands(&history, &same), "{same:?}");
    }
    let strange = known("another name", "another CAD", "");
    assert!(!stands(&history, &strange));
    // Who acknowledges another die acknowledges nothing of this one.
    history.acknowledge(&strange, "Ada").unwrap();
    assert!(stands(&history, &worn.die));
    history
        .acknowledge(&known("renamed", "g", ""), "Ada")
        .unwrap();
    assert!(!stands(&history, &worn.die));
    // With serial numbers, dies of one design and name are two.
    worn.die = known("die", "g", "A 7");
    history.record(&worn, None).unwrap();
    assert!(stands(&history, &known("renamed", "h", "A 7")));
    assert!(!stands(&history, &known("die", "g", "A 8")));
    history
        .acknowledge(&known("die", "g", "A 8"), "Ada")
        .unwrap();
    assert!(stands(&history, &worn.die) && stands(&history, &known("die", "g", "")));
}

#[test]
fn one_watch_at_a_time_holds_a_die() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("press.db");
    let writer = || {
        let history = History::open(&path, &seals()).unwrap();
        HistoryWriter::new(history, None, keep(), "tester".into())
    };
    let mut first = writer();
    first
        .put(&mut inspection(1, Word::Go, "all is well"))
        .unwrap();
    let held = first.hold(&die()).unwrap();
    let second = writer();
    let renamed = DieKey {
        tool: "another name".into(),
        serial: None,
        ..die()
    };
    for same in [die(), renamed] {
        let error = second.hold(&same).unwrap_err();
        let said = error.to_string();
        assert!(
            matches!(error, HistoryError::Held { .. }) && said.contains("is watched by tester"),
            "{said}"
        );
    }
    let other = DieKey {
        serial: Some("A 8".into()),
        ..die()
    };
    drop(second.hold(&other).unwrap());
    drop(held);
    drop(second.hold(&die()).unwrap());
    let left = std::fs::read_dir(folder.path().join("press.db.watches")).unwrap();
    assert_eq!(left.count(), 0);
}

#[test]
fn a_history_is_not_for_everybodys_eyes() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("press.db");
    let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode() & 0o7777;
    let mut writer = HistoryWriter::new(
        History::open(&path, &seals()).unwrap(),
        None,
        keep(),
        "tester".into(),
    );
    writer
        .put(&mut inspection(1, Word::Go, "all is well"))
        .unwrap();
    let wal = folder.path().join("press.db-wal");
    assert_eq!([mode(&path), mode(&wal)], [0o640; 2]);
    let phasors = folder.path().join("press.db.phasors");
    assert_eq!(mode(&phasors), 0o750);
    for file in std::fs::read_dir(&phasors).unwrap() {
        assert_eq!(mode(&file.unwrap().path()), 0o640);
    }
    drop(writer);
    // One that others may read is closed.
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o644)).unwrap();
    drop(History::open(&path, &seals()).unwrap());
    assert_eq!(mode(&path), 0o640);
}
