//! The in-situ check through the controller's Cortex-M image in QEMU.

use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

use serde_json::Value;

use flankscope_test_requisites::{at_least, emulated_image, workspace};
use flankscope_tests::{Run, flankscope, inspect, run};

const IMAGE: &str = "flankscope-mps2-an386";

#[track_caller]
fn assert_same(one: &Run, other: &Run) {
    assert_eq!(
        one.code, other.code,
        "{} {}",
        other.json["reason"], other.stderr
    );
    // Everything computed from frames, to the last bit: an exposure lasts whole lines of the sensor, so that the
    // microseconds by which the image's pulses are longer change nothing.
    for key in ["verdict", "reason", "features", "registration"] {
        assert_eq!(untimed(&one.json[key]), untimed(&other.json[key]), "{key}");
    }
}

/// Without the times that a computation took.
fn untimed(value: &Value) -> Value {
    match value {
        Value::Array(items) => items.iter().map(untimed).collect(),
        Value::Object(fields) => fields
            .iter()
            .filter(|(key, _)| *key != "elapsed_ms")
            .map(|(key, value)| (key.clone(), untimed(value)))
            .collect(),
        other => other.clone(),
    }
}

#[test]
fn the_emulated_image_gives_the_verdict_and_the_points_of_the_in_process_controller() {
    let Some(_) = emulated_image(IMAGE) else {
        return;
    };
    let cases = [
        vec!["--seed", "3", "--wear", "40:left:80"],
        vec!["--seed", "3"],
    ];
    for arguments in at_least(1, &cases) {
        let sim = inspect(arguments);
        let emulated = inspect(&[&arguments[..], &["--link", "qemu", "--speed", "1"]].concat());
        assert_same(&sim, &emulated);
        let controller = &emulated.json["truth"]["controller"];
        assert_eq!(
            controller["starts"], 1,
            "the image started once: {controller}"
        );
        assert_eq!(emulated.json["frames"]["received"], 75);
    }
}

#[test]
fn without_an_emulator_or_an_image_it_could_not_run_and_says_how_to_get_them() {
    let check = |image: &Path, path: &str| {
        let mut command = flankscope();
        command.args(["inspect", "--quiet", "--link", "qemu"]);
        run(command.env("FLANKSCOPE_IMAGE", image).env("PATH", path))
    };
    let missing = check(Path::new("nowhere/image"), "");
    assert_eq!(missing.code, 3, "{}", missing.stderr);
    assert!(
        missing.stderr.contains("cargo xtask firmware"),
        "{}",
        missing.stderr
    );
    let missing = check(&workspace().join("Cargo.toml"), "");
    assert_eq!(missing.code, 3, "{}", missing.stderr);
    assert!(
        missing.stderr.contains("apt-get install qemu-system-arm"),
        "{}",
        missing.stderr
    );
}

#[test]
fn the_emulated_image_lives_in_real_time() {
    let run = inspect(&["--link", "qemu", "--speed", "2"]);
    assert_eq!(run.code, 3, "{}", run.stderr);
    assert!(run.stderr.contains("--speed must be 1"), "{}", run.stderr);
}

/// The emulated image has pins for one projector, and says so before anything moves.
#[test]
fn a_head_with_two_projectors_is_refused_by_name() {
    if emulated_image(IMAGE).is_none() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let die = folder.path().join("die");
    let made = run(flankscope()
        .args(["bench", "demo-tool", "--head", "twin", "--out"])
        .arg(&die));
    assert_eq!(made.code, 0, "{}", made.stderr);
    let die = die.to_str().unwrap();
    let refused = inspect(&[
        "--link", "qemu", "--speed", "1", "--teeth", "40", "--tool", die,
    ]);
    assert_eq!(refused.code, 3, "{}", refused.stderr);
    let words = "2 projectors, and the controller found 1";
    assert!(refused.stderr.contains(words), "{}", refused.stderr);
}

#[test]
fn a_killed_check_leaves_no_emulator_behind() {
    let Some(image) = emulated_image(IMAGE) else {
        return;
    };
    // A name of its own, to find the emulator by.
    let folder = tempfile::tempdir().unwrap();
    let own = folder.path().join("image");
    std::fs::copy(image, &own).unwrap();
    let mut command = flankscope();
    command
        .args(["inspect", "--quiet", "--link", "qemu"])
        .env("FLANKSCOPE_IMAGE", &own);
    let mut check = command
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    wait_for("the emulator to start", || emulators(&own) == 1);
    check.kill().unwrap();
    check.wait().unwrap();
    wait_for("the emulator to end", || emulators(&own) == 0);
}

/// Processes that run `qemu-system-arm` with this image.
fn emulators(image: &Path) -> usize {
    let image = image.to_string_lossy().into_owned();
    let processes = std::fs::read_dir("/proc").unwrap().flatten();
    processes
        .filter_map(|process| std::fs::read(process.path().join("cmdline")).ok())
        .map(|line| String::from_utf8_lossy(&line).into_owned())
        .filter(|line| line.starts_with("qemu-system-arm") && line.contains(&image))
        .count()
}

#[track_caller]
fn wait_for(what: &str, mut done: impl FnMut() -> bool) {
    let start = Instant::now();
    while !done() {
        assert!(
            start.elapsed() < Duration::from_secs(60),
            "waited in vain for {what}"
        );
        std::thread::sleep(Duration::from_millis(20));
    }
}
