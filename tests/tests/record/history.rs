//! Checks that are stored, end to end: shown as a trend, kept over a restart, and worth nothing when they cannot be kept.

use std::io::Write;
use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

use flankscope_tests::{
    Run, bench, flankscope, head_of_pixels, inspect, inspect_full, run, small_tool,
    write_small_tool,
};
use serde_json::Value;

fn history(file: &Path, arguments: &[&str]) -> Run {
    let mut command = flankscope();
    command
        .arg("history")
        .arg(file)
        .args(["--quiet", "--json", "-"])
        .args(arguments);
    run(&mut command)
}

#[test]
fn wear_is_shown_against_the_cycles_of_the_tool() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("press.db");
    let path = file.to_str().unwrap();
    // 50 µm per 1000 cycles.
    for (number, hundreds) in (1..).zip([1, 2, 3, 4, 5]) {
        let (cycles, wear) = (format!("{hundreds}00"), format!("40:left:{}", 5 * hundreds));
        let seed = hundreds.to_string();
        // The trend is judged to 10 %: with one tooth in view, its wear and a turn of the die look alike.
        let check = inspect_full(&[
            "--teeth",
            "40",
            "--seed",
            &seed,
            "--wear",
            &wear,
            "--link",
            "sim",
            "--history",
            path,
            "--tool-cycles",
            &cycles,
        ]);
        assert_eq!(check.code, 0, "{} {}", check.json["reason"], check.stderr);
        assert_eq!(check.json["id"], number);
    }
    let table = folder.path().join("table.csv");
    let out = folder.path().join("out");
    let shown = history(
        &file,
        &[
            "--csv",
            table.to_str().unwrap(),
            "--report",
            out.to_str().unwrap(),
        ],
    );
    assert_eq!(shown.code, 0, "{}", shown.stderr);
    let flank = |name: &str| {
        let flanks = shown.json["flanks"].as_array().unwrap();
        flanks.iter().find(|f| f["flank"] == name).unwrap().clone()
    };
    // All figures share most of their 2 µm: the rate does not know of it.
    let left = flank("left");
    let rate = left["trend"]["rate_um"].as_f64().unwrap();
    assert!((rate - 0.05).abs() < 0.005, "{left}");
    // 25 µm are left to the stop limit: 500 cycles, and fewer with 5 % probability.
    let remaining = |q: &str| left["remaining_cycles"][q].as_f64().unwrap();
    assert!((remaining("q50") - 500.0).abs() < 60.0, "{left}");
    assert!(
        (300.0..remaining("q50")).contains(&remaining("q05")),
        "{left}"
    );
    assert!(
        flank("right")["remaining_cycles"]["q05"]
            .as_f64()
            .is_none_or(|q05| q05 > 2000.0)
    );
    let lines = std::fs::read_to_string(table).unwrap();
    assert_eq!(lines.lines().count(), 1 + 5 * 2, "{lines}");
    let page = std::fs::read_to_string(out.join("history.html")).unwrap();
    assert_eq!(
        page.matches("<svg").count(),
        3,
        "both flanks together, and each"
    );

    let unknown = history(&file, &["--tool", "another die"]);
    assert_eq!(unknown.code, 3);
    assert!(unknown.stderr.contains("demo die"), "{}", unknown.stderr);
    let missing = history(&folder.path().join("none.db"), &[]);
    assert_eq!(missing.code, 3, "{}", missing.stderr);
}

#[test]
fn a_check_that_cannot_be_stored_is_no_go() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("press.db");
    let path = file.to_str().unwrap().to_owned();
    let check = std::thread::spawn(move || {
        inspect(&["--teeth", "40", "--link", "sim", "--history", &path])
    });
    // The check has begun when its audit row is there; then somebody takes the file and does not give it back.
    let began = |connection: &rusqlite::Connection| {
        connection.query_row("SELECT count(*) FROM audit", [], |row| row.get::<_, i64>(0))
    };
    let other = loop {
        std::thread::sleep(Duration::from_millis(5));
        assert!(!check.is_finished(), "the check began and ended unseen");
        if file.exists()
            && let Ok(connection) = rusqlite::Connection::open(&file)
            && began(&connection).is_ok_and(|rows| rows > 0)
        {
            break connection;
        }
    };
    other.execute_batch("BEGIN IMMEDIATE").unwrap();
    let check = check.join().unwrap();
    assert_eq!(check.code, 2, "{}", check.stderr);
    assert_eq!(check.json["verdict"], "indeterminate");
    assert_eq!(
        check.json["features"][0]["verdict"], "go",
        "the flanks themselves are good"
    );
    let reason = check.json["reason"].as_str().unwrap();
    assert!(reason.contains("cannot store the check"), "{reason}");
    assert!(check.json["id"].is_null());
}

#[test]
fn a_no_go_outlives_a_restart_until_it_is_acknowledged() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("press.db");
    let watch = |arguments: &[&str], typed: &str| {
        let mut command = flankscope();
        command
            .args([
                "watch", "--quiet", "--json", "-", "--speed", "10", "--every", "3", "--cycles", "4",
            ])
            .args(["--teeth", "40", "--link", "sim", "--tool", small_tool()])
            .args(["--history", file.to_str().unwrap()])
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        let mut child = command.spawn().unwrap();
        child
            .stdin
            .take()
            .unwrap()
            .write_all(typed.as_bytes())
            .unwrap();
        let output = child.wait_with_output().unwrap();
        let json: Value = serde_json::from_slice(&output.stdout).unwrap_or(Value::Null);
        (output.status.code(), json)
    };
    let (code, worn) = watch(&["--wear", "40:left:80"], "");
    assert_eq!(
        (code, &worn["shown"]),
        (Some(1), &Value::from("no-go")),
        "{worn}"
    );
    // The same tool, repaired, but nobody said so.
    let (code, repaired) = watch(&[], "");
    assert_eq!(
        repaired["checks"][0]["inspection"]["verdict"], "go",
        "{repaired}"
    );
    assert_eq!((code, &repaired["shown"]), (Some(1), &Value::from("no-go")));
    let (code, acknowledged) = watch(&[], "Ada\n");
    assert_eq!(
        (code, &acknowledged["shown"]),
        (Some(0), &Value::from("go")),
        "{acknowledged}"
    );
    let shown = history(&file, &[]);
    assert_eq!(
        shown.json["acknowledgements"][0]["who"], "Ada",
        "{}",
        shown.json
    );
}

fn replay(file: &Path, id: &str, arguments: &[&str]) -> Run {
    let mut command = flankscope();
    command
        .arg("replay")
        .arg(file)
        .args([id, "--quiet", "--json", "-"]);
    if !arguments.contains(&"--tool") {
        command.args(["--tool", small_tool()]);
    }
    run(command.args(arguments))
}

#[test]
fn a_stored_verdict_is_computed_again_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (file, baseline) = (path("press.db"), path("new.json"));
    let check = |arguments: &[&str]| {
        let stored = ["--teeth", "40", "--link", "sim", "--history", &file];
        inspect(&[&stored, arguments].concat())
    };
    // A go, a no-go with pixels as points, wear since a baseline, and a view whose frames do not pair.
    assert_eq!(
        check(&[
            "--seed",
            "3",
            "--record-baseline",
            &baseline,
            "--approaches",
            "2"
        ])
        .code,
        0
    );
    let of_pixels = head_of_pixels(folder.path());
    let head = ["--head", &*of_pixels];
    assert_eq!(
        check(&[&["--wear", "40:left:80", "--tool", small_tool()][..], &head].concat()).code,
        1
    );
    assert_eq!(
        check(&[
            "--seed",
            "4",
            "--wear",
            "40:left:80",
            "--baseline",
            &baseline
        ])
        .code,
        1
    );
    let [option, file_of_bench] = bench("[camera]\nframe_fault = \"lose:7\"\n");
    let lost = check(&[&option, &file_of_bench]);
    assert_eq!(lost.code, 2, "{}", lost.json["reason"]);
    let history = Path::new(&file);
    for (id, code, captures, head) in [
        ("1", 0, 2, &[][..]),
        ("2", 1, 1, &head),
        ("3", 1, 1, &[]),
        ("4", 2, 0, &[]),
    ] {
        let again = replay(history, id, head);
        assert_eq!(
            again.code, code,
            "check {id}: {} {}",
            again.json, again.stderr
        );
        assert_eq!(again.json["same"], true, "check {id}: {}", again.json);
        assert_eq!(again.json["captures"], captures, "check {id}");
    }
    let none = replay(history, "5", &[]);
    assert_eq!(none.code, 3);
    assert!(none.stderr.contains("checks up to 4"), "{}", none.stderr);

    // Another tool file of the same tool: what follows from it differs, by name.
    let tool = path("tool");
    write_small_tool(Path::new(&tool));
    let text = std::fs::read_to_string(path("tool/tool.toml")).unwrap();
    let strict = text.replace("warn_um = 30", "warn_um = 1");
    assert_ne!(strict, text);
    std::fs::write(path("tool/tool.toml"), strict).unwrap();
    let changed = replay(history, "1", &["--tool", &tool]);
    assert_eq!(
        (changed.code, &changed.json["same"]),
        (2, &Value::Bool(false)),
        "{}",
        changed.stderr
    );
    let named: Vec<&str> = changed.json["differences"]
        .as_array()
        .unwrap()
        .iter()
        .filter_map(|difference| difference["what"].as_str())
        .collect();
    for what in ["hashes.tool", "features.0.warn_um", "verdict"] {
        assert!(named.contains(&what), "{what} among {named:?}");
    }
    assert!(!named.contains(&"features.0.wear_um"), "{named:?}");

    // Phasors that are not what they were, or not there.
    let phasors = |id: &str| {
        let connection = rusqlite::Connection::open(&file).unwrap();
        let hash: String = connection
            .query_row(
                "SELECT json_extract(document, '$.evidence[0].phasors[0]') FROM inspection WHERE id = ?1",
                [id],
                |row| row.get(0),
            )
            .unwrap();
        Path::new(&format!("{file}.phasors")).join(format!("{hash}.zz"))
    };
    let damaged = phasors("1");
    let mut bytes = std::fs::read(&damaged).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0x10;
    std::fs::write(&damaged, bytes).unwrap();
    let missing = phasors("3");
    std::fs::remove_file(&missing).unwrap();
    for (id, file) in [("1", damaged), ("3", missing)] {
        let refused = replay(history, id, &[]);
        assert_eq!(refused.code, 3, "{}", refused.json);
        assert!(
            refused.stderr.contains(file.to_str().unwrap()),
            "{}",
            refused.stderr
        );
    }
}
