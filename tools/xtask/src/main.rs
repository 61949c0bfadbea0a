//! `cargo xtask`: every check and chore of the repository; [`HELP`] lists them.

mod bench;
mod circles;
mod deps;
mod elf;
mod firmware;
mod fleet;
mod licences;
mod light;
mod pages;
mod prerequisites;
mod python;
mod scan_study;
mod tests;

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

const HELP: &str = "\
cargo xtask COMMAND

  test [--all]           every test that this machine can run, and the arrows between the rooms; says what it could not run
                         and how to get it; --all: fails instead, and runs the long campaigns
  deps                   the arrows between the rooms: who may depend on whom; licences and sources of other people's crates
  python                 the Python package: installed by pip into an environment below target, its tests, its examples, its types
  fleet [--all]          the fleet's program and its questions, a workspace of its own: rustfmt, clippy, its tests; other readers
                         of Parquet and a server that speaks S3 by pip in an environment below target; --all: 200 kills, not 60
  lint                   rustfmt and clippy, warnings are errors
  doc                    documentation, warnings are errors
  firmware               every board image, with its budgets
  qemu                   a check through the controller's image in an emulator: same verdict as in-process, and its timing
  demo                   the README's first command, as a newcomer runs it
  bench [--peers VENV]   our figures beside other tools', on the same data in one run (BENCHMARK.md)
  bench --instructions   instructions of every stage of a check, counted by valgrind; fails where one changed by more than 3 %
  light [VENV]           the bench's light beside that of another renderer (Mitsuba), which renders the die anew: 5 minutes;
                         without VENV its packages go into an environment of their own below target
  bench --checks N       N in-situ checks of one tooth: how long the press waits after the last exposure
  study --why TEXT [--blocks N --captures N --only TEXT --head NAME --surface KIND --patterns SET --seed S]
                         how often the verdict is right, on the bench: tables and plots in docs/study, of bare steel and of
                         another head in folders of their own there (--surface ground, polished, oiled; --head 10mm, or a file)
  study resolution|families|press --why TEXT [--blocks N --captures N --seed S]
                         the smallest openings that are seen (docs/study/resolution.md); how often dies of families drawn at
                         random are passed, N heads and N dies before each (docs/study/families.md); how often dies whose teeth all
                         wear are judged right (docs/study/press.md). Of any of them: what is drawn follows
                         from the commit, a tree with changes is refused, every run is appended to docs/study/log.csv
  study --scan           what a scan keeps of the die's form by either method, five seeds: docs/study/scan.md
  pages [--release]      how many commits of their code the pages with figures lack; --release: fails where these are too many
  campaign [--mutants N | --seconds S | --kills N] [--seed S]
                         mutants of every file that the instrument reads, 100 000 unless said otherwise; or kills of a check
                         in each of its phases
  deny                   advisories, licences and sources of what is linked, by cargo-deny and deny.toml; needs the internet
  sbom                   what each crate is made of, transitively: CycloneDX files in target/sbom, by cargo-cyclonedx
  ci                     all of it, in the order of .ci/run
";

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let result = match words.as_slice() {
        ["test"] => test(false),
        ["test", "--all"] => test(true),
        ["deps"] => dependencies(&root()),
        ["python"] => python::run_all(&root()),
        ["fleet"] => fleet::run_all(&root(), false),
        ["fleet", "--all"] => fleet::run_all(&root(), true),
        ["lint"] => lint(),
        ["doc"] => doc(),
        ["firmware"] => firmware::build(&root()),
        ["qemu"] => firmware::qemu(&root()),
        ["bench"] => bench::run(&root(), None),
        ["bench", "--instructions"] => bench::instructions(&root()),
        ["bench", "--checks", count] => match count.parse() {
            Ok(count) => bench::checks(&root(), count),
            Err(_) => Err(format!("--checks {count}: a number is needed")),
        },
        ["bench", "--peers", environment] => bench::run(&root(), Some(environment)),
        ["study", "--scan"] => clean_commit().and_then(|commit| scan_study::run(&root(), &commit)),
        ["study", rest @ ..] => study(rest),
        ["campaign", rest @ ..] => campaign(rest),
        ["light"] => light::run(&root(), None),
        ["light", environment] => light::run(&root(), Some(environment)),
        ["pages"] => pages::check(&root(), false),
        ["pages", "--release"] => pages::check(&root(), true),
        ["deny"] => deny(),
        ["sbom"] => sbom(&root()),
        ["demo"] => demo(),
        ["ci"] => ci(),
        [] | ["help" | "--help" | "-h"] => {
            print!("{HELP}");
            Ok(())
        }
        other => Err(format!("no command \"{}\"\n\n{HELP}", other.join(" "))),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("xtask: {error}");
            ExitCode::FAILURE
        }
    }
}

/// The workspace root: two folders above this crate.
fn root() -> PathBuf {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    here.ancestors().nth(2).unwrap_or(here).to_path_buf()
}

/// The crate behind the Python package.
const PYTHON: &str = "host/python";

/// The test whose locks are a scheduler's instead of the system's, as no other is built.
const INTERLEAVINGS: &[&str] = &[
    "-p",
    "flankscope-sim",
    "--features",
    "shuttle",
    "--test",
    "interleavings",
];

/// What the workspace is tested with.
const FEATURES: &str = "flankscope/parquet,flankscope-plant/mqtt,flankscope-plant/opcua,flankscope-plant/parquet,flankscope-plant/tls";

/// The workspaces with programs that are installed or flashed.
const SHIPPED: [&str; 5] = [
    ".",
    fleet::FLEET,
    PYTHON,
    "firmware/mps2-an386",
    "firmware/nucleo-h743zi",
];

/// Where cargo builds.
fn target() -> PathBuf {
    std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), PathBuf::from)
}

fn test(all: bool) -> Result<(), String> {
    let missing = prerequisites::missing(&root());
    for item in &missing {
        eprintln!(
            "not run here: {} — needs {}; get it: {}",
            item.what, item.needs, item.how
        );
    }
    if all && !missing.is_empty() {
        return Err(format!(
            "{} group(s) of tests cannot run on this machine",
            missing.len()
        ));
    }
    // The one does not keep the other back: who mends wants to know of both.
    let mut tests = tests::run_all(&root(), all);
    if all {
        tests = tests.and(deployment());
        tests = tests.and(run(self::cargo(&[&["test"][..], INTERLEAVINGS].concat())));
        tests = tests.and(python::run_all(&root()));
    }
    let arrows = arrows(&root());
    eprintln!("\nsummary");
    let state = |result: &Result<(), String>| match result {
        Ok(()) => "passed",
        Err(_) => "FAILED",
    };
    eprintln!("  tests                      {}", state(&tests));
    eprintln!("  arrows between the rooms   {}", state(&arrows));
    match missing.len() {
        0 => eprintln!("  not run                    nothing"),
        count => eprintln!("  not run                    {count} group(s), listed at the top"),
    }
    if !all {
        eprintln!(
            "  --all adds                 three times the kills (700), drawn flanks (10 000), \
             twice the seeds, 16 damaged dies instead of 6; three times the shapes of damage, surfaces and unmodelled errors; uneven \
             lenses, dies of other teeth or put down turned by one, a study in small, README and docs/hardware.md step by \
             step, a calibration and a check by it, one from other people's board; smoother steel lit in passes, a rack; \
             interleavings of the simulated controller's threads; a deployment without a bench; the Python package; and fails where something cannot run"
        );
    }
    match (tests, arrows) {
        (Err(tests), Err(arrows)) => Err(format!("{tests}; {arrows}")),
        (tests, arrows) => tests.and(arrows),
    }
}

/// A build for a press has no bench.
const DEPLOYMENT: &[&str] = &["-p", "flankscope", "--no-default-features", "--bins"];

/// Tests of the program that a press gets. Of its libraries only those are built anew whose features differ.
fn deployment() -> Result<(), String> {
    run(cargo(&[&["test"][..], DEPLOYMENT].concat()))
}

/// What is built beside the default: Parquet, the plant's protocols, and the GigE camera where its library is. The same in every
/// command, so that nothing is built twice.
fn features() -> &'static [&'static str] {
    match flankscope_test_requisites::has_aravis() {
        true => &["--features", FEATURES, "--features", "flankscope/aravis"],
        false => &["--features", FEATURES],
    }
}

fn lint() -> Result<(), String> {
    run(cargo(&["fmt", "--all", "--check"]))?;
    // The images are workspaces of their own, and so is the module for Python.
    for other in [
        "firmware/mps2-an386",
        "firmware/stm32-board",
        "firmware/nucleo-h743zi",
        "firmware/netduinoplus2-f405",
        PYTHON,
    ] {
        let mut fmt = cargo(&["fmt", "--check"]);
        fmt.current_dir(root().join(other));
        run(fmt)?;
    }
    let mut clippy = cargo(&[
        "clippy",
        "--all-targets",
        "--locked",
        "--",
        "-D",
        "warnings",
    ]);
    clippy.current_dir(root().join(PYTHON));
    run(clippy)?;
    let mut clippy = cargo(&["clippy", "--workspace", "--all-targets"]);
    clippy.args(features()).args(["--", "-D", "warnings"]);
    run(clippy)?;
    // Code that only a bench or a scheduler uses would be a warning here.
    for built_otherwise in [DEPLOYMENT, INTERLEAVINGS] {
        run(cargo(
            &[&["clippy"], built_otherwise, &["--", "-D", "warnings"]].concat(),
        ))?;
    }
    Ok(())
}

fn doc() -> Result<(), String> {
    let mut cargo = cargo(&["doc", "--workspace", "--no-deps"]);
    cargo.args(features());
    cargo.env("RUSTDOCFLAGS", "-D warnings");
    run(cargo)
}

fn demo() -> Result<(), String> {
    run(cargo(&["run", "--release", "--", "inspect"]))
}

/// The folder of the workspace's programs in the profile of the tests, as the tests build them: after those nothing is left to build.
fn test_programs() -> Result<PathBuf, String> {
    let mut build = cargo(&["build", "--workspace", "--bins"]);
    build.args(features());
    run(build)?;
    Ok(target().join("debug"))
}

/// With the checks of the test profile in both programs: an overflow is a finding.
fn campaign(rest: &[&str]) -> Result<(), String> {
    let programs = test_programs()?;
    let mut campaign = Command::new(programs.join("flankscope-campaign"));
    let program = programs.join("flankscope");
    campaign
        .current_dir(root())
        .arg("--program")
        .arg(program)
        .args(rest);
    run(campaign)
}

fn deny() -> Result<(), String> {
    run(cargo(&["deny", "check"])).map_err(|error| {
        format!("{error}; cargo-deny comes with `cargo install --locked cargo-deny`, its advisories from the RustSec database")
    })
}

/// What every crate is made of. The tool writes beside each manifest; what it wrote is moved below target.
fn sbom(root: &Path) -> Result<(), String> {
    let folder = target().join("sbom");
    let shown = |error: std::io::Error| format!("{}: {error}", folder.display());
    std::fs::create_dir_all(&folder).map_err(shown)?;
    for room in SHIPPED {
        let mut cyclonedx = cargo(&["cyclonedx", "--format", "json", "--all-features"]);
        cyclonedx.current_dir(root.join(room));
        run(cyclonedx).map_err(|error| {
            format!("{error}; it comes with `cargo install --locked cargo-cyclonedx`")
        })?;
    }
    for room in deps::crates(root)? {
        for entry in std::fs::read_dir(root.join(room)).map_err(shown)?.flatten() {
            let name = entry.file_name();
            if name.to_string_lossy().ends_with(".cdx.json") {
                std::fs::rename(entry.path(), folder.join(name)).map_err(shown)?;
            }
        }
    }
    eprintln!("bills of materials in {}", folder.display());
    Ok(())
}

fn study(rest: &[&str]) -> Result<(), String> {
    let given = |option| rest.iter().skip_while(|word| **word != option).nth(1);
    let mut out = "docs/study".to_owned();
    let surface = given("--surface").filter(|word| **word != "sprayed");
    for other in given("--head").into_iter().chain(surface) {
        let name = Path::new(other).file_stem().unwrap_or_default();
        out = format!("{out}/{}", name.to_string_lossy());
    }
    let commit = clean_commit()?;
    let kept = target().join("study");
    let study = [
        "run",
        "--release",
        "-p",
        "flankscope-study",
        "--",
        "--out",
        &out,
        "--commit",
        &commit,
        "--log",
        "docs/study/log.csv",
        "--keep",
        &kept.to_string_lossy(),
    ];
    run(cargo(&[&study[..], rest].concat()))
}

/// The commit that a study's page names, and its draws follow from: that of sources without changes.
fn clean_commit() -> Result<String, String> {
    let commit = commit();
    match commit.len() {
        40 => Ok(commit),
        _ => Err(format!(
            "a study names the commit that it ran on; here is \"{commit}\": commit first"
        )),
    }
}

/// The commit that is checked out, and whether the sources differ from it.
fn commit() -> String {
    let git = |arguments: &[&str]| git(&root(), arguments);
    let changed = git(&["status", "--porcelain", "--untracked-files=no", ":!docs"]);
    match (git(&["rev-parse", "HEAD"]), changed) {
        (Ok(commit), Ok(changed)) if changed.is_empty() => commit,
        (Ok(commit), _) => format!("{commit} with changes"),
        (Err(_), _) => "unknown".into(),
    }
}

/// What git prints, without the spaces around it.
fn git(root: &Path, arguments: &[&str]) -> Result<String, String> {
    let output = Command::new("git")
        .args(arguments)
        .current_dir(root)
        .output()
        .map_err(|error| format!("git: {error}"))?;
    let printed = match output.status.success() {
        true => Ok(&output.stdout),
        false => Err(&output.stderr),
    };
    let text = |bytes: &Vec<u8>| String::from_utf8_lossy(bytes).trim().to_owned();
    printed.map(text).map_err(text)
}

fn ci() -> Result<(), String> {
    firmware::build(&root())?;
    test(true)?;
    bench::instructions(&root())?;
    lint()?;
    doc()?;
    dependencies(&root())?;
    pages::check(&root(), false)?;
    campaign(&["--seconds", "60"])?;
    firmware::qemu(&root())
}

fn cargo(arguments: &[&str]) -> Command {
    let mut command = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    command.args(arguments).current_dir(root());
    command
}

fn run(mut command: Command) -> Result<(), String> {
    eprintln!("$ {command:?}");
    match command.status() {
        Ok(status) if status.success() => Ok(()),
        Ok(status) => Err(format!("{command:?} ended with {status}")),
        Err(error) => Err(format!("{command:?} could not start: {error}")),
    }
}

/// The arrows between the crates, and within them.
fn arrows(root: &Path) -> Result<(), String> {
    deps::check(root)?;
    circles::check(root, &deps::crates(root)?)
}

/// What may be linked: the arrows, then licences and sources of other people's crates.
fn dependencies(root: &Path) -> Result<(), String> {
    arrows(root)?;
    licences::check(root)
}
