//! Another user writes into every file of shared memory that it can open, from the moment it is seen, and makes files beside it:
//! no start fails, twenty at a time.
//!
//! The test starts itself: as root in a shared memory of its own, since other tests are not to be sprayed, and there as `nobody`.

use std::fs::OpenOptions;
use std::io::{Read, Seek, Write};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use flankscope_frames::{FrameReceiver, SharedRoot};
use rustix::process::{Signal, set_parent_process_death_signal};

/// `nobody` and `nogroup`.
const NOBODY: u32 = 65_534;
const SHM: &str = "/dev/shm";
const STARTS: usize = 200;
const AT_ONCE: usize = 20;

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words[1..] {
        ["starts"] => starts(),
        ["spray"] => spray(),
        _ => in_a_shared_memory_of_its_own(),
    }
}

fn in_a_shared_memory_of_its_own() {
    if !rustix::process::getuid().is_root() {
        println!("SKIPPED: another user's process, only root can start one");
        return;
    }
    // Where nobody may run it.
    let folder = tempfile::tempdir_in("/tmp").unwrap();
    std::fs::set_permissions(folder.path(), PermissionsExt::from_mode(0o755)).unwrap();
    let program = folder.path().join("spray");
    std::fs::copy(std::env::current_exe().unwrap(), &program).unwrap();
    let own = format!("mount -t tmpfs -o mode=1777 flankscope {SHM} && exec \"$0\" starts");
    let started = Command::new("unshare")
        .args(["--mount", "--propagation", "private", "sh", "-c", &own])
        .arg(&program)
        .status();
    match started {
        Ok(status) => assert!(status.success(), "{status}"),
        Err(error) => println!("SKIPPED: unshare of util-linux: {error}"),
    }
}

fn starts() {
    // Open to everybody: shows that there is somebody who sprays.
    let decoy = Path::new(SHM).join("flankscope_decoy");
    std::fs::write(&decoy, [0; 16]).unwrap();
    std::fs::set_permissions(&decoy, PermissionsExt::from_mode(0o666)).unwrap();
    let sprayed = || std::fs::read(&decoy).unwrap() != [0; 16];
    let mut sprayer = Command::new(std::env::current_exe().unwrap())
        .arg("spray")
        .uid(NOBODY)
        .gid(NOBODY)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    while !sprayed() {
        std::thread::sleep(Duration::from_millis(1));
    }
    let base = tempfile::Builder::new()
        .prefix("s")
        .tempdir_in("/tmp")
        .unwrap();
    let failures: Vec<String> = std::thread::scope(|scope| {
        let start = || {
            let root = SharedRoot::create(base.path()).map_err(|error| error.to_string())?;
            let receiver = FrameReceiver::create(&root).map_err(|error| error.to_string())?;
            drop(receiver);
            Ok::<(), String>(())
        };
        let threads: Vec<_> = (0..AT_ONCE)
            .map(|_| {
                scope.spawn(move || {
                    (0..STARTS / AT_ONCE)
                        .filter_map(|_| start().err())
                        .collect::<Vec<_>>()
                })
            })
            .collect();
        threads
            .into_iter()
            .flat_map(|thread| thread.join().unwrap())
            .collect()
    });
    sprayer.kill().unwrap();
    let mut seen = String::new();
    sprayer
        .stdout
        .take()
        .unwrap()
        .read_to_string(&mut seen)
        .unwrap();
    sprayer.wait().unwrap();
    let seen = seen
        .lines()
        .filter(|line| line.ends_with("global_mgmt"))
        .count();
    assert!(seen > STARTS / 10, "nobody saw only {seen} starts");
    assert_eq!(
        failures,
        Vec::<String>::new(),
        "{} of {STARTS} starts failed",
        failures.len()
    );
    println!(
        "{STARTS} starts, {AT_ONCE} at a time, {seen} of them seen by nobody while they ran: none failed"
    );
}

/// Writes into all that can be opened, keeps it open and goes on, and makes a file of each name that comes.
fn spray() {
    set_parent_process_death_signal(Some(Signal::KILL)).unwrap();
    let mut known = std::collections::BTreeSet::new();
    let mut open = Vec::new();
    let mut random = 0x9e37_79b9_u64;
    loop {
        for entry in std::fs::read_dir(SHM).into_iter().flatten().flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            if let Ok(file) = OpenOptions::new().write(true).open(entry.path()) {
                open.push(file);
            }
            if name.starts_with("flankscope_")
                && !name.ends_with("beside")
                && known.insert(name.clone())
            {
                println!("{name}");
                let _taken =
                    std::fs::write(Path::new(SHM).join(format!("{name}beside")), "nobody's");
            }
        }
        let more = open.len().saturating_sub(100);
        open.drain(..more);
        for file in &mut open {
            random = random
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            let _full = file
                .rewind()
                .and_then(|()| file.write_all(&[random.to_le_bytes(); 2].concat()));
        }
    }
}
