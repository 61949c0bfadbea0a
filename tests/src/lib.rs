//! What the cross-crate tests share: the command under test and its answers.

pub mod die;
mod fixture;

use fixture::write_demo;
pub use fixture::{small_target, small_tool, write_small_tool};

use std::fs::{DirBuilder, File};
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};

use flankscope_foundation::date::Date;
use flankscope_gear_cad::{GearKind, GearSpec};
use flankscope_profilometry::HeadModel;
use flankscope_profilometry::head::CalibrationRecord;
use flankscope_test_requisites::{has_aravis, workspace};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use serde_json::Value;

/// A process that ends with its test.
#[derive(Debug)]
pub struct Killed(pub Child);

impl Drop for Killed {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The `flankscope` command, freshly built in this build's own profile.
///
/// # Panics
/// It cannot be built.
#[must_use]
pub fn flankscope() -> Command {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    let program = PROGRAM.get_or_init(|| {
        // `cargo xtask test` has built it.
        if let Some(built) = std::env::var_os("FLANKSCOPE_PROGRAM") {
            return built.into();
        }
        let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
        let mut build = Command::new(cargo);
        build.args(["build", "--quiet", "--offline", "--package", "flankscope"]);
        if has_aravis() {
            // As `cargo xtask test` builds it.
            build.args(["--features", "aravis"]);
        }
        if !cfg!(debug_assertions) {
            build.arg("--release");
        }
        let built = build.current_dir(workspace()).status();
        assert!(
            built.is_ok_and(|status| status.success()),
            "cannot build the flankscope command"
        );
        // This test runs from <target>/<profile>/deps.
        let here = std::env::current_exe().unwrap_or_default();
        here.ancestors()
            .nth(2)
            .unwrap_or(Path::new("."))
            .join("flankscope")
    });
    let mut command = Command::new(program);
    // The tests' own station.
    command.env("FLANKSCOPE_STATE", state());
    // Its words are the same on every machine.
    command.env("LC_ALL", "C");
    command
}

/// Where the station of this process's tests keeps its key and what it remembers, beside the program: what an earlier run
/// trusted is nothing to this one. The first use removes those of processes that have ended.
#[must_use]
pub fn state() -> PathBuf {
    static STATE: OnceLock<PathBuf> = OnceLock::new();
    let state = STATE.get_or_init(|| {
        const PREFIX: &str = "flankscope-state-";
        let here = std::env::current_exe().unwrap_or_default();
        let profile = here.ancestors().nth(2).unwrap_or(Path::new("."));
        let own = std::process::id();
        for entry in std::fs::read_dir(profile).into_iter().flatten().flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            let id = name.strip_prefix(PREFIX).and_then(|id| id.parse().ok());
            let over = |id: u32| id == own || !Path::new(&format!("/proc/{id}")).exists();
            if id.is_some_and(over) {
                let _another_process_may_do_the_same = std::fs::remove_dir_all(entry.path());
            }
        }
        profile.join(format!("{PREFIX}{own}"))
    });
    state.clone()
}

/// The demo die's drawing.
#[must_use]
pub fn demo_gear() -> GearSpec {
    let module_mm = 82.9 / 84.0;
    GearSpec {
        kind: GearKind::Internal,
        teeth: 84,
        module_mm,
        pressure_angle_rad: 20f64.to_radians(),
        tip_radius_mm: 41.45 - module_mm,
        root_radius_mm: 41.45 + 1.25 * module_mm,
        root_fillet_radius_mm: 0.0,
        turned_rad: 0.0,
        body_radius_mm: 88.5,
        height_mm: [0.0, 66.0],
    }
}

/// The demo tool's files with a small head that says it was calibrated at a press, and that passed its test today: what a real link
/// demands. Returns the folder as an argument.
///
/// # Panics
/// It cannot be written.
#[must_use]
pub fn press_tool(folder: &Path) -> String {
    write_small_tool(folder);
    let file = folder.join("head.toml");
    let mut head = HeadModel::load(&file).expect("the demo's head");
    let today = Date::today();
    let blake3 = head.geometry_blake3();
    head.calibration = Some(CalibrationRecord {
        date: today,
        expires: today.plus_days(30),
        target: "plates".into(),
        link: Some("/dev/ttyACM0".into()),
        simulated: Some(false),
        frames: ["camera", "projector", "stage"].map(Into::into).to_vec(),
        unit: "mm".into(),
        blake3: blake3.clone(),
        views: 12,
        dots: 900,
        dropped: 0,
        camera_rms_px: 0.05,
        projector_rms_px: 0.05,
        depth_sigma_um: 1.0,
        lateral_sigma_um: 1.0,
        farther_sigma_um: None,
        hold_out: None,
        without_field: None,
        board: None,
        second_projector: None,
        focus: None,
    });
    std::fs::write(&file, head.to_toml().expect("TOML")).expect("written");
    let test = folder.join("head.check.toml");
    let due = today.plus_days(7);
    let passed = format!(
        "date = \"{today}\"\ndue = \"{due}\"\ngeometry_blake3 = \"{blake3}\"\nplane_points = 1000\nflatness_um = 1.0\n\
         sphere_points = 1000\nprobing_form_um = 1.0\nprobing_size_um = 0.0\n[limits]\nflatness_um = 10.0\n\
         probing_form_um = 10.0\nprobing_size_um = 10.0\nevery_days = 7\n"
    );
    std::fs::write(&test, passed).expect("written");
    for file in [file, test] {
        let mut trust = flankscope();
        trust.arg("trust").arg(file);
        let trusted = run(trust.args(["--quiet", "--name", "tester"]));
        assert_eq!(trusted.code, 0, "{}", trusted.stderr);
    }
    folder.to_str().expect("UTF-8").to_owned()
}

/// A bench file with these lines, as the options that name it. It lies with the station's key, and goes with it.
///
/// # Panics
/// It cannot be written.
#[must_use]
pub fn bench(lines: &str) -> [String; 2] {
    static FILES: AtomicUsize = AtomicUsize::new(0);
    let folder = state();
    let made = DirBuilder::new()
        .recursive(true)
        .mode(0o700)
        .create(&folder);
    made.expect("the station's folder");
    let number = FILES.fetch_add(1, Ordering::Relaxed);
    let path = folder.join(format!("bench-{number}.toml"));
    std::fs::write(&path, lines).expect("written");
    ["--bench".into(), path.to_str().expect("UTF-8").to_owned()]
}

/// What a run of the command left behind.
#[derive(Debug)]
pub struct Run {
    /// Exit code.
    pub code: i32,
    /// The `--json -` document, null where there is none.
    pub json: Value,
    /// Standard error.
    pub stderr: String,
}

/// Adds the demo tool with the small head to a command, unless its arguments name another tool or head.
pub fn with_small_head<'a>(command: &'a mut Command, arguments: &[&str]) -> &'a mut Command {
    let names = |options: &[&str]| options.iter().any(|option| arguments.contains(option));
    if !names(&["--tool", "--head"]) {
        command.args(["--tool", small_tool()]);
        // A recording needs no link.
        if !names(&["--link", "--frames", "--clouds"]) {
            command.args(["--link", "sim"]);
        }
    }
    command.args(arguments)
}

/// Runs `flankscope inspect --quiet --json -` with more arguments, before the small head unless they name another, as fast as the
/// bench can.
///
/// # Panics
/// The command does not start or is killed.
#[must_use]
pub fn inspect(arguments: &[&str]) -> Run {
    inspect_by(|command| with_small_head(command, arguments), arguments)
}

/// Runs [`inspect`] before the built-in demo's head of 100 000 cores: for what only its optics can show.
///
/// # Panics
/// As [`inspect`].
#[must_use]
pub fn inspect_full(arguments: &[&str]) -> Run {
    inspect_by(|command| command.args(arguments), arguments)
}

/// Runs `inspect` with the arguments that `add` adds, at the bench's highest speed unless they name another.
fn inspect_by(add: impl FnOnce(&mut Command) -> &mut Command, arguments: &[&str]) -> Run {
    let mut command = flankscope();
    add(command.args(["inspect", "--quiet", "--json", "-"]));
    if !arguments.contains(&"--speed") {
        command.args(["--speed", "max"]);
    }
    run(&mut command)
}

/// As [`inspect`], on a bench with these lines in its file.
///
/// # Panics
/// As [`inspect`] and [`bench()`].
#[must_use]
pub fn inspect_on(lines: &str, arguments: &[&str]) -> Run {
    let [option, file] = bench(lines);
    inspect(&[&[&*option, &*file], arguments].concat())
}

/// Runs [`inspect_on`] before the built-in demo's head.
///
/// # Panics
/// As [`inspect_on`].
#[must_use]
pub fn inspect_full_on(lines: &str, arguments: &[&str]) -> Run {
    let [option, file] = bench(lines);
    inspect_full(&[&[&*option, &*file], arguments].concat())
}

/// Runs a command to its end.
///
/// # Panics
/// It does not start or is killed.
#[must_use]
pub fn run(command: &mut Command) -> Run {
    let Output {
        status,
        stdout,
        stderr,
    } = match command.output() {
        Ok(output) => output,
        Err(error) => panic!("{command:?}: {error}"),
    };
    let stderr = String::from_utf8_lossy(&stderr).into_owned();
    let Some(code) = status.code() else {
        panic!("{command:?} was killed: {stderr}")
    };
    Run {
        code,
        json: serde_json::from_slice(&stdout).unwrap_or(Value::Null),
        stderr,
    }
}

impl Run {
    /// The verdict of a flank, `None` if it is not in the document.
    #[must_use]
    pub fn flank(&self, tooth: u64, flank: &str) -> Option<&str> {
        let features = self.json["features"].as_array()?;
        let feature = features
            .iter()
            .find(|f| f["tooth"] == tooth && f["flank"] == flank)?;
        feature["verdict"].as_str()
    }

    /// Flanks whose verdict is not `go`, as `tooth:flank:verdict`.
    pub fn not_go(&self) -> Vec<String> {
        let features = self.json["features"]
            .as_array()
            .map_or(&[][..], Vec::as_slice);
        let word = |f: &Value, key: &str| f[key].as_str().unwrap_or_default().to_string();
        features
            .iter()
            .filter(|f| f["verdict"] != "go")
            .map(|f| format!("{}:{}:{}", f["tooth"], word(f, "flank"), word(f, "verdict")))
            .collect()
    }
}

/// The demo tool with a head of the bench (`small`, `20mm`) in `folder`, with limits around 30 µm and no uncertainty but noise, and with `more` lines in `[inspect]`;
/// returns the folder's name.
///
/// # Panics
/// It cannot be written.
#[must_use]
pub fn tool_of_noise_alone(folder: &Path, head: &str, more: &str) -> String {
    write_demo("demo-tool", head, folder);
    edit(&folder.join("tool.toml"), |text| {
        text.replace("chord_error_um = 0.2", "chord_error_um = 0.0")
            .replace("warn_um = 30.0", "warn_um = 20.0")
            .replace(
                "limit_um = 50.0",
                &format!("limit_um = 30.0\ncalibration_um = 0.0\n{more}"),
            )
    });
    folder.display().to_string()
}

/// The small head without its core map, whose points are blocks of pixels, in this folder; the file's name.
///
/// # Panics
/// It cannot be written.
#[must_use]
pub fn head_of_pixels(folder: &Path) -> String {
    let folder = folder.join("pixels");
    write_small_tool(&folder);
    let head = folder.join("head.toml");
    edit(&head, |text| {
        let (before, rest) = text
            .split_once("[cores]")
            .expect("the demo head's core map");
        let after = rest.split_once("\n[").map(|(_, after)| format!("[{after}"));
        format!("{before}{}", after.unwrap_or_default())
    });
    head.display().to_string()
}

/// Sets the calibration of a head's file to the first half of 2001.
///
/// # Panics
/// It cannot be read or written.
pub fn expire(head: &Path) {
    let line = |line: &str| match line.split(' ').next() {
        Some("date") => "date = \"2001-01-01\"\n".into(),
        Some("expires") => "expires = \"2001-06-30\"\n".into(),
        _ => format!("{line}\n"),
    };
    edit(head, |text| text.lines().map(line).collect());
}

fn edit(path: &Path, change: impl FnOnce(&str) -> String) {
    let edited = std::fs::read_to_string(path).and_then(|text| std::fs::write(path, change(&text)));
    assert!(edited.is_ok(), "{}: {edited:?}", path.display());
}

/// A new pseudo-terminal: its master, and the port at its other end.
///
/// # Panics
/// The system has none left.
#[must_use]
pub fn pseudo_terminal() -> (File, PathBuf) {
    let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
    grantpt(&master).unwrap();
    unlockpt(&master).unwrap();
    let name = ptsname(&master, Vec::new()).unwrap();
    (master.into(), PathBuf::from(name.to_str().unwrap()))
}
