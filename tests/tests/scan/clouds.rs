//! A scan of recorded clouds: the map of the scan that they are of, nothing sound by points alone, and what is no recording.

use std::path::Path;

use flankscope_test_requisites::dear;
use flankscope_tests::{Run, flankscope, run};
use serde_json::Value;

fn scan(args: &[&str]) -> Run {
    let common = ["scan", "--quiet", "--json", "-", "--speed", "max"];
    run(flankscope().args(common).args(args))
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

fn edit(path: &Path, edited: impl Fn(Vec<u8>) -> Vec<u8>) {
    std::fs::write(path, edited(std::fs::read(path).unwrap())).unwrap();
}

/// Without the lines that begin so.
fn without(text: Vec<u8>, beginning: &str) -> Vec<u8> {
    let text = String::from_utf8(text).unwrap();
    let lines = text.lines().filter(|line| !line.starts_with(beginning));
    lines.collect::<Vec<_>>().join("\n").into_bytes()
}

#[test]
fn clouds_of_a_scan_make_its_map_again_and_no_flank_is_sound_by_them() {
    if !dear() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let clouds = folder.path().join("clouds");
    let saved = clouds.to_str().unwrap();
    let live = scan(&[
        "--views",
        "12x1",
        "--wear",
        "39:left:300",
        "--save-clouds",
        saved,
    ]);
    assert_eq!(live.code, 1, "{} {}", live.json["reason"], live.stderr);
    let again = scan(&["--clouds", saved]);
    assert_eq!(again.code, 1, "{} {}", again.json["reason"], again.stderr);
    assert_eq!(again.json["link"], "recorded clouds");
    assert_eq!(again.json["simulated"], true);
    assert_eq!(again.json["frames"]["received"], 0);

    let list = |run: &Run, of: &str| run.json[of].as_array().unwrap().clone();
    let registered = |run: &Run| {
        let views = list(run, "registration");
        views.iter().filter(|v| v["status"] == "registered").count()
    };
    assert_eq!(registered(&live), 12);
    assert_eq!(registered(&again), 12);
    let (before, after) = (list(&live, "features"), list(&again, "features"));
    assert_eq!(before.len(), after.len());
    let mut sound = 0;
    for (was, is) in before.iter().zip(&after) {
        assert_eq!((&was["tooth"], &was["flank"]), (&is["tooth"], &is["flank"]));
        let registration_um = number(&was["detail"]["budget_um"]["registration"]);
        for figure in ["wear_um", "mean_um"] {
            let moved = (number(&was[figure]) - number(&is[figure])).abs();
            assert!(moved <= registration_um, "{figure}: {was}\n{is}");
        }
        if was["verdict"] == "go" || was["verdict"] == "warn" {
            sound += 1;
            assert_eq!(is["verdict"], "indeterminate", "{is}");
            assert_eq!(is["code"], "no_frames", "{is}");
        } else {
            assert_eq!(is["verdict"], was["verdict"], "{is}");
        }
    }
    assert!(sound >= 6, "{before:?}");
    let of_map = |run: &Run| number(&run.json["coverage_ratio"]);
    assert!((of_map(&live) - of_map(&again)).abs() < 1e-3);

    // One cloud in the place of two; and one that says nothing of its uncertainty.
    let index = clouds.join("clouds.toml");
    let (first, second) = (clouds.join("view-0001.ply"), clouds.join("view-0002.ply"));
    edit(&index, |text| without(text, "blake3"));
    let kept = std::fs::read(&second).unwrap();
    std::fs::copy(&first, &second).unwrap();
    let twice = scan(&["--clouds", saved]);
    assert_eq!(twice.code, 3, "{}", twice.stderr);
    assert!(
        twice.stderr.contains("very points of view 1"),
        "{}",
        twice.stderr
    );
    std::fs::write(&second, kept).unwrap();
    edit(&first, |bytes| {
        let at = bytes.windows(7).position(|w| w == b"sigma_z").unwrap();
        let at = at
            + bytes[at + 7..]
                .windows(7)
                .position(|w| w == b"sigma_z")
                .unwrap()
            + 7;
        [&bytes[..at], b"sigma_q", &bytes[at + 7..]].concat()
    });
    let unsure = scan(&["--clouds", saved]);
    assert_eq!(unsure.code, 2, "{}", unsure.stderr);
    let reason = unsure.json["reason"].as_str().unwrap();
    assert!(
        reason.contains("view-0001.ply states no standard uncertainty"),
        "{reason}"
    );
    assert_eq!(unsure.json["features"].as_array().unwrap().len(), 0);
}

#[test]
fn what_is_no_recording_of_clouds_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path().to_str().unwrap();
    let refused = |args: &[&str], words: &str| {
        let said = scan(args);
        assert_eq!(said.code, 3, "{args:?}: {}", said.stderr);
        assert!(said.stderr.contains(words), "{args:?}: {}", said.stderr);
    };
    refused(&["--clouds", at], "clouds.toml");
    let index = "simulated = true\n[[view]]\nfile = \"a.ply\"\ntooth = 40\n";
    std::fs::write(folder.path().join("clouds.toml"), index).unwrap();
    refused(&["--clouds", at], "a.ply");
    refused(&["--clouds", at, "--method", "article"], "fringes");
    refused(&["--clouds", at, "--views", "12x1"], "--views");
    refused(&["--clouds", at, "--frames", at], "--frames");
    refused(&["--save-clouds", at], "is not empty");
}
