//! What is shipped is what is stored: every check once, as it is, whoever ships it and however often.

mod histories;

use std::collections::BTreeMap;
use std::path::Path;

use flankscope_fleet::lake::Lake;
use flankscope_fleet::name::{FileName, cover};
use flankscope_fleet::rows::{LakeCheck, Stream};
use flankscope_fleet::ship::{PART_CHECKS, ShipError};
use flankscope_record::history::History;
use histories::{LATER, OVER, Station, fleet, minute_of_march, run};

fn names(lake: &Lake) -> Vec<FileName> {
    let listing = run(lake.list(None)).unwrap();
    assert_eq!(listing.foreign, Vec::<String>::new());
    listing.files.into_iter().map(|file| file.name).collect()
}

/// Every check of the files that count, by its number; each is there once.
fn in_lake(lake: &Lake) -> BTreeMap<(Stream, i64), LakeCheck> {
    let found = cover(names(lake));
    assert_eq!(found.doubled, Vec::new());
    let mut checks = BTreeMap::new();
    for name in found.current {
        for check in run(lake.read(&name)).unwrap().checks {
            let key = (name.range.stream.clone(), check.number());
            assert_eq!(checks.insert(key, check), None);
        }
    }
    checks
}

fn bytes_by_name(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in std::fs::read_dir(next).unwrap() {
            let path = entry.unwrap().path();
            match path.is_dir() {
                true => folders.push(path),
                false => {
                    let name = path
                        .strip_prefix(folder)
                        .unwrap()
                        .to_string_lossy()
                        .into_owned();
                    files.insert(name, std::fs::read(path).unwrap());
                }
            }
        }
    }
    files
}

#[test]
fn every_check_is_in_the_lake_once_and_as_it_is_stored() {
    let station = Station::new("press 7, hall ä");
    station.store(150);
    // Over midnight, then the clock is set back to before it.
    station.date(|id| minute_of_march(if id <= 100 { 1400 + id } else { 1300 + id }));
    let lake = station.lake();
    let shipped = station.ship(&lake, LATER).unwrap();
    assert_eq!(shipped.checks, 150);
    let history = station.read();
    let checks = in_lake(&lake);
    let stored = history.linked_checks(1..=150, 0).unwrap();
    assert_eq!(checks.len(), stored.len());
    for (((stream, _), shipped), stored) in checks.iter().zip(&stored) {
        assert_eq!(*shipped, LakeCheck::new(stream, stored).unwrap());
        assert_eq!(
            shipped.flanks.len(),
            if stored.check.id == 100 { 0 } else { 6 }
        );
    }
    // Shipped again, nothing is: not by this shipper, not by another one.
    assert_eq!(station.ship(&lake, LATER).unwrap(), Default::default());
    // Into another lake, in another order of passes: the same names and bytes.
    let other = tempfile::tempdir().unwrap();
    let second = Lake::open(other.path().to_str().unwrap()).unwrap();
    assert!(station.ship(&second, OVER).unwrap().files > 0);
    station.ship(&second, LATER).unwrap();
    assert_eq!(
        bytes_by_name(other.path()),
        bytes_by_name(&station.lake_folder())
    );
    let folders: std::collections::BTreeSet<String> = names(&lake)
        .iter()
        .map(|name| name.range.date.clone())
        .collect();
    assert_eq!(
        folders.into_iter().collect::<Vec<_>>(),
        ["2001-03-01", "2001-03-02"]
    );
}

#[test]
fn an_open_part_waits_for_what_closes_it() {
    let station = Station::new("press 7");
    let lake = station.lake();
    station.store(40);
    assert_eq!(
        station.ship(&lake, OVER).unwrap().checks,
        PART_CHECKS as u64
    );
    station.store(30);
    assert_eq!(
        station.ship(&lake, OVER).unwrap().checks,
        PART_CHECKS as u64
    );
    assert_eq!(station.ship(&lake, LATER).unwrap().checks, 6);
    // A day that was not over after all: what comes is a file of its own.
    station.store(30);
    assert_eq!(station.ship(&lake, LATER).unwrap().checks, 30);
    assert_eq!(in_lake(&lake).len(), 100);
}

#[test]
fn what_is_removed_from_the_lake_is_shipped_again() {
    let station = Station::new("press 7");
    let lake = station.lake();
    station.store(200);
    station.ship(&lake, LATER).unwrap();
    let before = bytes_by_name(&station.lake_folder());
    for name in names(&lake).iter().take(5).step_by(2) {
        run(lake.remove(name)).unwrap();
    }
    assert_eq!(station.ship(&lake, LATER).unwrap().files, 3);
    assert_eq!(bytes_by_name(&station.lake_folder()), before);
}

#[test]
fn two_shippers_of_one_history_put_the_same_files() {
    let station = Station::new("press 7");
    station.store(400);
    let lake_folder = station.lake_folder();
    let arguments = [
        "ship",
        "--history",
        station.history().to_str().unwrap(),
        "--lake",
        lake_folder.to_str().unwrap(),
    ]
    .map(str::to_owned);
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let mut both: Vec<_> = (0..2)
        .map(|_| fleet!(station, &arguments).spawn().unwrap())
        .collect();
    for shipper in &mut both {
        assert!(shipper.wait().unwrap().success());
    }
    let lake = station.lake();
    station.ship(&lake, LATER).unwrap();
    assert_eq!(in_lake(&lake).len(), 400);
}

#[test]
fn a_history_accepted_as_it_is_goes_on_where_the_lake_ends() {
    let station = Station::new("press 7");
    let lake = station.lake();
    station.store(50);
    station.ship(&lake, LATER).unwrap();
    let backup = station.folder.path().join("backup.db");
    std::fs::copy(station.history(), &backup).unwrap();
    station.store(20);
    station.ship(&lake, LATER).unwrap();
    assert_eq!(in_lake(&lake).len(), 70);
    // The backup takes its place: numbers 51 to 70 are given a second time.
    std::fs::copy(&backup, station.history()).unwrap();
    History::trust(&station.history(), &station.seals, "Ada").unwrap();
    assert_eq!(station.ship(&lake, LATER).unwrap(), Default::default());
    station.store(30);
    assert_eq!(station.ship(&lake, LATER).unwrap().checks, 30);
    let checks = in_lake(&lake);
    assert_eq!(checks.len(), 100);
    let twice: Vec<i64> = checks
        .keys()
        .map(|(_, number)| *number)
        .filter(|n| *n > 50)
        .collect();
    assert_eq!(twice.len(), 50);
    assert_eq!(station.ship(&lake, LATER).unwrap(), Default::default());
}

/// The copy of a history went on by itself, on a station that does not know of it.
#[test]
fn a_copy_that_went_on_apart_is_refused() {
    let station = Station::new("press 7");
    let lake = station.lake();
    station.store(40);
    let (copy, seals) = station.copy_that_went_on();
    station.store(40);
    station.ship(&lake, LATER).unwrap();
    let refused = run(async {
        let history = History::read(&copy, &seals).unwrap();
        flankscope_fleet::ship::Shipper::new(history, &seals, &lake)
            .await
            .err()
    });
    assert!(
        matches!(refused, Some(ShipError::Diverged { check: 80, .. })),
        "{refused:?}"
    );
}
