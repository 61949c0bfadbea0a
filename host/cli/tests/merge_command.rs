//! `merge` as a user runs it.

mod support;

use flankscope_metrology::io::{Unit, cloud};
use flankscope_test_requisites::Random;
use support::{assert_refused, flankscope, json, write_xyz};

#[test]
fn two_clouds_become_the_centroids_of_their_common_voxels() {
    let folder = tempfile::tempdir().unwrap();
    let mut random = Random(7);
    let mut cloud_of = |count: usize| -> Vec<[f64; 3]> {
        (0..count)
            .map(|_| {
                let mut across = || 4.0 * random.uniform() - 2.0;
                [across(), across(), random.normal()]
            })
            .collect()
    };
    let (first, second) = (cloud_of(3000), cloud_of(2000));
    write_xyz(&folder.path().join("first.xyz"), &first);
    write_xyz(&folder.path().join("second.xyz"), &second);
    let voxel_mm = 0.5;
    let args = [
        "merge",
        "first.xyz",
        "second.xyz",
        "--voxel-mm",
        "0.5",
        "-o",
        "merged.ply",
        "--json",
        "-",
    ];
    let output = flankscope(folder.path(), &args);
    assert_eq!(output.status.code(), Some(0));

    // Brute force over all voxels: which points of either cloud lie in it, and where is their mean.
    let all: Vec<[f64; 3]> = first.iter().chain(&second).copied().collect();
    let low: [f64; 3] = [0, 1, 2].map(|k| all.iter().map(|p| p[k]).fold(f64::INFINITY, f64::min));
    let voxel_of = |p: &[f64; 3]| [0, 1, 2].map(|k| ((p[k] - low[k]) / voxel_mm).floor() as i64);
    let mut expected = Vec::new();
    for x in 0..8 {
        for y in 0..8 {
            for z in 0..24 {
                let inside: Vec<&[f64; 3]> =
                    all.iter().filter(|p| voxel_of(p) == [x, y, z]).collect();
                if !inside.is_empty() {
                    let mean =
                        |k: usize| inside.iter().map(|p| p[k]).sum::<f64>() / inside.len() as f64;
                    expected.push([mean(0), mean(1), mean(2)]);
                }
            }
        }
    }
    let mut merged = cloud::load(&folder.path().join("merged.ply"), Unit::Mm)
        .unwrap()
        .points
        .to_vec();
    // The command keeps the order of each voxel's first point; compared is the set.
    merged.sort_by(|a, b| a.partial_cmp(b).unwrap());
    expected.sort_by(|a, b| a.partial_cmp(b).unwrap());
    assert_eq!(merged.len(), expected.len());
    for (a, b) in merged.iter().zip(&expected) {
        for k in 0..3 {
            assert!((a[k] - b[k]).abs() < 1e-12, "{a:?} {b:?}");
        }
    }
    let report = json(&output);
    assert_eq!(report["clouds"], 2);
    assert_eq!(report["points"], 5000);
    assert_eq!(report["count"], expected.len());
    assert!(report["elapsed_ms"]["merge"].is_number());
}

#[test]
fn a_voxel_size_that_is_none_is_refused_before_anything_is_loaded() {
    let folder = tempfile::tempdir().unwrap();
    for size in ["0", "-0.1", "nan", "inf"] {
        let voxel = format!("--voxel-mm={size}");
        let args = ["merge", "absent.xyz", &voxel, "-o", "out.ply"];
        let output = flankscope(folder.path(), &args);
        assert_refused(folder.path(), size, &output, &["voxel size", "above 0"]);
    }
}
