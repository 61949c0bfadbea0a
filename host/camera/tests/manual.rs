//! The man pages of the camera process.

use std::process::Command;

#[test]
fn every_camera_has_a_man_page() {
    let folder = tempfile::tempdir().unwrap();
    let made = Command::new(env!("CARGO_BIN_EXE_flankscope-camera"))
        .args(["manual", "--out"])
        .arg(folder.path())
        .status()
        .unwrap();
    assert!(made.success());
    let page = |name: &str| {
        let path = folder.path().join("man").join(name);
        std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{name}: {error}"))
    };
    let all = page("flankscope-camera.1");
    for camera in ["aravis", "folder"] {
        assert!(all.contains(camera), "{camera}");
        page(&format!("flankscope-camera-{camera}.1"));
    }
    assert!(page("flankscope-camera-folder.1").contains("ROOT"));
}
