//! Compaction changes files, not rows: at no moment is a check there twice or not at all, for readers that keep to the rule.

mod histories;

use std::time::Duration;

use flankscope_fleet::compact::{Compacted, Compaction, compact};
use flankscope_fleet::lake::Lake;
use flankscope_fleet::name::{FileName, cover};
use flankscope_fleet::retired::kept;
use flankscope_fleet::verify::{Finding, Verifier};
use histories::{LATER, Station, minute_of_march, run};
use jiff::Timestamp;

/// The files that count, as a reader finds them.
fn current(lake: &Lake) -> Vec<FileName> {
    let listing = run(lake.list(None)).unwrap();
    let found = cover(kept(
        listing.files.into_iter().map(|file| file.name),
        &listing.retired,
    ));
    assert_eq!(found.doubled, Vec::new());
    found.current
}

fn numbers(lake: &Lake) -> Vec<i64> {
    let mut numbers = Vec::new();
    for name in current(lake) {
        let file = run(lake.read(&name)).unwrap();
        numbers.extend(file.checks.iter().map(|check| check.number()));
    }
    numbers
}

fn compacted(lake: &Lake, at: &str, retire: Option<u32>, grace: Duration) -> Compacted {
    let now: Timestamp = at.parse().unwrap();
    run(compact(lake, &Compaction::of_days(1, retire, grace, now))).unwrap()
}

fn verified(station: &Station, lake: &Lake) -> Vec<Finding> {
    let keys = std::slice::from_ref(&station.seals);
    let history = station.read();
    let report = run(Verifier::new(lake, keys).run(Some(&history))).unwrap();
    assert_eq!(report.sealed, report.checks);
    report.findings
}

/// Three days in March, shipped.
fn shipped() -> (Station, Lake) {
    let station = Station::new("press 7");
    station.store(300);
    station.date(|id| minute_of_march(id * 12));
    let lake = station.lake();
    station.ship(&lake, LATER).unwrap();
    (station, lake)
}

const LONG_AFTER: &str = "2100-01-01T00:00:00Z";

#[test]
fn the_files_of_a_day_become_one_and_keep_their_seals() {
    let (station, lake) = shipped();
    let before = numbers(&lake);
    let none = Duration::ZERO;
    // On the second of March, the first day is joined.
    let done = compacted(&lake, "2001-03-02T12:00:00Z", None, none);
    assert_eq!((done.into, done.removed), (1, 0));
    assert_eq!(numbers(&lake), before);
    assert_eq!(verified(&station, &lake), Vec::new());
    // By a clock that is behind that of the store, nothing is old enough to be removed.
    assert_eq!(
        compacted(&lake, "2001-03-02T12:00:00Z", None, none),
        Compacted::default()
    );
    let done = compacted(&lake, LONG_AFTER, None, none);
    assert_eq!((done.into, done.removed), (2, 4));
    assert_eq!(compacted(&lake, LONG_AFTER, None, none).into, 0);
    assert_eq!(
        compacted(&lake, LONG_AFTER, None, none),
        Compacted::default()
    );
    assert_eq!(current(&lake).len(), 3);
    assert_eq!(run(lake.list(None)).unwrap().files.len(), 3);
    assert_eq!(numbers(&lake), before);
    assert_eq!(verified(&station, &lake), Vec::new());
    // The shipper finds everything shipped.
    assert_eq!(station.ship(&lake, LATER).unwrap(), Default::default());
}

#[test]
fn a_file_that_comes_late_is_joined_to_the_others() {
    let (station, lake) = shipped();
    let late = current(&lake).remove(1);
    run(lake.remove(&late)).unwrap();
    compacted(&lake, LONG_AFTER, None, Duration::ZERO);
    compacted(&lake, LONG_AFTER, None, Duration::ZERO);
    assert_eq!(station.ship(&lake, LATER).unwrap().files, 1);
    for _ in 0..3 {
        compacted(&lake, LONG_AFTER, None, Duration::ZERO);
        assert_eq!(numbers(&lake), (1..=300).collect::<Vec<_>>());
    }
    assert_eq!(current(&lake).len(), 3);
    assert_eq!(verified(&station, &lake), Vec::new());
}

#[test]
fn what_is_given_up_is_marked_and_not_shipped_again() {
    let (station, lake) = shipped();
    compacted(&lake, LONG_AFTER, None, Duration::ZERO);
    let done = compacted(&lake, "2001-03-03T12:00:00Z", Some(2), Duration::ZERO);
    assert!(done.retired > 0);
    let first = 1440 / 12;
    assert_eq!(numbers(&lake), (first..=300).collect::<Vec<_>>());
    assert_eq!(station.ship(&lake, LATER).unwrap(), Default::default());
    assert_eq!(verified(&station, &lake), Vec::new());
    let report = run(Verifier::new(&lake, &[]).run(None)).unwrap();
    assert_eq!(report.retired, u64::try_from(first - 1).unwrap());
}

#[test]
fn what_a_killed_process_had_begun_is_removed_and_nothing_else() {
    let (station, lake) = shipped();
    let folder = station.lake_folder();
    let digest = "0".repeat(32);
    std::fs::create_dir_all(folder.join("_sums")).unwrap();
    let begun = [
        format!("{}#1", current(&lake)[0]),
        format!("_sums/2001-03-01-{digest}-{digest}#12"),
    ];
    let foreign = ["notes#1", "_sums/notes#1"].map(str::to_owned);
    for name in begun.iter().chain(&foreign) {
        std::fs::write(folder.join(name), "begun").unwrap();
    }
    compacted(&lake, LONG_AFTER, None, Duration::from_secs(3600));
    assert!(folder.join(&begun[0]).exists(), "it may be written now");
    std::thread::sleep(Duration::from_millis(5));
    compacted(&lake, LONG_AFTER, None, Duration::ZERO);
    let there = |name: &String| folder.join(name).exists();
    assert!(!begun.iter().any(there) && foreign.iter().all(there));
}

#[test]
fn damaged_and_doubled_files_are_left_alone() {
    let (station, lake) = shipped();
    let names = current(&lake);
    let path = station.lake_folder().join(names[1].to_string());
    let whole = std::fs::read(&path).unwrap();
    std::fs::write(&path, &whole[..whole.len() / 2]).unwrap();
    let done = compacted(&lake, LONG_AFTER, None, Duration::ZERO);
    assert_eq!((done.left.len(), done.into), (1, 2), "{done:?}");
    assert_eq!(done.left[0].0, names[1]);
    assert!(path.exists());
    // A joined file that is damaged does not cost those that it was made of.
    std::fs::write(&path, &whole).unwrap();
    let done = compacted(&lake, LONG_AFTER, None, Duration::MAX);
    assert_eq!(done.into, 1);
    let joined = current(&lake)
        .into_iter()
        .find(|name| name.range.first == 1)
        .unwrap();
    let joined_path = station.lake_folder().join(joined.to_string());
    let bytes = std::fs::read(&joined_path).unwrap();
    std::fs::write(&joined_path, &bytes[..bytes.len() - 9]).unwrap();
    let done = compacted(&lake, LONG_AFTER, None, Duration::ZERO);
    assert!(
        path.exists() && done.left.iter().any(|(name, _)| *name == joined),
        "{done:?}"
    );
}
