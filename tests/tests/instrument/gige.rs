//! The check through a stranger's camera: every frame leaves the bench as GigE Vision packets of Aravis' own fake camera, and comes
//! back through the camera process.

use flankscope_test_requisites::aravis;
use flankscope_tests::{Run, flankscope, inspect, inspect_on, run, with_small_head};
use serde_json::{Value, json};

fn through_gige(arguments: &[&str]) -> Run {
    inspect(&[&["--camera", "gige"], arguments].concat())
}

fn troubled(trouble: &str) -> Run {
    let lines = format!("[camera]\ngige_trouble = \"{trouble}\"\n");
    inspect_on(&lines, &["--camera", "gige"])
}

/// What a check found, without what its clocks and its link say.
fn figures(run: &Run) -> Value {
    let mut found = json!({});
    for key in ["verdict", "reason", "features", "registration", "truth"] {
        found[key] = run.json[key].clone();
    }
    for view in found["registration"].as_array_mut().into_iter().flatten() {
        view["elapsed_ms"].take();
    }
    for clock in ["held_ms", "lagged_ms", "virtual_s"] {
        found["truth"][clock].take();
    }
    for key in ["triggered", "received", "recaptured_views"] {
        found[key] = run.json["frames"][key].clone();
    }
    found
}

#[test]
fn the_verdict_and_every_figure_are_those_of_the_shared_memory() {
    if !aravis() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let frames = folder.path().join("frames");
    for (arguments, code) in [(&["--wear", "40:left:80"][..], 1), (&["--seed", "3"], 0)] {
        let written = inspect(arguments);
        let mut more = arguments.to_vec();
        let keeps = ["--save-frames", frames.to_str().unwrap()];
        if code == 0 {
            more.extend(keeps);
        }
        let sent = through_gige(&more);
        assert_eq!(sent.code, code, "{} {}", sent.json["reason"], sent.stderr);
        let found = figures(&sent);
        assert_eq!(found["received"], 75, "{found}");
        // Truth and figures alike: the same pixels, packed and unpacked.
        assert_eq!(found, figures(&written));
    }
    // What a camera did not measure does not stand in the recording as measured: it is judged again as it was.
    let mut again = flankscope();
    again.args(["inspect", "--quiet", "--json", "-"]);
    let again = run(with_small_head(
        &mut again,
        &["--frames", frames.to_str().unwrap()],
    ));
    assert_eq!(again.code, 0, "{} {}", again.json["reason"], again.stderr);
}

/// One packet in two thousand: every tenth frame. It is captured again, or nobody says go.
#[test]
fn lost_packets_are_no_verdict() {
    if !aravis() {
        return;
    }
    let few = troubled("lost:0.0005");
    match few.code {
        0 => assert!(few.json["reason"].is_string()),
        2 => assert_eq!(few.json["verdict"], "indeterminate"),
        code => panic!("exit {code}: {} {}", few.json["reason"], few.stderr),
    }
    let many = troubled("lost:0.02");
    assert_eq!(
        (many.code, &many.json["verdict"]),
        (2, &"indeterminate".into())
    );
    for words in ["frames incomplete", "packets lost"] {
        assert!(many.stderr.contains(words), "{}", many.stderr);
    }
}

/// A camera that is another one than it must be is named, and the stages stay where they are.
#[test]
fn a_wrong_camera_is_named_and_nothing_moves() {
    if !aravis() {
        return;
    }
    for (trouble, words) in [
        ("free-runs", &["TriggerMode", "nothing triggers"][..]),
        ("colour", &["PixelFormat", "BayerRG12p", "Mono12p"]),
        ("smaller", &["576 x 416 px", "640 x 480"]),
        ("shallow", &["8 bits", "says 12"]),
        // 6 dB are a factor of 1.995 in the counts of an electron.
        ("amplified", &["3.964 electrons per count", "7.910"]),
    ] {
        let run = troubled(trouble);
        assert_eq!(run.code, 2, "{trouble}: {}", run.stderr);
        assert_eq!(run.json["verdict"], "indeterminate");
        let said = run.json["reason"].to_string() + &run.stderr;
        for word in words {
            assert!(said.contains(word), "{trouble}: {word}: {said}");
        }
        assert_eq!(run.json["frames"]["triggered"], 0, "{trouble}");
        assert_eq!(run.json["timing_ms"]["positioning"], 0.0, "{trouble}");
    }
}

/// It comes back by itself; what it missed is captured again or not judged.
#[test]
fn a_camera_that_is_unplugged_in_the_middle_is_missed_and_found_again() {
    if !flankscope_test_requisites::dear() {
        return;
    }
    if !aravis() {
        return;
    }
    let run = troubled("unplugged:30");
    assert!([0, 2].contains(&run.code), "{}: {}", run.code, run.stderr);
    assert_eq!(run.code == 0, run.json["verdict"] == "go");
    assert!(run.stderr.contains("the camera is gone"), "{}", run.stderr);
}
