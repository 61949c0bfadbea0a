//! Structure finer than a cell through the whole instrument: openings whose floors no light comes back from are never passed, and
//! hairlines that are seen to their floor do not cost a go.
//!
//! They need the full head: with one tooth in view wear of this size is indeterminate for want of neighbours, so that a refusal would
//! prove nothing about the structure.

use std::path::Path;

use flankscope_gear_cad::Flank;
use flankscope_test_requisites::at_least;
use flankscope_tests::die::{Fine, Place, bore, write_bore};
use flankscope_tests::{Run, flankscope, inspect_full, run, tool_of_noise_alone};

/// Heights of the judged zone, and radii less that of the tip between which damage is cut, mm.
const ZONE_MM: [f64; 2] = [29.0, 37.0];
const CUT_MM: [f64; 2] = [0.35, 1.75];

/// A die whose flanks here have a loss by radius less that of the tip and height above the zone's lower end, all in mm, cut in
/// steps.
fn die(
    folder: &Path,
    flanks: &[(u32, Flank)],
    step_mm: [f64; 2],
    loss_mm: impl Fn([f64; 2]) -> f64,
) -> String {
    let fine = |&(tooth, flank): &(u32, Flank)| Fine {
        tooth,
        flank,
        from_tip_mm: [CUT_MM[0] - 0.02, CUT_MM[1] + 0.02],
        height_mm: ZONE_MM,
        step_mm,
    };
    let loss = |at: Place| {
        let here = flanks.contains(&(at.tooth, at.flank))
            && (CUT_MM[0]..CUT_MM[1]).contains(&at.from_tip_mm)
            && (ZONE_MM[0]..ZONE_MM[1]).contains(&at.height_mm);
        match here {
            true => loss_mm([at.from_tip_mm, at.height_mm - ZONE_MM[0]]),
            false => 0.0,
        }
    };
    let fine: Vec<Fine> = flanks.iter().map(fine).collect();
    write_bore(folder, &bore(loss, &fine))
}

/// A check of tooth 40, whose left flank is worn so.
fn worn(step_mm: [f64; 2], loss_mm: impl Fn([f64; 2]) -> f64, more: &[&str]) -> Run {
    let folder = tempfile::tempdir().unwrap();
    let die = die(folder.path(), &[(40, Flank::Left)], step_mm, loss_mm);
    inspect_full(&[&["--teeth", "40", "--die-mesh", &die], more].concat())
}

/// The left flank's entry and its true wear, µm.
fn left(run: &Run) -> (&serde_json::Value, f64) {
    let features = run.json["features"].as_array().unwrap();
    let of = features.iter().find(|f| f["flank"] == "left").unwrap();
    let truth = &run.json["truth"]["flanks"]["40:left"]["max_disc_wear_um"];
    println!(
        "{} ± {} (at least {}), true {truth}: {}",
        of["wear_um"], of["u95_um"], of["at_least_um"], of["verdict"]
    );
    (of, truth.as_f64().unwrap())
}

#[track_caller]
fn assert_not_passed(run: &Run, beyond_um: f64) {
    let (of, truth_um) = left(run);
    assert!(truth_um > beyond_um, "{truth_um}");
    let verdict = of["verdict"].as_str().unwrap();
    assert!(["no-go", "indeterminate"].contains(&verdict), "{of}");
    // What is said is a lower bound, and it holds.
    assert!(of["u95_um"].is_null(), "{of}");
    assert!(of["at_least_um"].as_f64().unwrap() <= truth_um, "{of}");
    assert_eq!(run.flank(40, "right"), Some("go"));
}

fn grooves(width: f64, pitch: f64, depth: f64) -> impl Fn([f64; 2]) -> f64 {
    move |[x, _]| {
        if (x - CUT_MM[0]).rem_euclid(pitch) < width {
            depth
        } else {
            0.0
        }
    }
}

/// Side by side, 85 µm wide and 120 µm deep, over a quarter of the height.
fn pits([x, y]: [f64; 2]) -> f64 {
    let away = |v: f64| v.rem_euclid(0.09) - 0.045;
    let inside = (3.0..5.0).contains(&y) && away(x).hypot(away(y)) < 0.0425;
    if inside { 0.12 } else { 0.0 }
}

/// Loss by radius and height, mm.
type Loss = Box<dyn Fn([f64; 2]) -> f64>;

#[test]
fn texture_below_a_cell_is_never_passed() {
    // Along the height, along the profile, pits, V grooves; mm.
    let cases: [(&str, [f64; 2], Loss); 4] = [
        ("scored", [2e-3, 0.5], Box::new(grooves(0.04, 0.07, 0.15))),
        ("pits", [6e-3, 6e-3], Box::new(pits)),
        (
            "V grooves",
            [2e-3, 0.5],
            Box::new(|[x, _]: [f64; 2]| 0.11 * (1.0 - (x.rem_euclid(0.05) / 0.025 - 1.0).abs())),
        ),
        (
            "scored along the profile",
            [0.05, 2.5e-3],
            Box::new(|[_, y]: [f64; 2]| if y.rem_euclid(0.07) < 0.04 { 0.15 } else { 0.0 }),
        ),
    ];
    for (name, step_mm, loss_mm) in at_least(2, &cases) {
        println!("{name}");
        assert_not_passed(&worn(*step_mm, loss_mm, &[]), 50.0);
    }
}

/// With sound material between them, in a patch: a fifth of its area is open, and its points scatter little more than those of a rough
/// flank.
#[test]
fn pits_apart_are_never_passed() {
    let cases: [(f64, f64, f64, [f64; 2]); 2] = [
        (0.106, 0.222, 0.4, [0.66, 0.34]),
        (0.065, 0.14, 0.35, [1.4, 0.7]),
    ];
    for &(width_mm, pitch_mm, depth_mm, size_mm) in at_least(1, &cases) {
        let loss_mm = move |[x, y]: [f64; 2]| {
            let (x, y) = (x - CUT_MM[0], y - 4.0);
            let in_patch = (0.0..size_mm[0]).contains(&x) && (0.0..size_mm[1]).contains(&y);
            let is_pit = [x, y].iter().all(|v| v.rem_euclid(pitch_mm) < width_mm);
            if in_patch && is_pit { depth_mm } else { 0.0 }
        };
        assert_not_passed(&worn([6e-3, 6e-3], loss_mm, &[]), 50.0);
    }
}

#[test]
fn texture_that_came_since_a_baseline_is_never_passed() {
    let folder = tempfile::tempdir().unwrap();
    let baseline = folder.path().join("new.json");
    let baseline = baseline.to_str().unwrap();
    let new = inspect_full(&[
        "--seed",
        "5",
        "--teeth",
        "40",
        "--record-baseline",
        baseline,
    ]);
    assert_eq!(new.code, 0, "{}", new.json["reason"]);
    let cases: [([f64; 2], Loss); 2] = [
        ([2e-3, 0.5], Box::new(grooves(0.04, 0.07, 0.15))),
        ([6e-3, 6e-3], Box::new(pits)),
    ];
    for (step_mm, loss_mm) in at_least(1, &cases) {
        assert_not_passed(&worn(*step_mm, loss_mm, &["--baseline", baseline]), 50.0);
    }
}

/// Where no flank is sound there is none to compare with.
#[test]
fn texture_on_every_judged_flank_is_never_passed() {
    let folder = tempfile::tempdir().unwrap();
    let teeth = [12, 40, 68];
    let flanks = teeth.map(|tooth| [Flank::Left, Flank::Right].map(|flank| (tooth, flank)));
    let flanks = flanks.as_flattened();
    let die = die(
        folder.path(),
        flanks,
        [2e-3, 0.5],
        grooves(0.04, 0.07, 0.15),
    );
    let run = inspect_full(&["--teeth", "12,40,68", "--die-mesh", &die]);
    assert!([1, 2].contains(&run.code), "{}", run.json["reason"]);
    for tooth in teeth {
        for flank in ["left", "right"] {
            let word = run.flank(tooth.into(), flank).unwrap();
            assert!(
                ["no-go", "indeterminate"].contains(&word),
                "{tooth} {flank}: {word}"
            );
        }
    }
}

#[test]
fn a_single_crack_is_never_passed() {
    // A V of 0.1 mm along the height, a straight one along the profile.
    let vee = |[x, _]: [f64; 2]| 0.35 * (1.0 - ((x - 1.05) / 0.05).abs()).max(0.0);
    assert_not_passed(&worn([2e-3, 0.5], vee, &[]), 30.0);
    let along = |[_, y]: [f64; 2]| if (4.0..4.1).contains(&y) { 0.35 } else { 0.0 };
    assert_not_passed(&worn([0.05, 2.5e-3], along, &[]), 50.0);
    // As deep as a hole is supposed to be, along the upper rim of the zone.
    let high = ZONE_MM[1] - ZONE_MM[0];
    let at_rim = |[_, y]: [f64; 2]| if y > high - 0.13 { 0.3 } else { 0.0 };
    assert_not_passed(&worn([0.05, 2.5e-3], at_rim, &[]), 30.0);
}

/// Its walls shade its floor, and some cores in it see light of both rims: their points lie too high on one side and too low on the
/// other.
#[test]
fn a_groove_along_the_line_of_sight_is_never_passed() {
    // Flat, V-shaped and round: depth by place across the width, from -1 to 1.
    type Form = fn(f64) -> f64;
    let cases: [(f64, Form, f64); 4] = [
        (0.086, |_| 1.0, 4.31),
        (0.088, |t| 1.0 - t.abs(), 2.07),
        (0.1, |t| (1.0 - t * t).sqrt(), 5.52),
        (0.095, |_| 1.0, 3.18),
    ];
    for &(width_mm, form, at_mm) in at_least(1, &cases) {
        let loss_mm = |[_, y]: [f64; 2]| {
            let t = (y - at_mm) / (0.5 * width_mm);
            if t.abs() < 1.0 { 0.4 * form(t) } else { 0.0 }
        };
        assert_not_passed(&worn([0.05, 2.5e-3], loss_mm, &[]), 30.0);
    }
}

#[test]
fn hairlines_that_are_seen_to_their_floor_are_go() {
    let hairline = |off_mm: f64, width: f64, depth: f64| {
        let t = off_mm / (0.5 * width);
        match t.abs() < 1.0 {
            true => 0.5 * depth * (1.0 + (std::f64::consts::PI * t).cos()),
            false => 0.0,
        }
    };
    let one = move |[x, _]: [f64; 2]| hairline(x - 1.05, 0.2, 8e-3);
    let run = worn([4e-3, 0.5], one, &[]);
    let (of, truth_um) = left(&run);
    assert_eq!(run.code, 0, "{}", run.json["reason"]);
    let [wear_um, u95_um] = ["wear_um", "u95_um"].map(|key| of[key].as_f64().unwrap());
    assert!((wear_um - truth_um).abs() <= u95_um, "{of}");
    // Across each other at every angle, 8 to 22 µm deep, 0.15 to 0.3 mm wide.
    let many = move |[x, y]: [f64; 2]| {
        let line = |i: u32| {
            let i = f64::from(i);
            let (angle, at) = (0.4 * i, [0.5 + 0.15 * i, 0.6 + 0.95 * i]);
            let off = (x - at[0]) * angle.cos() + (y - at[1]) * angle.sin();
            hairline(off, 0.15 + 0.02 * i, (8.0 + 2.0 * i) * 1e-3)
        };
        (0..8).map(line).fold(0.0, f64::max)
    };
    let run = worn([0.01, 0.02], many, &[]);
    left(&run);
    assert_eq!(run.code, 0, "{}", run.json["reason"]);
}

/// Hairlines 30 µm deep and 0.15 mm wide: with the tooth in the middle of the view one cannot say that nothing lies deeper in them, from
/// the side one can.
#[test]
fn what_one_view_hides_of_a_flank_a_further_one_shows() {
    let folder = tempfile::tempdir().unwrap();
    let hairline = |off_mm: f64| match off_mm.abs() < 0.075 {
        true => 0.015 * (1.0 + (std::f64::consts::PI * off_mm / 0.075).cos()),
        false => 0.0,
    };
    let lines = move |[x, _]: [f64; 2]| hairline((x - 0.35).rem_euclid(0.6) - 0.3);
    let die = die(folder.path(), &[(40, Flank::Left)], [4e-3, 0.5], lines);
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (history, frames) = (path("press.db"), path("frames"));
    let once = tool_of_noise_alone(&folder.path().join("once"), "20mm", "remeasure = 0");
    let again = tool_of_noise_alone(&folder.path().join("again"), "20mm", "");
    let check = |tool: &str, more: &[&str]| {
        let on = [
            "--link",
            "sim",
            "--tool",
            tool,
            "--teeth",
            "40",
            "--die-mesh",
            &die,
        ];
        inspect_full(&[&on, more].concat())
    };
    let alone = check(&once, &[]);
    let both = check(&again, &["--history", &history, "--save-frames", &frames]);
    let hidden_um = |run: &Run| {
        let (of, truth_um) = left(run);
        // A bound of 95 % of a single draw: it may be missed, but not by more than U95.
        let u95_um = of["detail"]["absolute_um"]["u95"].as_f64().unwrap();
        let at_least_um = of["at_least_um"].as_f64();
        assert!(at_least_um.is_none_or(|um| um <= truth_um + u95_um), "{of}");
        of["detail"]["hidden_um"].as_f64().unwrap_or(0.0)
    };
    let [one, two] = [&alone, &both].map(hidden_um);
    assert_eq!(alone.flank(40, "left"), Some("indeterminate"));
    assert!(one > 0.0 && two < one, "{two} of {one}");
    // As many frames again, and the evidence says of which view they are.
    let triggered = |run: &Run| run.json["frames"]["triggered"].as_u64().unwrap();
    assert_eq!(triggered(&both), 2 * triggered(&alone));
    let further = both.json["evidence"][0]["further"].as_array().unwrap();
    assert_eq!(further.len(), 1, "{further:?}");

    let mut replay = flankscope();
    let of = [
        "replay", &history, "1", "--quiet", "--json", "-", "--tool", &again,
    ];
    let replay = run(replay.args(of));
    assert_eq!(replay.code, both.code, "{}", replay.stderr);
    assert_eq!(replay.json["same"], true, "{}", replay.json);
    let on = [
        "inspect", "--quiet", "--json", "-", "--frames", &frames, "--tool", &again,
    ];
    let recorded = run(flankscope().args(on));
    assert_eq!(
        recorded.json["features"], both.json["features"],
        "{}",
        recorded.stderr
    );
}
