//! A verdict survives its papers: it is said, stored and returned, whatever becomes of reports and documents.

use std::fs::OpenOptions;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Command, Output, Stdio};

use flankscope_tests::{flankscope, with_small_head};

/// Limits of the demo, µm: warn at 30, stop at 50.
const WORN: &str = "40:left:80";
/// A check of one tooth by the small head.
fn check() -> Command {
    let mut check = flankscope();
    with_small_head(
        check.args(["inspect", "--speed", "max"]),
        &["--teeth", "40"],
    );
    check
}

fn output(command: &mut Command) -> (Option<i32>, String, String) {
    let Output {
        status,
        stdout,
        stderr,
    } = command.stdin(Stdio::null()).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8_lossy(&bytes).into_owned();
    (status.code(), text(stdout), text(stderr))
}

/// A device on which nothing has room.
fn full() -> Stdio {
    Stdio::from(OpenOptions::new().write(true).open("/dev/full").unwrap())
}

#[test]
fn a_full_disk_keeps_no_verdict_back() {
    let folder = tempfile::tempdir().unwrap();
    let history = folder.path().join("press.db");
    for (number, wear, code, said) in [(1, Some(WORN), 1, "NO-GO: "), (2, None, 0, "GO: ")] {
        let mut check = check();
        check.args(["--json", "/dev/full"]);
        check.args(["--record-baseline", "/dev/full"]);
        check.arg("--history").arg(&history);
        check.args(wear.map(|wear| ["--wear", wear]).into_iter().flatten());
        let (got, stdout, stderr) = output(&mut check);
        assert_eq!(got, Some(code), "{stderr}");
        assert!(
            stdout.lines().any(|line| line.starts_with(said)),
            "{stdout}"
        );
        assert!(stderr.contains("cannot write /dev/full"), "{stderr}");
        let stands = said.trim_end_matches(": ").to_lowercase();
        assert!(
            stderr.contains(&format!("the verdict stands: {stands}: ")),
            "{stderr}"
        );
        let stored: (i64, String) = rusqlite::Connection::open(&history)
            .unwrap()
            .query_row("SELECT max(id), verdict FROM inspection", [], |row| {
                Ok((row.get(0)?, row.get(1)?))
            })
            .unwrap();
        assert_eq!(stored, (number, stands));
    }
}

#[test]
fn nobody_has_to_listen() {
    for (wear, code) in [(Some(WORN), 1), (None, 0)] {
        let worn_check = || {
            let mut check = check();
            check.stdin(Stdio::null());
            check.args(wear.map(|wear| ["--wear", wear]).into_iter().flatten());
            check
        };
        let table = worn_check().stdout(full()).stderr(Stdio::null()).status();
        assert_eq!(table.unwrap().code(), Some(code));
        let mut document = worn_check();
        document.args(["--json", "-"]).stdout(full());
        let child = document.stderr(Stdio::piped()).spawn().unwrap();
        let ended = child.wait_with_output().unwrap();
        let stderr = String::from_utf8_lossy(&ended.stderr);
        assert_eq!(ended.status.code(), Some(code), "{stderr}");
        assert!(stderr.contains("standard output"), "{stderr}");
        let silent = worn_check().stdout(full()).stderr(full()).status();
        assert_eq!(silent.unwrap().code(), Some(code));
    }
}

/// Runs a command until it says `word` on standard error, does something, and lets it end.
fn meanwhile(
    command: &mut Command,
    word: &str,
    act: impl FnOnce(),
) -> (Option<i32>, String, String) {
    let mut child = command
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut said = BufReader::new(child.stderr.take().unwrap());
    let mut heard = String::new();
    while !heard.contains(word) {
        assert_ne!(said.read_line(&mut heard).unwrap(), 0, "{heard}");
    }
    act();
    said.read_to_string(&mut heard).unwrap();
    let output = child.wait_with_output().unwrap();
    let stdout = String::from_utf8_lossy(&output.stdout).into_owned();
    (output.status.code(), stdout, heard)
}

/// Puts a file where a folder was.
fn replace(folder: &Path) {
    std::fs::remove_dir_all(folder).unwrap();
    std::fs::write(folder, "no folder any more").unwrap();
}

#[test]
fn a_report_that_loses_its_place_keeps_neither_verdict_nor_document_back() {
    let folder = tempfile::tempdir().unwrap();
    let (report, json) = (folder.path().join("out"), folder.path().join("check.json"));
    let mut check = flankscope();
    with_small_head(
        check.arg("inspect"),
        &["--teeth", "40", "--speed", "4", "--wear", WORN],
    );
    check.arg("--report").arg(&report).arg("--json").arg(&json);
    let lost = || replace(&report);
    let (code, stdout, stderr) = meanwhile(&mut check, "controller answered", lost);
    assert_eq!(code, Some(1), "{stderr}");
    assert!(stdout.contains("NO-GO: "), "{stdout}");
    assert!(!stdout.contains("report: "), "{stdout}");
    assert!(
        stderr.contains("cannot write") && stderr.contains("inspection.json"),
        "{stderr}"
    );
    let document = std::fs::read_to_string(json).unwrap();
    let document: serde_json::Value = serde_json::from_str(&document).unwrap();
    assert_eq!(document["verdict"], "no-go");
}

#[test]
fn a_watch_goes_on_without_its_papers() {
    let folder = tempfile::tempdir().unwrap();
    let report = folder.path().join("out");
    let mut watch = flankscope();
    with_small_head(
        watch.arg("watch"),
        &["--every", "3", "--cycles", "7", "--speed", "4"],
    );
    watch.args(["--teeth", "40", "--wear", WORN, "--json", "/dev/full"]);
    watch.arg("--report").arg(&report);
    let lost = || replace(&report);
    let (code, _, stderr) = meanwhile(&mut watch, "checking", lost);
    assert_eq!(code, Some(1), "{stderr}");
    assert!(
        stderr.matches("NO-GO (shown: no-go)").count() >= 2,
        "{stderr}"
    );
    for lost in ["checks.jsonl", "report.html", "/dev/full"] {
        assert!(stderr.contains(lost), "{lost}: {stderr}");
    }
}

#[test]
fn a_scan_is_judged_without_its_papers() {
    let mut scan = flankscope();
    with_small_head(scan.arg("scan"), &["--views", "12x1", "--speed", "max"]);
    scan.args(["--json", "/dev/full", "--mesh", "/dev/full"]);
    let (code, stdout, stderr) = output(&mut scan);
    // The small head shows teeth one by one, so that no view is held by a neighbour.
    assert_eq!(code, Some(2), "{stderr}");
    assert!(
        stdout.contains("INDETERMINATE: ") && stdout.contains("12 of 84 teeth at 1 height"),
        "{stdout}"
    );
    assert!(stdout.contains("SIMULATED BENCH"), "{stdout}");
    assert_eq!(
        stderr.matches("cannot write /dev/full").count(),
        2,
        "{stderr}"
    );
}

/// What is known to be impossible is said before the head moves, and an older result stays.
#[test]
fn places_are_tried_before_anything_moves() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (file, below) = (path("file"), path("file/below"));
    let nowhere = path("nowhere/file");
    std::fs::write(&file, "old").unwrap();
    std::fs::create_dir_all(path("taken/report.html")).unwrap();
    let taken = path("taken");
    for (command, option, place) in [
        ("inspect", "--json", &nowhere),
        ("inspect", "--json", &taken),
        ("inspect", "--report", &below),
        ("inspect", "--report", &taken),
        ("inspect", "--record-baseline", &nowhere),
        ("watch", "--json", &nowhere),
        ("watch", "--report", &taken),
        ("scan", "--json", &below),
        ("scan", "--report", &taken),
        ("scan", "--mesh", &nowhere),
        ("scan", "--cloud", &nowhere),
    ] {
        let mut run = flankscope();
        run.args([command, option, place, "--speed", "max"]);
        let (code, stdout, stderr) = output(&mut run);
        assert_eq!(code, Some(3), "{command} {option} {place}: {stderr}");
        assert_eq!(stdout, "");
        assert!(stderr.contains(place), "{stderr}");
        assert_eq!(stderr.lines().count(), 1, "nothing was begun: {stderr}");
    }
    assert_eq!(std::fs::read_to_string(&file).unwrap(), "old");
    // Nothing is left of the trials.
    let left = std::fs::read_dir(folder.path()).unwrap().count();
    assert_eq!(left, 2, "the file and the taken folder");
}
