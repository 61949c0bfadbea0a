//! A lake to measure questions by: `cargo run --release --example made_up_lake FOLDER STATIONS DAYS [CHECKS-A-DAY]`.
//!
//! Every station checks six flanks of one die 480 times a day, 17 280 strokes, until now; wear is a line per flank with scatter, and
//! ends between 4 and 60 µm, mostly low. Files are as large as joined ones: a day each. Every eighth station fell silent two hours ago.

#[path = "../tests/histories/mod.rs"]
mod histories;
#[path = "../tests/made_up/mod.rs"]
mod made_up;

use std::time::Instant;

use flankscope_fleet::lake::Lake;
use flankscope_test_requisites::Random;
use jiff::Timestamp;
use made_up::{MadeUp, Maker};

/// Of a check every three minutes.
const CHECKS_A_DAY: i64 = 480;
const STROKES_A_DAY: i64 = 17_280;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (folder, stations, days, checks_a_day) = match &arguments[..] {
        [folder, stations, days] => (folder, stations, days, CHECKS_A_DAY),
        [folder, stations, days, checks] => (folder, stations, days, checks.parse().unwrap()),
        _ => {
            eprintln!("made_up_lake FOLDER STATIONS DAYS [CHECKS-A-DAY]");
            std::process::exit(2);
        }
    };
    let (stations, days): (i64, i64) = (stations.parse().unwrap(), days.parse().unwrap());
    std::fs::create_dir_all(folder).unwrap();
    let lake = Lake::open(folder).unwrap();
    let mut maker = Maker::new();
    let mut random = Random(7);
    let begun = Instant::now();
    // Minutes since 1 March 2001, as the checks count them.
    let now = (Timestamp::now().as_millisecond() - 983_404_800_000).div_euclid(60_000);
    let today = now - now.rem_euclid(1440);
    let strokes_in_all = (STROKES_A_DAY * days) as f64;
    let mut checks = 0;
    for station in 0..stations {
        let end_um: Vec<f64> = (0..6)
            .map(|_| 4.0 + 56.0 * random.uniform().powi(6))
            .collect();
        let silent_since = if station % 8 == 7 { now - 120 } else { now };
        for day in 0..days {
            let first = today + 1440 * (day + 1 - days);
            let check = |n: i64| {
                let strokes = STROKES_A_DAY * (day * checks_a_day + n) / checks_a_day;
                let share = strokes as f64 / strokes_in_all;
                let wear = |end_um: &f64| Some(4.0 + (end_um - 4.0) * share + random.normal());
                MadeUp {
                    station: format!("press {}", station + 1),
                    serial: Some(format!("A {station}")),
                    head: format!("head {station}"),
                    minute: first + 1440 * n / checks_a_day,
                    strokes,
                    wear_um: end_um.iter().map(wear).collect(),
                }
            };
            let mut of_day: Vec<MadeUp> = (0..checks_a_day).map(check).collect();
            of_day.retain(|check| check.minute <= silent_since);
            let Some(last) = of_day.last() else { continue };
            // As the press would see the last check, U95 being 4 µm.
            let most_um = last
                .wear_um
                .iter()
                .flatten()
                .fold(0.0_f64, |a, b| a.max(*b));
            maker.verdict = match most_um {
                54.0.. => "no-go",
                46.0.. => "indeterminate",
                30.0.. => "warn",
                _ => "go",
            };
            checks += of_day.len();
            maker.put(&lake, &of_day);
        }
    }
    let seconds = begun.elapsed().as_secs_f64();
    println!("{} rows of {checks} checks in {seconds:.1} s", 6 * checks);
}
