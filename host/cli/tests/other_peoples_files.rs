//! Meshes and clouds as other programs write them: wound the wrong way round, with concave faces, decimal commas, in metres.

mod support;

use std::path::Path;

use flankscope_gear_cad::{GearKind, GearSpec, Meshing, write_stl};
use flankscope_metrology::io::{Unit, cloud, mesh};
use flankscope_test_requisites::Random;
use serde_json::Value;
use support::{assert_refused, flankscope, json, write_xyz};

const CORNERS: [[f64; 3]; 8] = [
    [0.0, 0.0, 0.0],
    [10.0, 0.0, 0.0],
    [10.0, 10.0, 0.0],
    [0.0, 10.0, 0.0],
    [0.0, 0.0, 10.0],
    [10.0, 0.0, 10.0],
    [10.0, 10.0, 10.0],
    [0.0, 10.0, 10.0],
];
/// Faces of a cube, counter-clockwise seen from outside.
const FACES: [[usize; 4]; 6] = [
    [0, 3, 2, 1],
    [4, 5, 6, 7],
    [0, 1, 5, 4],
    [1, 2, 6, 5],
    [2, 3, 7, 6],
    [3, 0, 4, 7],
];

/// A cube of 10 mm whose faces, some turned, are given in words of their own format.
fn cube_obj(folder: &Path, name: &str, faces: &[usize], turned: impl Fn(usize) -> bool) {
    let mut text = String::new();
    for [x, y, z] in CORNERS {
        text += &format!("v {x} {y} {z}\n");
    }
    for &face in faces {
        let mut corners = FACES[face].map(|i| i + 1);
        if turned(face) {
            corners.reverse();
        }
        let [a, b, c, d] = corners;
        text += &format!("f {a} {b} {c} {d}\n");
    }
    std::fs::write(folder.join(name), text).unwrap();
}

fn deviation(folder: &Path, cad: &str, more: &[&str]) -> (Value, String) {
    let args = [
        "deviation",
        "--cad",
        cad,
        "-o",
        "deviation.ply",
        "--json",
        "-",
    ];
    let output = flankscope(folder, &[&args[..], more].concat());
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    (
        json(&output),
        String::from_utf8_lossy(&output.stderr).into_owned(),
    )
}

#[test]
fn signs_do_not_depend_on_how_a_solid_is_wound() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // 0.5 mm proud of one face, 0.25 mm missing from another.
    write_xyz(
        &folder.join("cloud.xyz"),
        &[[5.0, 5.0, 10.5], [9.75, 5.0, 5.0]],
    );
    let all = [0, 1, 2, 3, 4, 5];
    for pattern in [0_u32, 0b11_1111, 0b10_0101] {
        cube_obj(folder, "cube.obj", &all, |face| pattern >> face & 1 == 1);
        let (report, said) = deviation(folder, "cube.obj", &["--cloud", "cloud.xyz"]);
        assert_eq!(report["signed"], true);
        assert_eq!(report["mean_mm"], 0.125, "{pattern:b}");
        assert_eq!(report["orientation"]["turned"], 2 * pattern.count_ones());
        assert_eq!(
            said.contains("wound the wrong way round"),
            pattern != 0,
            "{said}"
        );
    }
    // Without a lid which side is outside is the file's word; without agreement it is nobody's.
    cube_obj(folder, "open.obj", &all[..5], |_| false);
    let (report, said) = deviation(folder, "open.obj", &["--cloud", "cloud.xyz"]);
    assert_eq!(
        (&report["signed"], &report["mean_mm"]),
        (&true.into(), &0.125.into())
    );
    assert!(said.contains("not closed"), "{said}");
    cube_obj(folder, "mixed.obj", &all[..5], |face| face < 2);
    let (report, said) = deviation(folder, "mixed.obj", &["--cloud", "cloud.xyz"]);
    assert_eq!(
        (&report["signed"], &report["mean_mm"]),
        (&false.into(), &0.375.into())
    );
    assert!(said.contains("without sign"), "{said}");
}

#[test]
fn faces_with_notches_are_covered_and_nothing_beside_them() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // A U of walls 1 mm thick, 10 mm high: floor and lid have eight corners, two of them in the notch.
    let outline = [
        [0, 0],
        [10, 0],
        [10, 10],
        [9, 10],
        [9, 1],
        [1, 1],
        [1, 10],
        [0, 10],
    ];
    let mut text = String::new();
    for z in [0, 10] {
        for [x, y] in outline {
            text += &format!("v {x} {y} {z}\n");
        }
    }
    text += "f 8 7 6 5 4 3 2 1\nf 9 10 11 12 13 14 15 16\n";
    for i in 0..8 {
        let next = (i + 1) % 8;
        text += &format!("f {} {} {} {}\n", i + 1, next + 1, next + 9, i + 9);
    }
    std::fs::write(folder.join("u.obj"), text).unwrap();
    let args = [
        "sample", "--cad", "u.obj", "--count", "20000", "--seed", "3", "-o", "u.ply", "--quiet",
    ];
    assert_eq!(flankscope(folder, &args).status.code(), Some(0));
    let points = cloud::load(&folder.join("u.ply"), Unit::Mm).unwrap().points;
    let in_notch = |[x, y, _]: &[f64; 3]| (1.0..9.0).contains(x) && *y > 1.0;
    let slack = |p: &[f64; 3]| {
        in_notch(&[p[0] + 1e-5, p[1] - 1e-5, p[2]]) && in_notch(&[p[0] - 1e-5, p[1] - 1e-5, p[2]])
    };
    assert_eq!(points.iter().filter(|p| slack(p)).count(), 0);
    // Area 28 mm² of 716 mm² lies on floor and lid each: so do the samples.
    let outline_area = 28.0;
    let walls = 10.0 * (10.0 + 10.0 + 1.0 + 9.0 + 8.0 + 9.0 + 1.0 + 10.0);
    let share = 2.0 * outline_area / (2.0 * outline_area + walls);
    let ends = points.iter().filter(|p| p[2] < 1e-6 || p[2] > 10.0 - 1e-6);
    let found = ends.count() as f64 / points.len() as f64;
    assert!(
        (found - share).abs() < 5.0 * (share / 20_000.0).sqrt(),
        "{found} {share}"
    );
}

#[test]
fn clouds_say_their_numbers_and_units() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    cube_obj(folder, "cube.obj", &[0, 1, 2, 3, 4, 5], |_| false);
    let mut random = Random(5);
    let points: Vec<[f64; 3]> = (0..300)
        .map(|_| [10.0 * random.uniform(), 10.0 * random.uniform(), 10.25])
        .collect();
    write_xyz(&folder.join("mm.xyz"), &points);
    let (expected, _) = deviation(folder, "cube.obj", &["--cloud", "mm.xyz"]);
    assert_eq!(expected["mean_mm"], 0.25);
    let lines = |write: &dyn Fn(f64) -> String, between: &str| -> String {
        let line = |p: &[f64; 3]| p.map(write).join(between) + "\n";
        points.iter().map(line).collect()
    };
    let exact = |v: f64| format!("{v:?}");
    for (name, text) in [
        ("comma.csv", lines(&|v| exact(v).replace('.', ","), ";")),
        ("comma.txt", lines(&|v| exact(v).replace('.', ","), "\t")),
        ("points.csv", lines(&exact, ",")),
    ] {
        std::fs::write(folder.join(name), text).unwrap();
        let (found, _) = deviation(folder, "cube.obj", &["--cloud", name]);
        assert_eq!(found["mean_mm"], 0.25, "{name}");
    }
    let both = lines(&|v| exact(v).replace('.', ","), ",");
    std::fs::write(folder.join("both.csv"), both).unwrap();
    let metres: Vec<[f64; 3]> = points.iter().map(|p| p.map(|v| v * 1e-3)).collect();
    write_xyz(&folder.join("metres.xyz"), &metres);
    for (name, what) in [("both.csv", "commas"), ("metres.xyz", "--cloud-unit")] {
        let args = [
            "deviation",
            "--cad",
            "cube.obj",
            "-o",
            "out.ply",
            "--cloud",
            name,
        ];
        assert_refused(folder, name, &flankscope(folder, &args), &[what]);
    }
    let (found, _) = deviation(
        folder,
        "cube.obj",
        &["--cloud", "metres.xyz", "--cloud-unit", "m"],
    );
    assert!((found["mean_mm"].as_f64().unwrap() - 0.25).abs() < 1e-12);
}

#[test]
fn meshes_of_other_formats_are_called_by_their_names() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let stl = "SOLID cube\n FACET NORMAL 0 0 1\n  OUTER LOOP\n   VERTEX 0 0 0\n   VERTEX 10 0 0\n   VERTEX 0 10 0\n  ENDLOOP\n ENDFACET\nENDSOLID cube\n";
    std::fs::write(folder.join("upper.stl"), stl).unwrap();
    write_xyz(&folder.join("cloud.xyz"), &[[1.0, 1.0, 0.5]]);
    let (report, _) = deviation(folder, "upper.stl", &["--cloud", "cloud.xyz"]);
    assert_eq!(report["mean_mm"], 0.5);
    let step = format!("ISO-10303-21;\nHEADER;\n{}", "ENDSEC;\n".repeat(30));
    for (name, text, what) in [
        ("part.step", step.as_str(), "STEP"),
        ("part.off", "OFF\n8 6 0\n0 0 0\n", "OFF"),
        ("part.csv", "x;y;z\n1.0;2.0;3.0\n", "table of numbers"),
    ] {
        std::fs::write(folder.join(name), text).unwrap();
        let args = [
            "deviation",
            "--cad",
            name,
            "-o",
            "out.ply",
            "--cloud",
            "cloud.xyz",
        ];
        assert_refused(folder, name, &flankscope(folder, &args), &[what]);
    }
}

/// A part of 5 m measured to half a millimetre: as good a fit as one of 0.2 m to 20 µm.
#[test]
fn a_large_part_is_laid_on_its_cad_by_limits_of_its_own_noise() {
    const NOISE_MM: f64 = 0.5;
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let gear = GearSpec {
        kind: GearKind::Internal,
        teeth: 84,
        module_mm: 25.0,
        pressure_angle_rad: 20f64.to_radians(),
        tip_radius_mm: 1025.0,
        root_radius_mm: 1081.25,
        root_fillet_radius_mm: 0.0,
        turned_rad: 0.0,
        body_radius_mm: 1300.0,
        height_mm: [0.0, 1650.0],
    };
    let meshing = Meshing {
        chord_error_mm: 0.1,
        ..Meshing::default()
    };
    let mut bytes = Vec::new();
    write_stl(&gear.mesh(&meshing).unwrap(), "ring", &mut bytes).unwrap();
    std::fs::write(folder.join("ring.stl"), bytes).unwrap();
    let args = [
        "sample", "--cad", "ring.stl", "--count", "60000", "--seed", "5", "-o", "all.ply",
        "--quiet",
    ];
    assert_eq!(flankscope(folder, &args).status.code(), Some(0));
    let truth = cloud::load(&folder.join("all.ply"), Unit::Mm)
        .unwrap()
        .points;
    let mut random = Random(9);
    let (sin, cos) = 1e-3_f64.sin_cos();
    let view: Vec<[f64; 3]> = truth
        .iter()
        .map(|p| {
            let [x, y, z] = p.map(|v| v + NOISE_MM * random.normal());
            [cos * x - sin * y + 3.0, sin * x + cos * y - 2.0, z + 1.0]
        })
        .collect();
    write_xyz(&folder.join("view.xyz"), &view);
    let args = [
        "register", "--cad", "ring.stl", "--cloud", "view.xyz", "--json", "-",
    ];
    let refused = flankscope(folder, &args);
    assert_eq!(refused.status.code(), Some(2), "limits of a head of 20 µm");
    let output = flankscope(folder, &[&args[..], &["--noise-mm", "0.5"]].concat());
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let report = json(&output);
    let rows = report["tool_from_cloud"].as_array().unwrap();
    let at = |r: usize, c: usize| rows[r][c].as_f64().unwrap();
    let squares = view.iter().zip(&*truth).map(|(from, to)| -> f64 {
        let off =
            |r: usize| at(r, 0) * from[0] + at(r, 1) * from[1] + at(r, 2) * from[2] + at(r, 3);
        (0..3).map(|r| (off(r) - to[r]).powi(2)).sum()
    });
    // Noise remains; what the pose adds to it is some hundredths of it.
    let rms = (squares.sum::<f64>() / view.len() as f64).sqrt();
    let noise = 3f64.sqrt() * NOISE_MM;
    assert!((rms / noise - 1.0).abs() < 0.02, "{rms} {noise}");
}

/// A disc with twelve tooth blocks that overlap it, as an assembly is exported: signs are those of the union.
#[test]
fn bodies_that_overlap_have_the_sign_of_their_union() {
    let Some(case) = flankscope_test_requisites::shared("cases/12-nested") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| case.join(name).to_str().unwrap().to_owned();
    let (report, told) = deviation(
        folder.path(),
        &path("disc_then_teeth.stl"),
        &["--cloud", &path("tooth_tips.xyz")],
    );
    assert!(!told.contains("wrong way"), "{told}");
    assert_eq!(report["orientation"]["turned"], 0, "{report}");
    let signed = cloud::load(&folder.path().join("deviation.ply"), Unit::Mm).unwrap();
    let column = signed
        .extras
        .iter()
        .find(|column| column.name == "deviation");
    let truth = std::fs::read_to_string(path("tooth_tips_true_mm.txt")).unwrap();
    let truth: Vec<f64> = truth
        .lines()
        .map(|line| line.trim().parse().unwrap())
        .collect();
    let got: Vec<f64> = column.unwrap().values().collect();
    assert_eq!(got.len(), truth.len());
    for (got, truth) in got.iter().zip(truth) {
        // Six decimals in the cloud's file, single precision in the answer's.
        assert!((got - truth).abs() < 2e-6, "{got} {truth}");
    }
}

/// The guard against the neighbouring tooth goes by the number of flanks, not by the facets of a bore.
#[test]
fn the_teeth_of_an_external_gear_are_counted() {
    let Some(case) = flankscope_test_requisites::shared("cases/14-gear-one-pitch-off") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| case.join(name).to_str().unwrap().to_owned();
    for cad in ["gear24_bore16.stl", "gear24_no_bore.stl"] {
        let cloud = path("whole_part_turned_9deg.xyz");
        let args = [
            "register",
            "--cad",
            &path(cad),
            "--cloud",
            &cloud,
            "--json",
            "-",
        ];
        let report = json(&flankscope(folder.path(), &args));
        assert_eq!(report["teeth"], 24, "{cad}");
    }
}

/// Points about a face of the cube, every fifth of them not finite, and an empty row of a scanner's grid.
fn holed_text() -> (String, usize, usize) {
    let (mut text, mut finite, mut not_finite) = (String::new(), 0, 0);
    for i in 0..400 {
        if i % 5 == 3 || (100..120).contains(&i) {
            text += ["nan nan nan\n", "-nan(ind) 1 2\n", "1 2 -1.#INF\n"][i % 3];
            not_finite += 1;
        } else {
            text += &format!(
                "{} {} 10.25\n",
                0.45 * (i % 20) as f64,
                0.45 * (i / 20) as f64
            );
            finite += 1;
        }
    }
    (text, finite, not_finite)
}

#[test]
fn points_that_are_not_finite_are_left_out_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    cube_obj(folder, "cube.obj", &[0, 1, 2, 3, 4, 5], |_| false);
    let (text, finite, not_finite) = holed_text();
    std::fs::write(folder.join("holed.xyz"), text).unwrap();

    let (report, said) = deviation(folder, "cube.obj", &["--cloud", "holed.xyz"]);
    assert_eq!(report["count"], finite);
    assert_eq!(report["points_not_finite"], not_finite);
    assert_eq!(report["max_abs_mm"], 0.25);
    let words = format!("{not_finite} of 400 points");
    assert!(said.contains(&words) && said.contains("--strict"), "{said}");
    let written = cloud::load(&folder.join("deviation.ply"), Unit::Mm).unwrap();
    assert_eq!(written.points.len(), finite);

    for (command, points) in [
        (
            &["register", "--cad", "cube.obj", "--cloud", "holed.xyz"][..],
            "points",
        ),
        (
            &[
                "register",
                "--reference",
                "holed.xyz",
                "--cloud",
                "holed.xyz",
            ][..],
            "points",
        ),
        (
            &["clean", "holed.xyz", "--share", "1", "-o", "clean.ply"][..],
            "points",
        ),
        (
            &[
                "merge",
                "holed.xyz",
                "--voxel-mm",
                "0.1",
                "-o",
                "merged.ply",
            ][..],
            "points",
        ),
    ] {
        let output = flankscope(folder, &[command, &["--json", "-"]].concat());
        let report = json(&output);
        assert_eq!(report[points], finite, "{command:?}");
        assert_eq!(report["points_not_finite"], not_finite, "{command:?}");
        let strict = flankscope(folder, &[command, &["--strict"]].concat());
        assert_refused(folder, command[0], &strict, &["holed.xyz", "line 4"]);
    }
    let (report, said) = deviation(
        folder,
        "cube.obj",
        &["--cloud", "deviation.ply", "--strict"],
    );
    assert_eq!(
        (&report["points_not_finite"], said.as_str()),
        (&0.into(), "")
    );
}

/// Bytes after the triangles of an STL are ignored with a note, and the distances are those of the STL without them.
#[test]
fn binary_stl_with_spare_bytes_is_read_with_a_note() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    cube_obj(folder, "cube.obj", &[0, 1, 2, 3, 4, 5], |_| false);
    let mesh = mesh::load(&folder.join("cube.obj"), Unit::Mm).unwrap();
    let mut bytes = Vec::new();
    mesh::write_stl(&mut bytes, &mesh).unwrap();
    bytes.extend([13, 10]);
    std::fs::write(folder.join("spare.stl"), bytes).unwrap();
    write_xyz(
        &folder.join("cloud.xyz"),
        &[[5.0, 5.0, 10.5], [9.75, 5.0, 5.0]],
    );
    let (report, said) = deviation(folder, "spare.stl", &["--cloud", "cloud.xyz"]);
    assert_eq!(report["mean_mm"], 0.125);
    assert!(
        said.contains("spare.stl") && said.contains("2 bytes"),
        "{said}"
    );
    // Named as a cloud, the file is refused as a mesh.
    let args = [
        "deviation",
        "--cad",
        "cube.obj",
        "--cloud",
        "spare.stl",
        "-o",
        "out.ply",
    ];
    let output = flankscope(folder, &args);
    assert_refused(folder, "spare.stl", &output, &["sample"]);
}
