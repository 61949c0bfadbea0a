//! A head whose lens the controller drives: commanded by its file, refused where nobody drives it, focused by its fringes.

use std::path::Path;

use flankscope_tests::{Run, flankscope, inspect, run};

fn written(what: &str, folder: &Path, head: &str) {
    let made = run(flankscope()
        .args(["bench", what, "--head", head, "--out"])
        .arg(folder));
    assert_eq!(made.code, 0, "{}", made.stderr);
}

fn calibrate(target: &str, arguments: &[&str]) -> Run {
    run(flankscope()
        .args(["calibrate", "--link", "sim", "--speed", "max", "--quiet"])
        .args(["--json", "-", "--target", target])
        .args(arguments))
}

#[test]
fn a_head_with_a_lens_before_a_controller_without_one_is_refused_and_nothing_moves() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (target, output) = (at("target"), at("head.toml"));
    // On this bench no head has a lens, and no controller a driver.
    written("demo-target", target.as_ref(), "20mm");
    let refused = calibrate(&target, &["--focus", "1", "-o", &output]);
    assert_eq!(refused.code, 3);
    assert!(
        refused.stderr.contains("has no [lens]"),
        "{}",
        refused.stderr
    );
    let head = folder.path().join("target/head.toml");
    let lens = "\n[lens]\nzero_counts = 516.0\ndpt_per_count = 0.0399\nrange = [416, 616]\n\
                settle_ms = 150\ncounts = 541\n";
    let text = std::fs::read_to_string(&head).unwrap();
    std::fs::write(&head, text + lens).unwrap();
    for arguments in [vec!["-o", &output], vec!["--autofocus"]] {
        let refused = calibrate(&target, &arguments);
        assert_eq!(refused.code, 3);
        let words = "the controller found no lens driver";
        assert!(refused.stderr.contains(words), "{}", refused.stderr);
    }
    assert!(!Path::new(&output).exists());
    // Beyond what the lens is driven to.
    let refused = calibrate(&target, &["--focus", "4.1", "-o", &output]);
    assert_eq!(refused.code, 3);
    let words = "must be -3.99 to 3.99 dpt";
    assert!(refused.stderr.contains(words), "{}", refused.stderr);
}

/// Best focus before the pinhole without current, as of a thin lens 1.5 mm before an objective that is sharp at 22 mm.
fn best_focus_mm(power_dpt: f64) -> f64 {
    1.5 + 1.0 / (1.0 / 20.5 + 1e-3 * power_dpt)
}

/// A tenth of a millimetre from best focus adds 0.013 core pitches of blur to 0.22 and 0.28, by squares: less than 0.2 % of either.
const SHARP_MM: f64 = 0.1;

/// The plate stands where a thin lens of a known power images it.
#[test]
fn autofocus_finds_where_a_thin_lens_is_sharp_cold_and_warm() {
    if !flankscope_test_requisites::dear() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    for (head, setting_dpt) in [("liquid@1.5", 1.5), ("liquid@1,33", 1.0)] {
        let target = folder.path().join(head);
        written("demo-target", &target, head);
        let found = calibrate(target.to_str().unwrap(), &["--autofocus"]);
        assert_eq!(found.code, 0, "{}", found.stderr);
        let found = &found.json["autofocus"];
        let warm_dpt = if head.ends_with("33") { 0.5 } else { 0.0 };
        let sharp_mm = |setting_dpt: f64| best_focus_mm(setting_dpt + warm_dpt);
        let off_mm = sharp_mm(found["sharpest_dpt"].as_f64().unwrap()) - sharp_mm(setting_dpt);
        assert!(off_mm.abs() < SHARP_MM, "{head}: {off_mm} mm, {found}");
        let counts = found["counts"].as_u64().unwrap();
        let step_off = found["setting_dpt"].as_f64().unwrap() - 0.0399 * (counts as f64 - 516.0);
        assert!(step_off.abs() < 1e-9);
    }
    // Where lenses are sharp that are much warmer: no setting of cold ones is.
    let far = folder.path().join("far");
    written("demo-target", &far, "liquid@4,80");
    let optics = far.join("optics.toml");
    let text = std::fs::read_to_string(&optics).unwrap();
    std::fs::write(&optics, text.replace("celsius = 80.0", "celsius = 23.0")).unwrap();
    let refused = calibrate(far.to_str().unwrap(), &["--autofocus"]);
    assert_eq!(refused.code, 3);
    assert!(
        refused.stderr.contains("end of the lens' range"),
        "{}",
        refused.stderr
    );
}

/// The same die on the same bench, whose optics follow what the controller was told: each head finds the wear through its own focus.
#[test]
fn one_die_at_two_focuses() {
    if !flankscope_test_requisites::dear() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let die = at("die");
    written("demo-tool", die.as_ref(), "liquid");
    let mut counts = Vec::new();
    for setting in ["0", "1.5"] {
        let (target, head) = (
            at(&format!("target{setting}")),
            at(&format!("head{setting}.toml")),
        );
        written("demo-target", target.as_ref(), &format!("liquid@{setting}"));
        let calibrated = calibrate(&target, &["-o", &head]);
        assert_eq!(calibrated.code, 0, "{}", calibrated.stderr);
        let lens = flankscope_profilometry::HeadModel::load(head.as_ref())
            .unwrap()
            .lens;
        counts.push(lens.unwrap().counts);
        let arguments = ["--link", "sim", "--tool", &die, "--head", &head];
        let checked = inspect(&[&arguments[..], &["--wear", "40:left:80"]].concat());
        assert_eq!(checked.not_go(), ["40:left:no-go"], "{}", checked.stderr);
    }
    assert_eq!(counts, [516, 554]);
}
