//! `init` of small and large gears, and `gear` by the tool folder that it wrote.

mod support;

use std::path::Path;

use flankscope_gear_cad::{GearKind, GearSpec, Meshing, write_stl};
use flankscope_metrology::gear::Flank;
use flankscope_metrology::tool::Tool;
use support::{flankscope, json, write_xyz};

/// A gear of standard proportions.
fn spec(kind: GearKind, teeth: u32, module_mm: f64, height_mm: f64) -> GearSpec {
    let pitch_mm = 0.5 * module_mm * f64::from(teeth);
    let outwards = if kind == GearKind::External {
        1.0
    } else {
        -1.0
    };
    GearSpec {
        kind,
        teeth,
        module_mm,
        pressure_angle_rad: 20_f64.to_radians(),
        tip_radius_mm: pitch_mm + outwards * module_mm,
        root_radius_mm: pitch_mm - outwards * 1.25 * module_mm,
        root_fillet_radius_mm: 0.0,
        turned_rad: 0.0,
        body_radius_mm: pitch_mm - outwards * 4.0 * module_mm,
        height_mm: [0.0, height_mm],
    }
}

fn init(folder: &Path, spec: &GearSpec) -> Tool {
    let meshing = Meshing {
        chord_error_mm: 1e-4 * spec.module_mm,
        ..Meshing::default()
    };
    let mut bytes = Vec::new();
    write_stl(&spec.mesh(&meshing).unwrap(), "gear", &mut bytes).unwrap();
    std::fs::write(folder.join("gear.stl"), bytes).unwrap();
    let args = [
        "init",
        "gear.stl",
        "--teeth",
        "1,2",
        "--warn-um",
        "20",
        "--limit-um",
        "40",
        "--out",
        "die",
        "--json",
        "-",
    ];
    let output = flankscope(folder, &args);
    let error = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{spec:?}: {error}");
    Tool::load(&folder.join("die")).unwrap()
}

/// Points of every flank by the drawing's involute have no deviation by the data that `init` found.
#[test]
fn gears_of_module_0_3_to_10_are_found_and_evaluated() {
    for (kind, teeth, module_mm, height_mm) in [
        (GearKind::External, 30, 0.3, 3.0),
        (GearKind::Internal, 60, 0.3, 3.0),
        (GearKind::External, 20, 2.0, 5.0),
        (GearKind::External, 20, 10.0, 60.0),
        (GearKind::Internal, 40, 10.0, 40.0),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let drawn = spec(kind, teeth, module_mm, height_mm);
        let tool = init(folder, &drawn);
        let gear = tool.gear.as_ref().unwrap();
        assert_eq!(gear.teeth, teeth);
        let module = gear.module_mm / module_mm - 1.0;
        let angle_deg = gear.pressure_angle_deg - 20.0;
        assert!(module.abs() < 1e-5 && angle_deg.abs() < 0.002, "{gear:?}");
        let zone = tool.zone().unwrap();
        let [low, high] = zone.height_mm;
        assert!(0.0 <= low && low < high && high <= height_mm, "{zone:?}");

        let [from_mm, to_mm] = gear.active_flank_mm();
        let mut points = Vec::new();
        for tooth in 1..=teeth {
            for (flank, side) in [
                (flankscope_gear_cad::Flank::Left, Flank::Left),
                (flankscope_gear_cad::Flank::Right, Flank::Right),
            ] {
                for i in 0..40 * 40 {
                    let radius_mm = from_mm + (to_mm - from_mm) * (0.5 + f64::from(i % 40)) / 40.0;
                    let z_mm = height_mm * (0.5 + f64::from(i / 40)) / 40.0;
                    let angle = drawn.flank_angle_rad(tooth, flank, radius_mm);
                    if angle.is_finite() {
                        points.push([radius_mm * angle.cos(), radius_mm * angle.sin(), z_mm]);
                        let off_mm =
                            gear.involute_deviation_mm(tooth, side, points[points.len() - 1]);
                        assert!(off_mm.unwrap().abs() < 5e-4, "{off_mm:?}");
                    }
                }
            }
        }
        write_xyz(&folder.join("exact.xyz"), &points);
        // ISO 1328-1 begins at module 0.5.
        if module_mm < 0.5 {
            continue;
        }
        let args = [
            "gear",
            "--tool",
            "die",
            "--cloud",
            "exact.xyz",
            "--u95-um",
            "1",
            "--json",
            "-",
        ];
        let output = flankscope(folder, &args);
        let error = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(0), "{drawn:?}: {error}");
        for rating in json(&output)["ratings"].as_array().unwrap() {
            if let Some(value_um) = rating["value_um"].as_f64() {
                assert!(value_um < 1.0, "{drawn:?}: {rating}");
            }
        }
    }
}
