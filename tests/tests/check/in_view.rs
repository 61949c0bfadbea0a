//! What is in view and was not asked for: worn neighbours, teeth that are missing, a die put down turned, a die of another size.
//!
//! All of them need the full head: in the small one's field stands one tooth, without neighbours.

use std::path::Path;

use flankscope_gear_cad::Flank;
use flankscope_test_requisites::at_least;
use flankscope_tests::die::{Fine, Place, bore, write_bore};
use flankscope_tests::{Run, inspect_full, tool_of_noise_alone};
use serde_json::Value;

/// A check of tooth 40 of a bore, with more arguments.
fn check(loss_mm: impl Fn(Place) -> f64, more: &[&str]) -> Run {
    let folder = tempfile::tempdir().unwrap();
    let die = write_bore(folder.path(), &bore(loss_mm, &[]));
    inspect_full(&[&["--die-mesh", die.as_str(), "--teeth", "40"], more].concat())
}

fn in_view<'a>(run: &'a Run, tooth: u64, flank: &str) -> &'a Value {
    let all = run.json["in_view"].as_array().unwrap();
    let is_it = |f: &&Value| f["tooth"] == tooth && f["flank"] == flank;
    all.iter().find(is_it).unwrap_or(&Value::Null)
}

fn reason(run: &Run) -> &str {
    run.json["reason"].as_str().unwrap_or_default()
}

/// All features are of the tooth that was asked for.
fn only_tooth_40_is_judged(run: &Run) {
    let features = run.json["features"].as_array().unwrap();
    let of_40 = features.iter().all(|f| f["tooth"] == 40);
    assert!(features.len() == 2 && of_40, "{features:?}");
}

#[test]
fn sound_neighbours_change_nothing() {
    for seed in at_least(1, &["1", "2", "3", "4", "5"]) {
        let run = check(|_| 0.0, &["--seed", seed]);
        assert_eq!(run.code, 0, "{seed}: {}", reason(&run));
        only_tooth_40_is_judged(&run);
        let seen = in_view(&run, 41, "right");
        assert!(seen["coverage_ratio"].as_f64().unwrap() > 0.5, "{seen}");
        let wear_um = seen["wear_um"].as_f64().unwrap();
        assert!(wear_um.abs() < seen["u95_um"].as_f64().unwrap(), "{seen}");
        assert_eq!(run.json["missing_teeth"], Value::Null);
        assert_eq!(run.json["tooth_identity"]["by"], "operator");
    }
}

/// A neighbour beyond the warning limit warns, one that is shown beyond the stop limit stops, and both are named.
#[test]
fn worn_neighbours_are_named() {
    let cases = [
        ("41:right:150", "tooth 41 right", &["no-go"][..]),
        ("41:right:40", "tooth 41 right", &["warn"]),
        ("39:left:100:half", "tooth 39 left", &["warn", "no-go"]),
        ("41:right:60", "tooth 41 right", &["warn", "no-go"]),
        ("41:left:60", "tooth 41 left", &["warn", "no-go"]),
    ];
    for (wear, named, words) in at_least(2, &cases) {
        let run = inspect_full(&["--teeth", "40", "--wear", wear, "--seed", "6"]);
        let verdict = run.json["verdict"].as_str().unwrap();
        assert!(words.contains(&verdict), "{wear}: {}", reason(&run));
        let said = format!("{named}, not asked for");
        assert!(reason(&run).contains(&said), "{wear}: {}", reason(&run));
        only_tooth_40_is_judged(&run);
    }
}

/// A tooth that has a view of its own is judged there alone.
#[test]
fn a_tooth_is_judged_once() {
    let run = inspect_full(&["--teeth", "40,41", "--wear", "41:right:80"]);
    assert_eq!(run.code, 1, "{}", reason(&run));
    assert_eq!(run.flank(41, "right"), Some("no-go"));
    for tooth in [40, 41] {
        for flank in ["left", "right"] {
            assert_eq!(*in_view(&run, tooth, flank), Value::Null);
        }
    }
}

/// A tooth that is not there, or over half of its height only, stops the check, whatever the other teeth are like.
#[test]
fn a_missing_tooth_stops_the_check() {
    let gone = |tooth: u32, above_mm: f64| {
        move |at: Place| {
            if at.tooth == tooth && at.height_mm > above_mm {
                f64::INFINITY
            } else {
                0.0
            }
        }
    };
    for &(tooth, above_mm) in at_least(2, &[(41, -1.0), (41, 33.0), (39, -1.0), (40, -1.0)]) {
        let run = check(gone(tooth, above_mm), &[]);
        assert_eq!(run.code, 1, "{tooth} above {above_mm}: {}", reason(&run));
        let said = reason(&run);
        let named = said.contains(&format!("tooth {tooth}"));
        assert!(named && said.contains("is missing or broken off"), "{said}");
        assert_eq!(run.json["missing_teeth"][0]["tooth"], tooth);
    }
    // With worn neighbours it never passes.
    let worn = check(
        |at| match at.tooth {
            41 => f64::INFINITY,
            39 => 0.1,
            _ => 0.0,
        },
        &[],
    );
    assert!(worn.code == 1 || worn.code == 2, "{}", reason(&worn));
}

/// A die put down one tooth further shows its damaged tooth beside the one that is asked for.
#[test]
fn damage_one_tooth_further_is_not_passed() {
    // Tooth 41 stands where 40 is asked for, and the damaged tooth 40 where 39 was.
    let spall = |at: Place| {
        let away = (at.from_tip_mm - 0.9).hypot(at.height_mm - 33.0);
        if (at.tooth, at.flank) == (39, Flank::Left) && away < 0.7 {
            0.15
        } else {
            0.0
        }
    };
    let cut = Fine {
        tooth: 39,
        flank: Flank::Left,
        from_tip_mm: [0.1, 1.7],
        height_mm: [32.0, 34.0],
        step_mm: [0.02, 0.05],
    };
    let folder = tempfile::tempdir().unwrap();
    let die = write_bore(folder.path(), &bore(spall, &[cut]));
    let run = inspect_full(&["--die-mesh", &die, "--teeth", "40"]);
    assert_eq!(run.code, 1, "{}", reason(&run));
    assert!(
        reason(&run).contains("tooth 39 left, not asked for"),
        "{}",
        reason(&run)
    );
    assert_eq!(run.flank(40, "left"), Some("go"));
    // A whole flank may move the pose beyond what the stages allow: no verdict, but no go either.
    let whole = check(
        |at| {
            if (at.tooth, at.flank) == (39, Flank::Left) {
                0.15
            } else {
                0.0
            }
        },
        &[],
    );
    assert!([1, 2, 4].contains(&whole.code), "{}", reason(&whole));
}

/// Every flank of the die is off by some micrometres of its own, between -5 and 5 µm.
fn form_mm(tooth: u32, flank: Flank) -> f64 {
    // SplitMix64: successive flanks have nothing to do with each other, where a line of growing values would be a scale.
    let mut x = 0x9e37_79b9_7f4a_7c15_u64
        .wrapping_mul(u64::from(2 * tooth) + u64::from(flank == Flank::Left) + 1);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^= x >> 31;
    5e-3 * ((x % 10_000) as f64 / 5_000.0 - 1.0)
}

fn put_down(folder: &Path, turned: u32) -> String {
    let name = folder.join(format!("turned{turned}"));
    std::fs::create_dir(&name).unwrap();
    let of_die = |at: Place| form_mm((at.tooth - 1 + turned) % 84 + 1, at.flank);
    write_bore(&name, &bore(of_die, &[]))
}

/// The forms that a baseline recorded say whether these are the teeth that were asked for.
#[test]
fn a_baseline_tells_a_turned_die() {
    let folder = tempfile::tempdir().unwrap();
    let baseline = folder.path().join("new.json");
    let baseline = baseline.to_str().unwrap();
    // What the forms are off is stated: values between -5 and 5 µm have a standard deviation of 3.
    let tool = tool_of_noise_alone(&folder.path().join("tool"), "20mm", "as_built_um = 3.0\n");
    let look = |die: &str, more: &[&str]| {
        let at = ["--link", "sim", "--tool", &tool, "--die-mesh", die];
        inspect_full(&[&at[..], more].concat())
    };
    let as_it_was = put_down(folder.path(), 0);
    let new = look(&as_it_was, &["--record-baseline", baseline, "--seed", "1"]);
    assert_eq!(new.code, 0, "{} {}", reason(&new), new.stderr);
    assert_eq!(new.json["tooth_identity"]["by"], "operator");
    let since = |die: &str| look(die, &["--baseline", baseline, "--seed", "2"]);
    let same = since(&as_it_was);
    assert_eq!(same.code, 0, "{}", reason(&same));
    assert_eq!(same.json["tooth_identity"]["by"], "baseline");
    let neighbour = in_view(&same, 41, "right");
    assert!(
        neighbour["wear_um"].as_f64().unwrap().abs() < 3.0,
        "{neighbour}"
    );
    let turned = since(&put_down(folder.path(), 1));
    assert_eq!(turned.code, 2, "{}", reason(&turned));
    assert_eq!(turned.json["tooth_identity"]["code"], "turned_die");
    assert!(
        reason(&turned).contains("other teeth than asked for"),
        "{}",
        reason(&turned)
    );
}

/// A die of another size is told from wear: nothing is claimed of its flanks, whether they are worn or not.
#[test]
fn a_scaled_die_is_another_die() {
    let folder = tempfile::tempdir().unwrap();
    for &(scale, lost_mm) in at_least(2, &[(1.001, 0.0), (1.001, 0.15), (0.999, 0.0)]) {
        let lost = |at: Place| {
            if (at.tooth, at.flank) == (40, Flank::Left) {
                lost_mm
            } else {
                0.0
            }
        };
        let mut mesh = bore(lost, &[]);
        for vertex in &mut mesh.vertices {
            *vertex = vertex.map(|x| x * scale);
        }
        let die = write_bore(folder.path(), &mesh);
        let run = inspect_full(&["--die-mesh", &die, "--teeth", "40", "--seed", "5"]);
        assert_eq!(run.code, 2, "{scale} {lost_mm}: {}", reason(&run));
        assert_eq!(run.json["features"][0]["code"], "other_die");
        assert_eq!(run.json["features"][0]["wear_um"], Value::Null);
        let said = if scale > 1.0 {
            "% larger than the drawing"
        } else {
            "% smaller"
        };
        assert!(reason(&run).contains(said), "{}", reason(&run));
    }
}
