//! Heads other than the demo's, from their files alone: written, calibrated, and before the die.

use std::path::Path;

use flankscope_profilometry::HeadModel;
use flankscope_tests::{flankscope, inspect, run};
use serde_json::Value;

/// What the bench writes for a head.
fn written(what: &str, folder: &Path, head: &str) {
    let made = run(flankscope()
        .args(["bench", what, "--head", head, "--out"])
        .arg(folder));
    assert_eq!(made.code, 0, "{}", made.stderr);
}

/// Diameter of the field in the middle of the volume, mm, and how deep the volume is.
fn field_and_depth_mm(head: &HeadModel) -> [f64; 2] {
    let volume = head.volume.unwrap();
    let middle_mm = 0.5 * (volume.near_mm + volume.far_mm);
    let radius_px = head.image_circle.unwrap().radius_px;
    let field_mm = 2.0 * radius_px * middle_mm / head.camera.focal_px[0];
    [field_mm, volume.far_mm - volume.near_mm]
}

#[test]
fn a_head_by_name_has_the_field_it_is_named_for() {
    let folder = tempfile::tempdir().unwrap();
    for (name, expected_mm, working_mm) in [
        ("10mm", [6.0, 3.0], 10.0),
        ("20mm", [10.0, 3.4], 20.0),
        ("liquid", [9.0, 3.4], 20.0),
    ] {
        let out = folder.path().join(name);
        written("demo-target", &out, name);
        let head = HeadModel::load(&out.join("head.toml")).unwrap();
        assert_eq!(head.working_distance_mm, Some(working_mm));
        for (got, expected) in field_and_depth_mm(&head).into_iter().zip(expected_mm) {
            // The drawing's focal length is off by 0.6 %.
            assert!((got - expected).abs() < 0.01 * expected, "{name}: {got}");
        }
    }
    // Whoever says nothing gets the 20 mm head, to the last bit.
    let unsaid = folder.path().join("unsaid");
    let made = run(flankscope()
        .args(["bench", "demo-target", "--out"])
        .arg(&unsaid));
    assert_eq!(made.code, 0, "{}", made.stderr);
    let named = folder.path().join("20mm");
    for file in ["head.toml", "target.toml"] {
        let read = |folder: &Path| std::fs::read_to_string(folder.join(file)).unwrap();
        assert_eq!(read(&unsaid), read(&named), "{file}");
    }
}

#[test]
fn what_is_no_head_is_refused_before_anything_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let made = folder.path().join("made");
    written("demo-target", &made, "10mm");
    let text = std::fs::read_to_string(made.join("optics.toml")).unwrap();
    let file = folder.path().join("other.toml");
    let out = folder.path().join("out");
    for (from, to, why) in [
        ("angle_deg = 30.0", "angle_deg = nan", "angle_deg = NaN"),
        ("field_mm = 6.0", "field_mm = -6.0", "field_mm = -6"),
        ("field_mm = 6.0", "feld_mm = 6.0", "feld_mm"),
    ] {
        assert!(text.contains(from), "{from}");
        std::fs::write(&file, text.replace(from, to)).unwrap();
        let refused = run(flankscope()
            .args(["bench", "demo-target", "--head"])
            .arg(&file)
            .arg("--out")
            .arg(&out));
        assert_eq!(refused.code, 3, "{to}");
        assert!(refused.stderr.contains(why), "{to}: {}", refused.stderr);
        assert!(!out.exists(), "{to}");
    }
    // A folder with such a file is no bench either.
    std::fs::write(made.join("optics.toml"), text.replace("6.0", "inf")).unwrap();
    let target = made.to_str().unwrap();
    let head = folder.path().join("head.toml");
    let refused = run(flankscope()
        .args([
            "calibrate",
            "--link",
            "sim",
            "--quiet",
            "--target",
            target,
            "-o",
        ])
        .arg(&head));
    assert_eq!(refused.code, 3, "{}", refused.stderr);
    assert!(refused.stderr.contains("field_mm"), "{}", refused.stderr);
    assert!(!head.exists());
}

/// A head of 10 mm is calibrated by a target in proportion, finds damage, leaves sound flanks go, and scans.
#[test]
fn the_10_mm_head_calibrates_inspects_and_scans() {
    if !flankscope_test_requisites::dear() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let [target, tool] = ["target", "tool"].map(|name| folder.path().join(name));
    written("demo-target", &target, "10mm");
    written("demo-tool", &tool, "10mm");
    let (target, tool) = (target.to_str().unwrap(), tool.to_str().unwrap());
    let head = folder.path().join("head.toml");
    let head = head.to_str().unwrap();
    let common = ["--quiet", "--speed", "max", "--json", "-"];
    let calibrated = run(flankscope()
        .args(["calibrate", "--link", "sim", "--target", target, "-o", head])
        .args(common));
    assert_eq!(calibrated.code, 0, "{}", calibrated.stderr);
    let record = &calibrated.json["calibration"];
    // Half the distance and the same angle: it is to be known better than the 20 mm head, which is held to 3 um.
    let depth_um = record["depth_sigma_um"].as_f64();
    assert!(depth_um.is_some_and(|um| um < 2.0), "{record}");

    let checked = inspect(&[
        "--link",
        "sim",
        "--tool",
        tool,
        "--head",
        head,
        "--wear",
        "40:left:80",
    ]);
    assert_eq!(checked.not_go(), ["40:left:no-go"], "{}", checked.stderr);
    let features = checked.json["features"].as_array().unwrap();
    let worn = features.iter().find(|f| f["verdict"] == "no-go").unwrap();
    let wear_um = worn["wear_um"].as_f64();
    assert!(wear_um.is_some_and(|um| (um - 80.0).abs() < 5.0), "{worn}");

    let scanned = run(flankscope()
        .args(["scan", "--link", "sim", "--tool", tool, "--head", head])
        .args(["--views", "24x1"])
        .args(common));
    let views = scanned.json["registration"].as_array().map(Vec::as_slice);
    let laid = |view: &&Value| !view["tool_from_camera"].is_null();
    let laid = views.unwrap_or_default().iter().filter(laid).count();
    assert!(
        laid >= 22,
        "{laid}: {} {}",
        scanned.json["reason"],
        scanned.stderr
    );
}

/// What docs/heads.md says of the 20 mm head's depth: the article's 4 mm are unambiguous and show the same of this die, 7 mm are refused.
#[test]
fn the_20_mm_head_takes_the_article_s_depth() {
    let folder = tempfile::tempdir().unwrap();
    let tool = folder.path().join("die");
    written("demo-tool", &tool, "20mm");
    let head = tool.join("head.toml");
    let drawn = std::fs::read_to_string(&head).unwrap();
    let with_depth = |near_mm: f64, far_mm: f64| {
        let deeper = drawn.replace("near_mm = 20.3", &format!("near_mm = {near_mm:?}"));
        let deeper = deeper.replace("far_mm = 23.7", &format!("far_mm = {far_mm:?}"));
        std::fs::write(&head, &deeper).unwrap();
        let die = tool.to_str().unwrap();
        inspect(&["--link", "sim", "--tool", die, "--teeth", "40"])
    };
    let points = [(20.3, 23.7), (20.0, 24.0)].map(|(near_mm, far_mm)| {
        let checked = with_depth(near_mm, far_mm);
        assert_eq!(checked.code, 0, "{}", checked.stderr);
        checked.json["registration"][0]["points"].as_u64().unwrap()
    });
    assert!(points[0] > 80_000 && points[0] == points[1], "{points:?}");
    let refused = with_depth(18.5, 25.5);
    assert_eq!(refused.code, 3);
    let words = "at most 0.95 are unambiguous";
    assert!(refused.stderr.contains(words), "{}", refused.stderr);
}

/// A head with a liquid lens is calibrated at three settings and computed between them; that head passes the self-test at its setting,
/// and finds the wear. On the same bench, whose optics follow what the controller was told, a head calibrated at another setting finds it,
/// too.
#[test]
fn a_liquid_lens_is_calibrated_at_three_settings_and_judges_between_them() {
    if !flankscope_test_requisites::dear() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let common = ["--quiet", "--speed", "max", "--json", "-"];
    let mut series =
        "name = \"liquid\"\ndrift_dpt_per_kelvin = 0.05\ndrift_sigma_dpt_per_kelvin = 0.01\n\
                      celsius_sigma = 0.5\n"
            .to_owned();
    for (setting, counts) in [("-3", 441), ("0", 516), ("3", 591)] {
        let (target, head) = (
            at(&format!("target{setting}")),
            format!("head{setting}.toml"),
        );
        written("demo-target", target.as_ref(), &format!("liquid@{setting}"));
        let calibrated = run(flankscope()
            .args(["calibrate", "--link", "sim", "--target", &target])
            .args(["-o", &at(&head)])
            .args(common));
        assert_eq!(calibrated.code, 0, "{}", calibrated.stderr);
        let lens = HeadModel::load(at(&head).as_ref()).unwrap().lens.unwrap();
        assert_eq!(lens.counts, counts);
        series +=
            &format!("[[focus]]\nsetting_dpt = {setting}.0\ncelsius = 23.0\nfile = \"{head}\"\n");
    }
    let file = at("focus.toml");
    std::fs::write(&file, &series).unwrap();
    let between = |setting: &str, head: &str| {
        run(flankscope()
            .args(["calibrate", "--focus-series", &file, "--focus", setting])
            .args(["--lens-celsius", "33", "-o", head, "--quiet", "--json", "-"]))
    };
    // As warm as that, the lenses are half a dioptre stronger; 75 counts either way are 2.9925 dpt.
    let refused = between("2.7", &at("beyond.toml"));
    assert_eq!(refused.code, 3);
    assert!(
        refused.stderr.contains("at that temperature -3.49"),
        "{}",
        refused.stderr
    );
    assert!(!folder.path().join("beyond.toml").exists());
    let head = at("between.toml");
    let computed = between("1", &head);
    assert_eq!(computed.code, 0, "{}", computed.stderr);
    let record = &computed.json["calibration"];
    let depth_um = record["depth_sigma_um"].as_f64();
    // It is not known better than the settings are.
    assert!(depth_um.is_some_and(|um| um > 0.8 && um < 8.0), "{record}");

    let (target, tool) = (at("target"), at("tool"));
    written("demo-target", target.as_ref(), "liquid@1,33");
    written("demo-tool", tool.as_ref(), "liquid@1,33");
    let tested = run(flankscope()
        .args(["calibrate", "--link", "sim", "--target", &target])
        .args(["--check", &head])
        .args(common));
    assert_eq!(tested.code, 0, "{}", tested.json);
    let cold = at("cold");
    written("demo-tool", cold.as_ref(), "liquid");
    for (tool, head) in [(&tool, &head), (&cold, &at("head0.toml"))] {
        let on = ["--link", "sim", "--tool", tool, "--head", head];
        let checked = inspect(&[&on[..], &["--wear", "40:left:80"]].concat());
        assert_eq!(checked.not_go(), ["40:left:no-go"], "{}", checked.stderr);
    }
    // Driven to another setting it is no calibrated head, even if somebody vouches for the file: a check never focuses.
    let elsewhere = folder.path().join("elsewhere.toml");
    let text = std::fs::read_to_string(at("head0.toml")).unwrap();
    std::fs::write(&elsewhere, text.replace("counts = 516\n", "counts = 530\n")).unwrap();
    let on = [
        "--link",
        "sim",
        "--tool",
        &cold,
        "--head",
        &at("elsewhere.toml"),
    ];
    let refused = inspect(&on);
    assert_eq!(refused.code, 3, "{}", refused.stderr);
    assert!(refused.stderr.contains("lens.counts"), "{}", refused.stderr);
    // A file that somebody touched is believed no more, and takes no part.
    let touched = folder.path().join("head0.toml");
    let text = std::fs::read_to_string(&touched).unwrap();
    std::fs::write(
        &touched,
        text.replace("working_distance_mm = 20.0", "working_distance_mm = 20.5"),
    )
    .unwrap();
    let refused = between("1", &at("touched.toml"));
    assert_eq!(refused.code, 3, "{}", refused.stderr);
    assert!(!folder.path().join("touched.toml").exists());
}

/// Nothing of a head is compiled in, nor are its fringes: pictures for its DMD, check, store and recording of a set of its own.
#[test]
fn a_head_throws_a_set_of_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (tool, pictures, history, frames) = (at("die"), at("dmd"), at("press.db"), at("frames"));
    written("demo-tool", tool.as_ref(), "20mm");
    let head = folder.path().join("die/head.toml");
    let text = std::fs::read_to_string(&head).unwrap();
    let own = text.replace("pattern_set = \"high12\"", "pattern_set = \"mine14\"");
    assert_ne!(own, text);
    let sets = [(37, 4), (40, 4), (49, 6)];
    let table = |(periods, steps)| format!("[[fringes]]\nperiods = {periods}\nsteps = {steps}\n");
    std::fs::write(&head, [&own, "\n", &sets.map(table).concat()].concat()).unwrap();

    let written = run(flankscope()
        .args([
            "patterns", "--set", "mine14", "--pack", "grey", "-q", "--json", "-",
        ])
        .args(["-o", &pictures, "--head"])
        .arg(&head));
    assert_eq!(written.code, 0, "{}", written.stderr);
    let patterns = written.json[0]["patterns"].as_array().unwrap();
    let shown: Vec<_> = patterns
        .iter()
        .map(|of| ["periods", "step", "steps"].map(|key| of[key].as_f64().unwrap()))
        .collect();
    let expected = sets.iter().flat_map(|&(periods, steps)| {
        (0..steps).map(move |step| [periods, step, steps].map(f64::from))
    });
    assert_eq!(shown, expected.collect::<Vec<_>>());

    let kept = ["--history", &history, "--save-frames", &frames];
    let check = ["--link", "sim", "--teeth", "40", "--wear", "40:left:80"];
    let worn = inspect(&[&check[..], &["--tool", &tool], &kept].concat());
    assert_eq!(worn.not_go(), ["40:left:no-go"], "{}", worn.stderr);
    let left = &worn.json["features"][0];
    let [wear_um, u95_um] = ["wear_um", "u95_um"].map(|key| left[key].as_f64().unwrap());
    assert!((wear_um - 80.0).abs() <= u95_um, "{wear_um} ± {u95_um}");
    assert_eq!(worn.json["recipe"]["pattern_set"], "mine14");
    assert_eq!(worn.json["frames"]["received"], 1 + 2 * 14);
    let recorded = inspect(&["--frames", &frames, "--tool", &tool]);
    assert_eq!(recorded.json["features"], worn.json["features"]);
    let again = run(flankscope()
        .args(["replay", &history, "1", "--tool", &tool])
        .args(["--quiet", "--json", "-"]));
    assert_eq!(again.json["same"], true, "{}", again.json);
}

/// Two projectors: each flank by the one that sees it, both where they agree; stored, recorded and computed again as any check.
#[test]
fn a_head_with_two_projectors_sees_more_and_contradicts_itself_by_name() {
    if !flankscope_test_requisites::dear() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (twin, one) = (at("twin"), at("one"));
    written("demo-tool", twin.as_ref(), "twin");
    written("demo-tool", one.as_ref(), "20mm");
    let check = |tool: &str, more: &[&str]| {
        let of_tooth = ["--link", "sim", "--teeth", "40", "--tool", tool];
        inspect(&[&of_tooth, more].concat())
    };
    let (history, frames) = (at("press.db"), at("frames"));
    let kept = ["--history", &history, "--save-frames", &frames];
    let worn = check(&twin, &[&["--wear", "40:left:80"][..], &kept].concat());
    assert_eq!(worn.not_go(), ["40:left:no-go"], "{}", worn.stderr);
    let left = &worn.json["features"][0];
    let [wear_um, u95_um] = ["wear_um", "u95_um"].map(|key| left[key].as_f64().unwrap());
    assert!((wear_um - 80.0).abs() <= u95_um, "{wear_um} ± {u95_um}");
    // Dark frame, then twelve patterns at two exposures by each.
    assert_eq!(worn.json["frames"]["received"], 1 + 2 * 2 * 12);
    let projectors = &worn.json["registration"][0]["light"]["projectors"];
    let count = |of: &Value| of.as_u64().unwrap();
    let alone = [&projectors["alone"][0], &projectors["alone"][1]].map(count);
    let both = count(&projectors["both"]);
    assert!(alone[0] > 100 && alone[1] > 100, "{projectors}");
    assert!(both > 10 * (alone[0] + alone[1]), "{projectors}");
    let recorded = inspect(&["--frames", &frames, "--tool", &twin]);
    assert_eq!(recorded.json["features"], worn.json["features"]);
    let again = run(flankscope()
        .args(["replay", &history, "1", "--tool", &twin])
        .args(["--quiet", "--json", "-"]));
    assert_eq!(again.json["same"], true, "{}", again.json);
    // The walls of a scratch across hide its floor from a projector on one side.
    let scratched = |tool: &str| {
        let found = check(tool, &["--wear", "40:left:150:scratch-across"]);
        assert_eq!(found.code, 1, "{} {}", found.json["reason"], found.stderr);
        // Part of the floor is hidden either way: what is claimed is a lower bound, and it holds.
        let at_least_um = found.json["features"][0]["at_least_um"].as_f64().unwrap();
        let truth = &found.json["truth"]["flanks"]["40:left"]["max_disc_wear_um"];
        assert!(
            at_least_um <= truth.as_f64().unwrap(),
            "{at_least_um} {truth}"
        );
        at_least_um
    };
    let (by_both, by_one) = (scratched(&twin), scratched(&one));
    assert!(by_both > by_one, "{by_both} {by_one}");

    // A second projector that is not where its file says: 0.1 mm along its base are 0.2 mm of depth.
    let text = std::fs::read_to_string(folder.path().join("twin/head.toml")).unwrap();
    let second = text
        .find("[second_projector.projector_from_camera]")
        .unwrap();
    let line = second + text[second..].find("translation_mm").unwrap();
    let end = line + text[line..].find('\n').unwrap();
    let moved = "translation_mm = [-10.9, 0.0, 2.947]";
    let moved = [&text[..line], moved, &text[end..]].concat();
    let elsewhere = folder.path().join("twin/elsewhere.toml");
    std::fs::write(&elsewhere, moved).unwrap();
    let strange = check(&twin, &["--head", elsewhere.to_str().unwrap()]);
    assert_eq!(strange.code, 2, "{}", strange.json["reason"]);

    // Both are calibrated against the one camera, and what they may be apart is the calibration's word.
    let target = at("target");
    written("demo-target", target.as_ref(), "twin");
    let calibrate = |target: &str, output: &str| {
        run(flankscope()
            .args(["calibrate", "--link", "sim", "--speed", "max", "--quiet"])
            .args(["--json", "-", "--target", target, "-o", output]))
    };
    let head = at("twin/calibrated.toml");
    let calibrated = calibrate(&target, &head);
    assert_eq!(calibrated.code, 0, "{}", calibrated.stderr);
    let apart = &calibrated.json["calibration"]["second_projector"];
    let allowed_um = apart["apart_um"].as_f64().unwrap();
    // Cells see a micrometre of noise each; what was allowed without a calibration was judged, not measured.
    assert!((1.0..20.0).contains(&allowed_um), "{apart}");
    let worn = check(&twin, &["--head", &head, "--wear", "40:left:80"]);
    assert_eq!(worn.not_go(), ["40:left:no-go"], "{}", worn.stderr);
    let left = &worn.json["features"][0];
    let [wear_um, u95_um] = ["wear_um", "u95_um"].map(|key| left[key].as_f64().unwrap());
    assert!((wear_um - 80.0).abs() <= u95_um, "{wear_um} ± {u95_um}");
    let projectors = &worn.json["registration"][0]["light"]["projectors"];
    let apart_um = projectors["apart_um"].as_f64().unwrap();
    assert!(apart_um.abs() < allowed_um, "{projectors}");
    assert!(count(&projectors["both"]) > 20 * count(&projectors["disagreeing"]));
    // Edited, it is no calibration any more.
    let text = std::fs::read_to_string(&head).unwrap();
    let cut = text.find("[calibration.second_projector]").unwrap();
    std::fs::write(at("twin/cut.toml"), &text[..cut]).unwrap();
    let cut = check(&twin, &["--head", &at("twin/cut.toml")]);
    assert_eq!(cut.code, 3);
    assert!(
        cut.stderr.contains("calibration.second_projector"),
        "{}",
        cut.stderr
    );

    // Before a controller with one projector nothing moves.
    let single = at("single");
    written("demo-target", single.as_ref(), "20mm");
    std::fs::copy(
        folder.path().join("target/head.toml"),
        folder.path().join("single/head.toml"),
    )
    .unwrap();
    let refused = calibrate(&single, &at("none.toml"));
    assert_eq!(refused.code, 3);
    let words = "2 projectors, and the controller found 1";
    assert!(refused.stderr.contains(words), "{}", refused.stderr);
    assert!(!folder.path().join("none.toml").exists());
}
