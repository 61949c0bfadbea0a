//! The history: what is stored, what is refused, and what a verdict is worth that cannot be stored.

mod inspections;

use std::path::Path;

use flankscope_metrology::verdict::{Code, Shown, Word};
use flankscope_record::die::DieKey;
use flankscope_record::document::{FeatureId, Inspection, LastExposure};
use flankscope_record::history::{
    History, HistoryError, HistoryWriter, Retention, clock_set_back, csv, series,
};
use flankscope_record::origin::{HeadId, Link, Origin, Setting};
use flankscope_record::seal::Seals;
use flankscope_record::sink::ResultSink;
use inspections::{inspection, seals};
use rusqlite::Connection;

fn writer(history: History) -> HistoryWriter {
    HistoryWriter::new(
        history,
        None,
        Retention {
            checks: 3,
            bytes: 10_000_000_000,
        },
        "tester".into(),
    )
}

fn die_key(tool: &str) -> DieKey {
    DieKey {
        tool: tool.into(),
        geometry: format!("geometry of {tool}"),
        serial: None,
    }
}

fn word(text: &str) -> Word {
    text.parse().unwrap()
}

#[test]
fn what_was_stored_is_read_back_and_cycles_count_on() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("press.db");
    let mut history = History::open(&path, &seals()).unwrap();
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
        let check = inspection(counter, Word::Go, "all is well");
        ids.push(history.record(&check, said).unwrap());
    }
    assert_eq!(ids, [1, 2, 3, 4, 5, 6]);
    // A reader beside the writer sees every stored check at once.
    let reader = History::read(&path, &seals()).unwrap();
    assert_eq!(reader.tools().unwrap(), ["die"]);
    let checks = reader.checks("die").unwrap();
    let cycles: Vec<i64> = checks.iter().map(|c| c.tool_cycles).collect();
    assert_eq!(cycles, [10, 25, 29, 34, 0, 3]);
    assert_eq!(clock_set_back(&checks), Vec::<String>::new());
    let mut dated = checks.clone();
    dated[3].at = "2020-01-31T12:00:05.000Z".into();
    let said = clock_set_back(&dated);
    assert!(
        said.len() == 1 && said[0].contains("check 4 is dated 2020-01-31"),
        "{said:?}"
    );
    let last = checks.last().unwrap();
    assert_eq!(last.flanks.len(), 6);
    assert_eq!(
        (last.flanks[5].id.tooth, last.flanks[5].id.flank.word()),
        (68, "right")
    );
    assert_eq!(last.flanks[0].wear_um, Some(14.0 / 8.0));
    history
        .record(&inspection(20, Word::Warn, "worn"), None)
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
    let mut history = History::open(&path, &seals()).unwrap();
    history
        .record(&inspection(1, Word::NoGo, "worn"), None)
        .unwrap();
    history.acknowledge(&die_key("die"), 1, "Ada").unwrap();
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
fn files_of_others_and_of_other_layouts_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    drop(History::open(&path("layout.db"), &seals()).unwrap());
    Connection::open(path("other.db"))
        .unwrap()
        .execute_batch("CREATE TABLE something (x)")
        .unwrap();
    std::fs::write(
        path("text.db"),
        "no database at all, but long enough to be read as one",
    )
    .unwrap();
    for (open, layout) in [
        (History::open as fn(&Path, &Seals) -> _, 2),
        (History::read, 0),
    ] {
        Connection::open(path("layout.db"))
            .unwrap()
            .pragma_update(None, "user_version", layout)
            .unwrap();
        let other_layout = open(&path("layout.db"), &seals()).unwrap_err();
        assert!(
            matches!(
                other_layout,
                HistoryError::Layout {
                    got,
                    expected: 1,
                    ..
                } if got == layout
            ),
            "{other_layout}"
        );
        let said = other_layout.to_string();
        assert!(
            said.contains(&format!("layout {layout},")) && said.contains("writes layout 1"),
            "{said}"
        );
        let other = open(&path("other.db"), &seals()).unwrap_err();
        assert!(
            matches!(other, HistoryError::Foreign { got: 0, .. }),
            "{other}"
        );
        let text = open(&path("text.db"), &seals()).unwrap_err().to_string();
        assert!(
            text.contains("text.db") && text.contains("not a database"),
            "{text}"
        );
    }
    let missing = History::read(&path("missing.db"), &seals())
        .unwrap_err()
        .to_string();
    assert!(missing.contains("missing.db"), "{missing}");
    assert!(!path("missing.db").exists(), "reading makes no file");
}

#[test]
fn a_verdict_that_cannot_be_stored_is_no_go() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("press.db");
    let mut writer = writer(History::open(&path, &seals()).unwrap());
    let mut first = inspection(1, Word::Go, "all is well");
    writer.put(&mut first).unwrap();
    assert_eq!((first.id, first.verdict), (Some(1), Word::Go));
    // Somebody else holds the file for longer than a writer waits.
    let other = Connection::open(&path).unwrap();
    other.execute_batch("BEGIN IMMEDIATE").unwrap();
    for (verdict, left) in [
        (Word::Go, Word::Indeterminate),
        (Word::Warn, Word::Indeterminate),
        (Word::Indeterminate, Word::Indeterminate),
        (Word::NoGo, Word::NoGo),
    ] {
        let mut check = inspection(2, verdict, "found");
        writer.put(&mut check).unwrap();
        assert_eq!((check.id, check.verdict), (None, left));
        assert!(
            check.reason.contains("cannot store the check"),
            "{}",
            check.reason
        );
    }
    other.execute_batch("COMMIT").unwrap();
    let mut again = inspection(3, Word::Go, "all is well");
    writer.put(&mut again).unwrap();
    assert_eq!((again.id, again.verdict), (Some(2), Word::Go));
}

#[test]
fn a_go_gives_its_phasors_up_after_some_checks_and_no_other_verdict_does() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("press.db");
    let mut writer = writer(History::open(&path, &seals()).unwrap());
    let mut stored = Vec::new();
    for (number, verdict) in
        (1..).zip(["go", "no-go", "indeterminate", "go", "go", "go", "warn"].map(word))
    {
        let mut check = inspection(number, verdict, "");
        stored.push((check.phasors[0].clone(), verdict));
        writer.put(&mut check).unwrap();
        assert!(check.id.is_some());
    }
    let history = History::read(&path, &seals()).unwrap();
    for (at, (phasors, verdict)) in stored.iter().enumerate() {
        let found = history.phasors(&phasors.blake3, phasors.bytes.len());
        // Seven are stored: those of a go that has three or more after it are gone.
        let gone = *verdict == Word::Go && at + 3 < stored.len();
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

/// Two checks that saw the same to the last bit share a file: it stays as long as one of them keeps it.
#[test]
fn a_file_that_another_check_names_is_not_given_up() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("press.db");
    let mut writer = writer(History::open(&path, &seals()).unwrap());
    // The first go, a no-go with the same phasors, and goes of their own.
    let verdicts = ["go", "no-go", "go", "go", "go", "go"].map(word);
    for (number, verdict) in [1, 1, 3, 4, 5, 6].into_iter().zip(verdicts) {
        writer.put(&mut inspection(number, verdict, "")).unwrap();
    }
    let history = History::read(&path, &seals()).unwrap();
    let there = |number| {
        let phasors = &inspection(number, Word::Go, "").phasors[0];
        history
            .phasors(&phasors.blake3, phasors.bytes.len())
            .is_ok()
    };
    assert!(there(1), "the no-go needs it");
    assert!(!there(3) && there(4) && there(5) && there(6));
}

#[test]
fn room_is_made_by_rule_and_a_no_go_keeps_its_phasors() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("press.db");
    let one = {
        let mut writer = writer(History::open(&path, &seals()).unwrap());
        writer.put(&mut inspection(1, Word::NoGo, "")).unwrap();
        let files = std::fs::read_dir(folder.path().join("press.db.phasors")).unwrap();
        files
            .map(|file| file.unwrap().metadata().unwrap().len())
            .sum::<u64>()
    };
    // Room for four: of the no-go, and of three more.
    let history = History::open(&path, &seals()).unwrap();
    let mut writer = HistoryWriter::new(
        history,
        None,
        Retention {
            checks: 1000,
            bytes: 4 * one + one / 2,
        },
        "tester".into(),
    );
    assert_eq!(writer.room().unwrap(), None);
    let verdicts = ["indeterminate", "go", "warn", "go", "indeterminate", "go"].map(word);
    let kept = |numbers: &[u32]| {
        let history = History::read(&path, &seals()).unwrap();
        let there = |number: &u32| {
            let phasors = &inspection(*number, Word::Go, "").phasors[0];
            history
                .phasors(&phasors.blake3, phasors.bytes.len())
                .is_ok()
        };
        (1..8).filter(there).collect::<Vec<u32>>() == numbers
    };
    for ((number, verdict), left) in (2..).zip(verdicts).zip([
        &[1, 2][..],
        &[1, 2, 3],
        &[1, 2, 3, 4],
        // The oldest go, then the next, then the warning.
        &[1, 2, 4, 5],
        &[1, 2, 4, 6],
        &[1, 2, 6, 7],
    ]) {
        writer.put(&mut inspection(number, verdict, "")).unwrap();
        assert!(kept(left), "after check {number}: {left:?}");
    }
    let said = writer.room().unwrap().unwrap();
    assert!(
        said.contains("of 4 checks") && said.contains("a no-go keeps"),
        "{said}"
    );
}

/// As an archive has it, or another user.
#[test]
fn a_history_in_a_folder_that_may_only_be_read_is_read() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("press 7?.db");
    let mut history = History::open(&path, &seals()).unwrap();
    history
        .record(&inspection(1, Word::Go, "all is well"), None)
        .unwrap();
    drop(history);
    let read_only = |mode| {
        let rights = std::fs::Permissions::from_mode(mode);
        std::fs::set_permissions(folder.path(), rights).unwrap();
    };
    read_only(0o555);
    // Root may write everywhere; with the journal's files gone the file is at least read without them.
    let history = History::read(&path, &seals()).unwrap();
    history.verify().unwrap();
    assert_eq!(history.checks("die").unwrap().len(), 1);
    drop(history);
    read_only(0o755);
}

#[test]
fn what_is_open_ends_with_an_acknowledgement() {
    let folder = tempfile::tempdir().unwrap();
    let mut history = History::open(&folder.path().join("press.db"), &seals()).unwrap();
    for verdict in ["go", "no-go", "go"].map(word) {
        history.record(&inspection(1, verdict, ""), None).unwrap();
    }
    assert_eq!(
        history.open_verdicts(&die_key("die")).unwrap(),
        ["go", "no-go", "go"].map(word)
    );
    assert!(
        history
            .open_verdicts(&die_key("another die"))
            .unwrap()
            .is_empty()
    );
    history.acknowledge(&die_key("die"), 3, "Ada").unwrap();
    assert!(history.open_verdicts(&die_key("die")).unwrap().is_empty());
    history
        .record(&inspection(2, Word::Warn, ""), None)
        .unwrap();
    assert_eq!(
        history.open_verdicts(&die_key("die")).unwrap(),
        [Word::Warn]
    );
    let noted = history.acknowledgements("die").unwrap();
    assert_eq!(
        (noted[0].who.as_str(), noted[0].inspection),
        ("Ada", Some(3))
    );
}

#[test]
fn acknowledging_clears_no_no_go_that_is_newer_than_the_one_that_was_seen() {
    let folder = tempfile::tempdir().unwrap();
    let mut history = History::open(&folder.path().join("press.db"), &seals()).unwrap();
    let die = die_key("die");
    for verdict in ["no-go", "no-go", "go"].map(word) {
        history.record(&inspection(1, verdict, ""), None).unwrap();
    }
    let standing = |history: &History| history.standing_no_gos().unwrap().len();
    // The first no-go was seen, the second was not.
    let refused = history.acknowledge(&die, 1, "Ada").unwrap_err();
    assert!(matches!(refused, HistoryError::NewerNoGo { seen: 1, .. }));
    for (check, tool) in [(1, None), (3, None), (2, Some("another die"))] {
        let refused = history.acknowledge_no_go(check, tool, "Ada").unwrap_err();
        assert!(matches!(refused, HistoryError::NotStanding { .. }));
    }
    assert_eq!(standing(&history), 1);
    assert!(history.acknowledgements("die").unwrap().is_empty());
    history.acknowledge_no_go(2, Some("die"), "Ada").unwrap();
    assert_eq!(standing(&history), 0);
    // The go after it was not seen and stays open.
    assert_eq!(history.open_verdicts(&die).unwrap(), [Word::Go]);
    // Acknowledged by another person meanwhile.
    let refused = history.acknowledge_no_go(2, None, "Bob").unwrap_err();
    assert!(matches!(
        refused,
        HistoryError::NotStanding { check: 2, .. }
    ));
    history.acknowledge(&die, 3, "Ada").unwrap();
    assert!(history.open_verdicts(&die).unwrap().is_empty());
}

#[test]
fn acknowledgements_that_race_with_new_no_gos_clear_none_unseen() {
    const RACES: usize = 200;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("press.db");
    let mut press = History::open(&path, &seals()).unwrap();
    let mut person = History::open(&path, &seals()).unwrap();
    let is_over = std::sync::atomic::AtomicBool::new(false);
    let order = std::sync::atomic::Ordering::SeqCst;
    let (mut accepted, mut refused) = (0, 0);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            while !is_over.load(order) {
                press.record(&inspection(1, Word::NoGo, ""), None).unwrap();
            }
        });
        while accepted + refused < RACES {
            let Some(shown) = person.standing_no_gos().unwrap().pop() else {
                continue;
            };
            // The no-go is on the screen; the person types.
            std::thread::yield_now();
            match person.acknowledge_no_go(shown.check, None, "Ada") {
                Ok(()) => accepted += 1,
                Err(HistoryError::NotStanding { .. } | HistoryError::NewerNoGo { .. }) => {
                    refused += 1
                }
                Err(error) => panic!("{error}"),
            }
        }
        is_over.store(true, order);
    });
    // In the order in which rows were stored, no no-go before an acknowledgement is newer than the one that it names.
    let connection = Connection::open(&path).unwrap();
    let unseen: i64 = connection
        .query_row(
            "SELECT count(*) FROM acknowledgement AS noted \
             JOIN chain AS note ON note.source = 'acknowledgement' AND note.key = CAST(noted.id AS TEXT) \
             JOIN chain AS made ON made.source = 'inspection' AND made.link < note.link \
             WHERE CAST(made.key AS INTEGER) > noted.inspection",
            [],
            |row| row.get(0),
        )
        .unwrap();
    assert_eq!(unseen, 0, "{accepted} accepted, {refused} refused");
}

/// A check of recorded frames.
fn recording(press_cycles: u32, verdict: Word) -> Inspection {
    let check = inspection(press_cycles, verdict, "");
    Inspection {
        origin: Origin {
            link: "recorded frames".into(),
            ..check.origin.clone()
        },
        ..check
    }
}

#[test]
fn a_recording_neither_sets_nor_clears_a_latch() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("press.db");
    let mut writer = writer(History::open(&path, &seals()).unwrap());
    let reader = History::read(&path, &seals()).unwrap();
    let die = die_key("die");
    let shown = |writer: &HistoryWriter| writer.latch(&die).unwrap().shown();
    let open = || -> Vec<i64> {
        let no_gos = reader.standing_no_gos().unwrap();
        no_gos.iter().map(|no_go| no_go.check).collect()
    };
    for link in ["recorded frames", "recorded clouds"] {
        let mut no_go = recording(1, Word::NoGo);
        no_go.origin.link = link.into();
        writer.put(&mut no_go).unwrap();
    }
    assert_eq!((open(), shown(&writer)), (vec![], Shown::Unchecked));
    assert!(reader.open_verdicts(&die).unwrap().is_empty());
    // There is nothing to acknowledge.
    let mut person = History::open(&path, &seals()).unwrap();
    let refused = person.acknowledge_no_go(2, None, "Ada").unwrap_err();
    assert!(matches!(
        refused,
        HistoryError::NotStanding { check: 2, .. }
    ));
    // Neither does the go of a recording clear the no-go of the press, nor does its no-go replace it.
    writer.put(&mut inspection(2, Word::NoGo, "")).unwrap();
    for verdict in [Word::Go, Word::Go, Word::Go, Word::NoGo] {
        writer.put(&mut recording(2, verdict)).unwrap();
    }
    assert_eq!((open(), shown(&writer)), (vec![3], Shown::NoGo));
    // With the recordings after it unseen, the no-go of the press is the newest one.
    person.acknowledge_no_go(3, None, "Ada").unwrap();
    assert_eq!((open(), shown(&writer)), (vec![], Shown::Unchecked));
    // Three recorded goes do not clear a warning.
    writer.put(&mut inspection(3, Word::Warn, "")).unwrap();
    for _ in 0..3 {
        writer.put(&mut recording(3, Word::Go)).unwrap();
    }
    let mut latch = writer.latch(&die).unwrap();
    assert_eq!(latch.take(Word::Go), Shown::Warn);
}

#[test]
fn cycles_of_the_press_count_on_across_recordings() {
    let folder = tempfile::tempdir().unwrap();
    let mut history = History::open(&folder.path().join("press.db"), &seals()).unwrap();
    let mut cycles = |check: Inspection| {
        let id = history.record(&check, None).unwrap();
        history.check(id).unwrap().tool_cycles
    };
    assert_eq!(cycles(inspection(100, Word::Go, "")), 100);
    cycles(recording(0, Word::Go));
    cycles(recording(4_000, Word::Go));
    assert_eq!(cycles(inspection(107, Word::Go, "")), 107);
}

#[test]
fn a_recording_is_stored_and_is_never_the_last_check() {
    let folder = tempfile::tempdir().unwrap();
    let mut history = History::open(&folder.path().join("press.db"), &seals()).unwrap();
    let recording = || recording(1, Word::Go);
    history.record(&recording(), None).unwrap();
    let last = history.last_checks().unwrap().pop().unwrap();
    assert_eq!(last.check, None);
    assert_eq!(last.recording.unwrap().id, 1);
    let exposure = LastExposure::before_now(std::time::Duration::from_secs(3));
    let live = Inspection {
        last_exposure: Some(exposure.clone()),
        ..inspection(2, Word::Warn, "")
    };
    history.record(&live, None).unwrap();
    history.record(&recording(), None).unwrap();
    let last = history.last_checks().unwrap().pop().unwrap();
    assert_eq!(last.check.unwrap().id, 2);
    assert_eq!(last.exposure, Some(exposure));
    assert_eq!(last.recording.unwrap().id, 3);
    assert_eq!(last.die, die_key("die"));
    assert!(history.newest_date().unwrap() >= Some(history.check(3).unwrap().at));
    // Newer than the last recording, the check is all there is.
    history.record(&live, None).unwrap();
    let last = history.last_checks().unwrap().pop().unwrap();
    assert_eq!((last.check.unwrap().id, last.recording), (4, None));
}

/// A check that says where it comes from.
fn check_at(link: &str, press_cycles: u32) -> Inspection {
    let setting = Setting {
        link: link.parse::<Link>().unwrap(),
        station: "press 7".into(),
        operator: Some("Ada".into()),
    };
    let head = HeadId {
        name: "demo, 20 mm".into(),
        blake3: "ab".repeat(32),
        seal: "signed".into(),
    };
    Inspection {
        origin: Origin::new(&setting, head),
        ..inspection(press_cycles, Word::Go, "all is well")
    }
}

#[test]
fn simulated_and_real_checks_never_share_a_history() {
    let folder = tempfile::tempdir().unwrap();
    for (first, other, holds) in [
        ("sim", "/dev/ttyACM0", "the simulated bench"),
        ("/dev/ttyACM0", "qemu", "a real press"),
    ] {
        let path = folder.path().join(holds);
        let mut history = History::open(&path, &seals()).unwrap();
        assert_eq!(history.kind().unwrap(), None);
        history.record(&check_at(first, 1), None).unwrap();
        let error = history.record(&check_at(other, 2), None).unwrap_err();
        assert!(
            matches!(error, HistoryError::OtherKind { simulated, .. } if simulated == (first == "sim")),
            "{error}"
        );
        let said = error.to_string();
        assert!(said.contains(&format!("holds checks of {holds}")), "{said}");
        // Already when it is opened, before anything moves.
        assert!(history.takes(other == "qemu").is_err());
        assert!(history.takes(first == "sim").is_ok());
        let mut writer = writer(history);
        let mut refused = check_at(other, 3);
        writer.put(&mut refused).unwrap();
        assert_eq!((refused.id, refused.verdict), (None, Word::Indeterminate));
        let reader = History::read(&path, &seals()).unwrap();
        assert_eq!(reader.checks("die").unwrap().len(), 1);
        let connection = Connection::open(&path).unwrap();
        for sql in [
            "UPDATE kind SET simulated = 1 - simulated",
            "DELETE FROM kind",
        ] {
            assert!(connection.execute(sql, []).is_err(), "{sql}");
        }
    }
}

#[test]
fn a_check_says_where_it_comes_from_in_row_document_and_table() {
    let folder = tempfile::tempdir().unwrap();
    let mut history = History::open(&folder.path().join("press.db"), &seals()).unwrap();
    let stored = check_at("sim", 1);
    history.record(&stored, None).unwrap();
    let checks = history.checks("die").unwrap();
    assert_eq!(checks[0].origin, stored.origin);
    assert!(checks[0].origin.simulated);
    let document: serde_json::Value = serde_json::from_str(&history.document(1).unwrap()).unwrap();
    for (key, value) in [
        ("id", serde_json::json!(1)),
        ("link", "sim".into()),
        ("simulated", true.into()),
        ("station", "press 7".into()),
        ("operator", "Ada".into()),
        ("date", stored.date.as_str().into()),
        ("tool", "die".into()),
    ] {
        assert_eq!(document[key], value, "{key}");
    }
    assert_eq!(document["head"]["name"], "demo, 20 mm");
    assert_eq!(document["head"]["blake3"], "ab".repeat(32));
    let mut table = Vec::new();
    csv(&checks, &mut table).unwrap();
    let table = String::from_utf8(table).unwrap();
    let mut lines = table.lines();
    assert!(
        lines
            .next()
            .unwrap()
            .ends_with("code,link,simulated,head,head_blake3,station,operator,patch")
    );
    let row = format!(",sim,true,\"demo, 20 mm\",{},press 7,Ada,", "ab".repeat(32));
    assert!(lines.all(|line| line.ends_with(&row)), "{table}");
}

/// What the file says is one of four words and a known reason, or it is not read: nothing is taken for a go.
#[test]
fn words_outlive_the_file_and_strange_ones_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    for (at, verdict) in Word::ALL.into_iter().enumerate() {
        let path = folder.path().join(format!("{verdict}.db"));
        let mut history = History::open(&path, &seals()).unwrap();
        let mut stored = inspection(1, verdict, "found");
        stored.features[0].code = Code::ALL.get(at).copied();
        history.record(&stored, None).unwrap();
        let checks = history.checks("die").unwrap();
        assert_eq!(checks[0].verdict, verdict);
        let flank = &checks[0].flanks[0];
        assert_eq!(
            (flank.verdict, flank.code),
            (verdict, stored.features[0].code)
        );
        assert_eq!(history.open_verdicts(&die_key("die")).unwrap(), [verdict]);
    }
    let path = folder.path().join("go.db");
    Connection::open(&path)
        .unwrap()
        .execute_batch("DROP TRIGGER flank_keeps_UPDATE; UPDATE flank SET code = 'bewitched'")
        .unwrap();
    History::trust(&path, &seals(), "Ada").unwrap();
    let error = History::read(&path, &seals())
        .unwrap()
        .checks("die")
        .unwrap_err();
    assert!(
        error.to_string().contains("\"bewitched\" is no word"),
        "{error}"
    );
}

/// A check of one patch.
fn of_patch(press_cycles: u32, place: u32, name: &str) -> Inspection {
    let mut check = inspection(press_cycles, Word::Go, "");
    check.features.truncate(1);
    check.features[0].id = FeatureId {
        tooth: place,
        flank: flankscope_metrology::gear::Flank::Face,
        patch: Some(name.into()),
    };
    check
}

#[test]
fn a_history_of_flanks_takes_patches() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("press.db");
    let mut history = History::open(&path, &seals()).unwrap();
    for cycles in [8, 16] {
        history
            .record(&inspection(cycles, Word::Go, ""), None)
            .unwrap();
    }
    let reader = History::read(&path, &seals()).unwrap();
    // Another patch was put before it in the tool file: it is still the same.
    for (cycles, place) in [(24, 1), (32, 2)] {
        history
            .record(&of_patch(cycles, place, "boss"), None)
            .unwrap();
    }
    history.record(&of_patch(40, 1, "rib"), None).unwrap();
    history.verify().unwrap();
    let checks = reader.checks("die").unwrap();
    let found = series(&checks);
    let told: Vec<(String, u32, usize)> = found
        .iter()
        .map(|of| (of.id.to_string(), of.id.tooth, of.points.len()))
        .collect();
    let patches = &told[told.len() - 2..];
    assert_eq!(
        patches,
        [("patch boss".into(), 2, 2), ("patch rib".into(), 1, 1)]
    );
    assert_eq!(told.len(), 6 + 2);
    let mut table = Vec::new();
    csv(&checks, &mut table).unwrap();
    let table = String::from_utf8(table).unwrap();
    assert_eq!(
        table.lines().filter(|row| row.ends_with(",boss")).count(),
        2
    );
    // A face has a name, a flank has none, and nothing of it can be changed.
    let connection = Connection::open(&path).unwrap();
    for sql in [
        "INSERT INTO flank VALUES (1, 7, 'face', 0, 0, 30, 50, 'go', NULL, NULL)",
        "INSERT INTO flank VALUES (1, 7, 'left', 0, 0, 30, 50, 'go', NULL, 'boss')",
        "INSERT INTO flank VALUES (1, 7, 'top', 0, 0, 30, 50, 'go', NULL, NULL)",
        "UPDATE flank SET patch = 'rib' WHERE patch = 'boss'",
        "DELETE FROM flank",
    ] {
        connection.execute(sql, []).expect_err(sql);
    }
    // Unless somebody opens the lock, which the chain tells.
    connection
        .execute_batch(
            "DROP TRIGGER flank_keeps_UPDATE; UPDATE flank SET patch = 'hub' WHERE patch = 'rib'",
        )
        .unwrap();
    assert!(reader.verify().is_err());
}
