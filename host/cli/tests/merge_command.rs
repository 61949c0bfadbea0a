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

/// A text PLY whose points state uncertainties.
fn ply_with_sigma(property: &str, points: &[([f64; 3], f32)]) -> String {
    let mut text = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty double x\nproperty double y\nproperty double z\nproperty float {property}\n\
         end_header\n",
        points.len()
    );
    for ([x, y, z], sigma) in points {
        text += &format!("{x} {y} {z} {sigma}\n");
    }
    text
}

#[test]
fn the_best_point_of_each_voxel_stays_as_measured_with_its_uncertainty() {
    let folder = tempfile::tempdir().unwrap();
    let mut random = Random(11);
    // Five values of uncertainty alone, so that voxels hold several points of the least one: the first of them stays.
    let mut cloud_of = |count: usize| -> Vec<([f64; 3], f32)> {
        (0..count)
            .map(|_| {
                let point = [0, 1, 2].map(|_| 4.0 * random.uniform());
                (
                    point,
                    0.001 * (1.0 + (5.0 * random.uniform()).floor()) as f32,
                )
            })
            .collect()
    };
    let (first, second) = (cloud_of(2500), cloud_of(2500));
    let write = |name: &str, text: String| std::fs::write(folder.path().join(name), text).unwrap();
    write("first.ply", ply_with_sigma("sigma_z", &first));
    write("second.ply", ply_with_sigma("sigma", &second));
    let merge = |clouds: &[&str], more: &[&str]| {
        let how = ["--voxel-mm", "0.5", "--keep", "best", "-o", "out.ply"];
        flankscope(
            folder.path(),
            &[&["merge"], clouds, &how[..], more].concat(),
        )
    };
    let output = merge(&["first.ply", "second.ply"], &["--json", "-"]);
    assert_eq!(output.status.code(), Some(0));
    let report = json(&output);

    let all: Vec<([f64; 3], f32)> = first.iter().chain(&second).copied().collect();
    let low: [f64; 3] =
        [0, 1, 2].map(|k| all.iter().map(|(p, _)| p[k]).fold(f64::INFINITY, f64::min));
    let voxel_of = |p: &[f64; 3]| [0, 1, 2].map(|k| ((p[k] - low[k]) / 0.5).floor() as i64);
    // A point stays if no other one of its voxel is more certain, nor as certain and before it; voxels in the order of first points.
    let mut expected: Vec<(usize, ([f64; 3], f32))> = Vec::new();
    for (at, (point, sigma)) in all.iter().enumerate() {
        let others: Vec<usize> = (0..all.len())
            .filter(|&k| voxel_of(&all[k].0) == voxel_of(point))
            .collect();
        let beats = |&k: &usize| all[k].1 < *sigma || (all[k].1 == *sigma && k < at);
        if !others.iter().any(beats) {
            expected.push((others[0], (*point, *sigma)));
        }
    }
    expected.sort_by_key(|(first, _)| *first);
    let merged = cloud::load(&folder.path().join("out.ply"), Unit::Mm).unwrap();
    assert_eq!(merged.extras[0].name, "sigma_z");
    let sigmas = merged.sigma_mm().unwrap().unwrap();
    let kept: Vec<([f64; 3], f32)> = merged.points.iter().copied().zip(sigmas).collect();
    let expected: Vec<_> = expected.into_iter().map(|(_, point)| point).collect();
    assert_eq!(kept, expected);
    assert!(expected.len() < 600, "voxels hold several points");
    assert_eq!(report["keep"], "best");
    assert_eq!(report["count"], expected.len());

    // The uncertainty is in the unit of the cloud, the merged cloud in mm.
    let inches = ["--cloud-unit", "inch"];
    assert_eq!(merge(&["first.ply"], &inches).status.code(), Some(0));
    let merged = cloud::load(&folder.path().join("out.ply"), Unit::Mm).unwrap();
    let least = first
        .iter()
        .map(|(_, sigma)| *sigma)
        .fold(f32::INFINITY, f32::min);
    let sigmas = merged.sigma_mm().unwrap().unwrap();
    assert!(
        sigmas
            .iter()
            .all(|&mm| mm >= 25.3 * least && mm < 25.5 * 5.1 * least)
    );
    std::fs::remove_file(folder.path().join("out.ply")).unwrap();

    // Without uncertainties, or with one that is none, nothing is merged.
    write_xyz(&folder.path().join("bare.xyz"), &[[0.0, 0.0, 1.0]]);
    let refused = merge(&["first.ply", "bare.xyz"], &[]);
    let words = [
        "bare.xyz states no uncertainty",
        "sigma_z or sigma",
        "--keep mean",
    ];
    assert_refused(folder.path(), "bare", &refused, &words);
    write("none.ply", ply_with_sigma("sigma", &[([0.0; 3], 0.0)]));
    let refused = merge(&["none.ply"], &[]);
    let words = [
        "none.ply",
        "point 0: sigma is 0 mm",
        "finite and above 0 mm",
    ];
    assert_refused(folder.path(), "none", &refused, &words);
}
