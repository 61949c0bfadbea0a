//! What another user of the same computer can do to a check: nothing.

use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::Path;
use std::process::Command;

use flankscope_frames::{FrameSender, Overflow, SharedRoot};
use flankscope_tests::{
    flankscope, inspect, inspect_full, inspect_on, run, with_small_head, write_small_tool,
};
use serde_json::Value;

/// A temporary folder that everybody may write to, as `/tmp` is.
fn temporary() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let mode = std::fs::Permissions::from_mode(0o1777);
    std::fs::set_permissions(folder.path(), mode).unwrap();
    folder
}

/// The demo tool with limits of a millimetre and without a look at what was seen, wherever a run could look for one.
fn plant(tool: &Path, place: &str) -> String {
    format!(
        "mkdir -p {place} && cp -r {}/. {place} && chmod -R a+rwX {place}",
        tool.display()
    )
}

#[test]
fn a_tool_that_somebody_put_where_a_run_keeps_its_own_is_not_read() {
    let temporary = temporary();
    let planted = tempfile::tempdir().unwrap();
    let tool = planted.path().join("tool");
    write_small_tool(&tool);
    let file = tool.join("tool.toml");
    let text = std::fs::read_to_string(&file).unwrap();
    let lax = text
        .replace("limit_um = 50.0", "limit_um = 700.0")
        .replace("warn_um = 30.0", "warn_um = 700.0");
    assert_ne!(text, lax);
    std::fs::write(&file, lax).unwrap();
    // The attacker knows the number of the process before it starts: it is the shell's own.
    let uid = std::fs::metadata(temporary.path()).unwrap().uid();
    let usual = format!("$TMPDIR/flankscope-{uid}");
    let plants = [
        plant(&tool, "$TMPDIR/flankscope-run-$$/demo"),
        plant(&tool, &format!("{usual}/flankscope-run-$$/demo")),
        plant(&tool, &format!("{usual}/flankscope_$$_0_/demo")),
        format!("chmod 1777 {usual}"),
    ];
    let program = flankscope();
    let mut shell = Command::new("sh");
    shell
        .env_remove("XDG_RUNTIME_DIR")
        .env("TMPDIR", temporary.path())
        .args(["-c", &format!("{}; exec \"$0\" \"$@\"", plants.join("; "))])
        .arg(program.get_program())
        .args(["inspect", "--quiet", "--json", "-", "--speed", "max"])
        .args(["--wear", "40:left:80", "--teeth", "40"]);
    let found = run(&mut shell);
    assert_eq!(found.code, 1, "{}", found.stderr);
    assert_eq!(found.json["features"][0]["limit_um"], 50.0);
    assert!(
        found.stderr.contains("another folder is taken"),
        "who looks is told: {}",
        found.stderr
    );
    // And nothing of the run stays.
    let mine = std::fs::read_dir(temporary.path()).unwrap().flatten();
    let folders = mine.filter(|entry| {
        let name = entry.file_name().to_string_lossy().into_owned();
        name.starts_with(&format!("flankscope-{uid}-"))
    });
    let left: Vec<_> = folders
        .flat_map(|folder| std::fs::read_dir(folder.path()).unwrap().flatten())
        .map(|entry| entry.file_name())
        .collect();
    assert_eq!(left, [".lock"]);
}

#[test]
fn an_edited_baseline_turns_no_no_go_into_a_go() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("new.json");
    let file = path.to_str().unwrap();
    let new = inspect(&["--teeth", "40", "--record-baseline", file]);
    assert_eq!(new.code, 0, "{}", new.stderr);
    let worn = |why: &str, code: i32| {
        let check = inspect(&[
            "--teeth",
            "40",
            "--wear",
            "40:left:80",
            "--seed",
            "2",
            "--baseline",
            file,
        ]);
        assert_eq!(check.code, code, "{why}: {}", check.stderr);
        check
    };
    worn("as it was written", 1);
    let written: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    let edited = |change: &dyn Fn(&mut Value)| {
        let mut document = written.clone();
        change(&mut document);
        std::fs::write(&path, document.to_string()).unwrap();
    };
    let deeper = |document: &mut Value| {
        for flank in document["flanks"].as_array_mut().unwrap() {
            for cell in flank["field"]["wear_mm"].as_array_mut().unwrap() {
                if let Some(mm) = cell.as_f64() {
                    *cell = (mm + 0.08).into();
                }
            }
        }
    };
    edited(&deeper);
    let refused = worn("80 um deeper", 3);
    assert!(
        refused.stderr.contains("flankscope trust"),
        "{}",
        refused.stderr
    );
    edited(&|document| {
        deeper(document);
        document.as_object_mut().unwrap().remove("seal");
    });
    worn("without its seal", 3);
    // What somebody answers for may still be nonsense.
    for (why, change) in [
        (
            "is there twice",
            &(|document: &mut Value| {
                let flanks = document["flanks"].as_array_mut().unwrap();
                let first = flanks[0].clone();
                flanks.push(first);
            }) as &dyn Fn(&mut Value),
        ),
        ("variance -1", &|document: &mut Value| {
            document["flanks"][0]["field"]["variance_mm2"][0] = (-1.0).into();
        }),
    ] {
        edited(change);
        let trust = ["trust", file, "--quiet", "--name", "tester"];
        assert_eq!(run(flankscope().args(trust)).code, 0);
        let refused = worn(why, 3);
        assert!(refused.stderr.contains(why), "{}", refused.stderr);
    }
}

/// A head without a calibration claims nothing: it may be used, and every result says that nobody signed it.
#[test]
fn an_unsigned_head_says_so_in_every_result() {
    let folder = tempfile::tempdir().unwrap();
    let tool = folder.path().to_str().unwrap();
    write_small_tool(folder.path());
    let check = inspect(&["--tool", tool, "--link", "sim", "--teeth", "40"]);
    assert_eq!(check.code, 0, "{}", check.stderr);
    assert_eq!(check.json["head"]["seal"], "unsigned");
    // Only the built-in demo has the seal "built in", and its head is the full one.
    assert_eq!(
        inspect_full(&["--teeth", "40"]).json["head"]["seal"],
        "built in"
    );
}

/// A check whose bench stands still for some time from its first frame on.
fn stalled(ms: u64, station: &str) -> Value {
    use std::io::{BufRead, BufReader};
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("station.toml");
    std::fs::write(&file, station).unwrap();
    let mut check = flankscope();
    let mut check = with_small_head(
        check.args(["inspect", "--json", "-", "--teeth", "40", "--speed", "1"]),
        &["--link", "sim", "--station", file.to_str().unwrap()],
    )
    .stderr(std::process::Stdio::piped())
    .stdout(std::process::Stdio::piped())
    .spawn()
    .unwrap();
    let host = check.id();
    let mut said = BufReader::new(check.stderr.take().unwrap());
    // Said when the first frame is exposed.
    let mut line = String::new();
    while !line.contains("LED on") {
        line.clear();
        assert!(said.read_line(&mut line).unwrap() > 0, "the check began");
    }
    let children = std::fs::read_to_string(format!("/proc/{host}/task/{host}/children")).unwrap();
    let bench: i32 = children.split_whitespace().next().unwrap().parse().unwrap();
    let bench = rustix::process::Pid::from_raw(bench).unwrap();
    rustix::process::kill_process(bench, rustix::process::Signal::STOP).unwrap();
    std::thread::sleep(std::time::Duration::from_millis(ms));
    rustix::process::kill_process(bench, rustix::process::Signal::CONT).unwrap();
    std::thread::spawn(move || for _ in said.lines() {});
    let output = check.wait_with_output().unwrap();
    serde_json::from_slice(&output.stdout).unwrap()
}

/// The instrument's side stands still while frames are exposed, for less than the link takes for a loss; by its own clock nothing
/// was late. The host's clock says so in the result; from 2 s on views are captured again or the link is lost (below).
#[test]
fn a_stall_between_trigger_and_frame_is_evidence() {
    let frames = &stalled(1200, "")["frames"];
    assert!(frames["late_ms"].as_f64().unwrap() > 1000.0, "{frames}");
}

/// Nothing is answered for longer: the link counts as lost, whatever comes afterwards.
#[test]
fn a_controller_that_answers_nothing_is_given_up() {
    let found = stalled(6000, "");
    assert_eq!(found["verdict"], "indeterminate");
    let reason = found["reason"].as_str().unwrap();
    assert!(reason.contains("answers nothing for 2000 ms"), "{reason}");
}

/// A check of a bench with or without damage, stored.
fn stored(file: &Path, arguments: &[&str]) -> flankscope_tests::Run {
    let history = [
        "--teeth",
        "40",
        "--link",
        "sim",
        "--history",
        file.to_str().unwrap(),
    ];
    inspect(&[&history, arguments].concat())
}

/// A command that must refuse a history, and what it says.
fn refused(arguments: &[&str], file: &Path) -> String {
    let mut command = flankscope();
    command.args(arguments).arg(file);
    if arguments[0] != "history" {
        with_small_head(&mut command, &["--teeth", "40", "--link", "sim", "--quiet"]);
    }
    let run = run(&mut command);
    assert_eq!(run.code, 3, "{arguments:?}: {}", run.stderr);
    run.stderr
}

#[test]
fn a_no_go_is_shed_neither_by_a_planted_trigger_nor_by_a_copy() {
    let folder = tempfile::tempdir().unwrap();
    let [file, old] = ["press.db", "old.db"].map(|name| folder.path().join(name));
    assert_eq!(stored(&file, &[]).code, 0);
    std::fs::copy(&file, &old).unwrap();
    assert_eq!(stored(&file, &["--wear", "40:left:80"]).code, 1);
    let watch = ["watch", "--cycles", "1", "--speed", "max", "--history"];
    let inspect = ["inspect", "--speed", "max", "--history"];
    // The copy knows nothing of the no-go.
    for command in [&watch[..], &inspect, &["history"]] {
        let said = refused(command, &old);
        assert!(
            said.contains("an older copy") && said.contains("a no-go stands (demo die, check 2"),
            "{said}"
        );
    }
    // The true file shows it.
    let mut true_one = flankscope();
    true_one
        .args(watch)
        .arg(&file)
        .args(["--quiet", "--json", "-"]);
    let shown = run(with_small_head(&mut true_one, &["--teeth", "40"]));
    assert_eq!(
        (shown.code, &shown.json["shown"]),
        (1, &Value::from("no-go"))
    );
    // Whoever stores a go from now on is refused before, not believed afterwards.
    let plant = "DROP TRIGGER inspection_keeps_UPDATE; \
        CREATE TRIGGER e AFTER INSERT ON inspection WHEN new.verdict = 'no-go' BEGIN \
        UPDATE inspection SET verdict = 'go', document = replace(document, 'no-go', 'go'), reason = '' WHERE id = new.id; END";
    let connection = rusqlite::Connection::open(&file).unwrap();
    connection.execute_batch(plant).unwrap();
    drop(connection);
    for command in [&watch[..], &inspect, &["history"]] {
        let said = refused(command, &file);
        assert!(
            said.contains("trigger e on inspection is none of this program's")
                && said.contains("trigger inspection_keeps_UPDATE on inspection is missing"),
            "{said}"
        );
    }
    // A hard link would have a journal of its own.
    let hard = folder.path().join("hard.db");
    std::fs::hard_link(&file, &hard).unwrap();
    assert!(refused(&watch, &hard).contains("has 2 names"));
}

/// What ends never, or only when somebody comes, is refused at once by whoever reads it.
#[test]
fn pipes_and_devices_are_not_waited_for() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("pipe");
    let mode = rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR;
    rustix::fs::mknodat(rustix::fs::CWD, &pipe, rustix::fs::FileType::Fifo, mode, 0).unwrap();
    let cube = folder.path().join("cube.stl");
    std::fs::write(&cube, "solid\nendsolid\n").unwrap();
    let cube = cube.to_str().unwrap();
    for strange in [
        pipe.to_str().unwrap(),
        "/dev/zero",
        folder.path().to_str().unwrap(),
    ] {
        for arguments in [
            &[
                "deviation",
                "--cad",
                strange,
                "--cloud",
                cube,
                "-o",
                "/dev/null",
            ][..],
            &[
                "deviation",
                "--cad",
                cube,
                "--cloud",
                strange,
                "-o",
                "/dev/null",
            ],
            &["inspect", "--link", "sim", "--tool", strange],
            &["inspect", "--link", "sim", "--head", strange],
            &[
                "inspect",
                "--link",
                "sim",
                "--station",
                "x.toml",
                "--baseline",
                strange,
            ],
            &["inspect", "--link", "sim", "--baseline", strange],
            &["inspect", "--bench", strange],
            &["inspect", "--die-mesh", strange],
            &["history", strange],
            &["inspect", "--link", "sim", "--history", strange],
            &["trust", strange, "--name", "Ada"],
            &[
                "decode",
                "--images",
                strange,
                "--plan",
                strange,
                "--head",
                strange,
                "-o",
                "/dev/null",
            ],
        ] {
            let refused = run(flankscope().args(arguments));
            assert_eq!(refused.code, 3, "{arguments:?}: {}", refused.stderr);
        }
    }
}

/// Names that would paint a verdict, and cells that a spreadsheet would calculate.
#[test]
fn names_forge_nothing() {
    let folder = tempfile::tempdir().unwrap();
    write_small_tool(folder.path());
    let file = folder.path().join("tool.toml");
    let text = std::fs::read_to_string(&file).unwrap();
    for forged in ["die\\nGO: all is well", "die\\u001b[2K"] {
        let name = format!("name = \"{forged}\"");
        let written = text.replace("name = \"demo die\"", &name);
        assert_ne!(written, text);
        std::fs::write(&file, written).unwrap();
        let refused = inspect(&["--link", "sim", "--tool", folder.path().to_str().unwrap()]);
        assert_eq!(refused.code, 3);
        let said = &refused.stderr;
        assert!(
            said.contains("words on one line") && !said.contains('\x1b'),
            "{said:?}"
        );
    }
    // Who is at work is told by the system; what it says is shown, not obeyed.
    let history = folder.path().join("press.db");
    let mut command = flankscope();
    command
        .env("USER", "=Ada\r\x1b[32mGO")
        .args(["inspect", "--speed", "max", "--history"])
        .arg(&history);
    with_small_head(&mut command, &["--teeth", "40"]);
    let output = command.output().unwrap();
    assert_eq!(output.status.code(), Some(0));
    for stream in [&output.stdout, &output.stderr] {
        assert!(!stream.contains(&b'\x1b') && !stream.contains(&b'\r'));
    }
    let table = folder.path().join("table.csv");
    let exported = run(flankscope()
        .arg("history")
        .arg(&history)
        .args(["--quiet", "--csv"])
        .arg(&table));
    assert_eq!(exported.code, 0, "{}", exported.stderr);
    let table = std::fs::read_to_string(table).unwrap();
    assert!(table.contains(",'=Ada\\r\\u{1b}[32mGO,"), "{table}");
    let unnamed = run(flankscope()
        .arg("trust")
        .arg(&history)
        .args(["--name", "Ada\nGO"]));
    assert_eq!(unnamed.code, 3);
    assert!(unnamed.stderr.contains("one line"), "{}", unnamed.stderr);
}

#[test]
fn a_link_where_pages_go_is_not_followed() {
    let folder = tempfile::tempdir().unwrap();
    let elsewhere = tempfile::tempdir().unwrap();
    std::os::unix::fs::symlink(elsewhere.path(), folder.path().join("reports")).unwrap();
    let report = folder.path().to_str().unwrap();
    let refused = inspect(&["--link", "sim", "--teeth", "40", "--report", report]);
    assert_eq!(refused.code, 3, "{}", refused.stderr);
    assert!(
        refused.stderr.contains("it is a link"),
        "{}",
        refused.stderr
    );
    assert_eq!(std::fs::read_dir(elsewhere.path()).unwrap().count(), 0);
}

/// Frames that are lost, come twice or once too often, are of a session that never was or at times that cannot be, or were changed after
/// their checksum was made. They are no go whatever they show, and the reason is named; if only the first capture has them, the view is
/// captured again.
#[test]
fn a_camera_that_misbehaves_is_indeterminate_by_name() {
    // The first frame of a view, one amid it, and its last one, where it matters which.
    let table: [(&str, &[(u32, &str)]); 6] = [
        (
            "lose",
            &[
                (0, "missing, first the dark frame"),
                (13, "missing, first exposure 1, frequency 0, step 0"),
                (24, "only 24 of 25 frames came"),
            ],
        ),
        (
            "repeat",
            &[
                (0, "the dark frame came twice"),
                (13, "came twice"),
                (24, "missing, first the dark frame"),
            ],
        ),
        (
            "extra",
            &[
                (0, "no light, or frames lost step"),
                (13, "after the view's first, its trigger"),
                (24, "a frame beyond the plan"),
            ],
        ),
        ("foreign", &[(13, "a frame of session")]),
        ("timeless", &[(13, "was exposed for 0 us, commanded were")]),
        (
            "rewritten",
            &[(0, "missing, first the dark frame"), (13, "is corrupt")],
        ),
    ];
    for (kind, reasons) in table {
        // In the first view, so that the second capture meets the fault again.
        for &(frame, why) in reasons {
            let fault = format!("{kind}:{frame}");
            let lines = format!("[camera]\nframe_fault = \"{fault}\"\n");
            let found = inspect_on(&lines, &["--teeth", "40"]);
            let reason = found.json["reason"].as_str().unwrap_or_default();
            assert_eq!(found.code, 2, "{fault}: {reason} {}", found.stderr);
            assert_eq!(found.json["verdict"], "indeterminate", "{fault}");
            assert!(reason.contains(why), "{fault}: {reason}");
            assert_eq!(found.json["frames"]["recaptured_views"], 1, "{fault}");
        }
        // Once only: in the one view, or in the second of three. With a frame too many no view of the session is believed.
        let (frame, teeth, recaptured) = match kind {
            "extra" => (30, "12,40,68", 3),
            "lose" => (30, "12,40,68", 1),
            _ => (13, "40", 1),
        };
        let once = format!("{kind}:{frame}:once");
        let lines = format!("[camera]\nframe_fault = \"{once}\"\n");
        let found = inspect_on(&lines, &["--teeth", teeth]);
        let reason = &found.json["reason"];
        assert_eq!(found.code, 0, "{once}: {reason} {}", found.stderr);
        assert_eq!(
            found.json["frames"]["recaptured_views"], recaptured,
            "{once}"
        );
    }
}

/// Whoever else opens the shared memory of a running check publishes nothing there, and the check is what it is without.
#[test]
fn a_rival_camera_changes_no_check() {
    use std::io::{BufRead, BufReader};
    let runtime = tempfile::Builder::new()
        .prefix("r")
        .permissions(std::fs::Permissions::from_mode(0o700))
        .tempdir_in("/tmp")
        .unwrap();
    let mut command = flankscope();
    command.env("XDG_RUNTIME_DIR", runtime.path());
    command.args(["inspect", "--json", "-", "--speed", "1"]);
    let mut check = with_small_head(&mut command, &["--teeth", "40"])
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let mut said = BufReader::new(check.stderr.take().unwrap()).lines();
    // The camera is there from the first exposure on.
    let begun = said.by_ref().map_while(Result::ok);
    assert!(begun.into_iter().any(|line| line.contains("LED on")));
    std::thread::spawn(move || for _ in said {});
    // Of the run's folders, the one whose services have shared memory.
    let names = |folder: &Path| {
        let entries = std::fs::read_dir(folder).unwrap().flatten();
        let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
        names.collect::<Vec<String>>()
    };
    let folders = runtime.path().join("flankscope");
    let shared = names(Path::new("/dev/shm"));
    let mut roots = names(&folders);
    roots.retain(|root| root.starts_with("flankscope_"));
    roots.retain(|root| shared.iter().any(|segment| segment.starts_with(root)));
    assert_eq!(roots.len(), 1, "{roots:?}");
    for _ in 0..20 {
        let root = SharedRoot::of_owner(&folders.join(&roots[0])).unwrap();
        let refused = FrameSender::open(&root, Overflow::Drop).unwrap_err();
        let refused = refused.to_string();
        assert!(refused.contains("cannot publish frames"), "{refused}");
    }
    assert!(
        check.try_wait().unwrap().is_none(),
        "it came during the check"
    );
    let output = check.wait_with_output().unwrap();
    let found: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(found["verdict"], "go", "{}", found["reason"]);
    assert_eq!(found["frames"]["recaptured_views"], 0);
}
