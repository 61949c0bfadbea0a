//! Frames from elsewhere through the whole instrument: no controller, no camera process, no bench.

use std::path::Path;

use flankscope_test_requisites::shared;
use flankscope_tests::{Run, flankscope, run};
use serde_json::Value;

/// What the outside renderer's head is off the place that its file says, µm.
const HEAD_OFF_UM: [f64; 2] = [35.0, -20.0];

fn check(folder: &Path, arguments: &[&str]) -> Run {
    let mut command = flankscope();
    command.args(["inspect", "--quiet", "--json", "-", "--frames"]);
    run(command.arg(folder).args(arguments))
}

/// An index in a folder of its own, for images that lie where nothing can be written.
fn index_of(outside: &Path, plan: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let text = format!(
        "simulated = true\nplan = {:?}\nhead = {:?}\nimages = {outside:?}\n[[view]]\ntooth = 40\n",
        outside.join(plan),
        outside.join("head.toml")
    );
    std::fs::write(folder.path().join("frames.toml"), text).unwrap();
    folder
}

fn feature<'a>(run: &'a Run, flank: &str) -> &'a Value {
    let features = run.json["features"].as_array().unwrap();
    let of = features
        .iter()
        .find(|f| f["tooth"] == 40 && f["flank"] == flank);
    of.unwrap_or_else(|| panic!("no {flank} flank: {}", run.json["features"]))
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

#[test]
fn a_sprayed_die_of_an_outside_renderer_is_go_and_where_the_head_was() {
    let Some(outside) = shared("outside/sprayed-new") else {
        return;
    };
    for (plan, frames) in [("plan-insitu12.toml", 12), ("plan-scan16.toml", 16)] {
        let folder = index_of(&outside, plan);
        let new = check(folder.path(), &["--teeth", "40"]);
        let json = &new.json;
        assert_eq!(new.code, 0, "{plan}: {} {}", json["reason"], new.stderr);
        assert_eq!(json["features"].as_array().unwrap().len(), 2, "{plan}");
        for flank in ["left", "right"] {
            let of = feature(&new, flank);
            let (wear, u95) = (number(&of["wear_um"]), number(&of["u95_um"]));
            assert!(
                wear.abs() <= u95,
                "{plan} {flank}: {wear} ± {u95} µm of nothing"
            );
        }
        let shift = &json["registration"][0]["shift_mm"];
        for (axis, off_um) in HEAD_OFF_UM.into_iter().enumerate() {
            let found_um = 1e3 * number(&shift[axis]);
            assert!((found_um - off_um).abs() < 2.0, "{plan}: {shift}");
        }
        let count = &json["frames"];
        assert_eq!(
            [
                &count["triggered"],
                &count["received"],
                &count["bytes_copied"]
            ],
            [&frames.into(), &frames.into(), &Value::from(0)]
        );
        assert_eq!(json["link"], "recorded frames");
        assert_eq!(json["simulated"], true);
        assert_eq!(json["recording"]["blake3"].as_str().unwrap().len(), 64);
        assert!(json["versions"]["firmware"].is_null(), "no controller");
    }
}

/// Light that goes from flank to flank spoils the coarse fringes: what follows from them must not be go where 80 µm are
/// missing.
#[test]
fn half_a_flank_of_bare_steel_that_lost_80_um_is_never_go() {
    let Some(outside) = shared("outside/steel-half80") else {
        return;
    };
    for plan in ["plan-insitu12.toml", "plan-scan16.toml"] {
        let folder = index_of(&outside, plan);
        let worn = check(folder.path(), &[]);
        assert!(
            [1, 2].contains(&worn.code),
            "{plan}: {} {}",
            worn.code,
            worn.stderr
        );
        assert_ne!(feature(&worn, "left")["verdict"], "go", "{plan}");
    }
}

#[test]
fn a_recorded_check_is_stored_reported_and_computed_again() {
    let Some(outside) = shared("outside/sprayed-new") else {
        return;
    };
    let folder = index_of(&outside, "plan-insitu12.toml");
    let history = folder.path().join("checks.db");
    let report = folder.path().join("report");
    let [history, report] = [&history, &report].map(|path| path.to_str().unwrap());
    let stored = check(folder.path(), &["--history", history, "--report", report]);
    assert_eq!(stored.code, 0, "{}", stored.stderr);
    assert_eq!(stored.json["id"], 1);
    let page = std::fs::read_to_string(Path::new(report).join("report.html")).unwrap();
    assert!(page.contains("recorded frames"));
    // The images are not asked again.
    std::fs::remove_file(folder.path().join("frames.toml")).unwrap();
    let head = outside.join("head.toml");
    let mut replay = flankscope();
    replay.args(["replay", history, "1", "--quiet", "--json", "-", "--head"]);
    let again = run(replay.arg(head));
    assert_eq!(
        again.code, 0,
        "{} {}",
        again.json["differences"], again.stderr
    );
    assert_eq!(again.json["same"], true);
    assert_eq!(again.json["recording"], stored.json["recording"]);
}
