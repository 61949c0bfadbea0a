//! Two checks compared: what was lost between them, against what the bench took off.

use flankscope_tests::{Run, flankscope, inspect, run};

#[test]
fn what_was_lost_between_two_checks_is_told_with_its_uncertainty() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (history, page) = (path("press.db"), path("change.html"));
    let check = |wear: &str, seed: &str| {
        let on = [
            "--link",
            "sim",
            "--teeth",
            "40",
            "--history",
            &history,
            "--seed",
            seed,
            "--wear",
            wear,
        ];
        inspect(&on)
    };
    // The same die, 10 and then 28 um deep worn on the left flank, approached anew.
    for (wear, seed) in [("40:left:10", "4"), ("40:left:28", "5")] {
        let run = check(wear, seed);
        assert!([0, 2, 4].contains(&run.code), "{}", run.json["reason"]);
    }
    let compare = |ids: [&str; 2], more: &[&str]| -> Run {
        let mut command = flankscope();
        command
            .args(["compare", &history])
            .args(ids)
            .args(["--json", "-"]);
        run(command.args(more))
    };
    let compared = compare(["1", "2"], &["--page", &page]);
    assert_eq!(compared.code, 0, "{}", compared.stderr);
    let flanks = compared.json["flanks"].as_array().unwrap();
    for (side, lost_um) in [("left", 18.0), ("right", 0.0)] {
        let flank = flanks.iter().find(|of| of["flank"] == side).unwrap();
        let number =
            |value: &serde_json::Value| value.as_f64().unwrap_or_else(|| panic!("{flank}"));
        let [wear_um, u95_um] = ["wear_um", "u95_um"].map(|key| number(&flank["since"][key]));
        assert!(
            (wear_um - lost_um).abs() <= u95_um,
            "{side}: {wear_um} ± {u95_um}"
        );
        // Calibration cancels, so that the change is surer than either figure.
        assert!(u95_um < number(&flank["after_um"]["u95"]), "{flank}");
    }
    let html = std::fs::read_to_string(&page).unwrap();
    assert!(html.contains("40 left") && !html.contains("http://") && !html.contains("https://"));
    // A check against itself has lost nothing at all.
    let same = compare(["2", "2"], &[]);
    for flank in same.json["flanks"].as_array().unwrap() {
        let since = &flank["since"];
        let [wear_um, u95_um] = ["wear_um", "u95_um"].map(|key| since[key].as_f64().unwrap());
        assert!(wear_um.abs() <= u95_um, "{since}");
    }
    let missing = compare(["1", "9"], &[]);
    assert_eq!(missing.code, 3);
    assert!(missing.stderr.contains('9'), "{}", missing.stderr);
}
