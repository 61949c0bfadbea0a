//! What the cross-crate tests share: the command under test and its answers.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

use flankscope_gear_cad::{GearKind, GearSpec};
use flankscope_test_requisites::workspace;
use serde_json::Value;

/// The `flankscope` command, freshly built in this build's own profile.
///
/// # Panics
/// It cannot be built.
#[must_use]
pub fn flankscope() -> Command {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    let program = PROGRAM.get_or_init(|| {
        let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
        let mut build = Command::new(cargo);
        build.args(["build", "--quiet", "--offline", "--package", "flankscope"]);
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
    // The tests' own station: its key lies in the build folder.
    command.env("FLANKSCOPE_STATE", state());
    command
}

/// Where the tests' station keeps its key and what it remembers.
#[must_use]
pub fn state() -> PathBuf {
    let here = std::env::current_exe().unwrap_or_default();
    let profile = here.ancestors().nth(2).unwrap_or(Path::new("."));
    profile.join("flankscope-state")
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
        body_radius_mm: 88.5,
        height_mm: [0.0, 66.0],
    }
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

/// Runs `flankscope inspect --quiet --json -` with more arguments, as fast as the bench can.
///
/// # Panics
/// The command does not start or is killed.
#[must_use]
pub fn inspect(arguments: &[&str]) -> Run {
    let mut command = flankscope();
    command
        .args(["inspect", "--quiet", "--json", "-"])
        .args(arguments);
    if !arguments.contains(&"--speed") {
        command.args(["--speed", "max"]);
    }
    run(&mut command)
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
    #[must_use]
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
