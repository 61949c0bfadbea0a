//! Stations whose names are paths, encodings of paths or parts of file names ship into one lake: every file lies in a folder of its
//! station below the lake, and every check is there once and as stored.

mod histories;

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use flankscope_fleet::lake::Lake;
use flankscope_fleet::ship::Shipper;
use flankscope_fleet::verify::Verifier;
use flankscope_record::history::History;
use flankscope_test_requisites::{Random, everything};
use histories::{LATER, Station, run};

const CHECKS: u32 = 3;

const NAMES: [&str; 26] = [
    "..",
    ".",
    "../outside",
    "../../../../outside",
    "/outside",
    "//outside",
    "a/../../outside",
    "..\\outside",
    "%2e%2e%2foutside",
    "..%2Foutside",
    "%252e%252e%252f",
    "%",
    "%zz",
    "station=other",
    "press 7/date=2026-01-31",
    "date=2026-01-31",
    "_sums",
    "press 7.parquet",
    "press 7#1",
    "press 7?x=1",
    " press 7",
    "press 7 ",
    "press\n7",
    "press\u{202e}7",
    "$(touch outside)",
    "~/outside",
];

/// Pieces of drawn names.
const PIECES: [&str; 14] = [
    "..", "/", ".", "%", "2f", "2F", "\\", "station=", "date=", "_sums", "press", " ", "ä", "\n",
];

fn names() -> Vec<String> {
    let mut names: BTreeSet<String> = NAMES.map(str::to_owned).into();
    let mut random = Random(60);
    let mut below = |limit: usize| (random.uniform() * limit as f64) as usize;
    let count = if everything() { 200 } else { NAMES.len() };
    while names.len() < count {
        names.insert(
            (0..=below(6))
                .map(|_| PIECES[below(PIECES.len())])
                .collect(),
        );
    }
    names.into_iter().collect()
}

/// Files below a folder, relative to it.
fn files(folder: &Path) -> Vec<String> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(current) = folders.pop() {
        for entry in fs::read_dir(current).unwrap().flatten() {
            let kind = entry.file_type().unwrap();
            assert!(!kind.is_symlink());
            if kind.is_dir() {
                folders.push(entry.path());
            } else {
                let path = entry.path();
                let relative = path.strip_prefix(folder).unwrap();
                found.push(relative.to_str().unwrap().to_owned());
            }
        }
    }
    found
}

#[test]
fn station_names_with_path_tricks_stay_below_the_lake() {
    let parent = tempfile::tempdir().unwrap();
    let folder = parent.path().join("above/lake");
    fs::create_dir_all(&folder).unwrap();
    let lake = Lake::open(folder.to_str().unwrap()).unwrap();
    let names = names();
    for name in &names {
        let station = Station::new(name);
        station.store(CHECKS);
        let history: History = station.read();
        let shipped = run(async {
            let mut shipper = Shipper::new(station.read(), &station.seals, &lake).await?;
            shipper.pass(LATER).await
        });
        let shipped = shipped.unwrap_or_else(|error| panic!("{name:?}: {error}"));
        assert_eq!(shipped.checks, u64::from(CHECKS), "{name:?}");
        // Its own folder has its checks, as the history has them.
        let listing = run(lake.list(Some(name))).unwrap();
        let mut checks = 0;
        for listed in listing.files {
            assert_eq!(listed.name.range.station, *name);
            checks += run(lake.read(&listed.name)).unwrap().checks.len();
        }
        assert_eq!(checks, CHECKS as usize, "{name:?}");
        let keys = std::slice::from_ref(&station.seals);
        let report = run(Verifier::new(&lake, keys).run(Some(&history))).unwrap();
        assert_eq!(report.findings, Vec::new(), "{name:?}");
    }
    // One folder of the lake for each, and nothing beside the lake.
    let stored = files(&folder);
    let folders: BTreeSet<&str> = stored
        .iter()
        .filter_map(|path| path.split_once('/'))
        .map(|(station, _)| station)
        .collect();
    assert_eq!(folders.len(), names.len(), "{folders:?}");
    assert!(folders.iter().all(|name| name.starts_with("station=")));
    assert_eq!(files(parent.path()).len(), stored.len());
    println!("{} names, {} files", names.len(), stored.len());
}
