//! `flankscope wear`: clouds of another scanner, drawn on exact involutes, are judged like a check.

use std::fmt::Write;
use std::path::Path;

use flankscope_metrology::gear::{Flank, GearData};
use flankscope_metrology::tool::Tool;
use flankscope_test_requisites::Random;
use flankscope_tests::{Run, flankscope, run, write_small_tool};
use serde_json::Value;

/// Distance of neighbouring points, mm: closer than a fifth of the judged disc's diameter.
const STEP_MM: f64 = 0.09;
/// Points along the height.
const COLUMNS: u32 = 130;
/// Scatter of a point, mm.
const NOISE_MM: f64 = 3e-3;
/// The tooth that is judged, and those beside it that hold the pose.
const TOOTH: u32 = 40;

/// Points on flanks and tips of eleven teeth, of which the left one of [`TOOTH`] has lost `wear_mm`; moved as a scanner's frame may be.
fn cloud(gear: &GearData, wear_mm: impl Fn(f64, f64) -> f64, seed: u64) -> String {
    let mut scatter = Random(seed);
    let mut text = String::new();
    let [tip, root] = [gear.tip_radius_mm, gear.root_radius_mm];
    let rows = ((root - tip).abs() / STEP_MM) as u32;
    let grid = |rows: u32| (1..=rows).flat_map(|row| (0..COLUMNS).map(move |column| (row, column)));
    // A scanner's rows do not follow a flank's height: each column begins elsewhere.
    let share = |rows: u32, row: u32, column: u32| {
        (f64::from(row) - (0.618 * f64::from(column)).fract()) / f64::from(rows)
    };
    let height = |column: u32| 27.0 + STEP_MM * f64::from(column);
    let mut add = |[x, y, z]: [f64; 3]| {
        writeln!(text, "{:.5} {:.5} {z:.5}", x + 0.04, y - 0.03).unwrap();
    };
    for tooth in TOOTH - 5..=TOOTH + 5 {
        for (flank, (row, column)) in Flank::BOTH
            .into_iter()
            .flat_map(|f| grid(rows).map(move |at| (f, at)))
        {
            let radius = tip + (root - tip) * share(rows, row, column);
            let Some(at) = gear.flank_point(tooth, flank, radius, height(column)) else {
                continue;
            };
            let worn = (tooth, flank) == (TOOTH, Flank::Left);
            let lost_mm = if worn { wear_mm(radius, at[2]) } else { 0.0 };
            let off_mm = NOISE_MM * scatter.normal() - lost_mm;
            let normal = gear.flank_normal(flank, at);
            add(std::array::from_fn(|k| at[k] + off_mm * normal[k]));
        }
        let half = gear.half_tooth_rad(tip).unwrap();
        let rows = (2.0 * half * tip / STEP_MM) as u32;
        for (row, column) in grid(rows) {
            let along = half * (2.0 * share(rows, row, column) - 1.0);
            let angle = gear.tooth_centre_rad(tooth) + along;
            let radius = tip + NOISE_MM * scatter.normal();
            add([radius * angle.cos(), radius * angle.sin(), height(column)]);
        }
    }
    text
}

fn judge(folder: &Path, cloud: &str, more: &[&str]) -> Run {
    let file = folder.join("scan.xyz");
    std::fs::write(&file, cloud).unwrap();
    let (tool, file) = (folder.join("die"), file.to_str().unwrap().to_owned());
    let args = ["wear", "--tool", tool.to_str().unwrap(), &file];
    let common = ["--json", "-", "--quiet"];
    run(flankscope().args(args).args(common).args(more))
}

fn die(folder: &Path) -> Tool {
    let die = folder.join("die");
    write_small_tool(&die);
    Tool::load(&die).unwrap()
}

fn left(run: &Run) -> &Value {
    let mut features = run.json["features"].as_array().unwrap().iter();
    features.find(|of| of["flank"] == "left").unwrap()
}

#[test]
fn clouds_of_another_scanner_are_judged_by_the_tools_limits() {
    let folder = tempfile::tempdir().unwrap();
    let tool = die(folder.path());
    let gear = tool.gear.as_ref().unwrap();
    let middle = 0.5 * (gear.tip_radius_mm + gear.root_radius_mm);
    // A round pit twice as wide as the judged disc, so that the largest mean over a disc is its depth.
    let pit = |depth_mm: f64| {
        move |radius: f64, height: f64| {
            let away = ((radius - middle) / 20f64.to_radians().cos()).hypot(height - 33.0);
            if away < 0.6 { depth_mm } else { 0.0 }
        }
    };
    for (depth_um, verdict, code) in [(0.0, "go", 0), (38.0, "warn", 4), (70.0, "no-go", 1)] {
        let points = cloud(gear, pit(1e-3 * depth_um), depth_um as u64 + 1);
        let run = judge(folder.path(), &points, &["--teeth", "40"]);
        assert_eq!(run.json["verdict"], verdict, "{depth_um}: {}", run.json);
        assert_eq!(run.code, code);
        let left = left(&run);
        let wear_um = left["wear_um"].as_f64().unwrap();
        // A lower bound has no interval: the rim of a deep pit may hide more.
        match (left["u95_um"].as_f64(), left["at_least_um"].as_f64()) {
            (Some(u95_um), None) => {
                assert!((wear_um - depth_um).abs() <= u95_um, "{depth_um}: {left}");
                // The scanner's own uncertainty is in it.
                assert!(u95_um >= 5.0, "{left}");
            }
            (None, Some(least_um)) => assert!(least_um <= depth_um, "{depth_um}: {left}"),
            _ => panic!("{left}"),
        }
    }
    // The side is worn as a whole: the pose does not hide it, and whoever asks for the next tooth hears of it.
    let worn = cloud(gear, |_, _| 80e-3, 9);
    for tooth in ["40", "41"] {
        let run = judge(folder.path(), &worn, &["--teeth", tooth]);
        let reason = run.json["reason"].as_str().unwrap();
        assert_eq!(run.json["verdict"], "no-go", "{tooth}: {reason}");
        assert!(reason.contains("tooth 40 left"), "{tooth}: {reason}");
    }
}

#[test]
fn what_a_cloud_does_not_show_is_never_go() {
    let folder = tempfile::tempdir().unwrap();
    let tool = die(folder.path());
    let gear = tool.gear.as_ref().unwrap();
    let whole = cloud(gear, |_, _| 0.0, 3);
    let lines = || whole.lines();
    let kept = |keep: &dyn Fn(usize) -> bool| -> String {
        let chosen = lines().enumerate().filter(|(i, _)| keep(*i));
        chosen.map(|(_, line)| format!("{line}\n")).collect()
    };
    for (what, cloud) in [
        ("every fourth point", kept(&|i| i % 4 == 0)),
        ("ten points", kept(&|i| i % 20_000 == 0)),
    ] {
        let run = judge(folder.path(), &cloud, &["--teeth", "40"]);
        assert_eq!(run.json["verdict"], "indeterminate", "{what}: {}", run.json);
        assert_eq!(run.code, 2, "{what}");
    }
    let metres: String = lines().map(scaled).collect();
    for (bad, name) in [
        ("nan 1 2\n", "none of the 1 points"),
        ("", "empty"),
        (&metres, "--cloud-unit"),
    ] {
        let run = judge(folder.path(), bad, &[]);
        assert_eq!(run.code, 3, "{bad:?}: {}", run.stderr);
        assert!(run.stderr.to_lowercase().contains(name), "{}", run.stderr);
    }
    let run = judge(folder.path(), &whole, &["--u95-um", "0"]);
    assert!(
        run.code == 3 && run.stderr.contains("above 0"),
        "{}",
        run.stderr
    );
}

/// A line of metres.
fn scaled(line: &str) -> String {
    let numbers = line.split(' ').map(|x| x.parse::<f64>().unwrap() / 1000.0);
    let numbers: Vec<String> = numbers.map(|x| format!("{x:.8}")).collect();
    format!("{}\n", numbers.join(" "))
}
