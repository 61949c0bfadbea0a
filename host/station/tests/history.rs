//! The history: what is stored, what is refused, and what a verdict is worth that cannot be stored.

mod inspections;

use flankscope_station::history::{History, HistoryError, Keeper};
use inspections::inspection;
use rusqlite::Connection;

fn keeper(history: History) -> Keeper {
    Keeper::new(history, None, 3, "tester".into())
}

#[test]
fn what_was_stored_is_read_back_and_cycles_count_on() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("press.db");
    let mut history = History::open(&path).unwrap();
    // The counter falls back to 4 when the controller is switched off, and somebody mounts a new die after the fifth check.
    let mut ids = Vec::new();
    for (counter, said) in [
        (10, None),
        (25, None),
        (4, None),
        (9, None),
        (11, Some(0)),
        (14, None),
    ] {
        let check = inspection(counter, "go", "all is well");
        ids.push(history.record(&check, said).unwrap());
    }
    assert_eq!(ids, [1, 2, 3, 4, 5, 6]);
    // A reader beside the writer sees every stored check at once.
    let reader = History::read(&path).unwrap();
    assert_eq!(reader.tools().unwrap(), ["die"]);
    let checks = reader.checks("die").unwrap();
    let cycles: Vec<i64> = checks.iter().map(|c| c.tool_cycles).collect();
    assert_eq!(cycles, [10, 25, 29, 34, 0, 3]);
    let last = checks.last().unwrap();
    assert_eq!(last.flanks.len(), 6);
    assert_eq!(
        (last.flanks[5].tooth, last.flanks[5].flank.as_str()),
        (68, "right")
    );
    assert_eq!(last.flanks[0].wear_um, Some(14.0 / 8.0));
    history
        .record(&inspection(20, "warn", "worn"), None)
        .unwrap();
    assert_eq!(reader.checks("die").unwrap().len(), 7);
    let document: serde_json::Value = serde_json::from_str(&reader.document(7).unwrap()).unwrap();
    assert_eq!(document["verdict"], "warn");
    assert_eq!(document["hashes"]["cad"], "0".repeat(64));
    let error = reader.document(8).unwrap_err().to_string();
    assert!(
        error.contains("no check 8") && error.contains("up to 7"),
        "{error}"
    );
}

#[test]
fn rows_are_only_added() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("press.db");
    let mut history = History::open(&path).unwrap();
    history
        .record(&inspection(1, "no-go", "worn"), None)
        .unwrap();
    history.acknowledge("die", "Ada").unwrap();
    history.audit("Ada", "looked", "at it").unwrap();
    history.keep_baseline("abc", "die", "{}").unwrap();
    let connection = Connection::open(&path).unwrap();
    for sql in [
        "UPDATE inspection SET verdict = 'go'",
        "DELETE FROM inspection",
        "UPDATE flank SET wear_um = 0",
        "DELETE FROM flank",
        "UPDATE acknowledgement SET who = 'Bob'",
        "DELETE FROM acknowledgement",
        "DELETE FROM audit",
        "UPDATE baseline SET document = ''",
    ] {
        let error = connection.execute(sql, []).unwrap_err().to_string();
        assert!(error.contains("only added to"), "{sql}: {error}");
    }
}

#[test]
fn files_of_others_and_of_later_releases_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    drop(History::open(&path("later.db")).unwrap());
    Connection::open(path("later.db"))
        .unwrap()
        .pragma_update(None, "user_version", 2)
        .unwrap();
    Connection::open(path("other.db"))
        .unwrap()
        .execute_batch("CREATE TABLE something (x)")
        .unwrap();
    std::fs::write(
        path("text.db"),
        "no database at all, but long enough to be read as one",
    )
    .unwrap();
    for open in [History::open, History::read] {
        let later = open(&path("later.db")).unwrap_err();
        assert!(
            matches!(
                later,
                HistoryError::Newer {
                    got: 2,
                    known: 1,
                    ..
                }
            ),
            "{later}"
        );
        let other = open(&path("other.db")).unwrap_err();
        assert!(
            matches!(other, HistoryError::Foreign { got: 0, .. }),
            "{other}"
        );
        let text = open(&path("text.db")).unwrap_err().to_string();
        assert!(
            text.contains("text.db") && text.contains("not a database"),
            "{text}"
        );
    }
    let missing = History::read(&path("missing.db")).unwrap_err().to_string();
    assert!(missing.contains("missing.db"), "{missing}");
    assert!(!path("missing.db").exists(), "reading makes no file");
}

#[test]
fn a_verdict_that_cannot_be_stored_is_no_go() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("press.db");
    let mut keeper = keeper(History::open(&path).unwrap());
    let mut first = inspection(1, "go", "all is well");
    keeper.keep(&mut first);
    assert_eq!((first.id, first.verdict.as_str()), (Some(1), "go"));
    // Somebody else holds the file for longer than a writer waits.
    let other = Connection::open(&path).unwrap();
    other.execute_batch("BEGIN IMMEDIATE").unwrap();
    for (verdict, left) in [
        ("go", "indeterminate"),
        ("warn", "indeterminate"),
        ("indeterminate", "indeterminate"),
        ("no-go", "no-go"),
    ] {
        let mut check = inspection(2, verdict, "found");
        keeper.keep(&mut check);
        assert_eq!((check.id, check.verdict.as_str()), (None, left));
        assert!(
            check.reason.contains("cannot store the check"),
            "{}",
            check.reason
        );
    }
    other.execute_batch("COMMIT").unwrap();
    let mut again = inspection(3, "go", "all is well");
    keeper.keep(&mut again);
    assert_eq!((again.id, again.verdict.as_str()), (Some(2), "go"));
}

#[test]
fn a_go_gives_its_phasors_up_after_some_checks_and_no_other_verdict_does() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("press.db");
    let mut keeper = keeper(History::open(&path).unwrap());
    let mut stored = Vec::new();
    for (number, verdict) in (1..).zip(["go", "no-go", "indeterminate", "go", "go", "go", "warn"]) {
        let mut check = inspection(number, verdict, "");
        stored.push((check.phasors[0].clone(), verdict));
        keeper.keep(&mut check);
        assert!(check.id.is_some());
    }
    let history = History::read(&path).unwrap();
    for (at, (phasors, verdict)) in stored.iter().enumerate() {
        let found = history.phasors(&phasors.blake3, phasors.bytes.len());
        // Seven are stored: those of a go that has three or more after it are gone.
        let gone = *verdict == "go" && at + 3 < stored.len();
        match found {
            Ok(found) => {
                assert!(!gone, "check {}", at + 1);
                assert_eq!(found.bytes, phasors.bytes);
            }
            Err(error) => {
                assert!(gone, "check {}: {error}", at + 1);
                assert!(error.to_string().contains(&phasors.blake3), "{error}");
            }
        }
    }
    // A damaged file is named.
    let file = history
        .phasors_folder()
        .join(format!("{}.zz", stored[1].0.blake3));
    let mut bytes = std::fs::read(&file).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(&file, bytes).unwrap();
    let error = history
        .phasors(&stored[1].0.blake3, 4096)
        .unwrap_err()
        .to_string();
    assert!(error.contains(&stored[1].0.blake3), "{error}");
}

#[test]
fn what_is_open_ends_with_an_acknowledgement() {
    let folder = tempfile::tempdir().unwrap();
    let mut history = History::open(&folder.path().join("press.db")).unwrap();
    for verdict in ["go", "no-go", "go"] {
        history.record(&inspection(1, verdict, ""), None).unwrap();
    }
    assert_eq!(history.open_verdicts("die").unwrap(), ["go", "no-go", "go"]);
    assert!(history.open_verdicts("another die").unwrap().is_empty());
    history.acknowledge("die", "Ada").unwrap();
    assert!(history.open_verdicts("die").unwrap().is_empty());
    history.record(&inspection(2, "warn", ""), None).unwrap();
    assert_eq!(history.open_verdicts("die").unwrap(), ["warn"]);
    let noted = history.acknowledgements("die").unwrap();
    assert_eq!(
        (noted[0].who.as_str(), noted[0].inspection),
        ("Ada", Some(3))
    );
}
