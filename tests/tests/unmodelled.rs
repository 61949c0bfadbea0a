//! Errors that neither calibration nor joint solve has a parameter for: a worn flank must not pass because of them.

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
    for errors in [
        &["--encoder-saw", "84:30"][..],
        &["--encoder-saw", "7:200"],
        &["--backlash-mdeg", "60", "--backlash-um", "40"],
        &["--shiver-um", "20"],
        &["--shiver-um", "80"],
        &["--core-drift-px", "4"],
        &["--lens-error-um", "8"],
    ] {
        let word = worn_flank(errors);
        assert!(STOPPED.contains(&&*word), "{errors:?}: {word}");
    }
}

#[test]
fn no_surface_lets_a_worn_flank_pass() {
    for surface in [
        &["--surface", "ground"][..],
        &["--surface", "polished"],
        &["--surface", "oiled"],
        &["--surface", "ground", "--sprayed-above-mm", "33"],
        &["--bounces", "5"],
    ] {
        let word = worn_flank(&[surface, &["--teeth", "40"]].concat());
        assert!(STOPPED.contains(&&*word), "{surface:?}: {word}");
    }
}

/// A bore whose form no parameter follows, scanned as a whole.
#[test]
fn no_form_of_the_bore_lets_a_worn_flank_pass() {
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
