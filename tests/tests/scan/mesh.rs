//! `scan --mesh --mesh-mm`: a mesh of the measured surface at a chosen resolution, tight where it was seen, and as far from the true
//! surface as it says.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use flankscope_gear_cad::{Meshing, write_ply};
use flankscope_metrology::io::Unit;
use flankscope_metrology::io::mesh;
use flankscope_tests::{bench, demo_gear, flankscope, run};

const OVALITY_UM: f64 = 20.0;
const SPACING_MM: f64 = 0.1;

#[test]
fn a_mesh_has_the_spacing_that_was_asked_for_no_cracks_and_the_true_surface_within_its_uncertainty()
{
    if !flankscope_test_requisites::dear() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mesh.ply");
    let args = ["scan", "--quiet", "--json", "-", "--speed", "max"];
    let mesh = ["--mesh", path.to_str().unwrap(), "--mesh-mm", "0.1"];
    let oval = bench("[die]\novality_um = 20.0\n");
    let mut scan = flankscope();
    scan.args(args).args(["--views", "12x1", "--gear"]);
    let scanned = run(scan.args(mesh).args(oval));
    let mesh = mesh::load(&path, Unit::Mm);
    let mesh = mesh.unwrap_or_else(|error| panic!("{error}: {}", scanned.stderr));
    let mut edges: BTreeMap<(u32, u32), usize> = BTreeMap::new();
    for &[a, b, c] in &mesh.triangles {
        for edge in [(a, b), (b, c), (c, a)] {
            *edges.entry(edge).or_default() += 1;
        }
    }
    assert!(
        edges.values().all(|&times| times == 1),
        "triangles overlap or face each other"
    );
    let open: Vec<_> = edges
        .keys()
        .filter(|&&(a, b)| !edges.contains_key(&(b, a)))
        .collect();
    // Twelve fields of 10 mm, some 8 teeth of profile wide: their rims and what teeth hide are open, the rest is tight.
    assert!(
        open.len() * 10 < edges.len(),
        "{} of {}",
        open.len(),
        edges.len()
    );
    // Along the profile and the axis, neighbours are as far apart as was asked for.
    let at = |vertex: u32| mesh.vertices[vertex as usize];
    let length = |&(a, b): &(u32, u32)| {
        let (p, q) = (at(a), at(b));
        (0..3).map(|k| (p[k] - q[k]).powi(2)).sum::<f64>().sqrt()
    };
    let mut lengths: Vec<f64> = edges.keys().map(length).collect();
    lengths.sort_by(f64::total_cmp);
    let median = lengths[lengths.len() / 2];
    assert!((0.8..1.5).contains(&(median / SPACING_MM)), "{median}");
    // On the flanks, closed form: an involute turned by an angle moves by it times the base radius along its normals, and a radius that
    // grows by so much takes the surface back by the sine of the pressure angle there.
    let gear = demo_gear();
    let base_mm = 41.45 * 20f64.to_radians().cos();
    let u95_um = scanned.json["gear"]["u95_um"].as_f64().unwrap();
    let inner: BTreeSet<u32> = {
        let rim: BTreeSet<u32> = open.iter().flat_map(|&&(a, b)| [a, b]).collect();
        edges
            .keys()
            .map(|edge| edge.0)
            .filter(|v| !rim.contains(v))
            .collect()
    };
    let (mut within, mut all, mut squares) = (0, 0, 0.0);
    for &vertex in &inner {
        let [x, y, _] = at(vertex);
        let (radius, angle): (f64, f64) = (x.hypot(y), y.atan2(x));
        if !(gear.tip_radius_mm + 0.15..gear.root_radius_mm - 0.15).contains(&radius) {
            continue;
        }
        let tooth = (angle.rem_euclid(std::f64::consts::TAU) / gear.pitch_angle_rad()) as u32 + 1;
        let off = |flank: flankscope_gear_cad::Flank, sign: f64| {
            let off = angle - gear.flank_angle_rad(tooth, flank, radius);
            let off = (off + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU)
                - std::f64::consts::PI;
            1e3 * sign * base_mm * off
        };
        let left = off(flankscope_gear_cad::Flank::Left, 1.0);
        let right = off(flankscope_gear_cad::Flank::Right, -1.0);
        let deviation_um = if left.abs() < right.abs() {
            left
        } else {
            right
        };
        let grown_um = 0.5 * OVALITY_UM * (2.0 * angle).cos();
        let expected_um = -grown_um * (1.0 - (base_mm / radius).powi(2)).sqrt();
        let error_um = deviation_um - expected_um;
        all += 1;
        // 2 µm of noise in a cell of a few points, beside what they share.
        within += usize::from(error_um.abs() <= u95_um.hypot(1.96 * 2.0));
        squares += error_um * error_um;
    }
    assert!(all > 20_000, "{all}");
    let rms_um = (squares / f64::from(all)).sqrt();
    assert!(
        within as f64 >= 0.95 * f64::from(all),
        "{within} of {all}, rms {rms_um} µm"
    );
}

/// The demo die whose bore is larger all around by so much, mm.
fn larger_bore(path: &Path, by_mm: f64) {
    let mut mesh = demo_gear().mesh(&Meshing::default()).unwrap();
    for p in &mut mesh.vertices {
        let radius = p[0].hypot(p[1]);
        if radius < 50.0 {
            let [x, y] = [p[0], p[1]].map(|x| x * (radius + by_mm) / radius);
            (p[0], p[1]) = (x, y);
        }
    }
    let mut bytes = Vec::new();
    write_ply(&mesh, &mut bytes).unwrap();
    std::fs::write(path, bytes).unwrap();
}

/// Place, normal, deviation and standard uncertainty of every cell of a map.ply: three doubles, three floats, three bytes of
/// colour, three floats.
fn cells_of_map(path: &Path) -> Vec<([f64; 3], [f64; 3], f64, f64)> {
    let bytes = std::fs::read(path).unwrap();
    let end = b"end_header\n";
    let body = bytes.windows(end.len()).position(|w| w == end).unwrap() + end.len();
    let record = |cell: &[u8]| {
        let double = |at: usize| f64::from_le_bytes(cell[at..at + 8].try_into().unwrap());
        let float = |at: usize| f64::from(f32::from_le_bytes(cell[at..at + 4].try_into().unwrap()));
        (
            [0, 8, 16].map(double),
            [24, 28, 32].map(float),
            float(39),
            float(43),
        )
    };
    bytes[body..].chunks_exact(51).map(record).collect()
}

/// The poses take up how large the bore is as a whole: the map's uncertainty says so, in every cell.
#[test]
fn a_bore_larger_than_its_cad_lies_within_the_uncertainty_of_its_map() {
    const LARGER_MM: f64 = 20e-3;
    let folder = tempfile::tempdir().unwrap();
    let die = folder.path().join("die.ply");
    larger_bore(&die, LARGER_MM);
    for (name, by_mm) in [("larger", LARGER_MM), ("drawn", 0.0)] {
        let at = |what: &str| folder.path().join(format!("{name}-{what}"));
        let (report, session) = (at("report"), at("session"));
        let mut scan = flankscope();
        scan.args(["scan", "--quiet", "--json", "-", "--speed", "max"]);
        scan.args(["--views", "12x1", "--report"]).arg(&report);
        scan.arg("--session").arg(session);
        if by_mm > 0.0 {
            scan.arg("--die-mesh").arg(&die);
        }
        let scanned = run(&mut scan);
        assert_eq!(scanned.code, 0, "{name}: {}", scanned.stderr);
        let cells = cells_of_map(&report.join("map.ply"));
        assert!(cells.len() > 10_000, "{}", cells.len());
        let within = cells
            .iter()
            .filter(|([x, y, _], [nx, ny, _], found_mm, sigma_mm)| {
                let true_mm = by_mm * (nx * x + ny * y) / x.hypot(*y);
                (found_mm - true_mm).abs() <= 1.96 * sigma_mm
            });
        let share = within.count() as f64 / cells.len() as f64;
        assert!(share >= 0.9, "{name}: {share}");
        let form = &scanned.json["form"];
        let [size_um, u95_um] = ["size_um", "size_u95_um"].map(|key| form[key].as_f64().unwrap());
        assert!((size_um - 1e3 * by_mm).abs() <= u95_um, "{name}: {form}");
    }
}

#[test]
fn a_spacing_that_no_mesh_can_have_is_named_before_anything_moves() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mesh.ply");
    for spacing in ["0.0001", "3", "nan"] {
        let args = [
            "scan",
            "--quiet",
            "--views",
            "12x1",
            "--mesh",
            path.to_str().unwrap(),
            "--mesh-mm",
        ];
        let refused = run(flankscope().args(args).arg(spacing));
        assert_eq!(refused.code, 3, "{spacing}");
        let said = refused.stderr.contains("no spacing for a mesh")
            && refused.stderr.contains("right would be");
        assert!(said, "{}", refused.stderr);
        assert!(!path.exists());
    }
}
