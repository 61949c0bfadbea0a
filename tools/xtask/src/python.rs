//! The Python package: installed as a user does it, tested against others, its examples run, its types held against it.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::{run, target};

/// Installs `host/python` into an environment of its own and runs what it has. pip fetches what it builds with and compares with.
pub fn run_all(root: &Path) -> Result<(), String> {
    let python = environment(&target().join("python-package"))?;
    let package = root.join("host/python");
    let command = |arguments: &[&str]| {
        let mut command = Command::new(&python);
        command.current_dir(&package).args(arguments);
        command
    };
    let mut install = command(&["-m", "pip", "install", "--quiet", ".[test,view3d]"]);
    // With the checks of a development build, which is also the sooner built one.
    install.env("MATURIN_PEP517_ARGS", "--profile dev");
    run(install)?;
    run(command(&["-m", "unittest", "discover", "tests"]))?;
    run(command(&["examples/worn_block.py"]))?;
    // What the types promise is what is there, and the examples keep to them.
    let stubs = [
        "-m",
        "mypy.stubtest",
        "flankscope",
        "--allowlist",
        "tests/stubtest.txt",
    ];
    run(command(&stubs))?;
    run(command(&["-m", "mypy", "--strict", "examples"]))
}

/// The Python of an environment in this folder, which is made if it is not there.
///
/// # Errors
/// It cannot be made.
pub fn environment(folder: &Path) -> Result<PathBuf, String> {
    let python = folder.join("bin/python");
    if !python.is_file() {
        let mut venv = Command::new("python3");
        venv.args(["-m", "venv"]).arg(folder);
        run(venv)?;
    }
    Ok(python)
}

/// Whether Python can make environments here.
pub fn is_there() -> bool {
    let asked = Command::new("python3")
        .args(["-c", "import ensurepip, venv"])
        .output();
    asked.is_ok_and(|output| output.status.success())
}
