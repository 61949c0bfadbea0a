//! Whatever is done to a lake is named by `verify`, and nothing of it is believed.

mod histories;

use std::path::PathBuf;

use flankscope_fleet::file::LakeFile;
use flankscope_fleet::lake::Lake;
use flankscope_fleet::name::FileName;
use flankscope_fleet::rows::Value;
use flankscope_fleet::verify::{Finding, Report, Verifier};
use flankscope_record::history::History;
use flankscope_record::seal::Seals;
use flankscope_test_requisites::Random;
use histories::{LATER, Station, minute_of_march, run};

fn shipped(checks: u32) -> (Station, Lake) {
    let station = Station::new("press 7");
    station.store(checks);
    let lake = station.lake();
    station.ship(&lake, LATER).unwrap();
    (station, lake)
}

fn verified(lake: &Lake, keys: &[Seals], history: Option<&History>) -> Report {
    run(Verifier::new(lake, keys).run(history)).unwrap()
}

fn findings(station: &Station, lake: &Lake) -> Vec<Finding> {
    let keys = std::slice::from_ref(&station.seals);
    verified(lake, keys, None).findings
}

fn files(lake: &Lake) -> Vec<FileName> {
    let listing = run(lake.list(None)).unwrap();
    let mut names: Vec<FileName> = listing.files.into_iter().map(|file| file.name).collect();
    names.sort();
    names
}

fn path(station: &Station, name: &FileName) -> PathBuf {
    station.lake_folder().join(name.to_string())
}

#[test]
fn an_untouched_lake_is_as_its_station_shipped_it() {
    let (station, lake) = shipped(150);
    let history = station.read();
    let report = verified(&lake, std::slice::from_ref(&station.seals), Some(&history));
    assert_eq!(report.findings, Vec::new());
    assert_eq!(
        (report.checks, report.sealed, report.links_behind),
        (150, 150, 0)
    );
    assert_eq!(report.flanks, 149 * 6);
    // Without a key, digests alone.
    assert_eq!(verified(&lake, &[], None).sealed, 0);
    station.store(3);
    assert_eq!(
        verified(&lake, std::slice::from_ref(&station.seals), None).links_behind,
        3
    );
}

#[test]
fn damage_anywhere_in_a_file_is_found_or_changes_no_row() {
    let (station, lake) = shipped(40);
    let name = files(&lake).remove(0);
    let path = path(&station, &name);
    let whole = std::fs::read(&path).unwrap();
    let rows = run(lake.read(&name)).unwrap().checks;
    let mut random = Random(35);
    let mut below = |limit: usize| (random.uniform() * limit as f64) as usize;
    let (mut found, mut harmless) = (0, 0);
    for number in 0..400 {
        let mut bytes = whole.clone();
        if number % 4 == 0 {
            bytes.truncate(below(whole.len()));
        } else {
            let at = below(whole.len());
            bytes[at] ^= 1 << below(8);
        }
        std::fs::write(&path, bytes).unwrap();
        match run(lake.read(&name)) {
            Err(_) => {
                found += 1;
                if number % 40 == 0 {
                    let said = findings(&station, &lake);
                    assert!(matches!(&said[..], [Finding::Damaged { .. }]), "{said:?}");
                }
            }
            // Statistics and the like, of which no digest is made.
            Ok(file) => {
                assert_eq!(file.checks, rows);
                harmless += 1;
            }
        }
    }
    println!("400 damaged files: {found} found, {harmless} with the same rows");
    assert!(found > 200);
}

#[test]
fn who_edits_a_row_and_names_the_file_anew_has_no_key() {
    let (station, lake) = shipped(40);
    let name = files(&lake).remove(0);
    let mut file = run(lake.read(&name)).unwrap();
    let wear = file.checks[5].flanks[2]
        .iter_mut()
        .find(|value| matches!(value, Some(Value::Real(_))))
        .unwrap();
    *wear = Some(Value::Real(0.0));
    let forged = file.name();
    std::fs::remove_file(path(&station, &name)).unwrap();
    std::fs::write(path(&station, &forged), file.encode().unwrap()).unwrap();
    assert_eq!(
        verified(&lake, &[], None).findings,
        Vec::new(),
        "who has no key cannot know"
    );
    let said = findings(&station, &lake);
    assert!(
        matches!(&said[..], [Finding::Damaged { why, .. }] if why.contains("sealed")),
        "{said:?}"
    );
    // Nor with a key of one's own.
    let own = Seals::open(&station.folder.path().join("forger")).unwrap();
    let resealed = LakeFile::sealed(file.range.clone(), file.checks.clone(), &own);
    std::fs::write(path(&station, &forged), resealed.encode().unwrap()).unwrap();
    let keys = [station.seals.clone(), own];
    let said = verified(&lake, &keys, None).findings;
    assert!(
        matches!(&said[..], [Finding::TwoStations { .. }]),
        "{said:?}"
    );
    // The history knows which check it was.
    let said = verified(&lake, &[], Some(&station.read())).findings;
    assert!(
        said.iter()
            .any(|f| matches!(f, Finding::NotOfHistory { check: 6, .. })),
        "{said:?}"
    );
}

#[test]
fn what_is_missing_is_named_by_its_checks() {
    let (station, lake) = shipped(200);
    let names = files(&lake);
    let ranges = |gone: &[usize]| {
        for at in gone {
            std::fs::remove_file(path(&station, &names[*at])).unwrap();
        }
        let said = findings(&station, &lake);
        station.ship(&lake, LATER).unwrap();
        assert_eq!(findings(&station, &lake), Vec::new());
        said
    };
    let stream = names[0].range.stream.clone();
    let missing = |first, last| Finding::Missing {
        stream: stream.clone(),
        first,
        last,
    };
    assert_eq!(ranges(&[0]), [missing(1, 32)]);
    assert_eq!(ranges(&[1, 2, 4]), [missing(33, 96), missing(129, 160)]);
    // The last one: as if it had not been shipped yet. The station's memory knows how many links are behind it.
    std::fs::remove_file(path(&station, &names[6])).unwrap();
    let report = verified(&lake, std::slice::from_ref(&station.seals), None);
    assert_eq!((report.findings.len(), report.links_behind), (0, 8));
}

#[test]
fn a_file_in_another_folder_or_under_another_name_is_not_believed() {
    let (station, lake) = shipped(40);
    let name = files(&lake).remove(0);
    let mut others = [name.clone(), name.clone(), name.clone()];
    others[0].range.station = "press 8".into();
    others[1].range.date = "2001-03-01".into();
    others[2].range.last -= 1;
    for other in others {
        let to = path(&station, &other);
        std::fs::create_dir_all(to.parent().unwrap()).unwrap();
        std::fs::rename(path(&station, &name), &to).unwrap();
        let said = findings(&station, &lake);
        assert!(
            said.iter().any(|f| matches!(f, Finding::Damaged { .. })),
            "{said:?}"
        );
        std::fs::rename(&to, path(&station, &name)).unwrap();
    }
    std::fs::write(station.lake_folder().join("notes.txt"), "of somebody").unwrap();
    assert_eq!(
        findings(&station, &lake),
        [Finding::Foreign {
            path: "notes.txt".into()
        }]
    );
}

/// A copy of a history went on by itself, and both were shipped from the beginning, each before the other was there.
#[test]
fn two_copies_of_a_history_in_one_lake_are_named() {
    let station = Station::new("press 7");
    station.store(40);
    let (copy, seals) = station.copy_that_went_on();
    station.store(60);
    let lake = station.lake();
    let (one, two) = run(async {
        let of = |path: PathBuf, seals: &Seals| History::read(&path, seals).unwrap();
        let mut one = flankscope_fleet::ship::Shipper::new(
            of(station.history(), &station.seals),
            &station.seals,
            &lake,
        )
        .await
        .unwrap();
        let mut two = flankscope_fleet::ship::Shipper::new(of(copy.clone(), &seals), &seals, &lake)
            .await
            .unwrap();
        (
            one.pass(LATER).await.unwrap(),
            two.pass(LATER).await.unwrap(),
        )
    });
    assert_eq!((one.files, two.files, two.there_already), (4, 3, 1));
    let said = findings(&station, &lake);
    let doubled = said
        .iter()
        .filter(|f| matches!(f, Finding::Doubled { .. }))
        .count();
    assert_eq!(doubled, 3, "{said:?}");
}

#[test]
fn a_history_that_the_station_did_not_write_so_far_is_named() {
    let (station, lake) = shipped(40);
    // The station's memory of before.
    let memory = station.key().join("histories");
    let saved: Vec<(PathBuf, Vec<u8>)> = std::fs::read_dir(&memory)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|e| e == "json"))
        .map(|path| (path.clone(), std::fs::read(path).unwrap()))
        .collect();
    station.store(30);
    station.ship(&lake, LATER).unwrap();
    for (path, bytes) in saved {
        std::fs::write(path, bytes).unwrap();
    }
    let said = findings(&station, &lake);
    assert!(
        matches!(&said[..], [Finding::OtherChain { .. }]),
        "{said:?}"
    );
}

#[test]
fn two_stations_of_one_name_are_named() {
    let (one, other) = (Station::new("press 7"), Station::new("press 7"));
    let lake = one.lake();
    for station in [&one, &other] {
        station.store(40);
        station.ship(&lake, LATER).unwrap();
    }
    let said = findings(&one, &lake);
    assert!(
        matches!(&said[..], [Finding::TwoStations { keys, .. }] if keys.len() == 2),
        "{said:?}"
    );
    // One after the other: a station that got another key.
    let (one, other) = (Station::new("press 8"), Station::new("press 8"));
    let lake = one.lake();
    for (day, station) in [(0, &one), (3, &other)] {
        station.store(40);
        station.date(|id| minute_of_march(day * 1440 + id));
        station.ship(&lake, LATER).unwrap();
    }
    assert_eq!(findings(&one, &lake), Vec::new());
}
