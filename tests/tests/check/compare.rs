//! Two checks compared: what was lost between them, against what the bench took off.

use std::path::Path;

use flankscope_tests::{Run, flankscope, inspect, run, small_tool, write_small_tool};

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
        if !more.contains(&"--tool") {
            command.args(["--tool", small_tool()]);
        }
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
    // A head file that is not the one of these checks.
    let other = path("other");
    write_small_tool(Path::new(&other));
    let head = folder.path().join("other/head.toml");
    let text = std::fs::read_to_string(&head).unwrap();
    std::fs::write(&head, text + "# edited since\n").unwrap();
    let refused = compare(["1", "2"], &["--tool", &other]);
    assert_eq!(refused.code, 3);
    let why = &refused.stderr;
    assert!(
        why.contains("another head file") && why.contains("--head"),
        "{why}"
    );
    let mut replay = flankscope();
    replay.args(["replay", &history, "1", "--tool", &other]);
    let replayed = replay.output().unwrap();
    assert_eq!(replayed.status.code(), Some(2));
    let printed = String::from_utf8_lossy(&replayed.stdout);
    let says = "other files than those given (head)";
    assert!(printed.contains(says), "{printed}");
    let missing = compare(["1", "9"], &[]);
    assert_eq!(missing.code, 3);
    assert!(missing.stderr.contains('9'), "{}", missing.stderr);
}
