//! What another user of the same computer can do to a check: nothing.

use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::Path;
use std::process::Command;

use flankscope_tests::{flankscope, run};

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
    let made = flankscope()
        .args(["bench", "demo-tool", "--out"])
        .arg(&tool)
        .status();
    assert!(made.unwrap().success());
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
