//! Kills at random moments, three hundred where everything runs, leave nothing after the next start: no folder, no shared memory.
//!
//! The test starts itself: as an owner, which starts itself as a camera process that ends with it.

use std::io::Read;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use flankscope_frames::{FrameReceiver, FrameSender, Overflow, RunFolder, SharedRoot};
use flankscope_test_requisites::everything;
use rustix::process::{Signal, set_parent_process_death_signal};

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words[1..] {
        ["owner", base] => owner(Path::new(base)),
        ["camera", root] => camera(Path::new(root)),
        _ => kills_leave_nothing(if everything() { 300 } else { 100 }),
    }
}

fn owner(base: &Path) {
    loop {
        let Ok(root) = SharedRoot::create(base) else {
            continue;
        };
        let _receiver = FrameReceiver::create(&root);
        let scratch = RunFolder::create(base);
        if let Ok(scratch) = &scratch {
            let _ = std::fs::write(scratch.path().join("tool.toml"), "name = \"demo\"");
        }
        let mut child = Command::new(std::env::current_exe().unwrap())
            .arg("camera")
            .arg(root.path())
            .stdin(Stdio::piped())
            .spawn()
            .unwrap();
        std::thread::sleep(Duration::from_millis(2));
        drop(child.stdin.take());
        let _ = child.wait();
    }
}

fn camera(root: &Path) {
    set_parent_process_death_signal(Some(Signal::KILL)).unwrap();
    let Ok(root) = SharedRoot::of_owner(root) else {
        return;
    };
    let _sender = FrameSender::open(&root, Overflow::Drop);
    let _ = std::fs::write(root.path().join("beside.txt"), "of the camera process");
    let _ = std::io::stdin().read_to_end(&mut Vec::new());
}

/// Names in a folder that begin with a word.
fn names(folder: &Path, with: &str) -> Vec<String> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
    names.filter(|name| name.starts_with(with)).collect()
}

fn kills_leave_nothing(kills: usize) {
    let base = tempfile::Builder::new()
        .prefix("k")
        .tempdir_in("/tmp")
        .unwrap();
    let program = std::env::current_exe().unwrap();
    // Spread over the time that an owner needs for a whole round; what exactly is hit, chance decides.
    let mut state = u64::from(std::process::id()) | 1;
    let mut seen = std::collections::BTreeSet::new();
    let (mut litter, mut cut_short) = (0, 0);
    for _ in 0..kills {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        let mut child = Command::new(&program)
            .arg("owner")
            .arg(base.path())
            .stdin(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        std::thread::sleep(Duration::from_micros((state >> 33) % 25_000));
        child.kill().unwrap();
        child.wait().unwrap();
        let left = names(base.path(), "flankscope_");
        litter += left.len();
        cut_short += usize::from(!left.is_empty());
        seen.extend(left);
    }
    // With nothing left behind, nothing would have been tested.
    assert!(
        cut_short > kills / 20,
        "only {cut_short} kills left anything"
    );
    // The next start; a camera process that was killed with its owner needs a moment to be gone.
    let mut rest = Vec::new();
    for _ in 0..200 {
        drop(RunFolder::create(base.path()).unwrap());
        rest = names(base.path(), "flankscope_");
        if rest.is_empty() {
            break;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    assert_eq!(rest, Vec::<String>::new());
    let shared: Vec<String> = names(Path::new("/dev/shm"), "flankscope_")
        .into_iter()
        .filter(|name| seen.iter().any(|root| name.starts_with(root.as_str())))
        .collect();
    assert_eq!(shared, Vec::<String>::new());
    println!(
        "{kills} kills, {cut_short} of them left {litter} folders for a time; after the next start nothing is left"
    );
}
