//! What is too near to a limit is measured again where there is time, and ends by the policy of the tool file.

use std::process::Stdio;

use flankscope_tests::{Run, flankscope, inspect, run, tool_of_noise_alone};
use serde_json::Value;

/// A pit whose mean over the judged disc is 29.8 µm (0.771 of its depth, for a bowl (1 - r2/R2)2 of 1 mm2): noise leaves the
/// limit of 30 open.
const PIT: &str = "40:left:38.6:pit";

fn flank(inspection: &Value, tooth: u64, name: &str) -> Value {
    let features = inspection["features"].as_array().unwrap();
    let wanted = |f: &&Value| f["tooth"] == tooth && f["flank"] == name;
    features.iter().find(wanted).unwrap().clone()
}

fn number(value: &Value) -> f64 {
    value
        .as_f64()
        .unwrap_or_else(|| panic!("{value} is no number"))
}

#[test]
fn a_flank_at_its_limit_is_measured_again_and_judged_by_both() {
    let folder = tempfile::tempdir().unwrap();
    let history = folder.path().join("press.db");
    let once = tool_of_noise_alone(
        &folder.path().join("once"),
        "20mm",
        "remeasure = 0\nundecided = \"no-go\"",
    );
    let twice = tool_of_noise_alone(&folder.path().join("twice"), "20mm", "");
    let check = |tool: &str| -> Run {
        inspect(&[
            "--link",
            "sim",
            "--tool",
            tool,
            "--teeth",
            "12,40",
            "--wear",
            PIT,
            "--seed",
            "6",
            "--history",
            history.to_str().unwrap(),
        ])
    };
    let first = check(&once);
    let single = flank(&first.json, 40, "left");
    let guard = |u95: f64| 1.645 * u95 / 1.96;
    let off = number(&single["wear_um"]) - 30.0;
    assert!(
        off.abs() < guard(number(&single["u95_um"])),
        "too near to decide: {single}"
    );
    assert_eq!(first.code, 1, "the policy makes a no-go of it");
    assert_eq!(first.json["frames"]["triggered"], 50);
    assert!(single["measurements"].is_null());

    let again = check(&twice);
    let both = flank(&again.json, 40, "left");
    assert_eq!(
        again.json["frames"]["triggered"], 75,
        "only tooth 40 once more: {}",
        again.stderr
    );
    assert_eq!(again.json["frames"]["received"], 75);
    assert!(flank(&again.json, 12, "left")["measurements"].is_null());
    let measured: Vec<[f64; 2]> = both["measurements"]
        .as_array()
        .unwrap()
        .iter()
        .map(|m| [number(&m["value"]), number(&m["u95"])])
        .collect();
    assert_eq!(measured.len(), 2);
    assert_eq!(
        measured[0],
        [number(&single["wear_um"]), number(&single["u95_um"])]
    );
    assert_ne!(measured[0], measured[1], "another capture has other noise");
    // The figure is the largest mean over the points of both: near those of the captures. How much surer it is depends on how
    // much of the cells' scatter is noise, which they show themselves (see the wear tests); it is never less sure by more than
    // that scatter's own uncertainty, a tenth.
    let (wear, u95) = (number(&both["wear_um"]), number(&both["u95_um"]));
    let mean = 0.5 * (measured[0][0] + measured[1][0]);
    assert!((wear - mean).abs() < u95, "{both}");
    assert!(u95 < 1.1 * measured[0][1].max(measured[1][1]), "{both}");
    // Two looks share the allowed error of 5 %: each has a quantile of 97.5 %, which is U95's factor.
    let expected = match wear - 30.0 {
        off if off > u95 => ("no-go", 1),
        off if off < -u95 => ("warn", 4),
        _ => ("indeterminate", 2),
    };
    assert_eq!(
        (both["verdict"].as_str().unwrap(), again.code),
        expected,
        "{both}"
    );

    // Both captures are in the record, and give the same figures again.
    assert_eq!(
        again.json["evidence"][0]["phasors"]
            .as_array()
            .unwrap()
            .len(),
        1
    );
    assert_eq!(
        again.json["evidence"][1]["phasors"]
            .as_array()
            .unwrap()
            .len(),
        2
    );
    let mut replay = flankscope();
    replay
        .arg("replay")
        .arg(&history)
        .args(["2", "--quiet", "--json", "-", "--tool", &twice]);
    let replay = run(&mut replay);
    assert_eq!(
        (replay.code, &replay.json["captures"]),
        (again.code, &Value::from(3)),
        "{}",
        replay.stderr
    );
    assert_eq!(replay.json["same"], true, "{}", replay.json);
}

#[test]
fn a_watch_measures_again_only_within_the_time_it_may_hold_the_press() {
    let folder = tempfile::tempdir().unwrap();
    let tool = tool_of_noise_alone(&folder.path().join("tool"), "20mm", "");
    let station = folder.path().join("station.toml");
    let watch = |hold_s: &str| {
        let press = format!("[press]\nhold_limit_s = {hold_s}.0\n");
        std::fs::write(&station, press).unwrap();
        let mut command = flankscope();
        command
            .args([
                "watch", "--quiet", "--json", "-", "--speed", "3", "--every", "3", "--cycles", "4",
            ])
            .args([
                "--link", "sim", "--tool", &tool, "--teeth", "40", "--wear", PIT, "--seed", "6",
            ])
            .arg("--station")
            .arg(&station)
            .stdin(Stdio::null());
        run(&mut command)
    };
    // A visit of one tooth takes 3.7 s with its way in and out.
    for (hold_s, measured) in [("12", 2), ("6", 0)] {
        let run = watch(hold_s);
        let check = &run.json["checks"][0]["inspection"];
        let measurements = flank(check, 40, "left")["measurements"].clone();
        let count = measurements.as_array().map_or(0, Vec::len);
        assert_eq!(count, measured, "held {hold_s} s: {check} {}", run.stderr);
        assert!(!check["verdict"].as_str().unwrap().contains("go") || check["verdict"] == "no-go");
        let held_ms =
            number(&check["timing_ms"]["positioning"]) + number(&check["timing_ms"]["exposure"]);
        assert!(held_ms < 1e3 * hold_s.parse::<f64>().unwrap(), "{check}");
    }
}
