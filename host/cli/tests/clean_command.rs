//! `clean` as a user runs it.

mod support;

use flankscope_metrology::io::{Unit, cloud};
use flankscope_test_requisites::Random;
use support::{flankscope, json, write_xyz};

/// A wavy sheet of 4 by 4 mm with some points far off it.
fn sheet() -> Vec<[f64; 3]> {
    let mut random = Random(11);
    let mut points: Vec<[f64; 3]> = (0..4000)
        .map(|_| {
            let [x, y] = [4.0 * random.uniform(), 4.0 * random.uniform()];
            [x, y, 0.2 * (3.0 * x).sin() + 0.005 * random.normal()]
        })
        .collect();
    points.extend((0..20).map(|i| [0.2 * f64::from(i), 2.0, 3.0 + f64::from(i)]));
    points
}

#[test]
fn what_is_dropped_is_what_brute_force_drops_and_the_rest_stays_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let points = sheet();
    write_xyz(&folder.path().join("sheet.xyz"), &points);
    let args = [
        "clean",
        "sheet.xyz",
        "--crop",
        "1,3,-9,9,-9,9",
        "--denoise",
        "8,2",
        "--voxel-mm",
        "0.25",
        "-o",
        "clean.ply",
        "--json",
        "-",
    ];
    let output = flankscope(folder.path(), &args);
    assert_eq!(output.status.code(), Some(0), "{output:?}");

    let inside: Vec<[f64; 3]> = points
        .into_iter()
        .filter(|p| (1.0..=3.0).contains(&p[0]) && p[2] <= 9.0)
        .collect();
    let apart =
        |a: &[f64; 3], b: &[f64; 3]| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt();
    let means: Vec<f64> = (0..inside.len())
        .map(|i| {
            let others = (0..inside.len()).filter(|&j| j != i);
            let mut all: Vec<f64> = others.map(|j| apart(&inside[i], &inside[j])).collect();
            all.sort_by(f64::total_cmp);
            all[..8].iter().sum::<f64>() / 8.0
        })
        .collect();
    let n = means.len() as f64;
    let mean = means.iter().sum::<f64>() / n;
    let deviation = (means.iter().map(|m| (m - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
    let near: Vec<[f64; 3]> = inside
        .iter()
        .zip(&means)
        .filter(|(_, m)| **m <= mean + 2.0 * deviation)
        .map(|(p, _)| *p)
        .collect();
    assert!(near.len() < inside.len() && near.iter().all(|p| p[2] < 1.0));
    let low: [f64; 3] = [0, 1, 2].map(|k| near.iter().map(|p| p[k]).fold(f64::INFINITY, f64::min));
    let voxel = |p: &[f64; 3]| [0, 1, 2].map(|k| ((p[k] - low[k]) / 0.25).floor() as i64);
    let mut expected: Vec<[f64; 3]> = Vec::new();
    for point in &near {
        if expected.iter().all(|other| voxel(other) != voxel(point)) {
            expected.push(*point);
        }
    }
    let clean = cloud::load(&folder.path().join("clean.ply"), Unit::Mm).unwrap();
    assert_eq!(clean.points.to_vec(), expected);
    let report = json(&output);
    assert_eq!(report["count"], expected.len());
    assert_eq!(report["outliers"], inside.len() - near.len());
}

#[test]
fn every_kind_of_file_is_read_back_with_its_properties() {
    let folder = tempfile::tempdir().unwrap();
    let ply = "ply\nformat ascii 1.0\nelement vertex 6\nproperty double x\nproperty double y\nproperty double z\n\
        property float sigma\nend_header\n0 0 0 0.5\n1 0 0 1.5\n2 0 0 2.5\n3 0 0 3.5\n4 0 0 4.5\n5 0.125 0 5.5\n";
    std::fs::write(folder.path().join("six.ply"), ply).unwrap();
    for name in ["half.ply", "half.npz", "half.xyz"] {
        let args = ["clean", "six.ply", "--share", "0.5", "-o", name];
        let output = flankscope(folder.path(), &args);
        assert_eq!(output.status.code(), Some(0), "{output:?}");
        let half = cloud::load(&folder.path().join(name), Unit::Mm).unwrap();
        let expected = [[1.0, 0.0, 0.0], [3.0, 0.0, 0.0], [5.0, 0.125, 0.0]];
        assert_eq!(half.points.to_vec(), expected, "{name}");
        if name != "half.xyz" {
            let sigma: Vec<f64> = half.extras[0].values().collect();
            assert_eq!(sigma, [1.5, 3.5, 5.5], "{name}");
        }
    }
    let text = std::fs::read_to_string(folder.path().join("half.xyz")).unwrap();
    assert_eq!(text.lines().last(), Some("5 0.125 0 5.5"));
}

#[test]
fn impossible_requests_are_refused_and_write_nothing() {
    let folder = tempfile::tempdir().unwrap();
    write_xyz(&folder.path().join("sheet.xyz"), &sheet());
    for (args, part) in [
        (&[][..], "nothing to do"),
        (&["--crop", "1,0,0,1,0,1"][..], "no space"),
        (&["--crop", "1,2"][..], "6 numbers"),
        (&["--crop", "50,60,0,1,0,1"][..], "no point"),
        (&["--denoise", "0,2"][..], "neighbours"),
        (&["--denoise", "8,nan"][..], "not finite"),
        (&["--voxel-mm", "0"][..], "above 0"),
        (&["--share", "1.5"][..], "up to 1"),
    ] {
        let base = ["clean", "sheet.xyz", "-o", "out.ply"];
        let output = flankscope(folder.path(), &[&base[..], args].concat());
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(3), "{args:?}: {text}");
        assert!(text.contains(part), "{args:?}: {text}");
        assert!(!folder.path().join("out.ply").exists(), "{args:?}");
    }
}
