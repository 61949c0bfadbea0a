//! A die made by anyone: what it looks like, what is true of it, and which files are refused.

use std::path::Path;
use std::sync::Arc;

use flankscope_bench::demo;
use flankscope_bench::die_file::{self, DieFileError};
use flankscope_bench::world::{
    DieMesh, FlankId, PatternSpec, VIEW_HALF_MM, ViewState, World, WorldConfig, WorldError,
};
use flankscope_bench::zones::{Judged, ZoneTruth, compare};
use flankscope_gear_cad::{Flank, Mesh, Meshing, write_ply, write_stl};

const TOOTH: u32 = 40;
/// The drawing's chords lie up to 0.2 µm inside the involute.
const CHORD_UM: f64 = 0.2;

fn config() -> WorldConfig {
    demo::world_config().expect("the demo")
}

fn with_mesh(mesh: Mesh) -> WorldConfig {
    WorldConfig {
        die_mesh: Some(Arc::new(DieMesh::new(mesh).expect("a die"))),
        ..config()
    }
}

/// The head before tooth 40.
fn view(world: &World) -> ViewState {
    let rotation_rad = -demo::gear().tooth_centre_rad(TOOTH) + 1e-4;
    world
        .prepare(rotation_rad, demo::HEIGHT_MM, &PatternSpec::insitu12())
        .expect("a view")
}

/// Frame of the finest pattern, and what is true of it.
fn photographed(config: &WorldConfig) -> (Vec<u16>, usize) {
    let world = World::new(config).expect("a world");
    let view = view(&world);
    let [width, height] = world.size_px();
    let mut frame = vec![0u16; width * height];
    world
        .render(&view, 12, 20_000, true, 3, &mut frame)
        .expect("a frame");
    let of_tooth = |core: &&flankscope_bench::world::CoreTruth| {
        core.lit && core.flank.is_some_and(|id| id.tooth == TOOTH)
    };
    (frame, world.truth(&view).iter().filter(of_tooth).count())
}

fn zones(config: &WorldConfig) -> [ZoneTruth; 2] {
    let gear = &config.gear;
    let flanks = [Flank::Left, Flank::Right].map(|flank| FlankId {
        tooth: TOOTH,
        flank,
    });
    let judged = Judged {
        cad: config.cad.clone(),
        gear: gear.clone(),
        flanks: flanks.to_vec(),
        radius_mm: [
            gear.tip_radius_mm + 0.1 * gear.module_mm,
            gear.pitch_radius_mm() + 0.75 * gear.module_mm,
        ],
        height_mm: [
            demo::HEIGHT_MM - VIEW_HALF_MM,
            demo::HEIGHT_MM + VIEW_HALF_MM,
        ],
        disc_area_mm2: 0.25,
    };
    let zones = compare(&World::new(config).expect("a world"), &judged);
    flanks.map(|id| zones[&id])
}

/// The die in slices of a millimetre, with the upper half of a flank deeper by 80 µm.
fn half_worn() -> Mesh {
    let gear = demo::gear();
    let mut mesh = sliced(66);
    for p in &mut mesh.vertices {
        let radius = p[0].hypot(p[1]);
        let on_flank = (gear.tip_radius_mm - 1e-6..gear.root_radius_mm + 1e-6).contains(&radius);
        let off_rad = p[1].atan2(p[0]).rem_euclid(std::f64::consts::TAU)
            - gear.flank_angle_rad(TOOTH, Flank::Left, radius);
        if on_flank && off_rad.abs() < 1e-6 && p[2] > demo::HEIGHT_MM + 0.5 {
            let [nx, ny] = gear.flank_normal(TOOTH, Flank::Left, radius);
            p[0] -= 0.080 * nx;
            p[1] -= 0.080 * ny;
        }
    }
    mesh
}

fn sliced(axial_slices: u32) -> Mesh {
    demo::gear()
        .mesh(&Meshing {
            axial_slices,
            ..Meshing::default()
        })
        .expect("the demo gear")
}

/// The triangles of the teeth around tooth 40, 8 mm to each side of where the head looks: a sheet with edges.
fn cut_out(mut mesh: Mesh) -> Mesh {
    let middle_rad = demo::gear().tooth_centre_rad(TOOTH);
    let vertices = &mesh.vertices;
    mesh.triangles.retain(|t| {
        t.iter().all(|&v| {
            let [x, y, z] = vertices[v as usize];
            let off_rad = (y * middle_rad.cos() - x * middle_rad.sin())
                .atan2(x * middle_rad.cos() + y * middle_rad.sin());
            x.hypot(y) < 45.0 && off_rad.abs() < 0.3 && (z - demo::HEIGHT_MM).abs() < 8.5
        })
    });
    mesh
}

#[test]
fn the_cad_itself_as_a_mesh_gives_the_same_frames() {
    let (drawn, cores) = photographed(&config());
    let (standing, cores_too) = photographed(&with_mesh(config().cad));
    assert_eq!(drawn, standing);
    assert!(cores > 10_000, "{cores} cores on the tooth");
    // Attribution goes by the place, not by the triangle: the flank's very rim may count as land.
    assert!(
        cores.abs_diff(cores_too) < cores / 100,
        "{cores} and {cores_too}"
    );
    for zone in zones(&with_mesh(config().cad)) {
        assert_eq!(zone.missing_ratio, 0.0);
        assert!(zone.zone_max_wear_um.is_some_and(|um| um.abs() < 1e-6));
    }
}

#[test]
fn winding_and_triangulation_do_not_matter() {
    let (frame, _) = photographed(&with_mesh(sliced(66)));
    let mut inverted = sliced(66);
    for t in &mut inverted.triangles {
        t.swap(0, 1);
    }
    assert_eq!(frame, photographed(&with_mesh(inverted)).0);
    let mut mixed = sliced(66);
    for t in mixed.triangles.iter_mut().step_by(3) {
        t.swap(1, 2);
    }
    assert_eq!(frame, photographed(&with_mesh(mixed)).0);
    // Other slices cut the same surface: a ray meets it where it did, to rounding, and a count may round the other way.
    let (other, _) = photographed(&with_mesh(sliced(7)));
    let differing = frame.iter().zip(&other).filter(|(a, b)| a != b);
    let (count, largest) = differing.fold((0, 0), |(count, largest), (a, b)| {
        (count + 1, a.abs_diff(*b).max(largest))
    });
    assert!(
        largest <= 1 && count < frame.len() / 1000,
        "{count} pixels differ by up to {largest}"
    );
}

#[test]
fn half_a_flank_deeper_by_80_um_is_80_um() {
    let closed = half_worn();
    let mut inverted = closed.clone();
    for t in &mut inverted.triangles {
        t.swap(0, 1);
    }
    for mesh in [closed.clone(), inverted, cut_out(closed)] {
        let is_closed = DieMesh::new(mesh.clone()).expect("a die").is_closed();
        let [worn, sound] = zones(&with_mesh(mesh));
        println!("closed {is_closed}: {worn:?}");
        let near = |got: Option<f64>, um: f64, by: f64| {
            assert!(
                got.is_some_and(|got| (got - um).abs() <= by),
                "{got:?} against {um}"
            );
        };
        near(worn.max_disc_wear_um, 80.0, CHORD_UM);
        near(worn.zone_max_wear_um, 80.0, CHORD_UM);
        near(worn.max_disc_proud_um, 0.0, 1e-6);
        // Sound up to 33 mm, a slope over one slice, then 3 of 8 mm.
        near(worn.zone_mean_wear_um, 80.0 * 3.5 / 8.0, CHORD_UM);
        near(sound.zone_max_wear_um, 0.0, 1e-6);
        assert_eq!(worn.missing_ratio, 0.0);
    }
}

#[test]
fn what_is_missing_is_said_to_be_missing() {
    // Nothing left above 35 mm: a quarter of the zone.
    let mut mesh = cut_out(sliced(66));
    let vertices = &mesh.vertices;
    mesh.triangles
        .retain(|t| t.iter().all(|&v| vertices[v as usize][2] <= 35.0));
    for zone in zones(&with_mesh(mesh)) {
        assert!((zone.missing_ratio - 0.25).abs() < 1e-3, "{zone:?}");
        assert!(zone.max_disc_wear_um.is_some_and(|um| um.abs() < 1e-6));
    }
    // Another place altogether.
    let mut mesh = sliced(1);
    mesh.vertices.iter_mut().for_each(|p| p[2] += 200.0);
    for zone in zones(&with_mesh(mesh)) {
        assert_eq!(zone.missing_ratio, 1.0);
        assert_eq!(
            (zone.max_disc_wear_um, zone.zone_mean_wear_um),
            (None, None)
        );
    }
}

#[test]
fn an_open_die_is_seen_and_the_inside_of_a_closed_one_is_not() {
    let (frame, cores) = photographed(&with_mesh(sliced(66)));
    let (open, cores_open) = photographed(&with_mesh(cut_out(sliced(66))));
    assert_eq!(cores, cores_open);
    // What the head sees beyond the cut is dark, the tooth itself is as before.
    let same = frame.iter().zip(&open).filter(|(a, b)| a == b).count();
    assert!(same > frame.len() * 9 / 10, "{same} of {}", frame.len());

    // A box around the head: from inside its material nothing is seen; with its lid off it has no inside.
    let corner = |i: u32| [0, 1, 2].map(|k| if i >> k & 1 == 1 { 42.0 } else { -42.0 });
    let faces = [
        [0, 1, 3, 2],
        [4, 6, 7, 5],
        [0, 4, 5, 1],
        [2, 3, 7, 6],
        [0, 2, 6, 4],
        [1, 5, 7, 3],
    ];
    let mut around = Mesh {
        vertices: (0..8)
            .map(|i| corner(i).map(f64::from))
            .map(|[x, y, z]| [x, y, z + demo::HEIGHT_MM])
            .collect(),
        triangles: faces
            .into_iter()
            .flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]])
            .collect(),
    };
    let seen = |mesh: &Mesh| {
        let world = World::new(&with_mesh(mesh.clone())).expect("a world");
        let view = world
            .prepare(0.0, demo::HEIGHT_MM, &PatternSpec::insitu12())
            .expect("a view");
        world.truth(&view).len()
    };
    assert_eq!(seen(&around), 0, "closed");
    around.triangles.drain(..2);
    assert!(seen(&around) > 50_000, "open");
}

#[test]
fn form_and_growth_apply_to_a_mesh_and_wear_does_not() {
    let mut config = with_mesh(sliced(66));
    config.growth = 1.0005;
    let [left, _] = zones(&config);
    // The truth is about the die at the temperature of its drawing.
    assert!(left.zone_max_wear_um.is_some_and(|um| um.abs() < 1e-6));
    config.form.ovality_um = 20.0;
    // Tooth 40 stands at 169 degrees: there an oval bore is wider by 10 µm times cos(2 x 169), and a flank loses of that the
    // sine of its pressure angle.
    let gear = &config.gear;
    let wider_um = 10.0 * (2.0 * gear.tooth_centre_rad(TOOTH)).cos();
    let sine = |r: f64| (gear.base_radius_mm() / r).acos().sin();
    let zone_mm = [
        gear.tip_radius_mm + 0.1 * gear.module_mm,
        gear.pitch_radius_mm() + 0.75 * gear.module_mm,
    ];
    let [least, most] = zone_mm.map(|r| wider_um * sine(r));
    let [across, _] = zones(&config);
    let near = |got: Option<f64>, um: f64| {
        // Half a tooth more or less is 1 degree of 20 µm.
        assert!(
            got.is_some_and(|got| (got - um).abs() < 0.2),
            "{got:?} {um}"
        );
    };
    near(across.zone_max_wear_um, most);
    near(across.zone_mean_wear_um, 0.5 * (least + most));
    config.wear = vec!["40:left:10".parse().expect("valid")];
    let refused = World::new(&config).err();
    assert_eq!(refused, Some(WorldError::WearOnMesh { got: 1 }));
}

/// A PLY file of the mesh in one of the three encodings.
fn ply(mesh: &Mesh, encoding: &str) -> Vec<u8> {
    let mut bytes = format!(
        "ply\nformat {encoding} 1.0\nelement vertex {}\nproperty double x\nproperty double y\nproperty double z\n\
         element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        mesh.vertices.len(),
        mesh.triangles.len()
    )
    .into_bytes();
    for p in &mesh.vertices {
        match encoding {
            "ascii" => bytes.extend(format!("{} {} {}\n", p[0], p[1], p[2]).bytes()),
            "binary_big_endian" => bytes.extend(p.iter().flat_map(|x| x.to_be_bytes())),
            _ => bytes.extend(p.iter().flat_map(|x| x.to_le_bytes())),
        }
    }
    for t in &mesh.triangles {
        match encoding {
            "ascii" => bytes.extend(format!("3 {} {} {}\n", t[0], t[1], t[2]).bytes()),
            "binary_big_endian" => {
                bytes.push(3);
                bytes.extend(t.iter().flat_map(|i| i.to_be_bytes()));
            }
            _ => {
                bytes.push(3);
                bytes.extend(t.iter().flat_map(|i| i.to_le_bytes()));
            }
        }
    }
    bytes
}

fn text_stl(mesh: &Mesh) -> Vec<u8> {
    let mut text = String::from("solid die\n");
    for t in &mesh.triangles {
        text += "facet normal 0 0 0\nouter loop\n";
        for &v in t {
            let [x, y, z] = mesh.vertices[v as usize];
            text += &format!("vertex {x} {y} {z}\n");
        }
        text += "endloop\nendfacet\n";
    }
    text += "endsolid die\n";
    text.into_bytes()
}

fn load(folder: &Path, name: &str, bytes: &[u8]) -> Result<DieMesh, DieFileError> {
    let path = folder.join(name);
    std::fs::write(&path, bytes).expect("a file");
    die_file::load(&path)
}

#[test]
fn every_format_gives_the_same_die() {
    let folder = tempfile::tempdir().expect("a folder");
    let mesh = sliced(1);
    let mut files = vec![("text.stl", text_stl(&mesh))];
    for encoding in ["ascii", "binary_little_endian", "binary_big_endian"] {
        files.push((encoding, ply(&mesh, encoding)));
    }
    let mut written = Vec::new();
    write_ply(&mesh, &mut written).expect("in memory");
    files.push(("own.ply", written.clone()));
    for (name, bytes) in files {
        let die = load(folder.path(), name, &bytes).unwrap_or_else(|error| panic!("{error}"));
        assert!(die.is_closed(), "{name}");
        assert_eq!(die.degenerate(), 0, "{name}");
        let corners = |mesh: &Mesh| -> Vec<[[f64; 3]; 3]> {
            let of = |t: &[u32; 3]| t.map(|v| mesh.vertices[v as usize].map(|x| x + 0.0));
            mesh.triangles.iter().map(of).collect()
        };
        assert_eq!(corners(die.mesh()), corners(&mesh), "{name}");
    }
    // Binary STL has single precision: 4 nm at 88 mm.
    let mut bytes = Vec::new();
    write_stl(&mesh, "die", &mut bytes).expect("in memory");
    let die = load(folder.path(), "binary.stl", &bytes).unwrap_or_else(|error| panic!("{error}"));
    assert!(die.is_closed());
    assert_eq!(die.mesh().triangles.len(), mesh.triangles.len());
}

#[test]
fn files_that_are_no_die_are_refused_by_name() {
    let folder = tempfile::tempdir().expect("a folder");
    let mesh = sliced(1);
    let refused = |name: &str, bytes: &[u8], words: &[&str]| {
        let error = load(folder.path(), name, bytes).expect_err(name);
        let text = error.to_string();
        println!("{text}");
        assert!(text.contains(name), "{text}");
        for word in words {
            assert!(text.contains(word), "{text:?} does not say {word:?}");
        }
    };
    refused("empty.ply", b"", &["empty"]);
    refused(
        "picture.png",
        b"\x89PNG\r\n\x1a\n and so on",
        &["not a mesh"],
    );
    let whole = ply(&mesh, "binary_little_endian");
    refused("half.ply", &whole[..whole.len() / 2], &["face", "bytes"]);
    let mut bytes = Vec::new();
    write_stl(&mesh, "die", &mut bytes).expect("in memory");
    refused("half.stl", &bytes[..bytes.len() / 2], &["truncated"]);
    let mut nan = mesh.clone();
    nan.vertices[7][1] = f64::NAN;
    for encoding in ["ascii", "binary_little_endian", "binary_big_endian"] {
        refused("nan.ply", &ply(&nan, encoding), &["NaN"]);
    }
    bytes[84 + 50 * 3 + 16..84 + 50 * 3 + 20].copy_from_slice(&f32::NAN.to_le_bytes());
    refused("nan.stl", &bytes, &["NaN"]);
    let mut index = mesh.clone();
    index.triangles[5][2] = 4_000_000;
    refused("index.ply", &ply(&index, "ascii"), &["4000000"]);
    let negative = String::from_utf8(ply(&mesh, "ascii")).expect("text") + "";
    let last = negative.trim_end().rfind('\n').expect("lines");
    let negative = format!("{}\n3 0 1 -5\n", &negative[..last]);
    refused("negative.ply", negative.as_bytes(), &["-5"]);
    let mut metres = mesh.clone();
    metres
        .vertices
        .iter_mut()
        .flatten()
        .for_each(|x| *x *= 1e-3);
    refused("metres.ply", &ply(&metres, "ascii"), &["millimetres"]);
    let mut far = mesh.clone();
    far.vertices.iter_mut().for_each(|p| p[0] += 2000.0);
    refused("far.ply", &ply(&far, "ascii"), &["1000"]);
    let mut flat = mesh.clone();
    flat.triangles.iter_mut().for_each(|t| t[1] = t[0]);
    refused("flat.ply", &ply(&flat, "ascii"), &["degenerate"]);

    // Told by the header, before anything is read or allocated.
    let many = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
                element face 5000001\nproperty list uchar int vertex_indices\nend_header\n";
    refused("many.ply", many.as_bytes(), &["5000001", "5000000"]);
    let path = folder.path().join("many.stl");
    let file = std::fs::File::create(&path).expect("a file");
    // A sparse file: 250 MB that take no space.
    file.set_len(84 + 50 * 5_000_001).expect("a length");
    std::os::unix::fs::FileExt::write_at(&file, &5_000_001u32.to_le_bytes(), 80).expect("a count");
    let text = die_file::load(&path).expect_err("too many").to_string();
    assert!(text.contains("5000001"), "{text}");

    let missing = die_file::load(&folder.path().join("missing.stl"));
    assert!(matches!(missing, Err(DieFileError::Read { .. })));
    let is_folder = die_file::load(folder.path());
    assert!(matches!(is_folder, Err(DieFileError::NoFile { .. })));
    file.set_len(5 << 30).expect("a length");
    let long = die_file::load(&path);
    assert!(matches!(long, Err(DieFileError::TooLong { .. })));
}
