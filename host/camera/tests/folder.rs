//! The folder camera: a camera process like any other, and what it does with frames that are not whole.

use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use flankscope_frames::conformance::{CommandRig, Settings, run};
use flankscope_frames::{Arm, BorrowedFrame, Frame, FrameReceiver, FrameSource, SharedRoot};

const PROGRAM: &str = env!("CARGO_BIN_EXE_flankscope-camera");
const SIZE_PX: [usize; 2] = [64, 48];

/// Writes images whose samples are known: sample k of image n is (7 k + 31 n) mod 4096, packed as Mono12p.
fn images(folder: &Path, count: usize, cut: Option<usize>, more: &str) {
    let text = format!("width_px = 64\nheight_px = 48\nformat = \"Mono12p\"\n{more}");
    std::fs::write(folder.join("camera.toml"), text).unwrap();
    for n in 0..count {
        let samples: Vec<u16> = (0..SIZE_PX[0] * SIZE_PX[1]).map(|k| sample(n, k)).collect();
        let mut bytes: Vec<u8> = samples
            .chunks_exact(2)
            .flat_map(|p| {
                [
                    p[0] as u8,
                    (p[0] >> 8 | (p[1] & 15) << 4) as u8,
                    (p[1] >> 4) as u8,
                ]
            })
            .collect();
        if cut == Some(n) {
            bytes.truncate(bytes.len() - 1500);
        }
        std::fs::write(folder.join(format!("{n:03}.raw")), bytes).unwrap();
    }
}

fn sample(image: usize, k: usize) -> u16 {
    ((7 * k + 31 * image) % 4096) as u16
}

#[test]
fn the_folder_camera_conforms() {
    let folder = tempfile::tempdir().unwrap();
    images(folder.path(), 3, None, "");
    let base = tempfile::tempdir().unwrap();
    let mut rig = CommandRig::new(PROGRAM, ["folder".as_ref(), folder.path().as_os_str()]);
    let mut passed = 0;
    run(&mut rig, base.path(), &Settings::default(), |_| passed += 1).unwrap();
    assert_eq!(passed, 8);
}

struct Camera(Child);

impl Drop for Camera {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn start(images: &Path, root: &SharedRoot) -> Camera {
    let child = Command::new(PROGRAM)
        .arg("folder")
        .arg(images)
        .arg(root.path())
        .stdin(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    Camera(child)
}

/// Everything that comes until `count` frames are there, or nothing has come for two seconds.
fn frames(source: &mut FrameReceiver, count: usize) -> Vec<(u32, usize)> {
    let mut seen: Vec<(u32, usize)> = Vec::new();
    let mut last = Instant::now();
    while seen.len() < count && last.elapsed() < Duration::from_secs(2) {
        if let Some(frame) = source.receive(Duration::from_millis(50)).unwrap() {
            seen.push((frame.header().counter, image_of(&frame)));
            last = Instant::now();
        }
    }
    seen
}

/// Which image these pixels are, every one of them.
fn image_of(frame: &Frame) -> usize {
    let is = |n: &usize| {
        frame
            .pixels()
            .iter()
            .enumerate()
            .all(|(k, &pixel)| pixel == sample(*n, k))
    };
    (0..8).find(is).expect("pixels of no image")
}

fn ready(source: &mut FrameReceiver, session: u32) -> flankscope_frames::Ready {
    let end = Instant::now() + Duration::from_secs(20);
    loop {
        assert!(
            Instant::now() < end,
            "the camera does not say that it is ready"
        );
        if let Some(word) = source
            .ready()
            .unwrap()
            .filter(|word| word.session == session)
        {
            return word;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// At a rate, frames follow the arming; one that is not whole is missing, never pixels; numbers wrap at 16 bits.
#[test]
fn what_is_not_whole_is_missing() {
    let folder = tempfile::tempdir().unwrap();
    images(
        folder.path(),
        4,
        Some(2),
        "rate_hz = 200.0\nexposure_us = 500\nfirst_id = 65534\nmodel = \"F 1\"\n",
    );
    let base = tempfile::tempdir().unwrap();
    let root = SharedRoot::create(base.path()).unwrap();
    let mut source = FrameReceiver::create(&root).unwrap();
    let _camera = start(folder.path(), &root);
    let word = ready(&mut source, 0);
    assert_eq!((word.width_px, word.height_px, word.bits), (64, 48, 12));
    assert_eq!(word.model(), "F 1");
    let arm = Arm {
        session: 9,
        views: 1,
        exposures: 1,
        patterns: 7,
        ..Arm::default()
    };
    source.arm(arm).unwrap();
    assert_eq!(ready(&mut source, 9).counter, 0);
    // Images 0 1 2 3 0 1 2 3, of which number 2 is cut off.
    let expected = [(0, 0), (1, 1), (3, 3), (4, 0), (5, 1), (7, 3)];
    assert_eq!(frames(&mut source, 8), expected);
    // The count goes on over a new arming.
    source.arm(Arm { session: 10, ..arm }).unwrap();
    assert_eq!(ready(&mut source, 10).counter, 8);
    assert_eq!(frames(&mut source, 1), [(8, 0)]);
}

#[test]
fn what_is_no_camera_is_named() {
    let base = tempfile::tempdir().unwrap();
    let root = SharedRoot::create(base.path()).unwrap();
    let _source = FrameReceiver::create(&root).unwrap();
    let refused = |text: Option<&str>, words: &[&str]| {
        let folder = tempfile::tempdir().unwrap();
        if let Some(text) = text {
            std::fs::write(folder.path().join("camera.toml"), text).unwrap();
        }
        let output = Command::new(PROGRAM)
            .arg("folder")
            .arg(folder.path())
            .arg(root.path())
            .stdin(Stdio::null())
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(3));
        let said = String::from_utf8_lossy(&output.stderr);
        for word in words {
            assert!(said.contains(word), "{word}: {said}");
        }
    };
    refused(None, &["camera.toml"]);
    refused(
        Some("width_px = 64\nheight_px = 48\nformat = \"BayerRG8\"\n"),
        &["BayerRG8", "Mono12p"],
    );
    refused(
        Some("width_px = 6400\nheight_px = 4800\nformat = \"Mono8\"\n"),
        &["6400 x 4800"],
    );
    refused(
        Some("width_px = 64\nheight_px = 48\nformat = \"Mono8\"\n"),
        &["no image"],
    );
    refused(
        Some("width_px = 64\nheight_px = 48\nformat = \"Mono8\"\nrate = 3\n"),
        &["rate"],
    );
}

/// Without a host: what the camera is, and each frame's counts.
#[test]
fn a_dry_run_shows_frames_without_a_host() {
    let folder = tempfile::tempdir().unwrap();
    images(folder.path(), 2, None, "model = \"F 2\"\n");
    let mut child = Command::new(PROGRAM)
        .arg("folder")
        .arg(folder.path())
        .arg("--dry-run")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    use std::io::Write;
    child
        .stdin
        .take()
        .unwrap()
        .write_all(b"1000\n1000\n")
        .unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "{output:?}");
    let text = String::from_utf8(output.stdout).unwrap();
    for words in [
        "F 2",
        "64 x 48 px, 12 bits",
        "frame 0: ",
        "frame 1: ",
        "% saturated",
    ] {
        assert!(text.contains(words), "{words}: {text}");
    }
}
