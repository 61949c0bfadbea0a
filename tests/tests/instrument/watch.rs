//! The instrument by itself: a stroking press, checks between strokes, a verdict that is latched.

use std::process::Stdio;

use flankscope_tests::{Run, bench, flankscope, run, with_small_head};

/// A watch of the small head before a press that is `speed` times as fast as a real one.
fn watch(speed: &str, arguments: &[&str]) -> Run {
    let mut command = flankscope();
    command.args(["watch", "--quiet", "--json", "-", "--speed", speed]);
    with_small_head(&mut command, arguments);
    run(command.stdin(Stdio::null()))
}

/// What was shown after each check.
fn shown(run: &Run) -> Vec<&str> {
    let checks = run.json["checks"].as_array().map_or(&[][..], Vec::as_slice);
    checks
        .iter()
        .filter_map(|check| check["shown"].as_str())
        .collect()
}

#[test]
fn growing_wear_goes_from_go_over_warn_to_a_no_go_that_stays() {
    // 1.2 µm per stroke: 30 µm (warn) after 25 strokes, 50 µm (stop) after 42.
    let arguments = "--every 8 --cycles 60 --teeth 40 --wear-rate 40:left:1.2";
    // Wear between the limits is told from a turn of the die by the neighbours that only the large head shows.
    let result = run(flankscope()
        .args(["watch", "--quiet", "--json", "-", "--speed", "10"])
        .args(arguments.split(' '))
        .stdin(Stdio::null()));
    let shown = shown(&result);
    assert_eq!(result.code, 1, "{shown:?} {}", result.stderr);
    assert_eq!(shown.first(), Some(&"go"), "{shown:?}");
    let first = |word| shown.iter().position(|&s| s == word);
    let (warn, no_go) = (
        first("warn").expect("a warning"),
        first("no-go").expect("a no-go"),
    );
    assert!(warn < no_go, "{shown:?}");
    assert!(
        shown[no_go..].iter().all(|&s| s == "no-go"),
        "a no-go stays until it is acknowledged: {shown:?}"
    );
    // The figure follows the wear, each within its own uncertainty.
    for check in result.json["checks"].as_array().unwrap() {
        let strokes = check["cycle"].as_f64().unwrap();
        let feature = &check["inspection"]["features"][0];
        let (wear, u95) = (
            feature["wear_um"].as_f64().unwrap(),
            feature["u95_um"].as_f64().unwrap(),
        );
        assert!(
            (wear - 1.2 * strokes).abs() <= u95,
            "after {strokes} strokes: {wear} µm ± {u95} µm"
        );
    }
}

#[test]
fn a_check_that_does_not_fit_is_cut_short_and_shows_no_go() {
    let folder = tempfile::tempdir().unwrap();
    let station = folder.path().join("station.toml");
    std::fs::write(&station, "[press]\nhold_limit_s = 5.0\n").unwrap();
    let at = ["--link", "sim", "--station", station.to_str().unwrap()];
    // Of the press's time a host that is kept from its processor for 50 ms loses twice that.
    let result = watch("2", &[&["--every", "3", "--cycles", "6"], &at[..]].concat());
    assert_eq!(result.code, 2, "{}", result.stderr);
    assert!(!shown(&result).is_empty() && shown(&result).iter().all(|&s| s == "indeterminate"));
    for check in result.json["checks"].as_array().unwrap() {
        let timing = &check["inspection"]["timing_ms"];
        let held_ms =
            timing["positioning"].as_f64().unwrap() + timing["exposure"].as_f64().unwrap();
        assert!(
            held_ms < 5000.0,
            "the head was out within the limit: {timing}"
        );
        assert!(
            check["inspection"]["reason"]
                .as_str()
                .unwrap()
                .contains("held"),
            "{}",
            check["inspection"]["reason"]
        );
    }
}

#[test]
fn bad_arguments_could_not_run() {
    let folder = tempfile::tempdir().unwrap();
    let station = folder.path().join("station.toml");
    std::fs::write(&station, "[press]\nhold_limit_s = nan\n").unwrap();
    let press = bench("[press]\nstrokes_per_minute = 3000\n");
    let press = press.each_ref().map(String::as_str);
    for (arguments, hint) in [
        (&["--every", "0"][..], "1"),
        (&["--station", station.to_str().unwrap()], "600"),
        (&press, "300"),
        (&["--wear-rate", "40:left"], "TOOTH:FLANK:DEPTH"),
    ] {
        let result = watch("10", &[&["--cycles", "1"], arguments].concat());
        assert_eq!(result.code, 3, "{arguments:?}: {}", result.stderr);
        assert!(
            result.stderr.contains(hint),
            "{arguments:?} should mention {hint:?}: {}",
            result.stderr
        );
    }
}
