//! The calibration, end to end: bench process, controller, captures, head file, and a check with it.

use flankscope_tests::{bench, expire, flankscope, inspect, press_tool, run};

#[test]
fn a_calibrated_head_checks_the_die() {
    if !flankscope_test_requisites::dear() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let head = folder.path().join("head.toml");
    let path = head.to_str().unwrap();
    // Lenses that bend light where no distortion model follows.
    let uneven = bench("[head]\nlens_error_um = 1.5\n");
    let [option, uneven] = uneven.each_ref().map(String::as_str);
    let calibrated = run(flankscope().args([
        "calibrate",
        "--quiet",
        "--speed",
        "max",
        "--seed",
        "4",
        option,
        uneven,
        "-o",
        path,
        "--json",
        "-",
    ]));
    assert_eq!(calibrated.code, 0, "{}", calibrated.stderr);
    let record = &calibrated.json["calibration"];
    assert_eq!(record["views"], 12, "{record}");
    assert_eq!(record["frames"][2], "stage");
    // A head from the bench says so.
    assert_eq!(record["simulated"], true, "{record}");
    assert_eq!(calibrated.json["link"], "sim");
    let text = std::fs::read_to_string(&head).unwrap();
    assert!(text.contains("simulated = true"), "{text}");
    assert!(calibrated.json["cores"].as_u64() > Some(70_000));
    // As good as it says: the article's head measures some ten micrometres, this one shall be known to three.
    let depth_um = record["depth_sigma_um"].as_f64();
    assert!(depth_um.is_some_and(|um| um < 3.0), "{record}");
    assert_eq!(record["hold_out"]["views"], 6, "{record}");
    // The bench's lenses are uneven: what that is worth shows on plates that took no part.
    let dots = |of: &str| record[of]["dots_rms_um"].as_f64();
    assert!(dots("hold_out") < dots("without_field"), "{record}");
    eprintln!("{record:#}");

    let size = &calibrated.json["self_test"]["probing_size_um"];
    assert!(size.as_f64().is_some_and(|um| um.abs() < 8.0), "{size}");
    let flat = &calibrated.json["self_test"]["flatness_cells_um"];
    // The widest of three ranges of a thousand normal values each, once in a hundred times.
    assert!(flat.as_f64().is_some_and(|um| um < 8.1), "{flat}");
    let spacing = &calibrated.json["self_test"]["sphere_spacing_um"];
    assert!(
        spacing.as_f64().is_some_and(|um| um.abs() < 8.0),
        "{spacing}"
    );

    let checked = inspect(&["--head", path, "--wear", "40:left:80", option, uneven]);
    assert_eq!(
        checked.code, 1,
        "{} {}",
        checked.json["reason"], checked.stderr
    );
    assert_eq!(checked.not_go(), ["40:left:no-go"]);
    let features = checked.json["features"].as_array().unwrap();
    let worn = features.iter().find(|f| f["verdict"] == "no-go").unwrap();
    let wear = worn["wear_um"].as_f64();
    assert!(wear.is_some_and(|um| (um - 80.0).abs() < 5.0), "{wear:?}");
    // The budget counts the calibration with what it says of itself along the flank's normal: the base circle seen from the
    // middle of the zone (40.562 to 42.190 mm).
    let sigma = |key: &str| record[key].as_f64().unwrap();
    let (sin, cos) = f64::acos(41.45 * 20f64.to_radians().cos() / 41.376).sin_cos();
    let expected = (sigma("depth_sigma_um") * sin).hypot(sigma("lateral_sigma_um") * cos);
    let counted = worn["detail"]["budget_um"]["calibration"].as_f64().unwrap();
    assert!((counted - expected).abs() < 0.01, "{counted} {expected}");

    let tested = run(flankscope().args([
        "calibrate",
        "--quiet",
        "--speed",
        "max",
        "--seed",
        "4",
        option,
        uneven,
        "--check",
        path,
        "--json",
        "-",
    ]));
    assert_eq!(tested.code, 0, "{}", tested.stderr);
    assert_eq!(tested.json["fit"], true, "{}", tested.json);

    // No press is judged with it.
    let tool = press_tool(&folder.path().join("die"));
    let press = ["--link", "/dev/flankscope-is-not-here", "--tool", &tool];
    let refused = inspect(&[&press[..], &["--head", path]].concat());
    assert_eq!(refused.code, 3);
    assert!(
        refused.stderr.contains("calibrated on the simulated bench"),
        "{}",
        refused.stderr
    );
    // A head that is not known to be the bench's is not tested there by mistake, nor a press's by intention.
    let text = std::fs::read_to_string(&head).unwrap();
    let check = |said: &str, arguments: &[&str], why: &str| {
        let other = folder.path().join("other.toml");
        std::fs::write(&other, text.replace("simulated = true", said)).unwrap();
        let trusted = run(flankscope()
            .arg("trust")
            .arg(&other)
            .args(["--quiet", "--name", "tester"]));
        assert_eq!(trusted.code, 0, "{}", trusted.stderr);
        let check = ["calibrate", "--quiet", "--check", other.to_str().unwrap()];
        let run = run(flankscope().args(check).args(arguments));
        assert_eq!(run.code, 3, "{said}");
        assert!(run.stderr.contains(why), "{}", run.stderr);
    };
    check("", &[], "--link PORT");
    check("simulated = false", &[], "--link PORT");
    check("simulated = false", &["--link", "sim"], "cannot test it");

    // What somebody edited is not believed, until somebody answers for it.
    let answered_for = |file: &std::path::Path| {
        let run_head = inspect(&["--head", path]);
        assert_eq!(run_head.code, 3, "{}", run_head.stderr);
        let named = format!("{}: this ", file.display());
        assert!(
            run_head.stderr.contains(&named) && run_head.stderr.contains("not believed"),
            "{}",
            run_head.stderr
        );
        let trust = run(flankscope()
            .arg("trust")
            .arg(file)
            .args(["--quiet", "--name", "tester"]));
        assert_eq!(trust.code, 0, "{}", trust.stderr);
    };
    // Nothing is measured with a head that must not judge.
    let refused = |why: &str| {
        let run = inspect(&["--head", path]);
        assert_eq!(run.code, 2, "{why}: {} {}", run.json["reason"], run.stderr);
        let reason = run.json["reason"].as_str().unwrap_or_default();
        assert!(reason.contains(why), "{reason}");
        assert_eq!(run.json["frames"]["triggered"], 0);
    };
    let test_path = folder.path().join("head.check.toml");
    let test = std::fs::read_to_string(&test_path).unwrap();
    let edited = |from: &str, to: &str| {
        let line = test.lines().find(|line| line.starts_with(from)).unwrap();
        std::fs::write(&test_path, test.replacen(line, to, 1)).unwrap();
    };
    edited("flatness_um", "flatness_um = 400.0");
    answered_for(&test_path);
    refused("failed: flatness");
    edited("due", "due = \"2001-01-01\"");
    answered_for(&test_path);
    refused("counted until 2001-01-01");
    std::fs::remove_file(&test_path).unwrap();
    refused("never tested");
    expire(&head);
    answered_for(&head);
    refused("expired after 2001-06-30");
    // Nor is a scan begun.
    let scan = [
        "scan", "--quiet", "--json", "-", "--views", "12x1", "--head", path,
    ];
    let scan = run(flankscope().args(scan));
    assert_eq!(scan.code, 2, "{}", scan.stderr);
    let reason = scan.json["reason"].as_str().unwrap_or_default();
    assert!(reason.contains("expired after 2001-06-30"), "{reason}");
    assert_eq!(scan.json["frames"]["triggered"], 0);
    assert!(scan.json["form"].is_null());
}

#[test]
fn nothing_to_calibrate_with_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let nowhere = folder.path().join("missing/head.toml");
    let refused = run(flankscope().args(["calibrate", "-o", nowhere.to_str().unwrap()]));
    assert_eq!(refused.code, 3);
    assert!(
        refused.stderr.contains("folder does not exist"),
        "{}",
        refused.stderr
    );
    let images = folder.path().to_str().unwrap();
    let head = folder.path().join("head.toml");
    let head = head.to_str().unwrap();
    let refused = run(flankscope().args(["calibrate", "--images", images, "-o", head]));
    assert_eq!(refused.code, 3);
    assert!(
        refused.stderr.contains("captures.toml"),
        "{}",
        refused.stderr
    );
    std::fs::write(folder.path().join("target.toml"), "name = 'x'\n").unwrap();
    let target = folder.path().to_str().unwrap();
    let refused =
        run(flankscope().args(["calibrate", "--link", "sim", "--target", target, "-o", head]));
    assert_eq!(refused.code, 3);
    assert!(
        refused.stderr.contains("target.toml:1") && refused.stderr.contains("exposure_us"),
        "{}",
        refused.stderr
    );
}
