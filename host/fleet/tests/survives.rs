//! Shippers and compactions are killed at random moments, 60 times, 200 where everything runs, and run out of disk at every place; at
//! every moment every check is in the lake at most once and as it was stored, and in the end each is there.

mod histories;

use std::collections::BTreeSet;
use std::process::{Child, Stdio};
use std::time::Duration;

use flankscope_fleet::lake::Lake;
use flankscope_fleet::name::{FileName, cover};
use flankscope_fleet::verify::Verifier;
use flankscope_test_requisites::{Random, everything};
use histories::{LATER, Station, fleet, minute_of_march, run};

const CHECKS: u32 = 640;

/// Six days, in whose midst the clock is set back by one and a half.
fn station() -> Station {
    let station = Station::new("press 7");
    station.store(CHECKS);
    station.date(|id| minute_of_march(if id <= 320 { id * 14 } else { id * 14 - 2160 }));
    station
}

/// Ship, or compact at once: without any grace, which only one compaction at a time may do.
fn arguments(station: &Station, compact: bool) -> Vec<String> {
    let (history, lake) = (station.history(), station.lake_folder());
    let (history, lake) = (history.to_str().unwrap(), lake.to_str().unwrap());
    let words: Vec<&str> = match compact {
        true => vec!["compact", "--lake", lake, "--grace-minutes", "0"],
        false => vec!["ship", "--history", history, "--lake", lake],
    };
    words.into_iter().map(str::to_owned).collect()
}

fn start(station: &Station, compact: bool) -> Child {
    let arguments = arguments(station, compact);
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let mut command = fleet!(station, &words);
    command.stdout(Stdio::null()).spawn().unwrap()
}

/// Reads the files that count and have not been read before; the number of their checks.
fn checks_once(lake: &Lake, read: &mut BTreeSet<FileName>) -> i64 {
    let listing = run(lake.list(None)).unwrap();
    assert_eq!(listing.foreign, Vec::<String>::new());
    let found = cover(listing.files.into_iter().map(|file| file.name));
    assert_eq!(found.doubled, Vec::new());
    let mut checks = 0;
    for name in found.current {
        checks += name.range.checks();
        if read.insert(name.clone()) {
            run(lake.read(&name)).unwrap();
        }
    }
    checks
}

#[test]
fn kills_lose_and_double_nothing() {
    let kills = if everything() { 200 } else { 60 };
    let station = station();
    let lake = station.lake();
    let mut random = Random(35);
    let mut below = |limit: u64| (random.uniform() * limit as f64) as u64;
    let mut read = BTreeSet::new();
    let (mut killed, mut ended, mut lakes) = (0, 0, 0);
    while killed < kills {
        // Two shippers by mistake, and a compaction, in most rounds.
        let mut processes = vec![start(&station, false)];
        if below(2) == 0 {
            processes.push(start(&station, false));
        }
        if below(4) > 0 {
            processes.push(start(&station, true));
        }
        std::thread::sleep(Duration::from_micros(below(120_000)));
        for process in &mut processes {
            // Some come to their end.
            if below(6) == 0 {
                assert!(process.wait().unwrap().success());
                ended += 1;
            } else if process.try_wait().unwrap().is_none() {
                process.kill().unwrap();
                process.wait().unwrap();
                killed += 1;
            }
        }
        let checks = checks_once(&lake, &mut read);
        if checks == i64::from(CHECKS) && below(3) == 0 {
            // Full: from the beginning.
            assert_whole(&station, &lake);
            std::fs::remove_dir_all(station.lake_folder()).unwrap();
            std::fs::create_dir(station.lake_folder()).unwrap();
            read.clear();
            lakes += 1;
        }
    }
    station.ship(&lake, LATER).unwrap();
    assert_whole(&station, &lake);
    for _ in 0..3 {
        assert!(start(&station, true).wait().unwrap().success());
    }
    assert_whole(&station, &lake);
    #[cfg(feature = "query")]
    assert_summed(&lake);
    println!(
        "{killed} kills ({ended} processes came to their end): {} lakes filled, {CHECKS} checks in each, once and as stored",
        lakes + 1
    );
}

/// Every day has sums of the files that count, and no other.
#[cfg(feature = "query")]
fn assert_summed(lake: &Lake) {
    let listing = run(lake.list(None)).unwrap();
    let current = listing.cover().current;
    let mut days = flankscope_fleet::sums::days(&current);
    for name in &listing.sums {
        let day = days.remove(&name.date[..]).unwrap();
        assert_eq!(day.source, name.source);
        assert!(run(lake.read_sums(name)).unwrap().is_some());
    }
    assert!(days.is_empty(), "{days:?}");
}

fn assert_whole(station: &Station, lake: &Lake) {
    let history = station.read();
    let keys = std::slice::from_ref(&station.seals);
    let report = run(Verifier::new(lake, keys).run(Some(&history))).unwrap();
    assert_eq!(report.findings, Vec::new());
    assert_eq!(report.sealed, u64::from(CHECKS));
    // The acceptance of its dates, which is no check.
    assert_eq!(report.links_behind, 1);
}

/// No file may grow beyond a limit, which lets files of few checks through and refuses others: writes fail as on a full disk.
#[test]
fn a_full_disk_leaves_whole_files_only() {
    let station = station();
    let lake = station.lake();
    let mut read = BTreeSet::new();
    let (mut refused, mut before) = (0, 0);
    // In blocks of 512 bytes.
    for blocks in (0..40).chain([1000]) {
        for compact in [false, true] {
            // Without the trap the system would end the process instead of failing the write.
            let status = std::process::Command::new("sh")
                .args(["-c", "trap '' XFSZ; ulimit -f $1; shift; exec \"$@\"", "sh"])
                .arg(blocks.to_string())
                .arg(env!("CARGO_BIN_EXE_flankscope-fleet"))
                .args(arguments(&station, compact))
                .env("FLANKSCOPE_STATE", station.key())
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .status()
                .unwrap();
            assert!(matches!(status.code(), Some(0 | 3)), "{status}");
            refused += u32::from(!status.success());
            let checks = checks_once(&lake, &mut read);
            assert!(checks >= before, "what was shipped is kept");
            before = checks;
        }
    }
    assert_eq!(before, i64::from(CHECKS));
    assert_whole(&station, &lake);
    assert!(refused > 5, "{refused} refused: the limit must be felt");
    println!(
        "disks full at 40 places: {refused} runs refused, every check there once the disk had room"
    );
}

/// A reader lists and reads without pause while checks are stored, shipped, joined and removed.
#[test]
fn readers_see_every_check_once_at_every_moment() {
    let station = Station::new("press 7");
    station.store(40);
    let lake = station.lake();
    let (history, folder) = (station.history(), station.lake_folder());
    let (history, folder) = (history.to_str().unwrap(), folder.to_str().unwrap());
    let follow = ["ship", "--follow", "--history", history, "--lake", folder];
    let mut follower = fleet!(station, &follow)
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let (mut listings, mut most) = (0, 0);
    let until = std::time::Instant::now() + Duration::from_secs(6);
    std::thread::scope(|scope| {
        let (station, lake) = (&station, &lake);
        let writer = scope.spawn(move || {
            let mut stored = 40;
            while std::time::Instant::now() < until {
                station.store(16);
                stored += 16;
            }
            stored
        });
        let compactor = scope.spawn(move || {
            while std::time::Instant::now() < until {
                // Of a far tomorrow, so that today is joined, too; removed only after a while.
                let what = flankscope_fleet::compact::Compaction {
                    join_before: "2999-01-01".parse().unwrap(),
                    retire_before: None,
                    grace: Duration::from_secs(1),
                    now: jiff::Timestamp::now(),
                };
                let done = run(flankscope_fleet::compact::compact(lake, &what)).unwrap();
                assert_eq!(done.left, Vec::new());
            }
        });
        while std::time::Instant::now() < until {
            let listing = run(lake.list(None)).unwrap();
            let found = cover(listing.files.into_iter().map(|file| file.name));
            assert_eq!(found.doubled, Vec::new());
            let mut numbers = Vec::new();
            for name in found.current {
                let file = run(lake.read(&name)).unwrap();
                numbers.extend(file.checks.iter().map(|check| check.number()));
            }
            let last = numbers.len() as i64;
            numbers.sort_unstable();
            numbers.dedup();
            assert_eq!(numbers.len() as i64, last, "none twice");
            assert!(last >= most, "none gone");
            most = last;
            listings += 1;
        }
        compactor.join().unwrap();
        println!(
            "{listings} listings: up to {most} checks, each once, while {} were stored",
            writer.join().unwrap()
        );
    });
    follower.kill().unwrap();
    follower.wait().unwrap();
    assert!(most > 32, "{most}");
}
