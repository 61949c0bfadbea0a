//! Many in-situ checks of one tooth at real-time speed: how long the press waits after the last exposure; and how a check
//! grows with the teeth that it looks at.

use std::path::Path;

use serde_json::Value;

use super::plot::{self, Curve};

/// Neighbouring teeth of a check.
const TEETH: [usize; 5] = [1, 2, 4, 8, 16];

/// Runs the checks and prints how their times are spread.
pub fn run(root: &Path, count: usize) -> Result<(), String> {
    let (mut latencies_ms, mut handovers_us, mut totals_ms) = (Vec::new(), Vec::new(), Vec::new());
    for number in 0..count {
        let seed = number.to_string();
        let document = inspect(root, &["--teeth", "40", "--seed", &seed])?;
        let take = |value: &Value| value.as_f64().ok_or("a figure is missing");
        latencies_ms.push(take(&document["timing_ms"]["last_exposure_to_verdict"])?);
        totals_ms.push(take(&document["timing_ms"]["total"])?);
        handovers_us.push(take(&document["frames"]["handover_us"]["p99"])?);
    }
    println!("| {count} checks of one tooth | median | 99 % | worst |\n|---|---|---|---|");
    for (name, mut values) in [
        ("last exposure to verdict, ms", latencies_ms),
        ("whole check, ms", totals_ms),
        ("frame hand-over, 99 % of a check, us", handovers_us),
    ] {
        values.sort_by(f64::total_cmp);
        let at = |share: f64| {
            let place = ((values.len() as f64 - 1.0) * share).round();
            values.get(place as usize).copied().unwrap_or(f64::NAN)
        };
        println!(
            "| {name} | {:.0} | {:.0} | {:.0} |",
            at(0.5),
            at(0.99),
            at(1.0)
        );
    }
    features(root)
}

/// Checks of more and more neighbouring teeth.
fn features(root: &Path) -> Result<(), String> {
    println!(
        "\n| neighbouring teeth | whole check, ms | last exposure to verdict, ms |\n|---|---|---|"
    );
    let (mut totals, mut latencies) = (Vec::new(), Vec::new());
    for count in TEETH {
        let teeth: Vec<String> = (0..count).map(|n| (40 + n).to_string()).collect();
        let document = inspect(root, &["--teeth", &teeth.join(",")])?;
        let take = |key: &str| {
            let value = document["timing_ms"][key].as_f64();
            value.ok_or_else(|| format!("timing_ms.{key} is missing"))
        };
        let (total, latency) = (take("total")?, take("last_exposure_to_verdict")?);
        println!("| {count} | {total:.0} | {latency:.0} |");
        totals.push((count as f64, total));
        latencies.push((count as f64, latency));
    }
    let curves = [
        Curve {
            name: "whole check",
            points: totals,
        },
        Curve {
            name: "last exposure to verdict",
            points: latencies,
        },
    ];
    let folder = root.join("docs/bench");
    match plot::svg("growth with the teeth of a check", "teeth", &curves) {
        Some(svg) => plot::save(&folder, "features", &svg),
        None => Ok(()),
    }
}

/// What a check by the release program says.
fn inspect(root: &Path, arguments: &[&str]) -> Result<Value, String> {
    let release = crate::cargo(&["run", "--release", "--quiet", "--"]);
    crate::firmware::inspect(root, release, arguments)
}
