//! Errors that neither calibration nor joint solve has a parameter for: a worn flank must not pass because of them.

use flankscope_test_requisites::at_least;
use flankscope_tests::{flankscope, inspect, run};

/// Upper half of a flank, beyond the limit of 50 µm: part of the judged discs lies within it as a whole.
const WORN: &str = "40:left:80:half";
/// What such a flank may be found to be.
const STOPPED: [&str; 2] = ["no-go", "indeterminate"];

/// A check of the tooth, behind two others, and what it says of the worn flank.
fn worn_flank(errors: &[&str]) -> String {
    let fixed = ["--seed", "5", "--wear", WORN];
    let seen = inspect(&[&fixed[..], errors].concat());
    assert!(
        [1, 2].contains(&seen.code),
        "{errors:?}: {} {}",
        seen.json["reason"],
        seen.stderr
    );
    let word = seen.flank(40, "left").unwrap_or_default().to_owned();
    println!(
        "{errors:?}: worn {word}, sound {:?}",
        seen.flank(40, "right")
    );
    word
}

#[test]
fn no_error_of_stages_and_head_lets_a_worn_flank_pass() {
    let all = [
        &["--core-drift-px", "4"][..],
        &["--backlash-mdeg", "60", "--backlash-um", "40"],
        &["--encoder-saw", "84:30"],
        &["--encoder-saw", "7:200"],
        &["--shiver-um", "20"],
        &["--shiver-um", "80"],
        &["--lens-error-um", "8"],
    ];
    for errors in at_least(2, &all) {
        let word = worn_flank(errors);
        assert!(STOPPED.contains(&&*word), "{errors:?}: {word}");
    }
}

#[test]
fn no_surface_lets_a_worn_flank_pass() {
    let all = [
        &["--surface", "ground", "--sprayed-above-mm", "33"][..],
        &["--surface", "ground"],
        &["--surface", "polished"],
        &["--surface", "oiled"],
        &["--bounces", "5"],
    ];
    for surface in at_least(1, &all) {
        let word = worn_flank(&[*surface, &["--teeth", "40"]].concat());
        assert!(STOPPED.contains(&&*word), "{surface:?}: {word}");
    }
}

/// Nobody sprays a die between two strokes: bare ground steel is judged, not only refused.
#[test]
fn bare_ground_steel_is_judged() {
    let steel = ["--surface", "ground", "--teeth", "40", "--seed", "5"];
    let sound = inspect(&steel);
    assert_eq!(sound.code, 0, "{} {}", sound.json["reason"], sound.stderr);
    let worn = inspect(&[&steel[..], &["--wear", WORN]].concat());
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
    scan.args([
        "scan", "--views", "12x1", "--speed", "max", "--seed", "5", "--quiet", "--json", "-",
    ]);
    scan.args([
        "--three-lobe-um",
        "40",
        "--barrel-um",
        "20",
        "--bell-mouth-um",
        "60",
    ]);
    scan.args(["--encoder-saw", "12:20", "--wear", "39:left:80:half"]);
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
