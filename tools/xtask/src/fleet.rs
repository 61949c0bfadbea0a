//! The fleet's program with its features, a workspace of its own: formatted, linted, tested beside other people's readers of its files.

use std::path::Path;
use std::process::Command;

use flankscope_test_requisites::{LAKE_READERS, ballista};

use crate::python::environment;
use crate::{cargo, run, target};

/// Features that are tested in any case, and all where Ballista's programs are installed: without them its client need not be built.
const FEATURES: &str = "s3,serve";
const WITH_CLUSTER: &str = "s3,serve,cluster";

/// The workspace.
pub const FLEET: &str = "host/fleet";

/// Its checks; `all`: the long ones, too, and none may be missed.
pub fn run_all(root: &Path, all: bool) -> Result<(), String> {
    readers(root)?;
    let features = if ballista().is_some() {
        WITH_CLUSTER
    } else {
        FEATURES
    };
    let command = |arguments: &[&str]| {
        let mut command = cargo(arguments);
        // Built once for the workspace, not in a folder of its own.
        command
            .current_dir(root.join(FLEET))
            .env("CARGO_TARGET_DIR", target().join("fleet"));
        command
    };
    lean(command(&["tree", "--locked", "--prefix", "none"]))?;
    run(command(&["fmt", "--check"]))?;
    run(command(&[
        "clippy",
        "--all-targets",
        "--features",
        features,
        "--locked",
        "--",
        "-D",
        "warnings",
    ]))?;
    let mut test = command(&["test", "--features", features, "--locked"]);
    if all {
        test.env("FLANKSCOPE_TEST_ALL", "1");
    }
    run(test)
}

/// Whether `ship`, `verify` and `compact` are still built without the engine of `query`, which takes four times as long as all else together.
fn lean(mut tree: Command) -> Result<(), String> {
    let tree = tree
        .output()
        .map_err(|error| format!("cargo tree: {error}"))?;
    let crates = String::from_utf8_lossy(&tree.stdout);
    let engine = ["datafusion", "arrow"];
    let of_engine = |line: &&str| engine.iter().any(|name| line.starts_with(name));
    match (tree.status.success(), crates.lines().find(of_engine)) {
        (true, None) => Ok(()),
        (true, Some(one)) => Err(format!("{FLEET} without features links {one}")),
        (false, _) => Err(String::from_utf8_lossy(&tree.stderr).into()),
    }
}

/// Python with other people's readers of Parquet, fetched by pip.
fn readers(root: &Path) -> Result<(), String> {
    if root.join(LAKE_READERS).is_file() {
        return Ok(());
    }
    let python = environment(&root.join("target/lake-readers"))?;
    let mut pip = Command::new(&python);
    pip.args(["-m", "pip", "install", "--quiet", "--no-deps", "-r"])
        .arg(root.join("tools/peers/lake-readers.txt"));
    run(pip)
}
