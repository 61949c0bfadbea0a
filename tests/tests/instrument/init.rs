//! `flankscope init`: gears drawn by another generator come out with the numbers that they were drawn with, wherever they lie.

use std::f64::consts::{PI, TAU};
use std::path::Path;

use flankscope_gear_cad::{GearKind, GearSpec, Mesh, Meshing};
use flankscope_metrology::tool::Tool;
use flankscope_tests::{Run, demo_gear, flankscope, run};

fn internal() -> GearSpec {
    GearSpec {
        kind: GearKind::Internal,
        teeth: 57,
        module_mm: 1.25,
        pressure_angle_rad: 20f64.to_radians(),
        tip_radius_mm: 34.5,
        root_radius_mm: 37.2,
        root_fillet_radius_mm: 0.2,
        turned_rad: 0.0,
        body_radius_mm: 46.0,
        height_mm: [-12.0, 9.0],
    }
}

fn external() -> GearSpec {
    GearSpec {
        kind: GearKind::External,
        teeth: 23,
        module_mm: 2.0,
        pressure_angle_rad: 25f64.to_radians(),
        tip_radius_mm: 25.0,
        root_radius_mm: 20.6,
        root_fillet_radius_mm: 0.3,
        turned_rad: 0.0,
        body_radius_mm: 8.0,
        height_mm: [0.0, 15.0],
    }
}

/// A mesh as a text OBJ, each of its corners moved.
fn obj(mesh: &Mesh, moved: impl Fn([f64; 3]) -> [f64; 3]) -> String {
    let corners = mesh.vertices.iter().map(|&corner| {
        let [x, y, z] = moved(corner);
        format!("v {x:.12} {y:.12} {z:.12}\n")
    });
    let faces = mesh
        .triangles
        .iter()
        .map(|t| format!("f {} {} {}\n", t[0] + 1, t[1] + 1, t[2] + 1));
    corners.chain(faces).collect()
}

fn init(folder: &Path, cad: &str, more: &[&str]) -> Run {
    let (cad, out) = (folder.join(cad), folder.join("tool"));
    let args = [
        "init",
        cad.to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
        "--json",
        "-",
    ];
    run(flankscope().args(args).args(more))
}

/// Where the gear of a file lies.
type Motion<'a> = &'a dyn Fn([f64; 3]) -> [f64; 3];

const LIMITS: [&str; 6] = ["--teeth", "3,9", "--warn-um", "30", "--limit-um", "50"];

#[test]
fn a_gear_is_found_wherever_it_lies_and_in_whatever_unit() {
    for spec in [internal(), external()] {
        let mesh = spec.mesh(&Meshing::default()).unwrap();
        let turned = |[x, y, z]: [f64; 3], by: f64| {
            [x * by.cos() - y * by.sin(), x * by.sin() + y * by.cos(), z]
        };
        let places: [(&str, Motion<'_>, bool); 5] = [
            ("mm", &|p| p, false),
            ("mm", &|p| turned(p, 0.4), false),
            ("m", &|p| p.map(|x| x / 1000.0), true),
            ("mm", &|[x, y, z]| [x + 12.5, y - 3.0, z + 40.0], true),
            // Lying: its axis is x.
            (
                "inch",
                &|[x, y, z]| [z, x, y].map(|c| (c + 7.0) / 25.4),
                true,
            ),
        ];
        for (place, (unit, moved, is_moved)) in places.into_iter().enumerate() {
            let folder = tempfile::tempdir().unwrap();
            std::fs::write(folder.path().join("gear.obj"), obj(&mesh, moved)).unwrap();
            let made = init(
                folder.path(),
                "gear.obj",
                &[&LIMITS[..], &["--cad-unit", unit]].concat(),
            );
            assert_eq!(made.code, 0, "{place}: {}", made.stderr);
            assert_eq!(
                folder.path().join("tool/cad.ply").exists(),
                is_moved,
                "{place}"
            );

            let tool = Tool::load(&folder.path().join("tool")).unwrap();
            let gear = tool.gear.unwrap();
            assert_eq!(gear.teeth, spec.teeth);
            let kind = format!("{:?}", gear.kind);
            assert_eq!(kind, format!("{:?}", spec.kind));
            // The generator's chords are within 0.2 um of the involute, and its corners on it.
            for (found, drawn) in [
                (gear.base_radius_mm(), spec.base_radius_mm()),
                (gear.pitch_radius_mm(), spec.pitch_radius_mm()),
                (gear.tip_radius_mm, spec.tip_radius_mm),
                (gear.root_radius_mm, spec.root_radius_mm),
            ] {
                assert!((found - drawn).abs() < 1e-3, "{place}: {found} {drawn}");
            }
            let width = gear.height_mm[1] - gear.height_mm[0];
            assert!(
                (width - (spec.height_mm[1] - spec.height_mm[0])).abs() < 1e-6,
                "{place}"
            );
            if place < 2 {
                let by = if place == 1 { 0.4 } else { 0.0 };
                let pitch = TAU / f64::from(spec.teeth);
                let apart = (gear.tooth_centre_rad(1) - spec.tooth_centre_rad(1) - by) / pitch;
                let apart_mm = (apart - apart.round()) * pitch * gear.pitch_radius_mm();
                assert!(apart_mm.abs() < 1e-3, "{place}: {apart_mm}");
            }
            let ring = std::fs::read_to_string(folder.path().join("tool/ring.svg")).unwrap();
            assert!(
                ring.contains(">9</text>") && ring.contains(">1</text>"),
                "{place}"
            );
        }
    }
}

/// The drawing's first tooth lies anywhere; tool and bench must mean the same flank by its number.
#[test]
fn what_init_made_is_inspected_on_the_bench() {
    let spec = GearSpec {
        turned_rad: 0.3,
        ..demo_gear()
    };
    let folder = tempfile::tempdir().unwrap();
    let mesh = spec.mesh(&Meshing::default()).unwrap();
    std::fs::write(folder.path().join("gear.obj"), obj(&mesh, |p| p)).unwrap();
    let limits = ["--teeth", "40", "--warn-um", "30", "--limit-um", "50"];
    let made = init(folder.path(), "gear.obj", &limits);
    assert_eq!(made.code, 0, "{}", made.stderr);
    let tool = folder.path().join("tool");
    let check = run(flankscope()
        .args(["inspect", "--link", "sim", "--speed", "max", "--wear"])
        .args(["40:left:80", "--json", "-", "--tool"])
        .arg(&tool));
    assert_eq!(check.code, 1, "{}", check.stderr);
    assert_eq!(check.flank(40, "left"), Some("no-go"));
    assert_eq!(check.flank(40, "right"), Some("go"));
}

#[test]
fn what_is_missing_is_said_at_once_and_what_is_no_gear_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = external().mesh(&Meshing::default()).unwrap();
    std::fs::write(folder.path().join("gear.obj"), obj(&mesh, |p| p)).unwrap();
    let made = init(folder.path(), "gear.obj", &["--teeth", "3"]);
    assert_eq!(made.code, 3);
    assert!(
        made.stderr.contains("--warn-um") && made.stderr.contains("--limit-um"),
        "{}",
        made.stderr
    );
    assert!(!folder.path().join("tool").exists());

    // Sheared along its height: the flanks of a helical gear, as it were.
    let helical = obj(&mesh, |[x, y, z]| {
        let (sin, cos) = (0.05 * z).sin_cos();
        [x * cos - y * sin, x * sin + y * cos, z]
    });
    // A hexagonal prism repeats six times and has no involutes.
    let prism = {
        let at = |k: usize| {
            [
                10.0 * (PI * k as f64 / 3.0).cos(),
                10.0 * (PI * k as f64 / 3.0).sin(),
            ]
        };
        let mut mesh = Mesh::default();
        mesh.vertices
            .extend((0..12).map(|k| [at(k % 6)[0], at(k % 6)[1], if k < 6 { 0.0 } else { 5.0 }]));
        for k in 0..6_u32 {
            let next = (k + 1) % 6;
            mesh.triangles
                .extend([[k, next, 6 + next], [k, 6 + next, 6 + k]]);
        }
        for k in 1..5_u32 {
            mesh.triangles.extend([[0, k + 1, k], [6, 6 + k, 7 + k]]);
        }
        obj(&mesh, |p| p)
    };
    for (name, text) in [("helical", helical), ("prism", prism)] {
        std::fs::write(folder.path().join("other.obj"), text).unwrap();
        let made = init(folder.path(), "other.obj", &LIMITS);
        assert_eq!(made.code, 3, "{name}: {}", made.stderr);
        assert!(!folder.path().join("tool/tool.toml").exists(), "{name}");
    }
    let made = init(folder.path(), "die.step", &LIMITS);
    assert!(
        made.code == 3 && made.stderr.contains("gmsh"),
        "{}",
        made.stderr
    );

    // Nothing that is there is replaced.
    assert_eq!(init(folder.path(), "gear.obj", &LIMITS).code, 0);
    let again = init(folder.path(), "gear.obj", &LIMITS);
    assert!(
        again.code == 3 && again.stderr.contains("not replaced"),
        "{}",
        again.stderr
    );
}
