//! One side of all teeth worn and the other proud, without a datum: a turn of the view looks nearly the same. What is beyond
//! the stop limit is neither go nor warn, what is beyond the warning limit is not go, against the CAD and since a baseline.
//!
//! They need the full head: the view of one tooth is refused whatever its sides are like.

use flankscope_gear_cad::Flank;
use flankscope_test_requisites::at_least;
use flankscope_tests::die::{bore, write_bore};
use flankscope_tests::{Run, inspect_full};

const LIMIT_UM: f64 = 50.0;

/// Loss of all left and of all right flanks of these teeth, µm.
struct Die {
    teeth: std::ops::RangeInclusive<u32>,
    left_um: f64,
    right_um: f64,
}

fn die(teeth: std::ops::RangeInclusive<u32>, left_um: f64, right_um: f64) -> Die {
    Die {
        teeth,
        left_um,
        right_um,
    }
}

fn words(run: &Run) -> [&str; 2] {
    ["left", "right"].map(|flank| run.flank(40, flank).unwrap_or("not there"))
}

#[test]
fn worn_and_proud_sides_are_never_passed() {
    let folder = tempfile::tempdir().unwrap();
    let baseline = folder.path().join("new.json");
    let baseline = baseline.to_str().unwrap();
    let tooth = ["--teeth", "40"];
    let new = ["--seed", "77", "--record-baseline", baseline];
    let new = inspect_full(&[&tooth[..], &new].concat());
    assert_eq!(new.code, 0, "{}", new.json["reason"]);
    let dies = [
        die(1..=84, 45.0, -20.0),
        die(38..=42, 60.0, -25.0),
        die(1..=84, 65.0, -29.0),
        die(1..=84, 55.0, -10.0),
        die(1..=84, -20.0, 45.0),
        die(1..=84, 45.0, -45.0),
        die(1..=84, 55.0, 0.0),
        die(1..=84, 0.0, -55.0),
    ];
    for (seed, die) in at_least(2, &dies).iter().enumerate() {
        let mesh = bore(
            |place| {
                let um = match place.flank {
                    Flank::Left => die.left_um,
                    Flank::Right => die.right_um,
                };
                f64::from(die.teeth.contains(&place.tooth)) * 1e-3 * um
            },
            &[],
        );
        let mesh = write_bore(folder.path(), &mesh);
        let seed = (11 + seed).to_string();
        let standing = [&tooth[..], &["--die-mesh", &mesh, "--seed", &seed]].concat();
        for since in [&[][..], &["--baseline", baseline]] {
            let run = inspect_full(&[&standing, since].concat());
            for (word, um) in words(&run).into_iter().zip([die.left_um, die.right_um]) {
                println!("{} {} {since:?}: {word}", die.left_um, die.right_um);
                // All dies here have a flank beyond the warning limit, and each such flank counts by itself.
                if um.abs() > LIMIT_UM {
                    assert!(
                        ["no-go", "indeterminate"].contains(&word),
                        "{um}: {}",
                        run.json["reason"]
                    );
                } else if um.abs() > 30.0 {
                    assert_ne!(word, "go", "{um}: {}", run.json["reason"]);
                }
            }
        }
    }
}

/// A sound die made by the same hand stays go: what is not presumed of its sides costs it nothing.
#[test]
fn a_sound_die_stays_go() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = write_bore(folder.path(), &bore(|_| 0.0, &[]));
    for seed in at_least(1, &["5", "6", "7"]) {
        let run = inspect_full(&["--teeth", "40", "--die-mesh", &mesh, "--seed", seed]);
        assert_eq!(words(&run), ["go", "go"], "{}", run.json["reason"]);
    }
}
