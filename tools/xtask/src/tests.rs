//! Every test of the workspace: the programs that hold them, side by side.
//!
//! Cargo runs one test program after the other, and each ends with its slowest test alone; most machines have a core to spare
//! then. The longest of the last run come first, so that none is left over at the end.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::RecvTimeoutError;
use std::sync::{Mutex, MutexGuard};
use std::time::{Duration, Instant};

use cargo_metadata::{Message, TargetKind};

use crate::{cargo, features, run, target};

/// Where the last run's times lie, in the build's folder.
const TIMES: &str = "test-times.json";
/// The program that tests from end to end start, freshly built (`flankscope_tests::flankscope`).
const PROGRAM: &str = "FLANKSCOPE_PROGRAM";

/// Interval between two lines of progress.
const NEWS: Duration = Duration::from_secs(30);

/// Runs by itself, after the others: an emulator in real time, whose watchdog bites where the host does not let it run.
const ALONE: &str = "tests qemu";

/// The longest ones, the longest first: where none has run yet, one of them must not be left over at the end.
const LONGEST: [&str; 5] = [
    "tests check",
    "tests scan",
    "tests instrument",
    "tests record",
    "tools/study random_damage",
];

/// A program that holds tests.
struct TestProgram {
    /// Folder of its crate and its own name, as `host/cli history`.
    name: String,
    path: PathBuf,
    /// Its crate, where it runs.
    folder: PathBuf,
}

/// What a build made.
pub struct Built {
    tests: Vec<TestProgram>,
    /// The command line's program.
    program: Option<PathBuf>,
    /// Every crate's examples by name.
    pub examples: HashMap<String, PathBuf>,
}

/// Builds and runs all of them; `all`: nothing may be skipped.
///
/// # Errors
/// What does not build, and the programs in which a test failed.
pub fn run_all(root: &Path, all: bool) -> Result<(), String> {
    let built = build(root, None)?;
    let times_file = target().join(TIMES);
    let last: HashMap<String, f64> = std::fs::read(&times_file)
        .ok()
        .and_then(|text| serde_json::from_slice(&text).ok())
        .unwrap_or_default();
    let mut tests = built.tests;
    // What never ran may be long; on a new machine these are known to be.
    let expected = |test: &TestProgram| {
        let place = LONGEST.iter().position(|name| *name == test.name);
        let unknown = 1e6 - place.unwrap_or(LONGEST.len()) as f64;
        last.get(&test.name).copied().unwrap_or(unknown)
    };
    tests.sort_by(|a, b| expected(b).total_cmp(&expected(a)));

    let (alone, together): (Vec<_>, Vec<_>) =
        tests.into_iter().partition(|test| test.name == ALONE);

    let total = together.len() + alone.len();
    let progress = Mutex::new(Progress::new(total, last));
    let run_noted = |test: &TestProgram| {
        let mut command = Command::new(&test.path);
        command.current_dir(&test.folder);
        if let Some(program) = &built.program {
            command.env(PROGRAM, program);
        }
        if all {
            // Tests that look for something themselves fail instead of skipping.
            command.env("FLANKSCOPE_TEST_ALL", "1");
        }
        locked(&progress).begin(&test.name);
        let (passed, took, lines) = run_one(&test.name, command);
        locked(&progress).end(&test.name, passed, took, &lines);
    };
    let (stop, stopped) = std::sync::mpsc::channel::<()>();
    std::thread::scope(|scope| {
        let progress = &progress;
        scope.spawn(move || {
            while stopped.recv_timeout(NEWS) == Err(RecvTimeoutError::Timeout) {
                eprintln!("{}", locked(progress).news());
            }
        });
        on_every_core(&together, run_noted);
        alone.iter().for_each(run_noted);
        drop(stop);
    });
    let progress = progress.into_inner();
    let progress = progress.unwrap_or_else(|poisoned| poisoned.into_inner());
    let (times, failed) = (progress.times, progress.failed);
    let kept = serde_json::to_vec(&times).map_err(|error| error.to_string());
    // Only the order of the next run depends on it.
    let _best_effort = kept.map(|text| std::fs::write(times_file, text));

    let mut examples = cargo(&["test", "--workspace", "--doc", "--quiet"]);
    examples.args(features());
    let examples = run(examples);
    match (failed.is_empty(), examples) {
        (true, examples) => examples,
        (false, Ok(())) => Err(format!("tests failed in {}", failed.join(", "))),
        (false, Err(examples)) => Err(format!("tests failed in {}; {examples}", failed.join(", "))),
    }
}

/// Test programs that passed, failed, and run now.
struct Progress {
    begun: Instant,
    total: usize,
    /// Seconds that each program took in the last run.
    last: HashMap<String, f64>,
    running: Vec<(String, Instant)>,
    /// Seconds that each program took in this run.
    times: HashMap<String, f64>,
    failed: Vec<String>,
}

impl Progress {
    fn new(total: usize, last: HashMap<String, f64>) -> Self {
        Self {
            begun: Instant::now(),
            total,
            last,
            running: Vec::new(),
            times: HashMap::new(),
            failed: Vec::new(),
        }
    }

    fn begin(&mut self, name: &str) {
        self.running.push((name.to_owned(), Instant::now()));
    }

    /// Prints a program's lines, if it has any, and how far the whole run is.
    fn end(&mut self, name: &str, passed: bool, took: Duration, lines: &str) {
        self.running.retain(|(running, _)| running != name);
        self.times.insert(name.to_owned(), took.as_secs_f64());
        if !passed {
            self.failed.push(name.to_owned());
        }
        if !lines.is_empty() {
            // One call, so that no other program's lines come between.
            eprint!("{:3}/{} {lines}", self.times.len(), self.total);
        }
    }

    /// Line of progress: programs that passed and that run, and an estimate of the rest by the last run's times.
    fn news(&self) -> String {
        let now = Instant::now();
        let running: Vec<String> = self
            .running
            .iter()
            .map(|(name, begun)| format!("{name} ({} s)", (now - *begun).as_secs()))
            .collect();
        let last_s = |name: &String| self.last.get(name).copied();
        let done_s: f64 = self.times.keys().filter_map(last_s).sum();
        let all_s: f64 = self.last.values().sum();
        let elapsed_s = self.begun.elapsed().as_secs_f64();
        let left = match done_s > 0.0 {
            true => format!(
                "about {:.0} min left",
                (all_s / done_s - 1.0).max(0.0) * elapsed_s / 60.0
            ),
            false => "no earlier run to estimate the rest from".into(),
        };
        let failed = match self.failed.len() {
            0 => String::new(),
            count => format!("{count} failed, "),
        };
        format!(
            "--- {} of {} test programs passed, {failed}{left}; running: {}",
            self.times.len() - self.failed.len(),
            self.total,
            running.join(", ")
        )
    }
}

fn locked(progress: &Mutex<Progress>) -> MutexGuard<'_, Progress> {
    progress
        .lock()
        .unwrap_or_else(|poisoned| poisoned.into_inner())
}

/// Does `work` on every item, begun in their order, as many at a time as there are cores.
pub fn on_every_core<T: Sync>(items: &[T], work: impl Fn(&T) + Sync) {
    let next = AtomicUsize::new(0);
    let lanes = std::thread::available_parallelism().map_or(1, usize::from);
    std::thread::scope(|scope| {
        for _ in 0..lanes {
            scope.spawn(|| {
                while let Some(item) = items.get(next.fetch_add(1, Ordering::Relaxed)) {
                    work(item);
                }
            });
        }
    });
}

/// Runs a program to its end. Returns whether its tests passed, and lines to print: everything that it printed where a test failed,
/// else one line; none for a program without tests.
fn run_one(name: &str, mut command: Command) -> (bool, Duration, String) {
    let start = Instant::now();
    let output = command.stdin(Stdio::null()).output();
    let took = start.elapsed();
    let seconds = took.as_secs_f64();
    let output = match output {
        Ok(output) => output,
        Err(error) => return (false, took, format!("{name} could not start: {error}\n")),
    };
    let text = String::from_utf8_lossy(&output.stdout);
    let passed = output.status.success();
    let mut results = text
        .lines()
        .filter_map(|line| line.strip_prefix("test result: "));
    let counts = results
        .next_back()
        .unwrap_or(if passed { "ok." } else { "" });
    let counts = counts.split("; finished").next().unwrap_or(counts);
    if passed && counts.starts_with("ok. 0 passed; 0 failed; 0 ignored") {
        return (passed, took, String::new());
    }
    let mut lines = format!("{seconds:6.1} s  {name}: {counts}\n");
    if !passed {
        let errors = String::from_utf8_lossy(&output.stderr);
        lines += &format!("{text}{errors}{name} ended with {}\n", output.status);
    }
    (passed, took, lines)
}

/// Builds all tests and examples; `units`: each crate into so many code generation units, whatever the environment says.
///
/// # Errors
/// What does not build.
pub fn build(root: &Path, units: Option<u32>) -> Result<Built, String> {
    let mut cargo = cargo(&[
        "test",
        "--workspace",
        "--no-run",
        "--message-format=json-render-diagnostics",
    ]);
    cargo.args(features());
    if let Some(units) = units {
        cargo.env("CARGO_PROFILE_DEV_CODEGEN_UNITS", units.to_string());
        cargo.env("CARGO_INCREMENTAL", "0");
    }
    eprintln!("$ {cargo:?}");
    let output = cargo
        .stderr(Stdio::inherit())
        .output()
        .map_err(|error| format!("cargo could not start: {error}"))?;
    if !output.status.success() {
        return Err("the tests do not build".into());
    }
    let mut built = Built {
        tests: Vec::new(),
        program: None,
        examples: HashMap::new(),
    };
    for message in Message::parse_stream(&output.stdout[..]) {
        let message = message.map_err(|error| format!("cargo's answer: {error}"))?;
        let Message::CompilerArtifact(artifact) = message else {
            continue;
        };
        let Some(path) = artifact.executable.map(PathBuf::from) else {
            continue;
        };
        if !artifact.profile.test {
            if artifact.target.is_bin() && artifact.target.name == "flankscope" {
                built.program = Some(path);
            } else if artifact.target.is_example() {
                built.examples.insert(artifact.target.name, path);
            }
            continue;
        }
        let manifest = PathBuf::from(artifact.manifest_path);
        let folder = manifest.parent().unwrap_or(root).to_path_buf();
        let room = folder
            .strip_prefix(root)
            .unwrap_or(&folder)
            .display()
            .to_string();
        let kind = match artifact.target.kind.first() {
            Some(TargetKind::Test) => artifact.target.name,
            Some(TargetKind::Bin) => format!("{} (program)", artifact.target.name),
            _ => "(library)".into(),
        };
        built.tests.push(TestProgram {
            name: format!("{room} {kind}"),
            path,
            folder,
        });
    }
    Ok(built)
}
