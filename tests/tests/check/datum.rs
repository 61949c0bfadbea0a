//! Bands of the flanks that the workpiece never touches, as a datum: wear of all teeth shows in full.

use std::path::Path;

use flankscope_gear_cad::{Flank, Mesh};
use flankscope_test_requisites::at_least;
use flankscope_tests::die::{Fine, bore, write_bore};
use flankscope_tests::{Run, flankscope, inspect, run};

/// The forming zone wears in these heights, mm; 0.2 mm more to either side are the way to what stays as made.
const WORN_MM: [f64; 2] = [30.9, 35.1];
const EDGE_MM: f64 = 0.2;
/// The judged zone, relative to the middle of the view, and the datum.
const BANDS: &str = "zone_height_mm = [-2.0, 2.0]\ndatum_height_mm = [[28.2, 30.5], [35.5, 37.8]]";

/// The demo tool with more lines in `[inspect]`.
pub fn tool(folder: &Path, more: &str) -> String {
    let made = flankscope()
        .args(["bench", "demo-tool", "--out"])
        .arg(folder)
        .status();
    assert!(made.is_ok_and(|status| status.success()));
    let file = folder.join("tool.toml");
    let text = std::fs::read_to_string(&file).unwrap();
    let text = text.replace("warn_um", &format!("{more}\nwarn_um"));
    std::fs::write(&file, text).unwrap();
    folder.to_str().unwrap().to_owned()
}

/// A die whose forming zone lost so much on all left and all right flanks, as far as a view of tooth 40 reaches.
fn worn(left_um: f64, right_um: f64) -> Mesh {
    let teeth = 36..=44;
    let fine: Vec<Fine> = teeth
        .clone()
        .flat_map(|tooth| [Flank::Left, Flank::Right].map(|flank| (tooth, flank)))
        .map(|(tooth, flank)| Fine {
            tooth,
            flank,
            from_tip_mm: [0.0, 10.0],
            height_mm: [WORN_MM[0] - 1.0, WORN_MM[1] + 1.0],
            step_mm: [0.1, 0.1],
        })
        .collect();
    bore(
        |place| {
            let um = match place.flank {
                Flank::Left => left_um,
                Flank::Right => right_um,
            };
            let inside = (place.height_mm - WORN_MM[0]).min(WORN_MM[1] - place.height_mm);
            let share = (1.0 + inside / EDGE_MM).clamp(0.0, 1.0);
            f64::from(teeth.contains(&place.tooth)) * share * 1e-3 * um
        },
        &fine,
    )
}

/// Wear, its U95 and the true largest mean loss over a disc, µm.
fn answered(run: &Run, flank: &str) -> [f64; 3] {
    let features = run.json["features"].as_array().unwrap();
    let feature = features.iter().find(|f| f["flank"] == flank).unwrap();
    let key = format!("40:{flank}");
    [
        &feature["wear_um"],
        &feature["u95_um"],
        &run.json["truth"]["flanks"][key]["max_disc_wear_um"],
    ]
    .map(|value| value.as_f64().unwrap_or_else(|| panic!("{feature}")))
}

#[test]
fn wear_of_all_teeth_shows_in_full() {
    let folder = tempfile::tempdir().unwrap();
    let tool = tool(&folder.path().join("tool"), BANDS);
    let of_tool = ["--tool", &tool, "--link", "sim", "--teeth", "40"];
    // Loss on the left and on the right, and what is said of both.
    let dies = [
        ([0.0, 0.0], ["go", "go"]),
        ([45.0, -20.0], ["warn", "go"]),
        ([70.0, 0.0], ["no-go", "go"]),
        ([70.0, 70.0], ["no-go", "no-go"]),
        ([35.0, 0.0], ["warn", "go"]),
        ([-70.0, 70.0], ["no-go", "no-go"]),
    ];
    for (seed, &([left_um, right_um], words)) in at_least(3, &dies).iter().enumerate() {
        let mesh = write_bore(folder.path(), &worn(left_um, right_um));
        let seed = (21 + seed).to_string();
        let run = inspect(&[&of_tool[..], &["--die-mesh", &mesh, "--seed", &seed]].concat());
        for (flank, word) in ["left", "right"].into_iter().zip(words) {
            let [wear_um, u95_um, truth_um] = answered(&run, flank);
            println!(
                "{left_um} {right_um} {flank}: {wear_um:.2} ± {u95_um:.2}, true {truth_um:.2}"
            );
            assert!(
                (wear_um - truth_um).abs() <= u95_um,
                "{wear_um} ± {u95_um}: {truth_um}"
            );
            assert_eq!(run.flank(40, flank), Some(word), "{}", run.json["reason"]);
        }
    }
}

#[test]
fn a_baseline_knows_the_form_of_the_bands() {
    let folder = tempfile::tempdir().unwrap();
    let tool = tool(&folder.path().join("tool"), BANDS);
    let of_tool = ["--tool", &tool, "--link", "sim", "--teeth", "40"];
    let baseline = folder.path().join("new.json");
    let baseline = baseline.to_str().unwrap();
    let new = inspect(
        &[
            &of_tool[..],
            &["--seed", "77", "--record-baseline", baseline],
        ]
        .concat(),
    );
    assert_eq!(new.code, 0, "{}", new.json["reason"]);
    let mesh = write_bore(folder.path(), &worn(55.0, -20.0));
    let now = ["--die-mesh", &mesh, "--baseline", baseline];
    let run = inspect(&[&of_tool[..], &now].concat());
    let [wear_um, u95_um, truth_um] = answered(&run, "left");
    println!("{wear_um:.2} ± {u95_um:.2}, true {truth_um:.2}");
    assert!((wear_um - truth_um).abs() <= u95_um, "{wear_um} ± {u95_um}");
    assert_eq!(run.flank(40, "left"), Some("no-go"));
}

/// What is wrong with a datum is said with its value and what would be right, before anything moves.
#[test]
fn bands_that_cannot_be_a_datum_are_refused_by_name() {
    let zone = "zone_height_mm = [-2.0, 2.0]\n";
    let cases = [
        ("datum_height_mm = [[28.2, 31.5]]", "31.5", "ends at 31"),
        ("datum_height_mm = [[20.0, 25.0]]", "20 to 25", "tooth 40"),
        ("datum_height_mm = [[60.0, 70.0]]", "70", "0 to 66"),
        ("datum_height_mm = [[30.0, 29.0]]", "30", "upper end"),
        (
            "datum_height_mm = [[28.2, 30.5]]\ndatum = \"lands\"",
            "inspect.datum",
            "one of the two",
        ),
    ];
    for (i, (lines, value, right)) in cases.into_iter().enumerate() {
        let folder = tempfile::tempdir().unwrap();
        let tool = tool(
            &folder.path().join(i.to_string()),
            &format!("{zone}{lines}"),
        );
        let run = inspect(&["--tool", &tool, "--link", "sim", "--teeth", "40"]);
        assert_eq!(run.code, 3, "{lines}: {}", run.stderr);
        for part in ["datum_height_mm", value, right] {
            assert!(run.stderr.contains(part), "{lines}: {}", run.stderr);
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let tool = tool(&folder.path().join("tool"), BANDS);
    let session = folder.path().join("scan");
    let mut scan = flankscope();
    scan.args([
        "scan",
        "--quiet",
        "--tool",
        &tool,
        "--link",
        "sim",
        "--views",
        "12x2",
        "--session",
    ]);
    let scan = run(scan.arg(session));
    assert_eq!(scan.code, 3, "{}", scan.stderr);
    assert!(scan.stderr.contains("datum_height_mm"), "{}", scan.stderr);
}
