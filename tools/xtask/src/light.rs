//! The bench's light beside that of another renderer, on the same scene.

use std::path::{Path, PathBuf};
use std::process::Command;

/// Renders the demo die by `tools/peers/light.py` and lets the bench's own test compare. Without an environment one is made below
/// `target`, and its packages are fetched.
pub fn run(root: &Path, environment: Option<&str>) -> Result<(), String> {
    let folder = root.join("target/light");
    let python = match environment {
        Some(given) => Path::new(given).join("bin/python"),
        None => fetched(root, &folder.join("environment"))?,
    };
    let tool = folder.join("tool");
    let mut demo = super::cargo(&[
        "run",
        "--release",
        "-q",
        "-p",
        "flankscope",
        "--",
        "bench",
        "demo-tool",
        "--out",
    ]);
    demo.arg(&tool);
    super::run(demo)?;
    let rendered = folder.join("rendered");
    let mut render = Command::new(python);
    render
        .arg(root.join("tools/peers/light.py"))
        .arg(tool.join("die.ply"))
        .arg(&rendered);
    super::run(render)?;
    let mut compare = super::cargo(&[
        "test",
        "-p",
        "flankscope-bench",
        "--test",
        "outside_light",
        "--",
        "--nocapture",
        "--test-threads=1",
    ]);
    compare.env("FLANKSCOPE_RENDERED", &rendered);
    super::run(compare)
}

/// Python with the packages of `tools/peers/light.txt`.
fn fetched(root: &Path, environment: &Path) -> Result<PathBuf, String> {
    let python = super::python::environment(environment)?;
    let mut fetch = Command::new(&python);
    fetch
        .args(["-m", "pip", "install", "-q", "-r"])
        .arg(root.join("tools/peers/light.txt"));
    super::run(fetch)?;
    Ok(python)
}
