//! States the commit in `--version`, so that a plant can say which program it runs; outside a repository the release alone.

use std::process::Command;

fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| text.trim().to_owned())
}

fn main() {
    let release = env!("CARGO_PKG_VERSION");
    let version = git(&["rev-parse", "--short=10", "HEAD"]).map_or_else(
        || release.to_owned(),
        |commit| format!("{release} ({commit})"),
    );
    println!("cargo::rustc-env=FLANKSCOPE_VERSION={version}");
    println!("cargo::rerun-if-changed=build.rs");
    // What moves with a commit: HEAD, and the branch that it names.
    let branch = git(&["symbolic-ref", "-q", "HEAD"]);
    for name in branch
        .iter()
        .map(String::as_str)
        .chain(["HEAD", "packed-refs"])
    {
        let path = git(&["rev-parse", "--git-path", name]);
        if let Some(path) = path.filter(|path| std::path::Path::new(path).exists()) {
            println!("cargo::rerun-if-changed={path}");
        }
    }
}
