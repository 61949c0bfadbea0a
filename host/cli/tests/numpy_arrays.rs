//! Clouds and deviations as arrays for NumPy: what it reads is what the PLY of the same run holds, and the closed form.

use std::path::Path;
use std::process::{Command, Output};

use flankscope_test_requisites::python_with;

/// A cube of 10 mm, counter-clockwise seen from outside.
const CUBE: &str = "v 0 0 0\nv 10 0 0\nv 10 10 0\nv 0 10 0\nv 0 0 10\nv 10 0 10\nv 10 10 10\nv 0 10 10\n\
    f 4 3 2 1\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";

/// Points over and under the cube's lid, float coordinates, with properties of every kind.
const CLOUD: &str = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
    property uchar red\nproperty short level\nproperty uint number\nproperty double t\nend_header\n\
    2 3 10.5 255 -32768 4294967295 0.1\n5 5 9.75 0 7 1 1e300\n8 2 10 1 8 2 -2\n4 6 10.125 2 9 3 3\n";

fn flankscope(folder: &Path, words: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_flankscope"));
    let command = command.current_dir(folder).args(words.split(' '));
    command.output().unwrap()
}

#[test]
fn arrays_hold_what_the_ply_holds() {
    let Some(python) = python_with(&["numpy"]) else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::write(at("cube.obj"), CUBE).unwrap();
    std::fs::write(at("cloud.ply"), CLOUD).unwrap();
    let run = |words: &str| {
        let output = flankscope(folder.path(), words);
        assert_eq!(output.status.code(), Some(0), "{output:?}");
    };
    run("deviation --cad cube.obj --cloud cloud.ply -o deviation.npz --quiet");
    for ending in ["ply", "NPZ"] {
        run(&format!(
            "sample --cad cube.obj --count 70000 --seed 4 -o sample.{ending} --quiet"
        ));
        run(&format!(
            "merge sample.ply --voxel-mm 0.5 -o merged.{ending} --quiet"
        ));
        run(&format!(
            "register --cad cube.obj --cloud sample.ply -o laid.{ending} --quiet"
        ));
    }
    let script = r#"
import zipfile, numpy as np
of = np.load("deviation.npz")
assert of.files == ["points_mm", "red", "level", "number", "t", "deviation"], of.files
assert [of[n].dtype.str for n in of.files] == ["<f4", "|u1", "<i2", "<u4", "<f8", "<f8"]
assert of["points_mm"].tolist() == [[2, 3, 10.5], [5, 5, 9.75], [8, 2, 10], [4, 6, 10.125]]
assert of["red"].tolist() == [255, 0, 1, 2] and of["level"].tolist() == [-32768, 7, 8, 9]
assert of["number"].tolist() == [4294967295, 1, 2, 3] and of["t"].tolist() == [0.1, 1e300, -2, 3]
assert np.abs(of["deviation"] - [0.5, -0.25, 0, 0.125]).max() < 1e-12, of["deviation"]
for name, count in [("sample", 70000), ("merged", None), ("laid", 70000)]:
    arrays = np.load(f"{name}.NPZ")
    assert arrays.files == ["points_mm"] and arrays["points_mm"].dtype == np.float64
    assert zipfile.ZipFile(f"{name}.NPZ").testzip() is None
    body = open(f"{name}.ply", "rb").read().split(b"end_header\n", 1)[1]
    of_ply = np.frombuffer(body, "<f8").reshape(-1, 3)
    assert np.array_equal(arrays["points_mm"], of_ply) and len(of_ply) == (count or len(of_ply)) > 0
"#;
    let said = Command::new(python)
        .current_dir(folder.path())
        .args(["-c", script])
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&said.stderr);
    assert!(said.is_empty(), "{said}");
}

#[test]
fn a_property_that_is_no_name_of_an_array_is_refused_and_nothing_is_left() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("cube.obj"), CUBE).unwrap();
    let cloud = CLOUD.replace("uchar red", "uchar points_mm");
    std::fs::write(folder.path().join("cloud.ply"), cloud).unwrap();
    let words = "deviation --cad cube.obj --cloud cloud.ply -o out.npz";
    let output = flankscope(folder.path(), words);
    assert_eq!(output.status.code(), Some(3));
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("\"points_mm\" is no name"), "{said}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
}
