//! Many in-situ checks of one tooth at real-time speed: how long the press waits after the last exposure.

use std::path::Path;

use serde_json::Value;

/// Runs the checks and prints how their times are spread.
pub fn run(root: &Path, count: usize) -> Result<(), String> {
    let (mut latencies_ms, mut handovers_us, mut totals_ms) = (Vec::new(), Vec::new(), Vec::new());
    for number in 0..count {
        let seed = number.to_string();
        let document = crate::firmware::inspect(root, &["--teeth", "40", "--seed", &seed])?;
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
    Ok(())
}
