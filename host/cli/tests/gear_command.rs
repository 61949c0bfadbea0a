//! `gear` as a user runs it, on the demo die's own gear data.

mod support;

use std::path::Path;

use flankscope_metrology::gear::Flank;
use flankscope_metrology::tool::Tool;
use flankscope_test_requisites::Random;
use support::{assert_refused, flankscope, json, write_xyz};

/// The demo die's folder, made by the command itself.
fn demo(folder: &Path) -> Tool {
    let output = flankscope(folder, &["bench", "demo-tool", "--out", "die"]);
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    Tool::load(&folder.join("die")).unwrap()
}

/// All flanks, some pushed out of the material's normal by turning them (a rotation by a moves an involute by a r_b).
fn cloud(tool: &Tool, turned_um: impl Fn(u32, Flank) -> f64) -> Vec<[f64; 3]> {
    let gear = tool.gear.as_ref().unwrap();
    let [low, high] = gear.active_flank_mm();
    let mut random = Random(3);
    let mut points = Vec::new();
    for tooth in 1..=gear.teeth {
        for flank in Flank::BOTH {
            for _ in 0..4_000 {
                let radius = low + (high - low) * random.uniform();
                let height =
                    gear.height_mm[0] + (gear.height_mm[1] - gear.height_mm[0]) * random.uniform();
                // And 1 um of noise.
                let out_um = turned_um(tooth, flank) + random.normal();
                let turn = flank.sign() * 1e-3 * out_um / gear.base_radius_mm();
                let [x, y, z] = gear.flank_point(tooth, flank, radius, height).unwrap();
                points.push([
                    x * turn.cos() - y * turn.sin(),
                    x * turn.sin() + y * turn.cos(),
                    z,
                ]);
            }
        }
    }
    points
}

#[test]
fn a_perfect_die_holds_its_class_and_one_bad_pitch_breaks_it() {
    let folder = tempfile::tempdir().unwrap();
    let tool = demo(folder.path());
    let base = [
        "gear",
        "--tool",
        "die",
        "--cloud",
        "cloud.xyz",
        "--json",
        "-",
        "--band-mm",
        "3",
    ];
    let run = |more: &[&str]| flankscope(folder.path(), &[&base[..], more].concat());

    write_xyz(&folder.path().join("cloud.xyz"), &cloud(&tool, |_, _| 0.0));
    let output = run(&["--class", "9"]);
    let document = json(&output);
    assert_eq!(
        (output.status.code(), document["verdict"].as_str()),
        (Some(0), Some("go")),
        "{}",
        document["reason"]
    );
    // With an uncertainty of 5 um nobody may state class 5 of this small a gear.
    let output = run(&["--class", "5"]);
    let document = json(&output);
    assert_eq!(
        (output.status.code(), document["verdict"].as_str()),
        (Some(2), Some("indeterminate"))
    );
    assert!(
        document["reason"]
            .as_str()
            .unwrap()
            .contains("not capable for class 5")
    );

    write_xyz(
        &folder.path().join("cloud.xyz"),
        &cloud(&tool, |tooth, _| if tooth == 17 { 60.0 } else { 0.0 }),
    );
    let output = run(&["--class", "9"]);
    let document = json(&output);
    assert_eq!(output.status.code(), Some(1), "{document}");
    assert!(
        document["reason"].as_str().unwrap().contains("f_p = "),
        "{document}"
    );
    // Along the measuring circle: 60 um over the cosine of the pressure angle, before and after the tooth.
    let gear = tool.gear.as_ref().unwrap();
    let arc = 60.0 / gear.pressure_angle_deg.to_radians().cos();
    let left = &document["left"]["single_um"];
    assert!(
        (left[16].as_f64().unwrap() - arc).abs() < 2.0,
        "{}",
        left[16]
    );
    // The right flank of the tooth leans the other way: turned into the material, it moves against the angle.
    let right = &document["right"]["single_um"];
    assert!(
        (right[16].as_f64().unwrap() + arc).abs() < 2.0,
        "{}",
        right[16]
    );
}

#[test]
fn what_is_not_told_says_why_in_table_document_and_verdict() {
    let folder = tempfile::tempdir().unwrap();
    let tool = demo(folder.path());
    let gear = tool.gear.clone().unwrap();
    // Half of the ring, and nothing of the upper half of it.
    let mut points = cloud(&tool, |_, _| 0.0);
    points.retain(|p| p[1] > 0.0 && p[2] < 40.0);
    write_xyz(&folder.path().join("cloud.xyz"), &points);
    let base = [
        "gear",
        "--tool",
        "die",
        "--cloud",
        "cloud.xyz",
        "--band-mm",
        "3",
    ];
    let output = flankscope(folder.path(), &base);
    assert_eq!(output.status.code(), Some(0));
    let table = String::from_utf8_lossy(&output.stdout).into_owned();
    for line in table
        .lines()
        .filter(|line| line.split_whitespace().nth(1) == Some("-"))
    {
        assert!(line.contains(';') && line.contains("scan"), "{line}");
    }
    for (symbol, reason) in [
        ("F_beta ", "the helix has a gap from height"),
        ("F_p ", "teeth have no left flank with a position"),
        ("F_r ", "teeth have no left flank with a position"),
    ] {
        let line = table.lines().find(|line| line.starts_with(symbol)).unwrap();
        assert!(line.contains(reason), "{line}");
    }
    let slope = format!(
        "f_H_alpha from {:.3} to {:.3} mm",
        gear.active_flank_mm()[1],
        gear.tip_radius_mm
    );
    assert!(table.contains(&slope), "{table}");

    let output = flankscope(
        folder.path(),
        &[&base[..], &["--class", "10", "--json", "-"]].concat(),
    );
    let document = json(&output);
    assert_eq!(document["verdict"], "indeterminate", "{document}");
    assert!(
        document["reason"]
            .as_str()
            .unwrap()
            .contains("F_beta is not told: ")
    );
    // The same quantile as for wear: 95 % to one side of a figure whose U95 is 5 um.
    let guard = document["guard_um"].as_f64().unwrap();
    assert!(
        (guard - 5.0 * 1.644_854 / 1.959_964).abs() < 1e-4,
        "{guard}"
    );
    for rating in document["ratings"].as_array().unwrap() {
        assert_eq!(
            rating["value_um"].is_null(),
            rating["not_told"]["next"].is_string(),
            "{rating}"
        );
    }
    let flank = &document["flanks"][0];
    assert!(flank["helix"].is_null());
    assert_eq!(flank["helix_not_told"]["code"], "helix_gap");
    assert!(document["limits"]["slope_radii_mm"][1].as_f64().unwrap() == gear.tip_radius_mm);
}

#[test]
fn what_cannot_be_evaluated_is_refused_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    demo(folder.path());
    let elsewhere: Vec<[f64; 3]> = (0..100).map(|i| [f64::from(i), 200.0, 5.0]).collect();
    write_xyz(&folder.path().join("cloud.xyz"), &elsewhere);
    let refused = |name: &str, args: &[&str], words: &[&str]| {
        let output = flankscope(folder.path(), args);
        assert_refused(folder.path(), name, &output, words);
    };
    let base = ["gear", "--tool", "die", "--cloud", "cloud.xyz"];
    refused(
        "off the flanks",
        &base,
        &["0 of 100 points", "tool's coordinates"],
    );
    refused(
        "no cloud",
        &["gear", "--tool", "die", "--cloud", "none.xyz"],
        &["none.xyz"],
    );
    refused(
        "usable beyond the tip",
        &[&base[..], &["--usable-mm", "40,42"]].concat(),
        &["a usable radius = 40", "between tip and root circle"],
    );
    refused(
        "slope",
        &[&base[..], &["--slope-mm", "41,41"]].concat(),
        &["two different radii"],
    );
    refused(
        "usable",
        &[&base[..], &["--usable-mm", "1,2"]].concat(),
        &["base circle"],
    );
}
