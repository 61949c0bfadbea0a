//! Errors that neither calibration nor joint solve has a parameter for: a worn flank must not pass because of them.
//!
//! They need the full head: the errors act across its field, and its verdict without them is no-go.

use flankscope_test_requisites::at_least;
use flankscope_tests::{bench, flankscope, inspect_full, inspect_full_on, inspect_on, run};

/// Upper half of a flank, beyond the limit of 50 µm: part of the judged discs lies within it as a whole.
const WORN: &str = "40:left:80:half";
/// What such a flank may be found to be.
const STOPPED: [&str; 2] = ["no-go", "indeterminate"];

/// A check of the tooth, behind two others, and what it says of the worn flank.
fn worn_flank(errors: &str, rest: &[&str]) -> String {
    let fixed = ["--seed", "5", "--wear", WORN];
    let seen = inspect_full_on(errors, &[&fixed[..], rest].concat());
    assert!(
        [1, 2].contains(&seen.code),
        "{errors:?} {rest:?}: {} {}",
        seen.json["reason"],
        seen.stderr
    );
    let word = seen.flank(40, "left").unwrap_or_default().to_owned();
    println!(
        "{errors:?} {rest:?}: worn {word}, sound {:?}",
        seen.flank(40, "right")
    );
    word
}

#[test]
fn no_error_of_stages_and_head_lets_a_worn_flank_pass() {
    let all = [
        "[head]\ncore_drift_px = 4.0\n",
        "[stages]\nbacklash_mdeg = 60.0\nbacklash_um = 40.0\n",
        "[stages]\nencoder_saw = \"84:30\"\n",
        "[stages]\nencoder_saw = \"7:200\"\n",
        "[motion]\nshiver_um = 20.0\n",
        "[motion]\nshiver_um = 80.0\n",
        "[head]\nlens_error_um = 8.0\n",
        "[head]\ntwist_px = 2.0\ntwist_loss_ratio = 0.3\n",
    ];
    for errors in at_least(2, &all) {
        let word = worn_flank(errors, &[]);
        assert!(STOPPED.contains(&&*word), "{errors:?}: {word}");
    }
}

#[test]
fn no_surface_lets_a_worn_flank_pass() {
    let all = [
        ("[surface]\nsprayed_above_mm = 33.0\n", "ground"),
        ("[surface]\nfilm_um = 15.0\n", "sprayed"),
        ("", "polished"),
        ("", "oiled"),
        ("[surface]\nbounces = 5\n", "sprayed"),
    ];
    for surface in at_least(1, &all) {
        let (lines, kind) = surface;
        let word = worn_flank(lines, &["--surface", kind, "--teeth", "40"]);
        assert!(STOPPED.contains(&&*word), "{surface:?}: {word}");
    }
}

/// Nobody sprays a die between two strokes: bare ground steel is judged, not only refused.
#[test]
fn bare_ground_steel_is_judged() {
    let steel = ["--surface", "ground", "--teeth", "40", "--seed", "5"];
    let sound = inspect_full(&steel);
    assert_eq!(sound.code, 0, "{} {}", sound.json["reason"], sound.stderr);
    let worn = inspect_full(&[&steel[..], &["--wear", WORN]].concat());
    assert_eq!(worn.code, 1, "{} {}", worn.json["reason"], worn.stderr);
    assert_eq!(worn.flank(40, "left"), Some("no-go"));
    assert_eq!(worn.flank(40, "right"), Some("go"));
}

/// A bore whose form no parameter follows, scanned as a whole.
#[test]
fn no_form_of_the_bore_lets_a_worn_flank_pass() {
    if !flankscope_test_requisites::dear() {
        return;
    }
    let mut scan = flankscope();
    scan.args(["scan", "--speed", "max", "--quiet", "--json", "-"]);
    scan.args(["--views", "12x1", "--seed", "5"]);
    scan.args(bench(
        "[die]\nthree_lobe_um = 40.0\nbarrel_um = 20.0\nbell_mouth_um = 60.0\n[stages]\nencoder_saw = \"12:20\"\n",
    ));
    scan.args(["--wear", "39:left:80:half"]);
    let seen = run(&mut scan);
    assert!(
        [1, 2].contains(&seen.code),
        "{} {}",
        seen.json["reason"],
        seen.stderr
    );
    let word = seen.flank(39, "left").unwrap_or_default();
    assert!(STOPPED.contains(&word), "{word}");
}

/// Beyond what the simulated camera can show, the check could not run: no view is shown unshifted instead.
#[test]
fn shifts_of_the_cores_that_together_go_too_far_are_refused() {
    let refused = inspect_on("[head]\ncore_drift_px = 6.0\ntwist_px = -6.0\n", &[]);
    assert_eq!(refused.code, 3, "{}", refused.stderr);
    let words = "move the cores' image by up to 12 px; together 10 px are possible";
    assert!(refused.stderr.contains(words), "{}", refused.stderr);
}
