//! `flankscope view`: levels, saturation, contrast and focus of one tooth while the head is set up, and exposures that suit it.

use std::path::Path;

use flankscope_profilometry::HeadModel;
use flankscope_tests::{Run, bench, flankscope, press_tool, run, small_tool};
use serde_json::Value;

fn demo_tool(folder: &Path, head: &str) -> String {
    let path = folder.to_str().unwrap().to_owned();
    let made = run(flankscope().args(["bench", "demo-tool", "--head", head, "--out", &path]));
    assert_eq!(made.code, 0, "{}", made.stderr);
    path
}

fn view(arguments: &[&str]) -> Run {
    run(flankscope()
        .args(["view", "--speed", "max", "--quiet", "--json", "-"])
        .args(arguments))
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

/// Replaces the exposures in a head file as a person would.
fn expose(head: &Path, from: &str, to: &str) {
    let text = std::fs::read_to_string(head).unwrap();
    assert_eq!(text.matches(from).count(), 1, "{text}");
    std::fs::write(head, text.replace(from, to)).unwrap();
}

#[test]
fn levels_follow_the_exposure_and_the_proposed_ones_are_written() {
    let folder = tempfile::tempdir().unwrap();
    let tool = demo_tool(&folder.path().join("die"), "small");
    let head = folder.path().join("die/head.toml");
    let before = std::fs::read_to_string(&head).unwrap();
    let exposures_us = HeadModel::load(&head).unwrap().exposures_us;
    let said = |exposures_us: &[u32]| format!("exposures_us = {exposures_us:?}");
    let page = folder.path().join("view.html");
    let at = ["--tool", &tool, "--link", "sim", "--tooth", "40"];
    let with_page = ["--captures", "2", "--page", page.to_str().unwrap()];
    let whole = view(&[&at[..], &with_page].concat());
    assert_eq!(whole.code, 0, "{}", whole.stderr);
    let captures = whole.json["captures"].as_array().unwrap();
    assert_eq!(captures.len(), 2, "{}", whole.json);
    assert_eq!(whole.json["tooth"], 40);
    assert_eq!(whole.json["origin"]["simulated"], true);
    assert_eq!(whole.json["written"], Value::Null);
    let capture = &captures[1];
    assert_eq!(capture["number"], 2);
    for key in [
        "dark_dn",
        "focus_contrast",
        "cells",
        "points",
        "rejected",
        "date",
    ] {
        assert!(!capture[key].is_null(), "{key}: {capture}");
    }
    let levels = capture["exposures"].as_array().unwrap();
    assert_eq!(levels.len(), exposures_us.len());
    for (level, us) in levels.iter().zip(&exposures_us) {
        assert_eq!(level["exposure_us"], *us);
        assert_eq!(level["histogram"].as_array().unwrap().len(), 64);
        let of = |key: &str| number(&level[key]);
        assert!(
            of("median_dn") < of("bright_dn") && of("bright_dn") <= of("max_dn"),
            "{level}"
        );
        assert!(of("weak_modulation_dn") < of("modulation_dn"), "{level}");
    }
    let contrast = number(capture["contrast"].as_array().unwrap().last().unwrap());
    assert!((0.2..1.0).contains(&contrast), "{capture}");

    // The page is whole, stands alone, and no longer loads itself again.
    let text = std::fs::read_to_string(&page).unwrap();
    assert!(text.starts_with("<!doctype html>") && text.trim_end().ends_with("</html>"));
    for foreign in ["http://", "https://", "http-equiv", "<script src", "<link"] {
        assert!(!text.contains(foreign), "{foreign}");
    }
    assert_eq!(text.matches("<svg").count(), exposures_us.len());
    assert!(text.contains("data:image/png;base64,") && text.contains("SIMULATED BENCH"));

    // Half the exposure gives half the light.
    let halved: Vec<u32> = exposures_us.iter().map(|us| us / 2).collect();
    expose(&head, &said(&exposures_us), &said(&halved));
    let half = view(&[&at[..], &["--captures", "1", "--write-exposures"]].concat());
    assert_eq!(half.code, 0, "{}", half.stderr);
    let dim = &half.json["captures"][0];
    let lit = |capture: &Value, at: usize, key: &str| {
        number(&capture["exposures"][at][key]) - number(&capture["dark_dn"])
    };
    for at in 0..exposures_us.len() {
        // The brightest pixels of the demo's longer exposure are saturated.
        let saturated = number(&levels[at]["saturated_pixel_ratio"]) > 1e-3;
        assert_eq!(saturated, at > 0, "{capture}");
        let keys = &["median_dn", "bright_dn"][..if saturated { 1 } else { 2 }];
        for key in keys {
            let ratio = lit(dim, at, key) / lit(capture, at, key);
            assert!((ratio - 0.5).abs() < 0.03, "{key}: {capture} {dim}");
        }
        let modulation = |of: &Value| number(&of["exposures"][at]["modulation_dn"]);
        let ratio = modulation(dim) / modulation(capture);
        assert!((ratio - 0.5).abs() < 0.03, "{capture} {dim}");
    }
    let focus = |of: &Value| number(&of["focus_contrast"]);
    assert!(
        (focus(dim) / focus(capture) - 1.0).abs() < 0.05,
        "{capture} {dim}"
    );

    // Both propose the same exposures; they are in the file now, and nothing else of it is changed.
    let proposed = |of: &Run| -> Vec<f64> {
        let exposures = of.json["proposal"]["exposures_us"].as_array().unwrap();
        exposures.iter().map(number).collect()
    };
    assert_eq!(half.json["written"], head.to_str().unwrap());
    let written = HeadModel::load(&head).unwrap().exposures_us;
    let of_half = proposed(&half);
    assert_eq!(
        written.iter().map(|&us| f64::from(us)).collect::<Vec<_>>(),
        of_half
    );
    assert_eq!(of_half.len(), proposed(&whole).len());
    for (half, whole) in of_half.iter().zip(proposed(&whole)) {
        assert!((half / whole - 1.0).abs() < 0.05, "{of_half:?} {whole}");
    }
    expose(&head, &said(&written), &said(&exposures_us));
    assert_eq!(std::fs::read_to_string(&head).unwrap(), before);

    // With them the brightest pixels lie just under saturation.
    expose(&head, &said(&exposures_us), &said(&written));
    let now = view(&[&at[..], &["--captures", "1"]].concat());
    let bright = number(&now.json["captures"][0]["exposures"][0]["bright_dn"]);
    let limit = number(&now.json["saturation_limit_dn"]);
    assert!((0.85..0.96).contains(&(bright / limit)), "{bright} {limit}");
}

#[test]
fn what_cannot_be_is_refused_before_anything_moves() {
    let folder = tempfile::tempdir().unwrap();
    let nowhere = folder.path().join("missing/view.html");
    let text = folder.path().join("view.txt");
    for (arguments, words) in [
        (
            vec!["--tooth", "85", "--captures", "1"],
            "it has teeth 1 to 84",
        ),
        (vec!["--captures", "0"], "0 is not in 1.."),
        (vec!["--write-exposures"], "--captures"),
        (
            vec!["--write-exposures", "--captures", "1"],
            "the head is the built-in one",
        ),
        (vec!["--page", nowhere.to_str().unwrap()], "cannot write"),
        (
            vec!["--page", text.to_str().unwrap()],
            "its name ends in .html",
        ),
        (vec!["--tool", "die"], "--tool without --link"),
        (vec!["--focus"], "has no [lens]"),
    ] {
        let refused = view(&arguments);
        assert_eq!(refused.code, 3, "{arguments:?}: {}", refused.stderr);
        assert!(refused.stderr.contains(words), "{}", refused.stderr);
    }
}

/// A person answers for a trusted head file as it is.
#[test]
fn a_trusted_head_file_is_not_changed() {
    let folder = tempfile::tempdir().unwrap();
    let tool = press_tool(&folder.path().join("die"));
    let head = folder.path().join("die/head.toml");
    let before = std::fs::read_to_string(&head).unwrap();
    let at = ["--tool", &tool, "--link", "sim", "--captures", "1"];
    let refused = view(&[&at[..], &["--write-exposures"]].concat());
    assert_eq!(refused.code, 3, "{}", refused.stderr);
    let words = "tester declared this file trusted as it is";
    assert!(refused.stderr.contains(words), "{}", refused.stderr);
    // The captures are in the document nevertheless.
    assert_eq!(refused.json["captures"].as_array().unwrap().len(), 1);
    assert_eq!(refused.json["written"], Value::Null);
    assert_eq!(std::fs::read_to_string(&head).unwrap(), before);
}

#[test]
fn a_view_without_a_usable_capture_says_why() {
    let [option, file] = bench("[camera]\nframe_fault = \"lose:7\"\n");
    let lost = view(&[
        &option,
        &file,
        "--captures",
        "1",
        "--tool",
        small_tool(),
        "--link",
        "sim",
    ]);
    assert_eq!(lost.code, 2, "{}", lost.stderr);
    assert_eq!(lost.json["captures"].as_array().unwrap().len(), 0);
    assert_eq!(lost.json["lost"][0]["number"], 1);
    let reason = lost.json["lost"][0]["reason"].as_str().unwrap();
    assert!(reason.contains("frame"), "{reason}");
    assert_eq!(lost.json["proposal"], Value::Null);
}

/// The lens that the demo's die is seen through is sharp at one dioptre; the tooth's middle lies about where it is.
#[test]
fn a_lens_is_focused_on_a_tooth() {
    if !flankscope_test_requisites::dear() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let tool = demo_tool(&folder.path().join("die"), "liquid@1");
    let found = view(&["--tool", &tool, "--link", "sim", "--focus"]);
    assert_eq!(found.code, 0, "{}", found.stderr);
    let focus = &found.json["focus"];
    assert_eq!(focus["steps"].as_array().unwrap().len(), 18, "{focus}");
    assert!(
        (number(&focus["sharpest_dpt"]) - 1.0).abs() < 0.15,
        "{focus}"
    );
    assert!(number(&focus["sigma_dpt"]) < 0.1, "{focus}");
}
