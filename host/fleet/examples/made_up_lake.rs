//! A lake to measure questions by: `cargo run --release --example made_up_lake FOLDER STATIONS DAYS`.
//!
//! Every station checks six flanks of one die each three minutes, 36 strokes apart; wear is a line per flank with scatter. Files are as
//! large as joined ones: a day each.

#[path = "../tests/histories/mod.rs"]
mod histories;
#[path = "../tests/made_up/mod.rs"]
mod made_up;

use std::time::Instant;

use flankscope_fleet::lake::Lake;
use flankscope_test_requisites::Random;
use made_up::{MadeUp, Maker};

const CHECKS_A_DAY: i64 = 480;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, stations, days] = &arguments[..] else {
        eprintln!("made_up_lake FOLDER STATIONS DAYS");
        std::process::exit(2);
    };
    let (stations, days): (i64, i64) = (stations.parse().unwrap(), days.parse().unwrap());
    std::fs::create_dir_all(folder).unwrap();
    let lake = Lake::open(folder).unwrap();
    let mut maker = Maker::new();
    let mut random = Random(7);
    let begun = Instant::now();
    for station in 0..stations {
        let rates: Vec<f64> = (0..6).map(|_| 1e-5 * (1.0 + random.uniform())).collect();
        for day in 0..days {
            let check = |n: i64| {
                let strokes = 36 * (day * CHECKS_A_DAY + n);
                let wear = |rate: &f64| Some(4.0 + rate * strokes as f64 + random.normal());
                MadeUp {
                    station: format!("press {station}"),
                    serial: Some(format!("A {station}")),
                    head: format!("head {station}"),
                    minute: 1440 * day + 3 * n,
                    strokes,
                    wear_um: rates.iter().map(wear).collect(),
                }
            };
            let checks: Vec<MadeUp> = (0..CHECKS_A_DAY).map(check).collect();
            maker.put(&lake, &checks);
        }
    }
    let checks = stations * days * CHECKS_A_DAY;
    let seconds = begun.elapsed().as_secs_f64();
    println!("{} rows of {checks} checks in {seconds:.1} s", 6 * checks);
}
