//! The in-situ check, end to end: command, bench process, controller firmware, shared memory, verdict.

use flankscope_test_requisites::{everything, shared};
use flankscope_tests::{
    Run, flankscope, inspect, inspect_full, inspect_on, press_tool, pseudo_terminal, run,
};

/// The demo's limits, µm: warn at 30, stop at 50.
const WEAR: &str = "40:left:80";

#[track_caller]
fn assert_whole(run: &Run) {
    let json = &run.json;
    let frames = &json["frames"];
    assert_eq!(
        frames["bytes_copied"], 0,
        "no frame is ever copied: {frames}"
    );
    assert_eq!(
        frames["received"], 75,
        "three views of a dark frame and 12 patterns x 2 exposures: {frames}"
    );
    for key in [
        "total",
        "positioning",
        "exposure",
        "last_exposure_to_verdict",
    ] {
        assert!(
            json["timing_ms"][key].as_f64().is_some_and(|ms| ms > 0.0),
            "timing_ms.{key}: {}",
            json["timing_ms"]
        );
    }
    for key in [
        "verdict",
        "reason",
        "registration",
        "versions",
        "hashes",
        "truth",
    ] {
        assert!(!json[key].is_null(), "{key} is missing");
    }
    for feature in json["features"].as_array().unwrap() {
        for key in ["tooth", "wear_um", "u95_um", "warn_um", "limit_um"] {
            assert!(feature[key].is_number(), "{key} of {feature}");
        }
    }
}

/// Four seeds where everything runs, else two, each undamaged and worn: go, and no-go on exactly the worn flank. Split over
/// threads of the test runner.
fn seeds(seeds: std::ops::Range<u32>) {
    // The demo as it is shipped, whose head is the full one: this is what a newcomer runs first.
    let count = if everything() { 2 } else { 1 };
    for seed in seeds.take(count) {
        let seed = seed.to_string();
        let undamaged = inspect_full(&["--seed", &seed]);
        assert_eq!(
            undamaged.code, 0,
            "seed {seed}: {} {}",
            undamaged.json["reason"], undamaged.stderr
        );
        assert_eq!(undamaged.json["verdict"], "go");
        assert_whole(&undamaged);
        let worn = inspect_full(&["--seed", &seed, "--wear", WEAR]);
        assert_eq!(
            worn.code, 1,
            "seed {seed}: {} {}",
            worn.json["reason"], worn.stderr
        );
        assert_eq!(worn.not_go(), ["40:left:no-go"], "seed {seed}");
        assert_whole(&worn);
        let flank = worn.json["features"]
            .as_array()
            .unwrap()
            .iter()
            .find(|f| f["verdict"] == "no-go")
            .unwrap();
        let (wear, u95) = (
            flank["wear_um"].as_f64().unwrap(),
            flank["u95_um"].as_f64().unwrap(),
        );
        assert!(
            (wear - 80.0).abs() <= u95,
            "seed {seed}: {wear} µm ± {u95} µm does not hold the true 80 µm"
        );
    }
}

#[test]
fn undamaged_is_go_and_worn_is_no_go_seeds_from_1() {
    seeds(1..11);
}

#[test]
fn undamaged_is_go_and_worn_is_no_go_seeds_from_11() {
    seeds(11..21);
}

#[test]
fn one_seed_gives_one_result() {
    let results: Vec<_> = (0..2)
        .map(|_| inspect(&["--seed", "5", "--wear", "12:right:37"]))
        .collect();
    assert_eq!(results[0].json["features"], results[1].json["features"]);
    assert_eq!(
        results[0].json["truth"]["poses"],
        results[1].json["truth"]["poses"]
    );
    let other = inspect(&["--seed", "6", "--wear", "12:right:37"]);
    assert_ne!(
        results[0].json["features"], other.json["features"],
        "another seed is another noise"
    );
}

#[test]
fn other_teeth_and_in_between_limits() {
    // 40 µm lies between warn and stop, by more than the guard band of 1.645 x 2 µm: of the full head, with neighbours in view.
    let warned = inspect_full(&["--teeth", "7,84", "--wear", "84:left:40"]);
    assert_eq!(warned.code, 4, "{}", warned.json["reason"]);
    assert_eq!(warned.not_go(), ["84:left:warn"]);
    assert_eq!(warned.json["features"].as_array().unwrap().len(), 4);
    // Exactly at the limit nothing can be decided, which is never go.
    let at_limit = inspect_full(&["--teeth", "84", "--wear", "84:left:50"]);
    assert_eq!(at_limit.code, 2, "{}", at_limit.json["reason"]);
    // Stuck material is no loss, but has the same limits: over a disc its bowl of 40 µm is 35 µm high.
    let proud = inspect_full(&["--teeth", "84", "--wear", "84:left:40:buildup"]);
    assert_eq!(proud.code, 4, "{}", proud.json["reason"]);
    let reason = proud.json["reason"].as_str().unwrap();
    assert!(reason.contains("proud material"), "{reason}");
}

#[test]
fn a_gear_of_another_cad_kernel() {
    let Some(mesh) = shared("data/cad-ring84/ring84.stl") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let tool = format!(
        "name = \"ring84\"\n[cad]\nfile = {mesh:?}\nunit = \"mm\"\nchord_error_um = 2.0\n\
         [gear]\nkind = \"internal\"\nteeth = 84\nmodule_mm = 1.0\npressure_angle_deg = 20.0\ntip_radius_mm = 41.0\n\
         root_radius_mm = 43.25\nfirst_tooth_centre_deg = 2.142857142857143\nheight_mm = [0.0, 66.0]\n\
         [inspect]\nteeth = [3, 31, 59]\nheight_mm = 30.0\nwarn_um = 30.0\nlimit_um = 50.0\n"
    );
    std::fs::write(folder.path().join("tool.toml"), tool).unwrap();
    let folder = folder.path().to_str().unwrap();
    let undamaged = inspect(&["--link", "sim", "--tool", folder]);
    assert_eq!(
        undamaged.code, 0,
        "{} {}",
        undamaged.json["reason"], undamaged.stderr
    );
    for wear in ["31:right:80", "59:left:80"] {
        let worn = inspect(&["--link", "sim", "--tool", folder, "--wear", wear]);
        assert_eq!(worn.code, 1, "{} {}", worn.json["reason"], worn.stderr);
        assert_eq!(worn.not_go(), [wear.replace(":80", ":no-go")]);
    }
}

#[test]
fn the_report_is_one_file_with_its_pictures_inside() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("new/out");
    let result = inspect(&["--wear", WEAR, "--report", out.to_str().unwrap()]);
    assert_eq!(result.code, 1);
    let page = std::fs::read_to_string(out.join("report.html")).unwrap();
    assert_eq!(
        page.matches("data:image/png;base64,").count(),
        9,
        "six flank maps and a frame of each of three views"
    );
    assert_eq!(
        page.matches("<svg").count(),
        4,
        "ring, colour bar, histogram, timeline"
    );
    for outside in ["http://", "https://", "src=\"/", "<script src", "@import"] {
        assert!(
            !page.contains(outside),
            "the page must need nothing else, but holds {outside}"
        );
    }
    assert!(page.contains("tooth 40 left") && page.contains(">no-go<"));
    let document = std::fs::read_to_string(out.join("inspection.json")).unwrap();
    let document: serde_json::Value = serde_json::from_str(&document).unwrap();
    assert_eq!(document["verdict"], "no-go");
}

#[test]
fn a_port_that_does_not_answer_could_not_run() {
    // A real port with nobody behind it: the other end of a pseudo-terminal that stays silent.
    let (_master, port) = pseudo_terminal();
    let folder = tempfile::tempdir().unwrap();
    let tool = press_tool(folder.path());
    let silent = inspect(&["--link", port.to_str().unwrap(), "--tool", &tool]);
    assert_eq!(silent.code, 3, "{}", silent.stderr);
    assert!(
        silent.stderr.contains("answers nothing"),
        "{}",
        silent.stderr
    );
    let nowhere = "/dev/flankscope-is-not-here";
    let absent = inspect(&["--link", nowhere, "--tool", &tool]);
    assert_eq!(absent.code, 3);
    assert!(
        absent.stderr.contains("cannot open the port") && absent.stderr.contains(nowhere),
        "{}",
        absent.stderr
    );
}

/// Every start says which station, tool and head; a real press takes none of what is built in.
#[test]
fn a_press_demands_a_tool_and_a_calibrated_head() {
    let folder = tempfile::tempdir().unwrap();
    let tool = press_tool(folder.path());
    let nowhere = "/dev/flankscope-is-not-here";
    let started = |arguments: &[&str]| {
        run(flankscope()
            .env("USER", "Ada")
            .args(["inspect", "--station", "press 7"])
            .args(arguments))
    };
    let said = started(&["--link", nowhere, "--tool", &tool]).stderr;
    for words in [
        "station  press 7, link /dev/flankscope-is-not-here (a real press), operator Ada",
        &format!("tool     demo die ({tool}/tool.toml)"),
        &format!("head     small head ({tool}/head.toml; calibrated "),
        "cannot open the port",
    ] {
        assert!(said.contains(words), "{words}: {said}");
    }
    let built_in = started(&["--teeth", "40", "--speed", "max"]).stderr;
    for words in [
        "link sim (the simulated bench)",
        "tool     demo die (built in)",
        "head     prism head 20 mm (built in; not calibrated: a drawing's values)",
    ] {
        assert!(built_in.contains(words), "{words}: {built_in}");
    }
    let head = folder.path().join("head.toml");
    let text = std::fs::read_to_string(&head).unwrap();
    let (drawn, _) = text.split_once("[calibration]").unwrap();
    let refused = |arguments: &[&str], why: &[&str]| {
        // The built-in demo: refused before anything is rendered.
        let run = inspect_full(&[&["--link", nowhere], arguments].concat());
        assert_eq!(run.code, 3, "{arguments:?}");
        for words in why {
            assert!(run.stderr.contains(words), "{words}: {}", run.stderr);
        }
    };
    refused(&[], &["without --tool", "tool.toml"]);
    std::fs::write(&head, drawn).unwrap();
    refused(
        &["--tool", &tool],
        &["no [calibration]", "flankscope calibrate"],
    );
    std::fs::remove_file(&head).unwrap();
    refused(&["--tool", &tool], &["no head.toml", "--head"]);
    let target = run(flankscope().args(["calibrate", "--link", nowhere, "-o", "head.toml"]));
    assert_eq!(target.code, 3);
    assert!(target.stderr.contains("--target DIR"), "{}", target.stderr);
}

#[test]
fn bad_arguments_could_not_run_and_say_what_would_be_right() {
    for (arguments, hint) in [
        (&["--teeth", "85"][..], "1 to 84"),
        (&["--teeth", "12,12"], "twice"),
        (&["--wear", "12:left"], "TOOTH:FLANK:DEPTH"),
        (&["--wear", "12:top:80"], "left"),
        (&["--wear", "99:left:80"], "84"),
        (&["--wear", "12:left:nan"], "number"),
        (&["--speed", "fast"], "max"),
        (&["--speed", "0"], "0.1"),
        (
            &["--link", "sim", "--tool", "/flankscope-is-not-here"],
            "tool.toml",
        ),
        (&["--tool", "/flankscope-is-not-here"], "--link PORT"),
        (&["--history", "/flankscope-is-not-here.db"], "--link PORT"),
        (&["--link", ""], "/dev/ttyACM0"),
        (&["--no-such-option"], "--no-such-option"),
        (&["--report", "/dev/null/out"], "/dev/null/out"),
        (&["--report", "Cargo.toml"], "Cargo.toml"),
        (&["--json", "/flankscope-is-not-here/a.json"], "a.json"),
        (&["--json", "/"], "folder"),
        (&["--record-baseline", "/dev/null/new"], "/dev/null/new"),
    ] {
        let mut command = flankscope();
        command.args(["inspect", "--quiet"]).args(arguments);
        if !arguments.contains(&"--speed") {
            command.args(["--speed", "max"]);
        }
        let result = run(&mut command);
        assert_eq!(result.code, 3, "{arguments:?}: {}", result.stderr);
        assert!(
            result.stderr.contains(hint),
            "{arguments:?} should mention {hint:?}: {}",
            result.stderr
        );
    }
}

#[test]
fn a_tool_file_is_read_strictly() {
    let folder = tempfile::tempdir().unwrap();
    let written = flankscope()
        .args(["bench", "demo-tool", "--out"])
        .arg(folder.path())
        .status()
        .unwrap();
    assert!(written.success());
    let path = folder.path().join("tool.toml");
    let good = std::fs::read_to_string(&path).unwrap();
    for (from, to, hint) in [
        ("limit_um", "limit_mm", "limit_mm"),
        ("teeth = 84", "teeth = 83", "84"),
        ("module_mm = ", "module_mm = 2", "module"),
        ("unit = \"mm\"", "unit = \"m\"", "mm"),
        ("file = \"die.ply\"", "file = \"no.ply\"", "no.ply"),
        ("[gear]", "[gear", "tool.toml:"),
        ("warn_um = 30.0", "warn_um = nan", "warn_um"),
    ] {
        assert!(good.contains(from), "{from}");
        std::fs::write(&path, good.replacen(from, to, 1)).unwrap();
        let result = inspect(&["--link", "sim", "--tool", folder.path().to_str().unwrap()]);
        assert_eq!(
            result.code, 3,
            "{to}: {} {}",
            result.json["reason"], result.stderr
        );
        assert!(
            result.stderr.contains(hint),
            "{to} should mention {hint:?}: {}",
            result.stderr
        );
    }
}

#[test]
fn killed_at_any_moment_the_next_run_works() {
    for milliseconds in [30, 120, 400, 800] {
        let mut command = flankscope();
        command.args(["inspect", "--quiet", "--speed", "max"]);
        let mut child = command.stderr(std::process::Stdio::null()).spawn().unwrap();
        std::thread::sleep(std::time::Duration::from_millis(milliseconds));
        child.kill().unwrap(); // SIGKILL: nothing is cleaned up
        child.wait().unwrap();
    }
    let next = inspect(&[]);
    assert_eq!(next.code, 0, "{} {}", next.json["reason"], next.stderr);
}

/// A check of the new tool, stored; a later one on another day shows 5 µm as the difference to it.
#[test]
fn a_baseline_shows_five_micrometres() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("baseline.json");
    let file = path.to_str().unwrap();
    // Five micrometres since a baseline are a claim of the full head.
    let new = inspect_full(&["--seed", "31", "--teeth", "40", "--record-baseline", file]);
    assert_eq!(new.code, 0, "{} {}", new.json["reason"], new.stderr);

    let worn = [
        "--seed",
        "32",
        "--teeth",
        "40",
        "--wear",
        "40:left:5",
        "--baseline",
        file,
    ];
    let worn = inspect_full(&worn);
    assert_eq!(worn.code, 0, "{} {}", worn.json["reason"], worn.stderr);
    for feature in worn.json["features"].as_array().unwrap() {
        let wear = feature["wear_um"].as_f64().unwrap();
        let u95 = feature["u95_um"].as_f64().unwrap();
        let detects = feature["detail"]["detection_limit_um"].as_f64().unwrap();
        let truth = if feature["flank"] == "left" { 5.0 } else { 0.0 };
        assert!((wear - truth).abs() <= u95, "{feature}");
        assert!(u95 < 3.0 && detects < 3.0, "{feature}");
        assert_eq!(wear >= detects, truth > 0.0, "{feature}");
        let absolute = &feature["detail"]["absolute_um"];
        assert!(absolute["u95"].as_f64().unwrap() > u95, "{feature}");
    }

    // A tooth that was not recorded, and a head that is another one.
    let other = inspect_full(&["--teeth", "12", "--baseline", file]);
    assert_eq!(other.code, 2, "{}", other.json["reason"]);
    let text = std::fs::read_to_string(&path).unwrap();
    let mut json: serde_json::Value = serde_json::from_str(&text).unwrap();
    json["hashes"]["head"] = "0".into();
    std::fs::write(&path, json.to_string()).unwrap();
    // Somebody answers for it; that does not make it another head's.
    let trust = flankscope()
        .args(["trust", file, "--quiet", "--name", "tester"])
        .status()
        .unwrap();
    assert!(trust.success());
    let refused = flankscope()
        .args(["inspect", "--quiet", "--baseline", file])
        .output()
        .unwrap();
    assert_eq!(refused.status.code(), Some(3));
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(said.contains("another head file"), "{said}");
    // Damage is no baseline.
    let bad = flankscope()
        .args([
            "inspect",
            "--quiet",
            "--speed",
            "max",
            "--teeth",
            "40",
            "--wear",
            "40:left:80",
        ])
        .args(["--record-baseline", file])
        .output()
        .unwrap();
    assert_eq!(bad.status.code(), Some(1), "the verdict");
    let said = String::from_utf8_lossy(&bad.stderr);
    assert!(said.contains("is no baseline of a new tool"), "{said}");
    assert_eq!(std::fs::read_to_string(&path).unwrap(), json.to_string());
}

/// Frames that contradict each other are noticed in every core, not averaged into its point.
#[test]
fn a_shaking_head_is_indeterminate() {
    let calm = inspect(&["--teeth", "40"]);
    let ratio = &calm.json["registration"][0]["inconsistent_ratio"];
    assert!(
        ratio.as_f64().is_some_and(|r| r > 0.0 && r < 0.02),
        "{ratio}"
    );
    // Below what spoils a fringe, exposures still show one scene: noise alone sets one cell in a thousand apart.
    let moving = inspect_on("[motion]\nvibration_um = 0.5\n", &["--teeth", "40"]);
    assert_eq!(moving.code, 0, "{}", moving.stderr);
    let view = &moving.json["registration"][0];
    let apart = &view["light"]["rejected"]["exposures_disagree"];
    assert!(apart.as_f64().unwrap() < 1e-3 * view["points"].as_f64().unwrap());
    let shaken = inspect_on("[motion]\nvibration_um = 2.0\n", &["--teeth", "40"]);
    assert_eq!(shaken.code, 2, "{}", shaken.json["reason"]);
    let reason = shaken.json["reason"].as_str().unwrap_or_default();
    assert!(reason.contains("vibrates"), "{reason}");
}
