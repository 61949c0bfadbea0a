//! Other people's readers find in a lake what the stations stored: DuckDB and polars, by the list of files, by a pattern once it is
//! compacted, and by the rule of docs/formats/lake.md in SQL; and a lake in a server that speaks S3 is the same lake.

mod histories;

use std::path::Path;
use std::process::Command;
use std::time::Duration;

use flankscope_fleet::compact::{Compaction, compact};
use flankscope_test_requisites::{lake_readers, workspace};
use histories::{LATER, Station, fleet, minute_of_march, run};
use serde_json::{Value, json};

fn script() -> std::path::PathBuf {
    workspace().join("tools/peers/lake_readers.py")
}

fn asked(python: &Path, arguments: &[&str]) -> Value {
    let output = Command::new(python)
        .arg(script())
        .args(arguments)
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    serde_json::from_slice(&output.stdout).unwrap()
}

/// What is in the history, computed from it: rows, checks, wear.
fn stored(station: &Station) -> (i64, i64, f64) {
    let linked = station.read().linked_checks(1..=i64::MAX, 0).unwrap();
    // A check without flanks has a row, too.
    let rows: usize = linked.iter().map(|l| l.check.flanks.len().max(1)).sum();
    let flanks = linked.iter().flat_map(|l| &l.check.flanks);
    (
        rows as i64,
        linked.len() as i64,
        flanks.filter_map(|flank| flank.wear_um).sum(),
    )
}

fn assert_found(found: &Value, reader: &str, (rows, checks, wear_um): (i64, i64, f64)) {
    let found = &found[reader];
    let got = found["wear_um"].as_f64().unwrap();
    assert!(
        (got - wear_um).abs() < 1e-6 * wear_um,
        "{reader}: {got} of {wear_um}"
    );
    let expected = json!({ "rows": rows, "checks": checks, "station": "press 7/ä", "date": "2001-03-03", "wear_um": found["wear_um"],
        // 23:12 of the third of March.
        "at_ms": 983_661_120_000_i64 });
    assert_eq!(*found, expected, "{reader}");
}

#[test]
fn duckdb_and_polars_find_what_was_stored() {
    let Some(python) = lake_readers() else {
        return;
    };
    let station = Station::new("press 7/ä");
    station.store(356);
    station.date(|id| minute_of_march(id * 12));
    let lake = station.lake();
    station.ship(&lake, LATER).unwrap();
    let expected = stored(&station);
    let folder = station.lake_folder();
    let listing = station.folder.path().join("files.txt");
    let read = || {
        let files = fleet!(station, &["files", "--lake", folder.to_str().unwrap()])
            .output()
            .unwrap();
        assert!(files.status.success());
        std::fs::write(&listing, files.stdout).unwrap();
        asked(
            &python,
            &[folder.to_str().unwrap(), listing.to_str().unwrap()],
        )
    };
    let compacted = |grace| {
        let what = Compaction::of_days(1, None, grace, jiff::Timestamp::now());
        run(compact(&lake, &what)).unwrap()
    };
    let all = [
        "duckdb",
        "polars",
        "duckdb_rule",
        "duckdb_glob",
        "polars_glob",
    ];
    let found = read();
    for reader in all {
        assert_found(&found, reader, expected);
    }
    // Joined files beside those that they were made of: a pattern finds rows twice, the list and the rule do not.
    assert_eq!(compacted(Duration::from_secs(3600)).into, 3);
    let found = read();
    for reader in &all[..3] {
        assert_found(&found, reader, expected);
    }
    assert_eq!(found["duckdb_glob"]["rows"], json!(2 * expected.0));
    // The grace is over.
    std::thread::sleep(Duration::from_millis(5));
    assert!(compacted(Duration::ZERO).removed > 3);
    let found = read();
    for reader in all {
        assert_found(&found, reader, expected);
    }
    // Beside files of a release that had fewer columns.
    let old = station.folder.path().join("old");
    let both = asked(
        &python,
        &["--evolve", folder.to_str().unwrap(), old.to_str().unwrap()],
    );
    let linked = station.read().linked_checks(1..=356, 0).unwrap();
    let named = linked.iter().filter(|l| l.check.origin.operator.is_some());
    let named: usize = named.map(|l| l.check.flanks.len().max(1)).sum();
    let expected = json!([2 * expected.0, named, expected.0]);
    assert_eq!(both, json!({ "duckdb": expected, "polars": expected }));
}

/// `minute_of_march` and what the readers say agree on when that is.
#[test]
fn the_last_check_is_when_it_is_said_to_be() {
    assert_eq!(minute_of_march(356 * 12), "2001-03-03T23:12:00.000Z");
    let time = flankscope_fleet::rows::time_ms(1, &minute_of_march(356 * 12)).unwrap();
    assert_eq!(time, 983_661_120_000);
}

#[cfg(feature = "s3")]
#[test]
fn a_lake_in_a_server_that_speaks_s3_is_the_same_lake() {
    let Some(python) = lake_readers() else {
        return;
    };
    let (mut server, environment) = histories::s3_server(&python);
    let station = Station::new("press 7/ä");
    station.store(200);
    station.date(|id| minute_of_march(id * 12));
    let fleet = |arguments: &[&str]| {
        let mut command = fleet!(station, arguments);
        let output = command.envs(environment.clone()).output().unwrap();
        (
            output.status.code(),
            String::from_utf8(output.stdout).unwrap(),
        )
    };
    let url = "s3://lake/of/all";
    let history = station.history();
    let ship = [
        "ship",
        "--history",
        history.to_str().unwrap(),
        "--lake",
        url,
    ];
    assert_eq!(fleet(&ship).0, Some(0));
    let names = fleet(&["files", "--lake", url]).1;
    let lake = station.lake();
    station.ship(&lake, LATER).unwrap();
    let local = station.lake_folder();
    let local = fleet(&["files", "--lake", local.to_str().unwrap()]).1;
    assert_eq!(
        names.replace(url, station.lake_folder().to_str().unwrap()),
        local
    );
    assert!(fleet(&ship).1.contains("shipped 0 checks"));
    for _ in 0..2 {
        assert_eq!(
            fleet(&["compact", "--lake", url, "--grace-minutes", "0"]).0,
            Some(0)
        );
    }
    let key = station.key();
    let (code, said) = fleet(&["verify", "--lake", url, "--key", key.to_str().unwrap()]);
    assert!(
        code == Some(0) && said.contains("200 checks sealed"),
        "{said}"
    );
    assert_eq!(fleet(&["files", "--lake", url]).1.lines().count(), 2);
    server.kill().unwrap();
    server.wait().unwrap();
}
