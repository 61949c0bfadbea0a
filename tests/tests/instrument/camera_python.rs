//! A camera in another language, written from docs/camera.md alone, keeps the contract of a camera process.

use std::process::Command;
use std::time::Duration;

use flankscope_frames::conformance::{CommandRig, Settings, run};
use flankscope_test_requisites::{python_with, workspace};

#[test]
fn a_camera_in_python_conforms() {
    let Some(python) = python_with(&["iceoryx2", "xxhash", "numpy"]) else {
        return;
    };
    let camera = workspace().join("tests/cameras/camera.py");
    let base = tempfile::tempdir().unwrap();
    let mut rig = CommandRig::new(python, [camera]);
    let settings = Settings {
        patience: Duration::from_secs(60),
        ..Settings::default()
    };
    let mut passed = Vec::new();
    run(&mut rig, base.path(), &settings, |check| {
        passed.push(check.to_string())
    })
    .unwrap_or_else(|failure| panic!("after {passed:?}: {failure}"));
    assert_eq!(passed.len(), 8);
}

/// The checksum is what anybody's xxHash says.
#[test]
fn the_checksum_is_pythons() {
    let Some(python) = python_with(&["xxhash", "numpy"]) else {
        return;
    };
    let script = "import numpy, xxhash\n\
        for n in (0, 1, 17, 256003):\n    \
        p = (numpy.arange(n, dtype='u8') * 40503 % 65536).astype('<u2')\n    \
        print(n, xxhash.xxh3_64_intdigest(p))";
    let said = Command::new(python).args(["-c", script]).output().unwrap();
    let said = String::from_utf8(said.stdout).unwrap();
    assert_eq!(said.lines().count(), 4, "{said}");
    for line in said.lines() {
        let (length, theirs) = line.split_once(' ').unwrap();
        let pixels: Vec<u16> = (0..length.parse::<u64>().unwrap())
            .map(|i| (i * 40_503 % 65_536) as u16)
            .collect();
        let ours = flankscope_frames::checksum(&pixels);
        assert_eq!(ours.to_string(), theirs, "{length} pixels");
    }
}
