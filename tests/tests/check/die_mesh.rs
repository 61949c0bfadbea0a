//! Anyone's mesh on the simulated bench, end to end.

use std::path::Path;

use flankscope_gear_cad::{Flank, Mesh, MeshError, Meshing, write_ply, write_stl};
use flankscope_tests::{Run, demo_gear, flankscope, inspect, inspect_full, run, with_small_head};

/// The demo die in other triangles than its CAD, with one flank lower by `depth_mm` all over.
fn worn_flank(tooth: u32, flank: Flank, depth_mm: f64) -> Result<Mesh, MeshError> {
    let gear = demo_gear();
    let mut mesh = gear.mesh(&Meshing {
        axial_slices: 33,
        ..Meshing::default()
    })?;
    for p in &mut mesh.vertices {
        let radius = p[0].hypot(p[1]);
        let off_rad = p[1].atan2(p[0]).rem_euclid(std::f64::consts::TAU)
            - gear.flank_angle_rad(tooth, flank, radius);
        if radius < gear.root_radius_mm + 1e-6 && off_rad.abs() < 1e-6 {
            let [nx, ny] = gear.flank_normal(tooth, flank, radius);
            p[0] -= depth_mm * nx;
            p[1] -= depth_mm * ny;
        }
    }
    Ok(mesh)
}

fn write(path: &Path, mesh: &Mesh) {
    let mut bytes = Vec::new();
    if path.extension().is_some_and(|e| e == "stl") {
        write_stl(mesh, "die", &mut bytes).unwrap();
    } else {
        write_ply(mesh, &mut bytes).unwrap();
    }
    std::fs::write(path, bytes).unwrap();
}

#[track_caller]
fn assert_um(run: &Run, flank: &str, key: &str, expected_um: f64) {
    let truth = &run.json["truth"]["flanks"][flank];
    // The drawing's chords lie up to 0.2 µm inside the involute.
    let near = truth[key]
        .as_f64()
        .is_some_and(|um| (um - expected_um).abs() <= 0.2);
    assert!(near, "{flank} {key} should be {expected_um}: {truth}");
}

#[test]
fn the_cad_as_a_mesh_is_judged_as_the_cad() {
    let folder = tempfile::tempdir().unwrap();
    let demo = flankscope()
        .args(["bench", "demo-tool", "--out"])
        .arg(folder.path())
        .status();
    assert!(demo.unwrap().success());
    let mesh = folder.path().join("die.ply");
    let drawn = inspect(&["--seed", "3"]);
    let standing = inspect(&["--seed", "3", "--die-mesh", mesh.to_str().unwrap()]);
    assert_eq!(drawn.code, 0, "{} {}", drawn.json["reason"], drawn.stderr);
    assert_eq!(drawn.json["features"], standing.json["features"]);
    for key in ["max_disc_wear_um", "max_disc_proud_um", "zone_max_wear_um"] {
        for flank in ["12:left", "40:right", "68:left"] {
            assert_um(&drawn, flank, key, 0.0);
            assert_um(&standing, flank, key, 0.0);
        }
    }
    assert!(drawn.json["truth"]["die_mesh"].is_null());
    assert_eq!(standing.json["truth"]["die_mesh"]["closed"], true);
}

#[test]
fn a_worn_mesh_is_no_go_closed_open_and_inverted() {
    let folder = tempfile::tempdir().unwrap();
    let closed = worn_flank(40, Flank::Right, 0.08).unwrap();
    let mut open = closed.clone();
    // The bore alone, without wall and end faces, inside out.
    open.triangles.retain(|t| {
        let corners = t.map(|v| closed.vertices[v as usize]);
        corners.iter().all(|p| p[0].hypot(p[1]) < 50.0)
            && corners.iter().any(|p| (p[2] - corners[0][2]).abs() > 0.1)
    });
    open.triangles.iter_mut().for_each(|t| t.swap(0, 1));
    for (name, mesh, is_closed) in [("closed.ply", &closed, true), ("open.stl", &open, false)] {
        let path = folder.path().join(name);
        write(&path, mesh);
        // The full head: the other three flanks are go only where neighbours tell wear from a turn.
        let worn = inspect_full(&["--teeth", "12,40", "--die-mesh", path.to_str().unwrap()]);
        assert_eq!(
            worn.code, 1,
            "{name}: {} {}",
            worn.json["reason"], worn.stderr
        );
        assert_eq!(worn.not_go(), ["40:right:no-go"], "{name}");
        assert_eq!(
            worn.json["truth"]["die_mesh"]["closed"], is_closed,
            "{name}"
        );
        assert_um(&worn, "40:right", "max_disc_wear_um", 80.0);
        assert_um(&worn, "40:right", "zone_mean_wear_um", 80.0);
        assert_um(&worn, "40:left", "zone_max_wear_um", 0.0);
        assert_um(&worn, "12:right", "max_disc_wear_um", 0.0);
        assert_eq!(
            worn.json["truth"]["flanks"]["40:right"]["missing_ratio"],
            0.0
        );
    }
}

#[test]
fn watch_and_scan_see_the_mesh_too() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("die.ply");
    write(&path, &worn_flank(40, Flank::Right, 0.08).unwrap());
    let mesh = path.to_str().unwrap();
    let mut watch = flankscope();
    watch.args(["watch", "--quiet", "--json", "-", "--speed", "10"]);
    watch.args(["--every", "2", "--cycles", "4", "--teeth", "40"]);
    let watched =
        run(with_small_head(&mut watch, &["--die-mesh", mesh]).stdin(std::process::Stdio::null()));
    assert_eq!(watched.code, 1, "{}", watched.stderr);
    assert_um(&watched, "40:right", "max_disc_wear_um", 80.0);
    let mut scan = flankscope();
    scan.args(["scan", "--quiet", "--json", "-", "--speed", "max"]);
    let scanned = run(with_small_head(
        &mut scan,
        &["--views", "12x1", "--die-mesh", mesh],
    ));
    assert_ne!(scanned.code, 3, "{}", scanned.stderr);
    assert_um(&scanned, "40:right", "max_disc_wear_um", 80.0);
}

#[test]
fn what_cannot_stand_there_could_not_run_and_says_why() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let mut mesh = demo_gear().mesh(&Meshing::default()).unwrap();
    let good = folder.path().join("good.stl");
    write(&good, &mesh);
    let whole = std::fs::read(&good).unwrap();
    let half = file("half.stl", &whole[..whole.len() / 2]);
    let text = file("text.ply", b"once upon a time");
    mesh.vertices[9][2] = f64::NAN;
    let nan = folder.path().join("nan.ply");
    write(&nan, &mesh);
    let (good, nan) = (good.to_str().unwrap(), nan.to_str().unwrap());
    for (arguments, hint) in [
        (
            &["--die-mesh", "/flankscope-is-not-here.stl"][..],
            "/flankscope-is-not-here.stl",
        ),
        (&["--die-mesh", &half], "truncated"),
        (&["--die-mesh", &text], "neither PLY"),
        (&["--die-mesh", nan], "NaN"),
        (&["--die-mesh", good, "--wear", "40:left:20"], "--wear"),
        (
            &["--die-mesh", good, "--link", "/dev/null"],
            "--link /dev/null",
        ),
    ] {
        let refused = inspect(arguments);
        assert_eq!(refused.code, 3, "{arguments:?}: {}", refused.stderr);
        assert!(
            refused.stderr.contains(hint),
            "{arguments:?} should mention {hint:?}: {}",
            refused.stderr
        );
    }
    let rate = run(flankscope()
        .args([
            "watch",
            "--quiet",
            "--speed",
            "10",
            "--cycles",
            "4",
            "--wear-rate",
            "40:left:1",
        ])
        .args(["--die-mesh", good])
        .stdin(std::process::Stdio::null()));
    assert_eq!(rate.code, 3, "{}", rate.stderr);
    assert!(rate.stderr.contains("--wear-rate"), "{}", rate.stderr);
}
