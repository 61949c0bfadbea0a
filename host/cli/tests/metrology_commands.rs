//! `sample`, `register` and `deviation` as a user runs them: on ring gears.

mod support;

use std::path::Path;

use flankscope_gear_cad::{GearKind, GearSpec, Meshing, write_stl};
use flankscope_metrology::io::Unit;
use flankscope_metrology::io::mesh;
use flankscope_metrology::io::{cloud, ply};
use flankscope_metrology::surface::Surface;
use flankscope_test_requisites::{Random, shared};
use serde_json::Value;
use support::{flankscope, json, write_xyz};

/// Runs a test on the ring gear of 84 teeth and module 1, and on that of another CAD kernel if it is there.
fn on_every_ring84(body: impl Fn(&Path)) {
    let gear = GearSpec {
        kind: GearKind::Internal,
        teeth: 84,
        module_mm: 1.0,
        pressure_angle_rad: 20f64.to_radians(),
        tip_radius_mm: 41.0,
        root_radius_mm: 43.25,
        root_fillet_radius_mm: 0.0,
        turned_rad: 0.0,
        body_radius_mm: 51.25,
        height_mm: [0.0, 66.0],
    };
    // As coarse as the foreign one.
    let meshing = Meshing {
        chord_error_mm: 4e-3,
        ..Meshing::default()
    };
    let folder = tempfile::tempdir().unwrap();
    let own = folder.path().join("ring84.stl");
    let mut bytes = Vec::new();
    write_stl(&gear.mesh(&meshing).unwrap(), "ring gear", &mut bytes).unwrap();
    std::fs::write(&own, bytes).unwrap();
    body(&own);
    if let Some(foreign) = shared("data/cad-ring84/ring84.stl") {
        body(&foreign);
    }
}

/// The points of a sampled cloud about +x, with 10 um of noise.
fn patch(folder: &Path, cad: &str) -> Vec<[f64; 3]> {
    let args = [
        "sample", "--cad", cad, "--count", "3000000", "--seed", "5", "-o", "all.ply", "--quiet",
    ];
    assert_eq!(flankscope(folder, &args).status.code(), Some(0));
    let mut random = Random(1);
    cloud::load(&folder.join("all.ply"), Unit::Mm)
        .unwrap()
        .points
        .iter()
        .filter(|p| p[1].atan2(p[0]).abs() < 0.112 && (p[2] - 33.0).abs() < 5.0 && p[0] < 44.0)
        .map(|p| p.map(|c| c + 0.010 * random.normal()))
        .collect()
}

/// Turns by 0.4 degrees about the z direction through (42, 0) and shifts by 0.1 mm across the axis.
fn disturbed(points: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let (s, c) = 0.4f64.to_radians().sin_cos();
    points
        .iter()
        .map(|p| {
            let (x, y) = (p[0] - 42.0, p[1]);
            [42.0 + c * x - s * y + 0.06, s * x + c * y - 0.08, p[2]]
        })
        .collect()
}

#[test]
fn sampling_is_reproducible_and_on_the_surface() {
    on_every_ring84(run_sampling_is_reproducible_and_on_the_surface);
}

fn run_sampling_is_reproducible_and_on_the_surface(cad: &Path) {
    let folder = tempfile::tempdir().unwrap();
    let run = |seed: &str, file: &str| {
        let cad = cad.to_str().unwrap();
        let args = [
            "sample", "--cad", cad, "--count", "20000", "--seed", seed, "-o", file, "--json", "-",
        ];
        let output = flankscope(folder.path(), &args);
        assert_eq!(output.status.code(), Some(0), "{output:?}");
        assert_eq!(json(&output)["count"], 20000);
        std::fs::read(folder.path().join(file)).unwrap()
    };
    let first = run("7", "a.ply");
    assert_eq!(first, run("7", "b.ply"));
    assert_ne!(first, run("8", "c.ply"));
    let surface = Surface::new(&mesh::load(cad, Unit::Mm).unwrap()).unwrap();
    let points = cloud::parse(&first, Unit::Mm).unwrap().points;
    assert_eq!(points.len(), 20000);
    for p in points.iter() {
        assert!(surface.closest(*p).signed_distance_mm.abs() < 1e-12);
    }
}

#[test]
fn a_moved_patch_is_laid_back_and_its_deviation_is_the_noise() {
    on_every_ring84(run_a_moved_patch_is_laid_back);
}

fn run_a_moved_patch_is_laid_back(cad: &Path) {
    let folder = tempfile::tempdir().unwrap();
    let cad = cad.to_str().unwrap();
    let truth = patch(folder.path(), cad);
    assert!(truth.len() > 5000, "{}", truth.len());
    write_xyz(&folder.path().join("view.xyz"), &disturbed(&truth));

    let args = [
        "register",
        "--cad",
        cad,
        "--cloud",
        "view.xyz",
        "-o",
        "aligned.ply",
        "--json",
        "register.json",
    ];
    let output = flankscope(folder.path(), &args);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let report: Value =
        serde_json::from_slice(&std::fs::read(folder.path().join("register.json")).unwrap())
            .unwrap();
    assert_eq!(report["status"], "registered");
    assert_eq!(report["converged"], true);
    assert_eq!(report["teeth"], 84);
    assert!(report["elapsed_ms"]["align"].as_f64().unwrap() > 0.0);
    let weak = report["weak_directions"].as_array().unwrap();
    assert!(weak[0][5].as_f64().unwrap() > 0.999, "{weak:?}");
    assert_eq!(report["weak_prior_share"][0], 0.0);
    let aligned = cloud::load(&folder.path().join("aligned.ply"), Unit::Mm)
        .unwrap()
        .points;
    let sum: f64 = aligned
        .iter()
        .zip(&truth)
        .map(|(a, t)| (a[0] - t[0]).powi(2) + (a[1] - t[1]).powi(2))
        .sum();
    // 10 um over the root of some thousand points is 0.1 um.
    let across = (sum / truth.len() as f64).sqrt();
    assert!(across < 0.5e-3, "{across} mm");

    let args = [
        "deviation",
        "--cad",
        cad,
        "--cloud",
        "aligned.ply",
        "-o",
        "deviation.ply",
        "--json",
        "-",
    ];
    let output = flankscope(folder.path(), &args);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let report = json(&output);
    assert_eq!(report["signed"], true);
    assert_eq!(report["count"], truth.len());
    let std = report["std_mm"].as_f64().unwrap();
    assert!((std - 0.010).abs() < 0.5e-3, "{std}");
    let file = std::fs::read(folder.path().join("deviation.ply")).unwrap();
    let table = ply::read(&file, ply::Want::Extras).unwrap();
    assert_eq!(table.points, *aligned);
    assert_eq!(table.extras[0].name, "deviation");
    let surface = Surface::new(&mesh::load(Path::new(cad), Unit::Mm).unwrap()).unwrap();
    for (i, p) in aligned.iter().enumerate() {
        let expected = surface.closest(*p).signed_distance_mm;
        assert!((table.extras[0].values().nth(i).unwrap() - expected).abs() < 1e-8);
    }

    // The article's metric says something else: no sign, and half the spacing of its reference as a mean.
    let args = [
        "deviation",
        "--cad",
        cad,
        "--cloud",
        "aligned.ply",
        "--metric",
        "nearest",
        "--order",
        "inf",
        "-o",
        "n.ply",
        "--json",
        "-",
    ];
    let report = json(&flankscope(folder.path(), &args));
    assert_eq!(report["signed"], false);
    assert!(report["mean_mm"].as_f64().unwrap() > 0.05);

    // Start poses: the one that was found, and one from picked pairs.
    let args = [
        "register",
        "--cad",
        cad,
        "--cloud",
        "view.xyz",
        "--init",
        "register.json",
        "--json",
        "-",
    ];
    assert_eq!(
        json(&flankscope(folder.path(), &args))["status"],
        "registered"
    );
    let far: Vec<[f64; 3]> = truth
        .iter()
        .map(|p| [p[1] + 300.0, -p[0], p[2] - 20.0])
        .collect();
    write_xyz(&folder.path().join("far.xyz"), &far);
    let pairs: String = [0, 1000, 2000, 3000]
        .map(|i| {
            let (f, t) = (far[i], truth[i]);
            format!("{},{},{},{},{},{}\n", f[0], f[1], f[2], t[0], t[1], t[2])
        })
        .concat();
    std::fs::write(folder.path().join("pairs.csv"), pairs).unwrap();
    let args = [
        "register",
        "--cad",
        cad,
        "--cloud",
        "far.xyz",
        "--pairs",
        "pairs.csv",
        "--json",
        "-",
    ];
    assert_eq!(
        json(&flankscope(folder.path(), &args))["status"],
        "registered"
    );

    // Without a start pose the far cloud is disjoint: indeterminate, and nothing is written.
    let args = [
        "register", "--cad", cad, "--cloud", "far.xyz", "-o", "no.ply", "--json", "-",
    ];
    let output = flankscope(folder.path(), &args);
    assert_eq!(output.status.code(), Some(2));
    assert_eq!(json(&output)["reason_code"], "disjoint");
    assert!(!folder.path().join("no.ply").exists());

    // The article's method comes near, with its own noise floor.
    let args = [
        "register",
        "--cad",
        cad,
        "--cloud",
        "view.xyz",
        "--method",
        "article",
        "-o",
        "article.ply",
        "--json",
        "-",
    ];
    let output = flankscope(folder.path(), &args);
    assert_eq!(json(&output)["status"], "registered", "{output:?}");
    let laid = cloud::load(&folder.path().join("article.ply"), Unit::Mm)
        .unwrap()
        .points;
    let sum: f64 = laid
        .iter()
        .zip(&truth)
        .map(|(a, t)| (a[0] - t[0]).powi(2) + (a[1] - t[1]).powi(2))
        .sum();
    let across = (sum / truth.len() as f64).sqrt();
    assert!(across < 0.03, "{across} mm");

    // Its settings are a file's: one step of at most one, in place of many; a window that holds none of the CAD's points.
    let settle = |settings: &str, more: &[&str]| {
        std::fs::write(folder.path().join("settings.toml"), settings).unwrap();
        let base = ["register", "--cad", cad, "--cloud", "view.xyz"];
        let by = ["--article-settings", "settings.toml", "--json", "-"];
        flankscope(folder.path(), &[&base, &by[..], more].concat())
    };
    let article = ["--method", "article"];
    let many = json(&output)["iterations"].as_u64().unwrap();
    assert!(many > 1, "{many} steps");
    let one = settle("[registration]\nmost_iterations = 1\n", &article);
    assert_eq!(json(&one)["iterations"], 1, "{one:?}");
    let elsewhere = "[registration.region]\nradial_threshold_mm = 5.0\n";
    let elsewhere = settle(elsewhere, &article);
    assert_eq!(elsewhere.status.code(), Some(2));
    assert_eq!(json(&elsewhere)["reason_code"], "disjoint");
    // The article's own file, as the program writes it.
    let written = ["article", "--write-settings", "settings.toml"];
    let written = flankscope(folder.path(), &written);
    assert_eq!(written.status.code(), Some(0), "{written:?}");
    let own = std::fs::read_to_string(folder.path().join("settings.toml")).unwrap();
    let own = json(&settle(&own, &article));
    assert_eq!(own["tool_from_cloud"], json(&output)["tool_from_cloud"]);
    // Picked pairs may stand in the file, but not there and on the command line.
    let by_pairs = settle("pairs = \"pairs.csv\"\n", &article);
    assert_eq!(
        by_pairs.status.code(),
        Some(2),
        "the pairs are those of far.xyz"
    );
    for (settings, more, words) in [
        ("", &[][..], &["--article-settings", "--method article"][..]),
        (
            "",
            &["--method", "surface"],
            &["--article-settings", "--method article"],
        ),
        (
            "[registration]\nsamples = 3\n",
            &article,
            &["settings.toml:2", "samples", "100 to 10000000 points"],
        ),
        (
            "pairs = \"pairs.csv\"\n",
            &["--method", "article", "--pairs", "pairs.csv"],
            &["given twice", "--init or --pairs"],
        ),
    ] {
        support::assert_refused(folder.path(), settings, &settle(settings, more), words);
    }
}

#[test]
fn help_has_an_example_for_every_command() {
    let folder = tempfile::tempdir().unwrap();
    for command in ["sample", "register", "deviation", "merge"] {
        let output = flankscope(folder.path(), &[command, "--help"]);
        assert_eq!(output.status.code(), Some(0));
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(
            text.contains("Example:") && text.contains("--json") && text.contains("--quiet"),
            "{text}"
        );
    }
}
