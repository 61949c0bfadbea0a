//! The worn die against closed forms, brute force, and a mesh from another CAD kernel.

use flankscope_bench::demo;
use flankscope_bench::world::{
    Bundle, Die, FlankId, Form, HeadDesign, PatternSpec, Wear, WearError, WearField, World,
    WorldConfig, WorldError,
};
use flankscope_gear_cad::{Flank, GearSpec, Mesh, Meshing};
use flankscope_test_requisites::shared;
use std::collections::HashMap;

fn cad() -> Mesh {
    demo::gear()
        .mesh(&Meshing::default())
        .expect("the demo gear")
}

fn worn(cad: &Mesh, gear: &GearSpec, wear: &[&str]) -> Die {
    let wear: Vec<Wear> = wear
        .iter()
        .map(|w| w.parse().expect("a valid wear"))
        .collect();
    Die::as_built(
        cad,
        WearField::new(gear, &wear).expect("wear of this gear"),
        Form::default(),
    )
    .expect("a die")
}

fn assert_watertight(mesh: &Mesh) {
    let mut edges: HashMap<(u32, u32), u32> = HashMap::new();
    for t in &mesh.triangles {
        for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
            *edges.entry((a, b)).or_default() += 1;
        }
    }
    for (&(a, b), &count) in &edges {
        assert_eq!(
            count, 1,
            "edge {a}-{b} walked {count} times in one direction"
        );
        assert!(edges.contains_key(&(b, a)), "edge {a}-{b} is open");
    }
}

/// Distance of a point outside (positive) the flank that is nearest in angle: parallels of an involute are involutes of the
/// same base circle, so the distance is an angle times the base radius.
fn outside_mm(gear: &GearSpec, id: FlankId, p: [f64; 3]) -> f64 {
    let radius = p[0].hypot(p[1]);
    let angle = p[1].atan2(p[0]) - gear.tooth_centre_rad(id.tooth);
    let angle = (angle - std::f64::consts::TAU * (angle / std::f64::consts::TAU).round()).abs();
    gear.base_radius_mm() * (angle - gear.tooth_half_angle_rad(radius))
}

fn flank_vertices(die: &Die, id: FlankId) -> Vec<[f64; 3]> {
    let of_flank = (0..die.mesh().triangles.len()).filter(|&t| die.flank(t) == Some(id));
    let mut vertices: Vec<u32> = of_flank.flat_map(|t| die.mesh().triangles[t]).collect();
    vertices.sort_unstable();
    vertices.dedup();
    vertices
        .into_iter()
        .map(|v| die.mesh().vertices[v as usize])
        .collect()
}

#[test]
fn uniform_wear_moves_the_flank_to_its_parallel() {
    let (cad, gear) = (cad(), demo::gear());
    let die = worn(&cad, &gear, &["12:left:80"]);
    let id = FlankId {
        tooth: 12,
        flank: Flank::Left,
    };
    let vertices = flank_vertices(&die, id);
    assert!(vertices.len() > 20);
    for p in vertices {
        assert!(
            (outside_mm(&gear, id, p) + 0.080).abs() < 1e-9,
            "{} mm",
            outside_mm(&gear, id, p)
        );
        assert!((die.wear_at_mm(id, p) - 0.080).abs() < 1e-12);
    }
    assert_watertight(die.mesh());
    assert!(
        die.mesh().volume_mm3() < cad.volume_mm3(),
        "material is lost"
    );
}

#[test]
fn local_wear_has_its_depth_area_and_place() {
    let (cad, gear) = (cad(), demo::gear());
    let die = worn(
        &cad,
        &gear,
        &["3:right:50:pit", "5:left:40:buildup", "7:left:60:tip"],
    );
    assert_watertight(die.mesh());
    let extremes = |tooth, flank| {
        let id = FlankId { tooth, flank };
        let depths: Vec<([f64; 3], f64)> = flank_vertices(&die, id)
            .into_iter()
            .map(|p| (p, -outside_mm(&gear, id, p)))
            .collect();
        for (p, depth) in &depths {
            // The chord that was refined lies up to 0.2 µm inside the involute.
            let stated = die.wear_at_mm(id, *p);
            assert!(
                (depth - stated).abs() < 0.35e-3,
                "{tooth} {flank:?}: {depth} against {stated} at {p:?}"
            );
        }
        depths
    };
    let pit = extremes(3, Flank::Right);
    let deepest = pit.iter().map(|d| d.1).fold(0.0, f64::max);
    assert!((deepest - 0.050).abs() < 0.002, "pit of {deepest} mm");
    assert!(
        pit.iter()
            .all(|(p, depth)| *depth < 1e-3 || (p[2] - 33.0).abs() < 0.6),
        "the pit is at half height"
    );
    let buildup = extremes(5, Flank::Left);
    let highest = buildup.iter().map(|d| d.1).fold(0.0, f64::min);
    assert!(
        (highest + 0.040).abs() < 0.002,
        "built-up material of {highest} mm"
    );
    let tip = extremes(7, Flank::Left);
    let at_tip: Vec<f64> = tip
        .iter()
        .filter(|(p, _)| p[0].hypot(p[1]) < gear.tip_radius_mm + 0.03)
        .map(|d| d.1)
        .collect();
    assert!(
        !at_tip.is_empty() && at_tip.iter().all(|d| (d - 0.060).abs() < 0.008),
        "{at_tip:?}"
    );
    let inside: Vec<f64> = tip
        .iter()
        .filter(|(p, _)| p[0].hypot(p[1]) > gear.tip_radius_mm + 0.6)
        .map(|d| d.1)
        .collect();
    assert!(!inside.is_empty() && inside.iter().all(|d| d.abs() < 0.3e-3));
}

/// Volume between the worn and the CAD surface over one flank: the integral of the depth.
#[test]
fn a_pit_takes_the_volume_of_its_shape() {
    let (cad, gear) = (cad(), demo::gear());
    let die = worn(&cad, &gear, &["3:right:20:pit"]);
    // Depth (1 - x²)² over a disc of area A integrates to A/3; facets of 0.1 mm on a bowl of 1.1 mm cost some per cent.
    let lost = cad.volume_mm3() - die.mesh().volume_mm3();
    assert!(
        (lost - 0.020 / 3.0).abs() < 0.03 * 0.020 / 3.0,
        "{lost} mm3"
    );
}

#[test]
fn unworn_surface_stays_where_it_was() {
    let (cad, gear) = (cad(), demo::gear());
    let die = worn(&cad, &gear, &["3:right:50:pit", "12:left:80"]);
    let worn_ids = [
        FlankId {
            tooth: 3,
            flank: Flank::Right,
        },
        FlankId {
            tooth: 12,
            flank: Flank::Left,
        },
    ];
    let moved: Vec<usize> = (0..cad.vertices.len())
        .filter(|&v| cad.vertices[v] != die.mesh().vertices[v])
        .collect();
    assert!(!moved.is_empty());
    for v in moved {
        let p = cad.vertices[v];
        assert!(
            worn_ids
                .iter()
                .any(|&id| outside_mm(&gear, id, p).abs() < 1e-9),
            "vertex {v} at {p:?} belongs to no worn flank"
        );
    }
    let untouched = worn(&cad, &gear, &[]);
    assert_eq!(untouched.mesh(), &cad);
}

#[test]
fn every_flank_is_found() {
    let (cad, gear) = (cad(), demo::gear());
    let die = worn(&cad, &gear, &[]);
    let mut area: HashMap<FlankId, f64> = HashMap::new();
    for (t, triangle) in die.mesh().triangles.iter().enumerate() {
        if let Some(id) = die.flank(t) {
            let [a, b, c] = triangle.map(|v| die.mesh().vertices[v as usize]);
            let [u, v] = [b, c].map(|q| [0, 1, 2].map(|k| q[k] - a[k]));
            let n = [
                u[1] * v[2] - u[2] * v[1],
                u[2] * v[0] - u[0] * v[2],
                u[0] * v[1] - u[1] * v[0],
            ];
            *area.entry(id).or_default() += 0.5 * n.iter().map(|x| x * x).sum::<f64>().sqrt();
        }
    }
    assert_eq!(area.len(), 168);
    // Profile length b (t1² - t0²)/2 times the height.
    let base = gear.base_radius_mm();
    let [t0, t1] = [gear.tip_radius_mm, gear.root_radius_mm].map(|r| gear.roll_angle_rad(r));
    let expected = 0.5 * base * (t1 * t1 - t0 * t0) * 66.0;
    for (id, got) in area {
        assert!(
            (got - expected).abs() < 1e-3 * expected,
            "{id:?}: {got} against {expected} mm2"
        );
    }
}

#[test]
fn the_truth_is_what_brute_force_finds() {
    let mut config = demo::world_config().expect("the demo");
    config.wear = vec![
        "12:left:80".parse().expect("valid"),
        "12:right:50:pit".parse().expect("valid"),
    ];
    let world = World::new(&config).expect("a world");
    let (rotation_rad, vertical_mm) = (-config.gear.tooth_centre_rad(12) + 1e-4, 33.005);
    let view = world
        .prepare(rotation_rad, vertical_mm, &PatternSpec::insitu12())
        .expect("a view");
    let mesh = world.die().mesh();
    let eye = {
        // Rz(-phi) of (19.5, 0, vertical).
        let (sin, cos) = rotation_rad.sin_cos();
        [19.5 * cos, -19.5 * sin, vertical_mm]
    };
    let truth = world.truth(&view);
    let mut seen_worn = 0;
    for t in truth.iter().step_by(997) {
        let along = [0, 1, 2].map(|k| t.point_tool_mm[k] - eye[k]);
        let first = mesh
            .triangles
            .iter()
            .filter_map(|tri| crossing(eye, along, tri.map(|v| mesh.vertices[v as usize])))
            .fold(f64::INFINITY, f64::min);
        // In units of the distance to the stated point (some 22 mm): 1e-9 is far below a nanometre.
        assert!(
            (first - 1.0).abs() < 1e-9,
            "core {}: first crossing at {first}",
            t.core
        );
        let Some(id) = t.flank else { continue };
        let depth = -outside_mm(&config.gear, id, t.point_tool_mm);
        assert!(
            (depth - t.wear_mm).abs() < 0.35e-3,
            "core {}: {depth} against {}",
            t.core,
            t.wear_mm
        );
        seen_worn += usize::from(t.wear_mm > 0.0);
    }
    assert!(seen_worn > 5, "{seen_worn} worn samples");
    // Both flanks of the centred tooth are seen and lit alike.
    let lit = |flank| {
        truth
            .iter()
            .filter(|t| t.lit && t.flank == Some(FlankId { tooth: 12, flank }))
            .count() as f64
    };
    let (left, right) = (lit(Flank::Left), lit(Flank::Right));
    assert!(
        left > 5000.0 && (left / right - 1.0).abs() < 0.1,
        "{left} and {right} cores"
    );
}

/// Where a ray crosses a triangle: signed volumes, no shared code with the world.
fn crossing(origin: [f64; 3], along: [f64; 3], [a, b, c]: [[f64; 3]; 3]) -> Option<f64> {
    let minus = |p: [f64; 3], q: [f64; 3]| [0, 1, 2].map(|k| p[k] - q[k]);
    let volume = |u: [f64; 3], v: [f64; 3], w: [f64; 3]| {
        u[0] * (v[1] * w[2] - v[2] * w[1])
            + u[1] * (v[2] * w[0] - v[0] * w[2])
            + u[2] * (v[0] * w[1] - v[1] * w[0])
    };
    let [pa, pb, pc] = [a, b, c].map(|p| minus(p, origin));
    let (x, y, z) = (
        volume(along, pa, pb),
        volume(along, pb, pc),
        volume(along, pc, pa),
    );
    let total = x + y + z;
    let same_side = (x >= 0.0 && y >= 0.0 && z >= 0.0) || (x <= 0.0 && y <= 0.0 && z <= 0.0);
    let t = volume(pa, pb, pc) / total;
    (total != 0.0 && same_side && t > 0.0).then_some(t)
}

#[test]
fn bundles_have_the_statistics_they_are_drawn_from() {
    let made = HeadDesign::demo();
    let spec = made.bundle(&made.camera);
    let bundle = Bundle::camera(&spec, 7).expect("a bundle");
    assert_eq!(bundle.positions_px().len(), 100_000);
    let pitch = spec.pitch_px();
    assert!((pitch - 3.46).abs() < 0.01, "{pitch}");
    // Mean distance of lattice neighbours is the pitch (jitter adds its square: 0.05² = 0.25 %).
    let mut distances = Vec::new();
    for (core, ring) in bundle.neighbours().iter().enumerate() {
        for &other in ring.iter().filter(|&&n| n as usize != core) {
            let (p, q) = (
                bundle.positions_px()[core],
                bundle.positions_px()[other as usize],
            );
            distances.push((p[0] - q[0]).hypot(p[1] - q[1]));
        }
    }
    let mean = distances.iter().sum::<f64>() / distances.len() as f64;
    let spread =
        (distances.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / distances.len() as f64).sqrt();
    assert!((mean / pitch - 1.0).abs() < 0.005, "{mean}");
    // Two ends jitter along the line between them.
    let expected = 0.05 * pitch * 2f64.sqrt();
    assert!(
        (spread / expected - 1.0).abs() < 0.03,
        "{spread} against {expected}"
    );
    let complete = bundle
        .neighbours()
        .iter()
        .enumerate()
        .filter(|(c, ring)| ring.iter().all(|&n| n as usize != *c))
        .count();
    assert!(
        complete > 98_500,
        "{complete} cores have all six neighbours"
    );

    let outermost = bundle
        .positions_px()
        .iter()
        .map(|p| (p[0] - 959.5).hypot(p[1] - 599.5))
        .fold(0.0, f64::max);
    assert!((outermost - 575.0).abs() < pitch, "{outermost}");
    let dead = bundle.gains().iter().filter(|&&g| g == 0.0).count() as f64;
    // 100 of 100 000, five standard deviations of a Poisson number.
    assert!((dead - 100.0).abs() < 50.0, "{dead} dead cores");
    let alive: Vec<f64> = bundle
        .gains()
        .iter()
        .filter(|&&g| g > 0.0)
        .map(|&g| f64::from(g))
        .collect();
    let gain = alive.iter().sum::<f64>() / alive.len() as f64;
    let gain_spread =
        (alive.iter().map(|g| (g - gain).powi(2)).sum::<f64>() / alive.len() as f64).sqrt();
    assert!(
        (gain - 1.0).abs() < 0.002 && (gain_spread - 0.10).abs() < 0.003,
        "{gain} {gain_spread}"
    );

    // Cross-talk conserves light away from the rim and reaches exactly the six neighbours.
    let middle = (0..100_000)
        .min_by(|&a, &b| {
            let off = |i: usize| {
                (bundle.positions_px()[i][0] - 959.5).hypot(bundle.positions_px()[i][1] - 599.5)
            };
            off(a).total_cmp(&off(b))
        })
        .expect("cores");
    let mut light = vec![[0f32]; 100_000];
    light[middle] = [1.0];
    let mixed = bundle.with_crosstalk(&light);
    assert!((mixed[middle][0] - 0.97).abs() < 1e-6);
    for &n in &bundle.neighbours()[middle] {
        assert!((mixed[n as usize][0] - 0.005).abs() < 1e-6);
    }
    assert!((mixed.iter().map(|l| f64::from(l[0])).sum::<f64>() - 1.0).abs() < 1e-5);

    // A neighbourhood query misses no core.
    for at in [[959.5, 599.5], [400.0, 600.0], [1200.0, 250.0]] {
        let inside = |i: &usize| {
            let p = bundle.positions_px()[*i];
            (p[0] - at[0]).hypot(p[1] - at[1]) < 9.0
        };
        let found = bundle.near(at, 9.0).flatten().filter(inside).count();
        assert_eq!(found, (0..100_000).filter(inside).count(), "around {at:?}");
    }
    let other = Bundle::projector(&spec, 7).expect("a bundle");
    assert_ne!(
        other.positions_px(),
        bundle.positions_px(),
        "the two bundles are independent"
    );
}

#[test]
fn what_no_die_can_be_is_named() {
    let (cad, gear) = (cad(), demo::gear());
    let missing = "85:left:10".parse::<Wear>().expect("reads");
    assert_eq!(
        WearField::new(&gear, &[missing]).err(),
        Some(WearError::NoSuchTooth { got: 85, teeth: 84 })
    );
    let build = |cad: &Mesh, wear: &str| {
        Die::as_built(
            cad,
            WearField::new(&gear, &[wear.parse().expect("reads")]).expect("fits"),
            Form::default(),
        )
        .err()
    };
    let mut metres = cad.clone();
    metres
        .vertices
        .iter_mut()
        .for_each(|v| *v = v.map(|x| x * 1e-3));
    assert!(matches!(
        build(&metres, "3:left:10"),
        Some(WorldError::FlankNotFound { tooth: 3, .. })
    ));
    let mut nan = cad.clone();
    nan.vertices[17][1] = f64::NAN;
    assert!(matches!(
        build(&nan, "3:left:10"),
        Some(WorldError::Vertex { vertex: 17, .. })
    ));
    let mut index = cad.clone();
    index.triangles[5][2] = 4_000_000;
    assert!(matches!(
        build(&index, "3:left:10"),
        Some(WorldError::Index {
            triangle: 5,
            got: 4_000_000,
            ..
        })
    ));
    assert_eq!(
        build(&Mesh::default(), "3:left:10"),
        Some(WorldError::EmptyMesh)
    );
}

#[test]
fn a_ring_from_another_cad_kernel_wears_and_is_seen() {
    let Some(file) = shared("data/cad-ring84/ring84.stl") else {
        return;
    };
    let bytes = std::fs::read(file).expect("readable");
    let cad = welded_stl(&bytes);
    let gear = GearSpec {
        module_mm: 1.0,
        tip_radius_mm: 41.0,
        root_radius_mm: 43.25,
        body_radius_mm: 51.25,
        ..demo::gear()
    };
    let die = worn(&cad, &gear, &["40:left:80", "40:right:30:pit"]);
    assert_watertight(die.mesh());
    let ids: std::collections::BTreeSet<FlankId> = (0..die.mesh().triangles.len())
        .filter_map(|t| die.flank(t))
        .collect();
    assert_eq!(ids.len(), 168, "flanks found");
    let id = FlankId {
        tooth: 40,
        flank: Flank::Left,
    };
    for p in flank_vertices(&die, id) {
        // Single precision coordinates: 4e-6 mm; the kernel's own vertices are 0.1 µm off at worst.
        assert!(
            (outside_mm(&gear, id, p) + 0.080).abs() < 0.15e-3,
            "{}",
            outside_mm(&gear, id, p)
        );
    }
    let mut config = WorldConfig::new(cad, gear);
    config.wear = vec!["40:left:80".parse().expect("valid")];
    let world = World::new(&config).expect("a world");
    let view = world
        .prepare(
            -config.gear.tooth_centre_rad(40),
            33.0,
            &PatternSpec::insitu12(),
        )
        .expect("a view");
    let seen = world
        .truth(&view)
        .iter()
        .filter(|t| t.lit && t.flank == Some(id) && (t.wear_mm - 0.08).abs() < 1e-12)
        .count();
    assert!(seen > 5000, "{seen} cores on the worn flank");
}

/// A binary STL with equal corners merged.
fn welded_stl(bytes: &[u8]) -> Mesh {
    let mut mesh = Mesh::default();
    let mut known: HashMap<[u32; 3], u32> = HashMap::new();
    for record in bytes[84..].chunks_exact(50) {
        let value = |i: usize| {
            f32::from_le_bytes(
                record[12 + 4 * i..16 + 4 * i]
                    .try_into()
                    .expect("four bytes"),
            )
        };
        let corner = |c: usize| [value(3 * c), value(3 * c + 1), value(3 * c + 2)];
        mesh.triangles.push([0, 1, 2].map(|c| {
            let p = corner(c);
            *known
                .entry(p.map(|x| (x + 0.0).to_bits()))
                .or_insert_with(|| {
                    mesh.vertices.push(p.map(f64::from));
                    mesh.vertices.len() as u32 - 1
                })
        }));
    }
    mesh
}
