//! Files that many tests read: made once for each build of the program, and found again by the next run.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::Duration;

use crate::{flankscope, run};

/// File in a fixture's folder that says that all others are there.
const COMPLETE: &str = "complete";
/// Fixtures of other builds are removed when they are older than this: a run of the tests may still read them.
const KEPT: Duration = Duration::from_secs(24 * 3600);

/// Folder with files that `make` writes. The first test that asks for a name makes it, in whichever process; all others wait.
/// What depends on the station's key ([`crate::state`]) cannot be a fixture, because every process has a key of its own.
///
/// # Panics
/// The folder cannot be made; the message names the fixture.
#[must_use]
pub fn fixture(name: &str, make: impl FnOnce(&Path)) -> PathBuf {
    let folder = store().join(name);
    let complete = folder.join(COMPLETE);
    if complete.exists() {
        return folder;
    }
    let fails =
        |what: &str, error: std::io::Error| -> ! { panic!("fixture {name}: {what}: {error}") };
    let lock = File::create(store().join(format!("{name}.lock")));
    let lock = lock.unwrap_or_else(|error| fails("its lock", error));
    lock.lock().unwrap_or_else(|error| fails("its lock", error));
    if !complete.exists() {
        eprintln!("fixture {name} is made");
        let _left_by_a_killed_process = std::fs::remove_dir_all(&folder);
        std::fs::create_dir(&folder).unwrap_or_else(|error| fails("its folder", error));
        make(&folder);
        std::fs::write(&complete, "").unwrap_or_else(|error| fails("its last file", error));
    }
    folder
}

/// The demo tool with the small head (`tools/bench/heads/small.toml`): a check of one of its teeth takes a tenth of the time. Not to
/// be written to; [`write_small_tool`] makes a copy that may be.
#[must_use]
pub fn small_tool() -> &'static str {
    static TOOL: OnceLock<String> = OnceLock::new();
    TOOL.get_or_init(|| {
        let folder = fixture("small-tool", write_small_tool);
        folder.to_str().expect("UTF-8").to_owned()
    })
}

/// The demo's calibration target for the small head. Not to be written to.
#[must_use]
pub fn small_target() -> &'static str {
    static TARGET: OnceLock<String> = OnceLock::new();
    TARGET.get_or_init(|| {
        let folder = fixture("small-target", |folder| {
            write_demo("demo-target", "small", folder)
        });
        folder.to_str().expect("UTF-8").to_owned()
    })
}

/// Writes the demo tool with the small head into a folder.
///
/// # Panics
/// It cannot be written.
pub fn write_small_tool(folder: &Path) {
    write_demo("demo-tool", "small", folder);
}

/// Writes the demo tool or target of a head.
pub(crate) fn write_demo(what: &str, head: &str, folder: &Path) {
    let mut order = flankscope();
    order.args(["bench", what, "--head", head, "--out"]);
    let written = run(order.arg(folder));
    assert_eq!(written.code, 0, "{}", written.stderr);
}

/// Folder of the fixtures of this build of the program, below its own folder.
fn store() -> &'static Path {
    static STORE: OnceLock<PathBuf> = OnceLock::new();
    STORE.get_or_init(|| {
        let program = PathBuf::from(flankscope().get_program());
        let all = program.with_file_name("fixtures");
        let current = all.join(hash(&program));
        if !current.exists() {
            for entry in std::fs::read_dir(&all).into_iter().flatten().flatten() {
                let modified = entry.metadata().and_then(|data| data.modified()).ok();
                if modified.is_some_and(|at| at.elapsed().is_ok_and(|age| age > KEPT)) {
                    let _another_process_may_do_the_same = std::fs::remove_dir_all(entry.path());
                }
            }
        }
        let made = std::fs::create_dir_all(&current);
        assert!(made.is_ok(), "fixtures in {}: {made:?}", current.display());
        current
    })
}

/// BLAKE3 of a file, the first 16 hexadecimal digits.
fn hash(path: &Path) -> String {
    let read = || -> std::io::Result<String> {
        let mut hasher = blake3::Hasher::new();
        let (mut file, mut buffer) = (File::open(path)?, vec![0; 1 << 20]);
        loop {
            match file.read(&mut buffer)? {
                0 => return Ok(hasher.finalize().to_hex()[..16].to_owned()),
                count => hasher.update(&buffer[..count]),
            };
        }
    };
    read().unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}
