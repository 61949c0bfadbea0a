//! A head whose lens the controller drives: commanded by its file, refused where nobody drives it, focused by its fringes.

use std::path::Path;

use flankscope_tests::{Run, flankscope, run};

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

/// So far from best focus a thousandth of the fringes' contrast is lost: blurs of 0.13 core pitches per mm each, the camera's seen under
/// 30 degrees, of fringes of 0.19 periods per core.
fn unseen_mm() -> f64 {
    let blur_per_mm2 = 2.0 * (std::f64::consts::PI * 0.19 * 0.13).powi(2) * (1.0 + 0.75);
    (1e-3 / blur_per_mm2).sqrt()
}

/// The plate stands where a thin lens of a known power images it.
#[test]
fn autofocus_finds_where_a_thin_lens_is_sharp_as_surely_as_it_says() {
    if !flankscope_test_requisites::dear() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (target, calibrated) = (at("target"), at("calibrated.toml"));
    written("demo-target", target.as_ref(), "liquid");
    let made = calibrate(&target, &["-o", &calibrated]);
    assert_eq!(made.code, 0, "{}", made.stderr);
    for (head, setting_dpt) in [("liquid@-2", -2.0), ("liquid@1,33", 1.0)] {
        let target = at(head);
        written("demo-target", target.as_ref(), head);
        let warm_dpt = if head.ends_with("33") { 0.5 } else { 0.0 };
        let best_mm = |setting_dpt: f64| best_focus_mm(setting_dpt + warm_dpt);
        let mut sigmas_dpt = Vec::new();
        for by in [
            &["--autofocus"][..],
            &["--autofocus", "--head", &calibrated],
        ] {
            let found = calibrate(&target, by);
            assert_eq!(found.code, 0, "{}", found.stderr);
            let found = &found.json["autofocus"];
            let figure = |key: &str| found[key].as_f64().unwrap();
            let (off_dpt, sigma_dpt) = (figure("sharpest_dpt") - setting_dpt, figure("sigma_dpt"));
            assert!(off_dpt.abs() <= 2.0 * sigma_dpt, "{head}: {found}");
            let sigma_mm = (best_mm(setting_dpt + sigma_dpt) - best_mm(setting_dpt)).abs();
            assert!(sigma_mm < unseen_mm(), "{head}: {found}");
            let step_off = figure("setting_dpt") - 0.0399 * (figure("counts") - 516.0);
            assert!(step_off.abs() < 1e-9);
            sigmas_dpt.push(sigma_dpt);
        }
        assert!(sigmas_dpt[1] < sigmas_dpt[0], "{head}: {sigmas_dpt:?}");
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
