//! Where a result comes from: said everywhere, and never mixed.

use std::process::Stdio;

use flankscope_tests::{
    flankscope, inspect, inspect_full, press_tool, run, small_tool, with_small_head,
};
use serde_json::Value;

/// Options that are not for the built-in demo any more: the link must be named.
#[test]
fn a_forgotten_port_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let tool = folder.path().to_str().unwrap();
    let file = folder.path().join("press.db");
    let history = file.to_str().unwrap();
    for arguments in [
        &["inspect", "--tool", tool][..],
        &["inspect", "--history", history],
        &["watch", "--tool", tool],
        &["watch", "--history", history],
        &["scan", "--tool", tool],
    ] {
        let refused = run(flankscope().args(arguments).stdin(Stdio::null()));
        assert_eq!(refused.code, 3, "{arguments:?}");
        for said in [arguments[1], "--link PORT", "--link sim"] {
            assert!(refused.stderr.contains(said), "{}", refused.stderr);
        }
    }
    assert!(!file.exists(), "nothing was begun");
}

fn check_origin(document: &Value, link: &str, station: &str, operator: &str) {
    check_origin_of(document, link, station, operator);
    assert_eq!(document["head"]["blake3"], document["hashes"]["head"]);
}

fn check_origin_of(document: &Value, link: &str, station: &str, operator: &str) {
    assert_eq!(document["link"], link, "{document}");
    assert_eq!(document["simulated"], true);
    assert_eq!(document["station"], station);
    assert_eq!(document["operator"], operator);
    assert_eq!(document["tool"], "demo die");
    assert_eq!(document["head"]["name"], "small head");
    let date = document["date"].as_str().unwrap();
    assert!(
        date.len() == 20 && date.ends_with('Z') && date.contains('T'),
        "{date}"
    );
}

#[test]
fn a_simulated_check_says_so_in_document_report_and_history() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (history, out) = (path("press.db"), path("out"));
    let who = ["--station", "press 7"];
    let stored = ["--teeth", "40", "--link", "sim", "--history", &history];
    let mut check = flankscope();
    check.args(["inspect", "--quiet", "--json", "-", "--speed", "max"]);
    with_small_head(check.args(who).args(["--report", &out]), &stored);
    let check = run(check.env("USER", "Ada"));
    assert_eq!(check.code, 0, "{}", check.stderr);
    check_origin(&check.json, "sim", "press 7", "Ada");
    assert_eq!(check.json["id"], 1);
    let page = std::fs::read_to_string(path("out/report.html")).unwrap();
    for said in [
        "SIMULATED BENCH",
        "simulated bench (sim)",
        "press 7",
        "Ada",
        "small head",
        "number 1 of its history",
        check.json["date"].as_str().unwrap(),
    ] {
        assert!(page.contains(said), "{said}");
    }

    let mut shown = flankscope();
    shown.args(["history", &history, "--json", "-", "--report", &out]);
    let shown = run(&mut shown);
    assert_eq!(shown.code, 0, "{}", shown.stderr);
    assert_eq!(shown.json["simulated"], true);
    let last = &shown.json["last"];
    for (key, value) in [("link", "sim"), ("station", "press 7"), ("operator", "Ada")] {
        assert_eq!(last[key], value, "{last}");
    }
    assert_eq!((&last["simulated"], &last["id"]), (&true.into(), &1.into()));
    assert_eq!(last["head"], check.json["head"]);
    let page = std::fs::read_to_string(path("out/history.html")).unwrap();
    assert!(page.contains("SIMULATED BENCH") && page.contains("press 7"));

    let again = run(flankscope().args([
        "replay",
        &history,
        "1",
        "--quiet",
        "--json",
        "-",
        "--tool",
        small_tool(),
    ]));
    assert_eq!(again.code, 0, "{}", again.stderr);
    check_origin_of(&again.json, "sim", "press 7", "Ada");

    // A press does not write to it, and is not even asked.
    let tool = press_tool(&folder.path().join("die"));
    let nowhere = ["--link", "/dev/flankscope-is-not-here", "--tool", &tool];
    let press = inspect(&[&nowhere[..], &["--history", &history]].concat());
    assert_eq!(press.code, 3);
    assert!(
        press.stderr.contains("holds checks of the simulated bench"),
        "{}",
        press.stderr
    );

    // The built-in demo, whose head is the full one, has the name of a station although none was given.
    let demo = inspect_full(&["--teeth", "40"]);
    assert_eq!(
        (&demo.json["simulated"], &demo.json["id"]),
        (&true.into(), &Value::Null)
    );
    assert!(
        demo.json["station"]
            .as_str()
            .is_some_and(|name| !name.is_empty())
    );
}

#[test]
fn the_history_of_a_press_takes_no_simulated_check() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("press.db");
    let history = file.to_str().unwrap();
    // Made by a port that nobody answers at: it has no check yet, and is of neither kind.
    let tool = press_tool(&folder.path().join("die"));
    let nowhere = ["--link", "/dev/flankscope-is-not-here", "--tool", &tool];
    let absent = inspect(&[&nowhere[..], &["--history", history]].concat());
    assert_eq!(absent.code, 3);
    assert!(
        absent.stderr.contains("/dev/flankscope-is-not-here"),
        "{}",
        absent.stderr
    );
    rusqlite::Connection::open(&file)
        .unwrap()
        .execute("INSERT INTO kind (one, simulated) VALUES (1, 0)", [])
        .unwrap();
    // Somebody answers for the row that no check wrote.
    let mut trust = flankscope();
    let trusted = run(trust.args(["trust", history, "--quiet", "--name", "tester"]));
    assert_eq!(trusted.code, 0, "{}", trusted.stderr);
    for command in ["inspect", "watch"] {
        let refused = run(flankscope()
            .args([command, "--link", "sim", "--history", history])
            .stdin(Stdio::null()));
        assert_eq!(refused.code, 3);
        for said in ["holds checks of a real press", "name another file"] {
            assert!(refused.stderr.contains(said), "{}", refused.stderr);
        }
        assert!(
            !refused.stderr.contains("controller answered"),
            "{}",
            refused.stderr
        );
    }
}

/// A new tool on the bench is no baseline of one in a press.
#[test]
fn a_baseline_from_the_bench_judges_no_press() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("new.json");
    let file = path.to_str().unwrap();
    let new = inspect(&["--teeth", "40", "--record-baseline", file]);
    assert_eq!(new.code, 0, "{}", new.stderr);
    let tool = press_tool(&folder.path().join("die"));
    let nowhere = ["--link", "/dev/flankscope-is-not-here", "--tool", &tool];
    let press = inspect(&[&nowhere[..], &["--baseline", file]].concat());
    assert_eq!(press.code, 3);
    assert!(
        press.stderr.contains("recorded with the simulated bench"),
        "{}",
        press.stderr
    );
}

/// A station's file says who and where, stores and reports; what is wrong with it is named before anything moves.
#[test]
fn a_station_is_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("station.toml");
    let check = |text: &str| {
        std::fs::write(&file, text).unwrap();
        inspect(&[
            "--teeth",
            "40",
            "--tool",
            small_tool(),
            "--station",
            file.to_str().unwrap(),
        ])
    };
    let stored = "[history]\nfile = \"press.db\"\n[report]\nfolder = \"out\"\n";
    let sound = check(&format!(
        "name = \"press 9\"\n[controller]\nlink = \"sim\"\n{stored}"
    ));
    assert_eq!(sound.code, 0, "{}", sound.stderr);
    assert_eq!(sound.json["station"], "press 9");
    assert_eq!(sound.json["id"], 1, "stored beside the file");
    assert!(sound.json["hashes"]["station"].is_string());
    for made in ["press.db", "out/report.html", "out/inspection.json"] {
        assert!(folder.path().join(made).exists(), "{made}");
    }
    // Stages that promise less leave more in doubt.
    let link = "[controller]\nlink = \"sim\"\n";
    let loose = check(&format!("{link}[stages]\nrotation_error_mdeg = 150.0\n"));
    let u95 = |run: &flankscope_tests::Run| run.json["features"][0]["u95_um"].as_f64();
    assert!(
        u95(&loose) > u95(&sound),
        "{:?} {:?}",
        u95(&loose),
        u95(&sound)
    );
    std::fs::write(&file, stored).unwrap();
    // The built-in demo again: every other tool needs a link anyway. It is refused before anything is rendered.
    let unlinked = inspect_full(&["--station", file.to_str().unwrap()]);
    assert_eq!(unlinked.code, 3);
    let said = &unlinked.stderr;
    assert!(said.contains("--station without --link"), "{said}");
    for (text, named) in [
        (
            "[stages]\nmount_um = -1.0\n",
            "station.toml:2: stages.mount_um",
        ),
        ("[lights]\nled_ma = 1\n", "unknown field `lights`"),
    ] {
        let refused = check(text);
        assert_eq!(refused.code, 3, "{text}");
        assert!(refused.stderr.contains(named), "{}", refused.stderr);
    }
}
