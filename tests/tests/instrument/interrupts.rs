//! Ctrl-C and SIGTERM in the middle of everything that moves: the head comes out, what was measured is said, nothing is left.

use std::io::{BufRead, BufReader, Lines};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, ChildStderr, Command, Stdio};

use flankscope_tests::{flankscope, small_target, with_small_head};
use serde_json::Value;

const INTERRUPTED: Option<i32> = Some(130);

/// A command that runs with a runtime folder of its own.
struct Running {
    child: Child,
    said: Lines<BufReader<ChildStderr>>,
    runtime: tempfile::TempDir,
}

impl Running {
    /// Starts it in the foreground group of a terminal of its own, and waits until it says something with `word` in it.
    fn until(arguments: &[&str], word: &str) -> Self {
        let runtime = tempfile::Builder::new()
            .prefix("i")
            .permissions(std::fs::Permissions::from_mode(0o700))
            .tempdir_in("/tmp")
            .unwrap();
        let mut command = flankscope();
        let (name, options) = arguments.split_first().unwrap();
        command.arg(name);
        let mut child = match *name {
            "calibrate" => command.args(options),
            _ => with_small_head(&mut command, options),
        }
        .env("XDG_RUNTIME_DIR", runtime.path())
        .process_group(0)
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
        let mut said = BufReader::new(child.stderr.take().unwrap()).lines();
        let mut heard = Vec::new();
        let told = said.by_ref().map(Result::unwrap).find(|line| {
            heard.push(line.clone());
            line.contains(word)
        });
        assert!(told.is_some(), "{arguments:?}: {heard:?}");
        Self {
            child,
            said,
            runtime,
        }
    }

    /// Names of what it has made in its runtime folder.
    fn folders(&self) -> Vec<String> {
        let entries = std::fs::read_dir(self.runtime.path().join("flankscope")).unwrap();
        let names = entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned());
        names
            .filter(|name| name.starts_with("flankscope_"))
            .collect()
    }

    /// To everything in its group, as a terminal does.
    fn signal(&self, signal: &str) {
        let sent = Command::new("kill")
            .args([signal, "--", &format!("-{}", self.child.id())])
            .status();
        assert!(sent.unwrap().success());
    }

    /// Its exit code and what it said since; nothing of it is left.
    fn ended(mut self, mut folders: Vec<String>) -> (Option<i32>, Vec<String>) {
        let said: Vec<String> = self.said.by_ref().map(Result::unwrap).collect();
        let code = self.child.wait().unwrap().code();
        assert_eq!(self.folders(), Vec::<String>::new(), "{said:?}");
        folders.retain(|prefix| {
            let shared = std::fs::read_dir("/dev/shm").unwrap();
            shared
                .flatten()
                .any(|file| file.file_name().to_string_lossy().starts_with(prefix))
        });
        assert_eq!(folders, Vec::<String>::new(), "{said:?}");
        (code, said)
    }
}

fn interrupted(arguments: &[&str], word: &str, signal: &str) -> Vec<String> {
    let running = Running::until(arguments, word);
    let folders = running.folders();
    assert!(!folders.is_empty());
    running.signal(signal);
    let (code, said) = running.ended(folders);
    assert_eq!(code, INTERRUPTED, "{said:?}");
    said
}

fn says<'a>(said: &'a [String], words: &str) -> &'a str {
    let line = said.iter().find(|line| line.contains(words));
    line.unwrap_or_else(|| panic!("\"{words}\" is missing: {said:?}"))
}

fn document(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

#[test]
fn an_interrupted_check_is_indeterminate_and_kept() {
    let folder = tempfile::tempdir().unwrap();
    let (json, store) = (
        folder.path().join("check.json"),
        folder.path().join("press.db"),
    );
    let [json_at, store_at] = [&json, &store].map(|path| path.to_str().unwrap());
    let said = interrupted(
        &[
            "inspect",
            "--link",
            "sim",
            "--speed",
            "1",
            "--json",
            json_at,
            "--history",
            store_at,
        ],
        "(view 2 of",
        "-INT",
    );
    says(&said, "head retracts");
    let kept = says(&said, "interrupted after");
    assert!(
        kept.contains("of 3 views") && kept.contains("check 1 of the history"),
        "{kept}"
    );
    let check = document(&json);
    assert_eq!(check["verdict"], "indeterminate");
    assert_eq!(check["stopped"], "interrupted");
    assert_eq!(check["frames"]["triggered"].as_u64().unwrap() % 25, 0);
}

/// While the stages reference between two approaches of a baseline, or in the next approach.
#[test]
fn an_interrupted_baseline_is_not_recorded_and_its_check_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (baseline, json, store) = (at("new.json"), at("check.json"), at("press.db"));
    let order = [
        "inspect",
        "--teeth",
        "40",
        "--speed",
        "1",
        "--record-baseline",
        &baseline,
        "--approaches",
        "50",
        "--json",
        &json,
        "--history",
        &store,
    ];
    let said = interrupted(&order, "head retracts", "-INT");
    let kept = says(&said, "interrupted after");
    assert!(kept.contains("check 1 of the history"), "{kept}");
    let check = document(Path::new(&json));
    assert_eq!(
        (&check["verdict"], &check["stopped"]),
        (&"indeterminate".into(), &"interrupted".into())
    );
    assert!(!Path::new(&baseline).exists());
}

/// The host stands still for longer than any evaluation takes: the check is stored before the program ends.
#[test]
fn an_interrupted_check_is_kept_however_slow_the_machine_is() {
    let folder = tempfile::tempdir().unwrap();
    let (json, store) = (
        folder.path().join("check.json"),
        folder.path().join("press.db"),
    );
    let [json_at, store_at] = [&json, &store].map(|path| path.to_str().unwrap());
    let order = [
        "inspect",
        "--speed",
        "1",
        "--json",
        json_at,
        "--history",
        store_at,
    ];
    let running = Running::until(&order, "(view 2 of");
    let folders = running.folders();
    running.signal("-INT");
    let host = rustix::process::Pid::from_child(&running.child);
    for (signal, wait_ms) in [
        (rustix::process::Signal::STOP, 4000),
        (rustix::process::Signal::CONT, 0),
    ] {
        rustix::process::kill_process(host, signal).unwrap();
        std::thread::sleep(std::time::Duration::from_millis(wait_ms));
    }
    let (code, said) = running.ended(folders);
    assert_eq!(code, INTERRUPTED, "{said:?}");
    let kept = says(&said, "interrupted after");
    assert!(kept.contains("check 1 of the history"), "{kept}");
    assert_eq!(document(&json)["verdict"], "indeterminate");
}

#[test]
fn a_watch_ends_with_what_it_showed() {
    let folder = tempfile::tempdir().unwrap();
    let json = folder.path().join("watch.json");
    let said = interrupted(
        &[
            "watch",
            "--every",
            "2",
            "--speed",
            "1",
            "--json",
            json.to_str().unwrap(),
        ],
        "cycle",
        "-TERM",
    );
    says(&said, "interrupted after");
    assert!(document(&json)["shown"].is_string());
}

#[test]
fn an_interrupted_calibration_writes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let head = folder.path().join("head.toml");
    let said = interrupted(
        &[
            "calibrate",
            "--target",
            small_target(),
            "--link",
            "sim",
            "-o",
            head.to_str().unwrap(),
        ],
        "head moves to",
        "-INT",
    );
    says(&said, "no head is written");
    assert!(!head.exists());
}

#[test]
fn a_scan_without_a_session_does_not_name_a_folder_that_is_gone() {
    let said = interrupted(
        &["scan", "--views", "21x2", "--speed", "max"],
        "of 42 views",
        "-INT",
    );
    let kept = says(&said, "interrupted after");
    assert!(
        kept.contains("--session") && !kept.contains("flankscope_"),
        "{kept}"
    );
}

#[test]
fn a_second_signal_ends_at_once() {
    let running = Running::until(&["inspect", "--speed", "1"], "(view 1 of");
    let folders = running.folders();
    running.signal("-INT");
    let mut said = running.said;
    let heard = said.by_ref().map(Result::unwrap);
    assert!(heard.take(3).any(|line| line.contains("stopping")));
    let running = Running { said, ..running };
    running.signal("-INT");
    let (code, said) = running.ended(folders);
    assert_eq!(code, INTERRUPTED, "{said:?}");
    says(&said, "at once");
}
