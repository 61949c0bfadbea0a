//! `register` onto another cloud, as a user runs it.

mod support;

use flankscope_gear_cad::{GearKind, GearSpec, Meshing, write_stl};
use flankscope_metrology::io::{Unit, cloud};
use flankscope_test_requisites::Random;
use support::{assert_refused, flankscope, json, write_xyz};

/// A hilly patch of 10 x 10 mm, drawn anew for every seed, moved by `shift_mm` along x, y and z.
fn hills(seed: u64, count: usize, shift_mm: [f64; 3]) -> Vec<[f64; 3]> {
    let mut random = Random(seed);
    (0..count)
        .map(|_| {
            let (x, y) = (10.0 * random.uniform(), 10.0 * random.uniform());
            let z = 0.5 * (x + 0.3 * y).sin() * (0.7 * y).cos() + 0.005 * random.normal();
            [x + shift_mm[0], y + shift_mm[1], z + shift_mm[2]]
        })
        .collect()
}

fn folder_with_clouds() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    write_xyz(&folder.path().join("old.xyz"), &hills(1, 20_000, [0.0; 3]));
    write_xyz(
        &folder.path().join("new.xyz"),
        &hills(2, 10_000, [0.2, -0.1, 0.3]),
    );
    folder
}

#[test]
fn a_view_is_laid_on_an_earlier_one() {
    let folder = folder_with_clouds();
    let base = ["register", "--cloud", "new.xyz", "--json", "-"];
    let onto = ["--reference", "old.xyz", "-o", "laid.ply"];
    let output = flankscope(folder.path(), &[&base[..], &onto].concat());
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let report = json(&output);
    assert_eq!(report["status"], "registered");
    assert!(report["teeth"].is_null());
    for (row, expected_mm) in [-0.2, 0.1, -0.3].into_iter().enumerate() {
        let mm = report["tool_from_cloud"][row][3].as_f64().unwrap();
        // Noise of 5 um over the root of ten thousand points, and what a plane through 20 neighbours cuts off the hills, with
        // the turn's lever of 7 mm.
        assert!((mm - expected_mm).abs() < 0.01, "{mm} for {expected_mm}");
    }
    assert!(folder.path().join("laid.ply").is_file());
}

#[test]
fn what_it_is_laid_on_is_asked_for_and_looked_at() {
    let folder = folder_with_clouds();
    write_xyz(&folder.path().join("few.xyz"), &hills(3, 12, [0.0; 3]));
    let register = |more: &[&str]| {
        let base = ["register", "--cloud", "new.xyz", "-o", "out.ply"];
        flankscope(folder.path(), &[&base[..], more].concat())
    };
    // clap's own words take several lines.
    for (more, word) in [
        (&[][..], "--reference <CLOUD>"),
        (
            &["--reference", "old.xyz", "--cad", "die.stl"],
            "cannot be used with",
        ),
    ] {
        let output = register(more);
        assert_eq!(output.status.code(), Some(3));
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(text.contains(word), "{text}");
    }
    for (more, words) in [
        (
            &["--reference", "old.xyz", "--method", "article"][..],
            &["--method article", "--cad"][..],
        ),
        (&["--reference", "few.xyz"], &["few.xyz", "12", "20"]),
        (&["--reference", "missing.xyz"], &["missing.xyz"]),
        (&["--cad", "missing.stl"], &["missing.stl"]),
    ] {
        assert_refused(folder.path(), more[1], &register(more), words);
    }
}

/// A few noisy points of a nearly flat patch: the fit ends, and no direction of it is worth a pose.
#[test]
fn a_pose_of_which_every_direction_is_weak_is_not_registered() {
    let folder = folder_with_clouds();
    // As many as are needed, with a noise a quarter as large as the limits presume.
    write_xyz(&folder.path().join("few.xyz"), &hills(4, 110, [0.0; 3]));
    let base = [
        "register",
        "--reference",
        "old.xyz",
        "--json",
        "-",
        "-o",
        "laid.ply",
    ];
    let few = flankscope(
        folder.path(),
        &[&base[..], &["--cloud", "few.xyz", "--noise-mm", "0.005"]].concat(),
    );
    assert_eq!(few.status.code(), Some(2), "{few:?}");
    let report = json(&few);
    assert_eq!(report["status"], "indeterminate");
    assert_eq!(report["reason_code"], "unconstrained");
    assert_eq!(report["weak_directions"].as_array().unwrap().len(), 6);
    assert!(!folder.path().join("laid.ply").exists());
}

/// A site in metres, 30 m across, is laid on itself; read as millimetres it is told its unit.
#[test]
fn clouds_of_many_metres_are_read_in_metres() {
    let folder = tempfile::tempdir().unwrap();
    let site = |seed, count| -> Vec<[f64; 3]> {
        let of = |[x, y, z]: [f64; 3]| [3.0 * x, 3.0 * y, 3.0 * z];
        hills(seed, count, [0.0; 3]).into_iter().map(of).collect()
    };
    write_xyz(&folder.path().join("old.xyz"), &site(1, 20_000));
    write_xyz(&folder.path().join("new.xyz"), &site(1, 10_000));
    let base = [
        "register",
        "--reference",
        "old.xyz",
        "--cloud",
        "new.xyz",
        "--noise-mm",
        "15",
        "--json",
        "-",
    ];
    let units = ["--cloud-unit", "m"];
    let output = flankscope(folder.path(), &[&base[..], &units].concat());
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let report = json(&output);
    // Noise of 15 mm over the root of ten thousand points, and the curvature that planes through neighbours cut off.
    for row in 0..3 {
        let mm = report["tool_from_cloud"][row][3].as_f64().unwrap();
        assert!(mm.abs() < 30.0, "{mm}");
    }
    let far = site(3, 200).into_iter().map(|p| p.map(|c| 1e3 * c));
    write_xyz(&folder.path().join("far.xyz"), &far.collect::<Vec<_>>());
    let output = flankscope(
        folder.path(),
        &[&base[..3], &["--cloud", "far.xyz"]].concat(),
    );
    assert_refused(
        folder.path(),
        "far.xyz",
        &output,
        &["far.xyz", "10000 mm", "--cloud-unit", "1 km"],
    );
}

/// Bore and end faces of a whole gear fit at any turn. Points of all of it, turned by more than half a pitch, are laid on the teeth.
#[test]
fn a_whole_gear_is_registered_from_any_turn_within_a_pitch() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let spec = GearSpec {
        kind: GearKind::External,
        teeth: 24,
        module_mm: 2.5,
        pressure_angle_rad: 20_f64.to_radians(),
        tip_radius_mm: 32.5,
        root_radius_mm: 26.875,
        root_fillet_radius_mm: 0.0,
        turned_rad: 0.0,
        body_radius_mm: 8.0,
        height_mm: [0.0, 10.0],
    };
    let mut bytes = Vec::new();
    write_stl(&spec.mesh(&Meshing::default()).unwrap(), "gear", &mut bytes).unwrap();
    std::fs::write(folder.join("gear.stl"), bytes).unwrap();
    let args = [
        "sample", "--cad", "gear.stl", "--count", "8000", "--seed", "3", "-o", "all.ply",
    ];
    assert_eq!(flankscope(folder, &args).status.code(), Some(0));
    let points = cloud::load(&folder.join("all.ply"), Unit::Mm)
        .unwrap()
        .points;
    let pitch_deg = 15.0;
    for turn_deg in [2.0, 5.0, 7.5, 9.0, 12.0] {
        let (sin, cos) = f64::to_radians(turn_deg).sin_cos();
        let mut random = Random(7);
        let turned: Vec<[f64; 3]> = points
            .iter()
            .map(|[x, y, z]| [x * cos - y * sin, x * sin + y * cos, *z])
            .map(|point| point.map(|c| c + 0.005 * random.normal()))
            .collect();
        write_xyz(&folder.join("turned.xyz"), &turned);
        let args = [
            "register",
            "--cad",
            "gear.stl",
            "--cloud",
            "turned.xyz",
            "--json",
            "-",
        ];
        let output = flankscope(folder, &args);
        assert_eq!(output.status.code(), Some(0), "{turn_deg}: {output:?}");
        let report = json(&output);
        assert_eq!(report["teeth"], 24);
        let row = |i: usize| report["tool_from_cloud"][i][0].as_f64().unwrap();
        let off_deg = row(1).atan2(row(0)).to_degrees() + turn_deg;
        let off_deg = off_deg - pitch_deg * (off_deg / pitch_deg).round();
        assert!(off_deg.abs() < 0.02, "{turn_deg}: {off_deg}");
        assert!(
            report["inliers"].as_u64() > Some(7600),
            "{turn_deg}: {report}"
        );
    }
}
