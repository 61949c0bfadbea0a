//! A history that somebody else changed: whatever is changed, added or removed is found, and no no-go becomes a go.

mod inspections;

use std::path::{Path, PathBuf};

use flankscope_metrology::verdict::{Shown, Word};
use flankscope_record::die::DieKey;
use flankscope_record::document::Inspection;
use flankscope_record::history::{History, HistoryError, HistoryWriter, Retention};
use flankscope_record::seal::Seals;
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
    history.acknowledge(&die(), 1, "Ada").unwrap();
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
    let triggers: Vec<(String, String)> = connection
        .prepare("SELECT name, sql FROM sqlite_schema WHERE type = 'trigger'")
        .unwrap()
        .query_map([], |row| Ok((row.get(0)?, row.get(1)?)))
        .unwrap()
        .collect::<rusqlite::Result<_>>()
        .unwrap();
    connection
        .execute_batch("PRAGMA ignore_check_constraints = ON; PRAGMA foreign_keys = OFF;")
        .unwrap();
    for (trigger, _) in &triggers {
        connection
            .execute_batch(&format!("DROP TRIGGER {trigger}"))
            .unwrap();
    }
    change(&connection);
    // They are put back: what the file defines is as it was.
    for (_, sql) in triggers {
        connection.execute_batch(&sql).unwrap();
    }
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

/// The column says go, the document no-go; even where somebody trusts that, a replay compares them.
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
        assert!(History::read(&copy, &seals()).is_err(), "{sql}");
        History::trust(&copy, &seals(), "Ada").unwrap();
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
    let other = Seals::open(&folder.path().join("other")).unwrap();
    let error = History::read(&path, &other).unwrap_err().to_string();
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
    history.acknowledge(&strange, 1, "Ada").unwrap();
    assert!(stands(&history, &worn.die));
    history
        .acknowledge(&known("renamed", "g", ""), 1, "Ada")
        .unwrap();
    assert!(!stands(&history, &worn.die));
    // With serial numbers, dies of one design and name are two.
    worn.die = known("die", "g", "A 7");
    history.record(&worn, None).unwrap();
    assert!(stands(&history, &known("renamed", "h", "A 7")));
    assert!(!stands(&history, &known("die", "g", "A 8")));
    history
        .acknowledge(&known("die", "g", "A 8"), 2, "Ada")
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
    // By whatever name it is reached; one with two names is refused, because SQLite would keep two journals.
    let held = first.hold(&die()).unwrap();
    let link = folder.path().join("link.db");
    std::os::unix::fs::symlink(&path, &link).unwrap();
    let through_link = HistoryWriter::new(
        History::open(&link, &seals()).unwrap(),
        None,
        keep(),
        "tester".into(),
    );
    let error = through_link.hold(&die()).unwrap_err();
    assert!(matches!(error, HistoryError::Held { .. }), "{error}");
    drop((held, through_link));
    let hard = folder.path().join("hard.db");
    std::fs::hard_link(&path, &hard).unwrap();
    for name in [&hard, &path] {
        for found in [History::open(name, &seals()), History::read(name, &seals())] {
            let error = found.unwrap_err();
            assert!(
                matches!(error, HistoryError::SeveralNames { names: 2, .. }),
                "{error}"
            );
        }
    }
    std::fs::remove_file(&hard).unwrap();
    drop(History::open(&path, &seals()).unwrap());
}

/// What the issue tried: somebody without the key plants a trigger that stores a go where a no-go is meant.
#[test]
fn a_planted_trigger_changes_nothing_and_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let worn = || Inspection {
        die: die(),
        ..inspection(7, Word::NoGo, "worn")
    };
    for (at, (plant, named)) in [
        (
            "DROP TRIGGER inspection_keeps_UPDATE; \
             CREATE TRIGGER e AFTER INSERT ON inspection WHEN new.verdict = 'no-go' BEGIN \
             UPDATE inspection SET verdict = 'go', document = replace(document, 'no-go', 'go'), reason = '' WHERE id = new.id; END",
            "trigger e on inspection is none of this program's, trigger inspection_keeps_UPDATE on inspection is missing",
        ),
        (
            "CREATE TRIGGER f BEFORE INSERT ON flank BEGIN SELECT raise(IGNORE); END",
            "trigger f on flank is none of this program's",
        ),
        ("CREATE VIEW v AS SELECT 1", "view v is none of this program's"),
        ("CREATE TABLE t (x)", "table t is none of this program's"),
        (
            "CREATE INDEX i ON inspection (verdict)",
            "index i on inspection is none of this program's",
        ),
        (
            "DROP INDEX inspection_of_tool; CREATE INDEX inspection_of_tool ON inspection (tool, id) WHERE verdict = 'go'",
            "index inspection_of_tool on inspection is not as this program makes it",
        ),
        (
            "DROP TRIGGER audit_keeps_DELETE",
            "trigger audit_keeps_DELETE on audit is missing",
        ),
    ]
    .into_iter()
    .enumerate()
    {
        let path = written(&{
            let own = folder.path().join(at.to_string());
            std::fs::create_dir(&own).unwrap();
            own
        });
        // While a watch has it open, and before the next one begins.
        let mut open = History::open(&path, &seals()).unwrap();
        Connection::open(&path).unwrap().execute_batch(plant).unwrap();
        for refused in [
            open.record(&worn(), None).map(drop),
            open.verify(),
            History::open(&path, &seals()).map(drop),
            History::read(&path, &seals()).map(drop),
        ] {
            let said = refused.expect_err(plant).to_string();
            assert!(said.contains(named), "{plant}: {said}");
        }
        drop(open);
        if plant.contains("TABLE t") {
            continue;
        }
        // Somebody answers for it: what does not belong there is taken out.
        History::trust(&path, &seals(), "Ada").unwrap();
        let mut history = History::open(&path, &seals()).unwrap();
        let id = history.record(&worn(), None).unwrap();
        let check = history.check(id).unwrap();
        assert_eq!((check.verdict, check.flanks.len()), (Word::NoGo, 6));
        assert_eq!(history.row_differences(id).unwrap(), []);
    }
}

/// An index that lacks a row hides it from whoever asks by the index, and the chain does not ask by it.
#[test]
fn an_index_that_hides_a_no_go_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path());
    let definition = |sql: &str| {
        let connection = Connection::open(&path).unwrap();
        let set = "PRAGMA writable_schema = ON";
        connection.execute_batch(set).unwrap();
        let edit = "UPDATE sqlite_schema SET sql = ?1 WHERE name = 'inspection_of_tool'";
        assert_eq!(connection.execute(edit, [sql]).unwrap(), 1);
    };
    let own = "CREATE INDEX inspection_of_tool ON inspection (tool, id)";
    definition(&format!("{own} WHERE verdict != 'no-go'"));
    Connection::open(&path)
        .unwrap()
        .execute_batch("REINDEX")
        .unwrap();
    definition(own);
    let hidden: i64 = Connection::open(&path)
        .unwrap()
        .query_row(
            "SELECT count(*) FROM inspection WHERE tool = 'die' AND verdict = 'no-go'",
            [],
            |row| row.get(0),
        )
        .unwrap();
    assert_eq!(hidden, 0, "the attack works");
    let error = History::read(&path, &seals()).unwrap_err().to_string();
    assert!(error.contains("inspection_of_tool"), "{error}");
}

#[test]
fn a_copy_that_is_behind_is_refused_wherever_it_lies_until_somebody_restores_it_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path());
    History::open(&path, &seals())
        .unwrap()
        .acknowledge(&die(), 2, "Ada")
        .unwrap();
    let old = folder.path().join("old.db");
    changed(&path, &old, |_| {});
    // As long as nothing was added, the copy is as good.
    let mut copy = History::open(&old, &seals()).unwrap();
    let worn = |cycles| Inspection {
        die: die(),
        ..inspection(cycles, Word::NoGo, "worn")
    };
    let id = History::open(&path, &seals())
        .unwrap()
        .record(&worn(9), None)
        .unwrap();
    assert_eq!(shown_at_start(&path, &die()).unwrap(), Shown::NoGo);
    // Also where it was opened before.
    let go = Inspection {
        die: die(),
        ..inspection(10, Word::Go, "all is well")
    };
    for refused in [
        copy.record(&go, None).map(drop),
        shown_at_start(&old, &die()).map(drop),
        History::read(&old, &seals()).map(drop),
    ] {
        let error = refused.unwrap_err();
        let said = error.to_string();
        assert!(
            matches!(error, HistoryError::Broken { .. })
                && said.contains(path.to_str().unwrap())
                && said.contains(&format!("a no-go stands (die, check {id} of ")),
            "{said}"
        );
    }
    drop(copy);
    History::trust(&old, &seals(), "Ada").unwrap();
    assert_eq!(shown_at_start(&old, &die()).unwrap(), Shown::Unchecked);
    let said: String = Connection::open(&old)
        .unwrap()
        .query_row(
            "SELECT who || ': ' || detail FROM audit WHERE what = 'trust'",
            [],
            |row| row.get(0),
        )
        .unwrap();
    assert!(
        said.starts_with("Ada: 3 checks are believed") && said.contains(&format!("check {id} of ")),
        "{said}"
    );
    let listed = seals().all_trusted().unwrap();
    assert!(
        listed
            .iter()
            .any(|entry| entry.file == old && entry.by == "Ada")
    );
    // From then on the other one is behind.
    assert!(shown_at_start(&path, &die()).is_err());
}

/// The station remembers what stands against a real die, in whatever file its checks are.
#[test]
fn a_no_go_of_a_real_die_stands_in_every_history_of_the_station() {
    let folder = tempfile::tempdir().unwrap();
    let own = Seals::open(&folder.path().join("station")).unwrap();
    let writer = |name: &str| {
        let history = History::open(&folder.path().join(name), &own).unwrap();
        let mut writer = HistoryWriter::new(history, None, keep(), "tester".into());
        writer.begin(&die(), false, None).unwrap();
        writer
    };
    let mut first = writer("press.db");
    let mut worn = inspection(1, Word::NoGo, "worn");
    worn.die = die();
    worn.origin.simulated = false;
    first.put(&mut worn).unwrap();
    let second = writer("another.db");
    let error = second.hold(&die()).unwrap_err();
    let said = error.to_string();
    assert!(
        matches!(error, HistoryError::StandsElsewhere { .. }) && said.contains("press.db"),
        "{said}"
    );
    let other = DieKey {
        serial: Some("A 8".into()),
        ..die()
    };
    assert!(second.hold(&other).is_ok());
    first.acknowledge(&die(), 1, "Ada").unwrap();
    assert!(second.hold(&die()).is_ok());
    // What it remembers is its own word, too.
    let memory = folder.path().join("station/histories");
    for entry in std::fs::read_dir(&memory).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|ending| ending == "json") {
            let text = std::fs::read_to_string(&path).unwrap();
            std::fs::write(&path, text.replace("\"link\":", "\"link\":1")).unwrap();
        }
    }
    let error = History::open(&folder.path().join("press.db"), &own).unwrap_err();
    assert!(
        error.to_string().contains("not as this station wrote it"),
        "{error}"
    );
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

/// Whatever the reason, an opening that is refused leaves neither a journal nor its index beside the file.
#[test]
fn a_refused_opening_leaves_nothing_beside_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path());
    let refused = folder.path().join("refused.db");
    let older = std::fs::read(&path).unwrap();
    let mut history = History::open(&path, &seals()).unwrap();
    let go = inspection(4, Word::Go, "all is well");
    history.record(&go, None).unwrap();
    drop(history);
    let altered = |sql: &'static str| {
        let path = &path;
        move |to: &Path| {
            changed(path, to, |connection| {
                connection.execute_batch(sql).unwrap()
            })
        }
    };
    type Prepare<'a> = &'a dyn Fn(&Path);
    let prepare: [(&str, Prepare<'_>); 6] = [
        ("an older copy", &|to| std::fs::write(to, &older).unwrap()),
        (
            "a trigger",
            &altered("CREATE TRIGGER e AFTER INSERT ON inspection BEGIN SELECT 1; END"),
        ),
        ("another layout", &altered("PRAGMA user_version = 7")),
        (
            "a broken chain",
            &altered("UPDATE inspection SET tool_cycles = 9"),
        ),
        ("another program's", &|to| {
            let connection = Connection::open(to).unwrap();
            let sql = "PRAGMA journal_mode = wal; CREATE TABLE t (a); INSERT INTO t VALUES (1)";
            connection.execute_batch(sql).unwrap();
        }),
        ("no database", &|to| {
            std::fs::write(to, "name = \"demo\"").unwrap()
        }),
    ];
    for (what, prepare) in prepare {
        prepare(&refused);
        assert!(History::open(&refused, &seals()).is_err(), "{what}");
        assert!(History::read(&refused, &seals()).is_err(), "{what}");
        for suffix in ["-wal", "-shm", "-journal"] {
            let beside = PathBuf::from(format!("{}{suffix}", refused.display()));
            assert!(!beside.exists(), "{what}: {}", beside.display());
        }
        std::fs::remove_file(&refused).unwrap();
    }
}

#[test]
fn links_from_a_position_are_verified_alone_and_read_with_their_checks() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path());
    let copy = folder.path().join("copy/press.db");
    std::fs::create_dir(copy.parent().unwrap()).unwrap();
    changed(&path, &copy, |_| {});
    let history = History::read(&copy, &seals()).unwrap();
    let linked = history.linked_checks(1..=9, 0).unwrap();
    let checks: Vec<_> = linked.iter().map(|linked| &linked.check).collect();
    assert_eq!(
        checks,
        history.checks("die").unwrap().iter().collect::<Vec<_>>()
    );
    assert!(linked.iter().all(|linked| linked.geometry == "0123"));
    let connection = Connection::open(&copy).unwrap();
    let in_chain: Vec<(i64, String)> = connection
        .prepare("SELECT link, digest FROM chain WHERE source = 'inspection' ORDER BY link")
        .unwrap()
        .query_map([], |row| Ok((row.get(0)?, row.get(1)?)))
        .unwrap()
        .collect::<rusqlite::Result<_>>()
        .unwrap();
    let links: Vec<_> = linked.iter().map(|l| (l.link, l.digest.clone())).collect();
    assert_eq!(links, in_chain);
    let before = links[0].0;
    assert_eq!(history.linked_checks(2..=3, before).unwrap(), linked[1..]);
    assert!(
        history.linked_checks(1..=1, before).is_err(),
        "its link is not behind itself"
    );
    let whereabouts = history.whereabouts_after(1, 1).unwrap();
    assert_eq!(
        (whereabouts[0].check, &whereabouts[0].at),
        (2, &checks[1].at)
    );
    assert_eq!(history.station_names().unwrap(), ["press 7"]);
    assert_eq!(history.relinked().unwrap(), None);

    let last = history.verify_links_after(0).unwrap();
    assert_eq!(history.verify_links_after(before).unwrap(), last);
    assert!(
        history.verify_links_after(last + 1).is_err(),
        "there is no such link"
    );
    // A change of a row is found from every position before it, and from none behind it.
    let changed = || {
        let connection = Connection::open(&copy).unwrap();
        connection
            .execute_batch("DROP TRIGGER inspection_keeps_UPDATE")
            .unwrap();
        let sql = "UPDATE inspection SET reason = 'all is fine' WHERE id = 2";
        assert_eq!(connection.execute(sql, []).unwrap(), 1);
    };
    changed();
    for link in 0..last {
        let found = history.verify_links_after(link).is_err();
        assert_eq!(found, link < links[1].0, "from {link}");
    }
    drop(history);
    // Who accepts it as it is has all links made anew.
    History::trust(&copy, &seals(), "Ada").unwrap();
    let history = History::read(&copy, &seals()).unwrap();
    assert!(history.relinked().unwrap().is_some());
    assert_eq!(history.id().unwrap().len(), 32);
    assert_eq!(history.station_key(), seals().station());
}
