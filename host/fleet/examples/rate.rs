//! How fast checks get into a folder, and how large they are there: `cargo run --release --example rate [CHECKS]`.
//!
//! Once from a history that the instrument's own code has written, read, verified and shipped; once from rows that were made up,
//! encoded and put, for 50 stations one after the other. Six flanks a check.

#[path = "../tests/histories/mod.rs"]
mod histories;

use std::time::Instant;

use flankscope_fleet::compact::{Compaction, compact};
use flankscope_fleet::file::LakeFile;
use flankscope_fleet::lake::Lake;
use flankscope_fleet::name::Range;
use flankscope_fleet::rows::{LakeCheck, Stream, Value};
use flankscope_fleet::ship::{PART_CHECKS, put_all};
use flankscope_fleet::verify::Verifier;
use histories::{LATER, Station, run};

fn main() {
    let checks = std::env::args()
        .nth(1)
        .and_then(|n| n.parse().ok())
        .unwrap_or(3000);
    let station = Station::new("press 7");
    let begun = Instant::now();
    station.store(checks);
    println!("stored      {}", rate(checks.into(), begun));
    let lake = station.lake();
    let begun = Instant::now();
    let shipped = station.ship(&lake, LATER).unwrap();
    println!(
        "shipped     {}, opening and verifying the history included",
        rate(shipped.checks, begun)
    );
    sizes("as shipped", &lake);
    let begun = Instant::now();
    let keys = std::slice::from_ref(&station.seals);
    let report = run(Verifier::new(&lake, keys).run(None)).unwrap();
    println!("verified    {}", rate(report.sealed, begun));

    // The last check of the history, again and again, with other figures.
    let stream = Stream::of(&station.read()).unwrap();
    let last = i64::from(checks) - 1;
    let linked = station.read().linked_checks(last..=last, 0).unwrap();
    let model = LakeCheck::new(&stream, &linked[0]).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let lake = Lake::open(folder.path().to_str().unwrap()).unwrap();
    let (stations, days_of_480) = (50, 1);
    let parts = (0..stations).flat_map(|station| parts_of(&model, station, days_of_480 * 480));
    let mut random = flankscope_test_requisites::Random(7);
    let parts: Vec<(Range, Vec<LakeCheck>)> = parts
        .map(|(range, checks)| {
            (
                range,
                checks.into_iter().map(|c| drawn(c, &mut random)).collect(),
            )
        })
        .collect();
    let generated = stations as u64 * 480;
    let begun = Instant::now();
    let files = parts
        .into_iter()
        .map(|(range, checks)| Ok(LakeFile::sealed(range, checks, &station.seals)));
    run(put_all(&lake, files)).unwrap();
    println!("generated   {}", rate(generated, begun));
    sizes("as shipped", &lake);
    let begun = Instant::now();
    let what = Compaction::of_days(1, None, std::time::Duration::ZERO, jiff::Timestamp::MAX);
    run(compact(&lake, &what)).unwrap();
    println!("joined      {}", rate(generated, begun));
    run(compact(&lake, &what)).unwrap();
    sizes("joined", &lake);
}

fn rate(checks: u64, begun: Instant) -> String {
    let seconds = begun.elapsed().as_secs_f64();
    format!(
        "{checks} checks in {seconds:.2} s: {:.0} checks/s",
        checks as f64 / seconds
    )
}

fn sizes(what: &str, lake: &Lake) {
    let files = run(lake.list(None)).unwrap().files;
    let bytes: u64 = files.iter().map(|file| file.bytes).sum();
    let checks: i64 = files.iter().map(|file| file.name.range.checks()).sum();
    println!(
        "{what:<11} {} files, {bytes} bytes: {:.1} bytes a check, {:.2} a flank",
        files.len(),
        bytes as f64 / checks as f64,
        bytes as f64 / checks as f64 / 6.0
    );
}

/// A day of a station: a check every three minutes.
fn parts_of(model: &LakeCheck, station: i64, checks: i64) -> Vec<(Range, Vec<LakeCheck>)> {
    let numbers: Vec<i64> = (1..=checks).collect();
    let parts = numbers.chunks(usize::try_from(PART_CHECKS).unwrap_or(1));
    let part = |numbers: &[i64]| {
        let stream = Stream {
            history: format!("{station:032x}"),
            epoch: "0".repeat(8),
        };
        let range = Range {
            first: numbers[0],
            last: numbers[numbers.len() - 1],
            station: format!("press {station}"),
            date: "2001-03-01".into(),
            stream: stream.clone(),
        };
        let check = |number: &i64| {
            let mut check = model.clone();
            check.set("history", Value::from(&stream.history[..]));
            check.set("check_number", (*number).into());
            check.set("chain_link", (number + 5).into());
            check.set("stored_at", (983_404_800_000 + number * 180_000).into());
            check.set("tool_cycles", (number * 36).into());
            check.set("press_cycles", (number * 36).into());
            let digest = blake3::hash(format!("{station} {number}").as_bytes());
            check.set("chain_digest", Value::from(&digest.to_hex()[..]));
            check
        };
        (range, numbers.iter().map(check).collect())
    };
    parts.map(part).collect()
}

/// Wear and its uncertainty drawn anew, with every digit of their mantissas.
fn drawn(mut check: LakeCheck, random: &mut flankscope_test_requisites::Random) -> LakeCheck {
    for flank in &mut check.flanks {
        for value in flank.iter_mut() {
            if let Some(Value::Real(figure)) = value
                && *figure < 20.0
            {
                *figure = 4.0 + random.normal();
            }
        }
    }
    check
}
