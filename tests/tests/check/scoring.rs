//! Damage as a press makes it is never go: scoring along the height that leaves most of the surface in place, a datum band that wears
//! with the rest, equal and opposite changes of both sides beside a local loss.

use flankscope_gear_cad::{Flank, Mesh};
use flankscope_test_requisites::at_least;
use flankscope_tests::die::{Fine, Place, bore, write_bore};
use flankscope_tests::{Run, inspect, inspect_full};

use crate::datum;

const LIMIT_UM: f64 = 50.0;
/// Heights of the flank that is cut, and radii less that of the tip, mm.
const CUT_HEIGHT_MM: [f64; 2] = [28.5, 37.5];
const CUT_RADIUS_MM: [f64; 2] = [0.3, 2.0];

/// A bore whose left flank of tooth 40 has a loss by radius less that of the tip and by height, mm.
fn cut(step_mm: [f64; 2], loss_mm: impl Fn([f64; 2]) -> f64) -> Mesh {
    let fine = Fine {
        tooth: 40,
        flank: Flank::Left,
        from_tip_mm: CUT_RADIUS_MM,
        height_mm: CUT_HEIGHT_MM,
        step_mm,
    };
    let inside = |[low, high]: [f64; 2], at: f64| (low..high).contains(&at);
    let loss = |at: Place| {
        let is_cut = (at.tooth, at.flank) == (40, Flank::Left)
            && inside(CUT_RADIUS_MM, at.from_tip_mm)
            && inside(CUT_HEIGHT_MM, at.height_mm);
        match is_cut {
            true => loss_mm([at.from_tip_mm, at.height_mm]),
            false => 0.0,
        }
    };
    bore(loss, &[fine])
}

/// The left flank is beyond the stop limit, and its verdict does not pass.
#[track_caller]
fn assert_not_passed(name: &str, run: &Run) {
    let truth_um = run.json["truth"]["flanks"]["40:left"]["max_disc_wear_um"].as_f64();
    let word = run.flank(40, "left");
    println!(
        "{name}: true {truth_um:?}, {word:?}: {}",
        run.json["reason"]
    );
    assert!(
        truth_um.is_some_and(|um| um > LIMIT_UM),
        "{name}: {truth_um:?}"
    );
    assert!(
        [Some("indeterminate"), Some("no-go")].contains(&word),
        "{name}: {}",
        run.json["reason"]
    );
}

/// Grooves along the height: width, pitch and depth, mm, and even wear beside them, µm. Even wear stands before the full head, because the
/// small one sees no neighbours by which it is told from a turn of the pose.
#[test]
fn grooves_that_leave_most_of_the_flank_in_place_are_never_passed() {
    let folder = tempfile::tempdir().unwrap();
    let cases = [
        ([0.035, 0.18, 0.35], 0.0),
        ([0.045, 0.24, 0.135], 26.0),
        ([0.045, 0.3, 0.35], 0.0),
        ([0.025, 0.1, 0.3], 0.0),
        ([0.03, 0.12, 0.3], 0.0),
    ];
    for ([width_mm, pitch_mm, depth_mm], even_um) in at_least(2, &cases) {
        let mesh = cut([width_mm / 16.0, 0.5], |[x, _]| {
            let groove = x.rem_euclid(*pitch_mm) < *width_mm;
            1e-3 * even_um + if groove { *depth_mm } else { 0.0 }
        });
        let die = write_bore(folder.path(), &mesh);
        let order = ["--teeth", "40", "--die-mesh", &die, "--seed", "911"];
        let run = match *even_um > 0.0 {
            true => inspect_full(&order),
            false => inspect(&order),
        };
        let name = format!("{width_mm} every {pitch_mm}, {depth_mm} deep on {even_um} um");
        assert_not_passed(&name, &run);
        assert_eq!(run.flank(40, "right"), Some("go"), "{name}");
    }
}

#[test]
fn rows_of_pits_are_never_passed() {
    let folder = tempfile::tempdir().unwrap();
    let away = |at: f64, apart: f64| at.rem_euclid(apart) - 0.5 * apart;
    let mesh = cut([5e-3; 2], |[x, y]| {
        match away(x, 0.12).hypot(away(y, 0.04)) < 0.0175 {
            true => 0.35,
            false => 0.0,
        }
    });
    let die = write_bore(folder.path(), &mesh);
    let run = inspect(&["--teeth", "40", "--die-mesh", &die, "--seed", "912"]);
    assert_not_passed("rows of pits", &run);
}

/// Before the full head: the small one shows no band beside a judged zone.
#[test]
fn a_datum_band_that_wears_with_the_rest_is_never_passed_and_a_sound_one_is() {
    let folder = tempfile::tempdir().unwrap();
    // A single band below the judged zone.
    let band = "zone_height_mm = [0.0, 4.0]\ndatum_height_mm = [[28.2, 32.9]]";
    let tool = datum::tool(&folder.path().join("tool"), band);
    let of_tool = ["--tool", &tool, "--link", "sim", "--teeth", "40"];
    let sound = inspect_full(&[&of_tool[..], &["--seed", "913"]].concat());
    assert_eq!(sound.code, 0, "{}", sound.json["reason"]);
    let sentence = sound.json["reason"].as_str().unwrap_or_default();
    assert!(sentence.contains("one datum band"), "{sentence}");
    for (left_um, right_um) in at_least(2, &[(51.0, -25.0), (38.0, 0.0), (55.0, -15.0)]) {
        let mesh = bore(
            |at| match at.flank {
                Flank::Left => 1e-3 * left_um,
                Flank::Right => 1e-3 * right_um,
            },
            &[],
        );
        let die = write_bore(folder.path(), &mesh);
        let run = inspect_full(&[&of_tool[..], &["--die-mesh", &die, "--seed", "914"]].concat());
        let word = run.flank(40, "left");
        println!("{left_um} {right_um}: {word:?}: {}", run.json["reason"]);
        assert_eq!(word, Some("indeterminate"), "{}", run.json["reason"]);
    }
}

/// Before the full head: the small one sees no neighbours, which tell a local loss from one of the side.
#[test]
fn equal_and_opposite_changes_beside_a_local_loss_are_never_passed() {
    let folder = tempfile::tempdir().unwrap();
    let fine = |tooth, flank| Fine {
        tooth,
        flank,
        from_tip_mm: [0.0, 10.0],
        height_mm: CUT_HEIGHT_MM,
        step_mm: [0.1; 2],
    };
    let die = |opposite_um: f64| {
        let mesh = bore(
            |at| {
                let is_local = at.tooth == 40 && at.height_mm < 33.0;
                1e-3 * match (at.flank, is_local) {
                    (Flank::Left, true) => opposite_um + 25.0,
                    (Flank::Left, false) => opposite_um,
                    (Flank::Right, _) => -opposite_um,
                }
            },
            &[fine(40, Flank::Left)],
        );
        write_bore(folder.path(), &mesh)
    };
    let at_limit = die(26.0);
    for seed in at_least(2, &["915", "916", "917", "918"]) {
        let run = inspect_full(&["--teeth", "40", "--die-mesh", &at_limit, "--seed", seed]);
        assert_not_passed(seed, &run);
    }
    let baseline = folder.path().join("new.json");
    let baseline = baseline.to_str().unwrap();
    let new = [
        "--seed",
        "919",
        "--teeth",
        "40",
        "--record-baseline",
        baseline,
    ];
    let new = inspect_full(&new);
    assert_eq!(new.code, 0, "{}", new.json["reason"]);
    // By design one in twenty passes at the limit itself, where the stages' error happens to hide half of the change; 10 µm beyond it
    // that takes an error of three standard uncertainties, more than two approaches within ±15 mdeg can have.
    let beyond = die(36.0);
    for seed in at_least(2, &["920", "921", "922", "923", "924", "925"]) {
        let since = [
            "--teeth",
            "40",
            "--die-mesh",
            &beyond,
            "--baseline",
            baseline,
        ];
        let run = inspect_full(&[&since[..], &["--seed", seed]].concat());
        assert_not_passed(seed, &run);
    }
}
