//! The scan of the whole die, end to end, with few views: form kept, sessions resumed, losses named.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};

use flankscope_gear_cad::{Flank, Mesh, Meshing, write_ply};
use flankscope_test_requisites::python_with;
use flankscope_tests::{Run, bench, demo_gear, flankscope, head_of_pixels, run, with_small_head};
use serde_json::Value;

fn scan(args: &[&str]) -> Run {
    let common = ["scan", "--quiet", "--json", "-", "--speed", "max"];
    run(with_small_head(flankscope().args(common), args))
}

/// Runs [`scan`] by the built-in demo's head: only a field that shows three teeth tells the form of a die to some micrometres.
fn scan_full(args: &[&str]) -> Run {
    let common = ["scan", "--quiet", "--json", "-", "--speed", "max"];
    run(flankscope().args(common).args(args))
}

/// What stands on the bench for [`oval_and_conical`].
const FORM: &str = "[die]\novality_um = 20.0\ntaper_um = 15.0\n";

/// Twelve views in two layers of a die that is 20 µm oval and 15 µm conical, put down by hand.
fn oval_and_conical(session: &Path, report: &Path, method: &str) -> Run {
    oval_and_conical_with(session, report, method, &[])
}

fn oval_and_conical_with(session: &Path, report: &Path, method: &str, rest: &[&str]) -> Run {
    let [option, form] = bench(FORM);
    let form = ["--views", "12x2", &option, &form, "--method", method];
    let folders = [
        "--session",
        session.to_str().expect("a path in UTF-8"),
        "--report",
        report.to_str().expect("a path in UTF-8"),
    ];
    scan_full(&[&form[..], &folders, rest].concat())
}

/// At full density, every point that the session keeps stands where its view's final pose puts it.
#[test]
fn the_full_cloud_holds_every_point_of_every_view() {
    let folder = tempfile::tempdir().unwrap();
    let (session, cloud) = (
        folder.path().join("session"),
        folder.path().join("cloud.ply"),
    );
    let (session_name, cloud_name) = (session.to_str().unwrap(), cloud.to_str().unwrap());
    let scanned = scan(&[
        "--views",
        "12x1",
        "--session",
        session_name,
        "--cloud",
        cloud_name,
    ]);
    let bytes = std::fs::read(&cloud).unwrap_or_else(|_| panic!("{}", scanned.stderr));
    let end = bytes
        .windows(11)
        .position(|window| window == b"end_header\n")
        .unwrap()
        + 11;
    let manifest = std::fs::read_to_string(session.join("manifest.json")).unwrap();
    let manifest: Value = serde_json::from_str(&manifest).unwrap();
    let float = |bytes: &[u8]| f64::from(f32::from_le_bytes(bytes.try_into().unwrap()));
    let mut vertices = bytes[end..].chunks_exact(18);
    let mut views = 0;
    for view in scanned.json["registration"].as_array().unwrap() {
        let (number, pose) = (view["view"].as_u64().unwrap(), &view["tool_from_camera"]);
        if pose.is_null() {
            continue;
        }
        views += 1;
        let kept = std::fs::read(session.join(format!("view-{number:04}.points"))).unwrap();
        let points = manifest["views"][number.to_string()]["points"]
            .as_u64()
            .unwrap();
        for point in kept.chunks_exact(20).take(points as usize) {
            let p_camera = [0, 4, 8].map(|at| float(&point[at..at + 4]));
            let vertex = vertices.next().unwrap();
            for axis in 0..3 {
                let row = [0, 1, 2, 3].map(|column| pose[axis][column].as_f64().unwrap());
                let expected: f64 = (0..3).map(|k| row[k] * p_camera[k]).sum::<f64>() + row[3];
                let got = float(&vertex[4 * axis..4 * axis + 4]);
                // Single precision at 66 mm.
                assert!((got - expected).abs() < 1e-5, "{got} {expected}");
            }
            assert_eq!(vertex[12..16], point[12..16], "its uncertainty");
            assert_eq!(
                u64::from(u16::from_le_bytes([vertex[16], vertex[17]])),
                number
            );
        }
    }
    assert!(views >= 10, "{}", scanned.json["reason"]);
    assert!(vertices.next().is_none() && bytes.len() - end > 18 * 100_000);
    arrays_hold_the_same(folder.path());
}

/// The session's views once more, as arrays for NumPy: those of the PLYs.
fn arrays_hold_the_same(folder: &Path) {
    let Some(python) = python_with(&["numpy"]) else {
        return;
    };
    let at = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    let again = |ending: &str| {
        let [session, cloud, mesh] = ["session", "again", "mesh"].map(at);
        let (cloud, mesh) = (cloud + ending, mesh + ending);
        let mut args = vec!["--views", "12x1", "--session", &session];
        args.extend(["--cloud", &cloud, "--mesh", &mesh]);
        scan(&args)
    };
    again(".ply");
    again(".npz");
    let script = r#"
import numpy as np
body = lambda name: open(name, "rb").read().split(b"end_header\n", 1)[1]
cloud, ply = np.load("again.npz"), body("again.ply")
ply = np.frombuffer(ply, [("points_mm", "<f4", 3), ("sigma", "<f4"), ("view", "<u2")])
assert sorted(cloud.files) == sorted(ply.dtype.names)
assert all(np.array_equal(cloud[n], ply[n]) and cloud[n].dtype.base == ply[n].dtype.base for n in cloud.files)
mesh, ply = np.load("mesh.npz"), body("mesh.ply")
floats = ["nx", "ny", "nz", "deviation", "sigma", "views"]
vertex = np.dtype([("points_mm", "<f8", 3), *[(n, "<f4") for n in floats[:3]], ("rgb", "u1", 3), *[(n, "<f4") for n in floats[3:]]])
count = len(mesh["points_mm"])
vertices = np.frombuffer(ply, vertex, count)
assert np.array_equal(mesh["points_mm"], vertices["points_mm"]) and count > 1000
assert all(np.array_equal(mesh[n].astype("f4"), vertices[n]) for n in floats)
assert np.array_equal(np.stack([mesh[c] for c in ("red", "green", "blue")], 1), vertices["rgb"])
faces = np.frombuffer(ply, [("n", "u1"), ("at", "<u4", 3)], offset=count * vertex.itemsize)
assert np.array_equal(mesh["triangles"], faces["at"]) and len(faces) > count
"#;
    let mut said = Command::new(python);
    let said = said.current_dir(folder).args(["-c", script]);
    let said = String::from_utf8(said.output().unwrap().stderr).unwrap();
    assert!(said.is_empty(), "{said}");
}

/// The same scan, stopped from the keyboard once its first sixteen views are captured; returns how many it kept.
fn interrupted_after_the_first_capture(session: &Path) -> u64 {
    let form = bench(FORM);
    let mut command = flankscope();
    command.args(["scan", "--speed", "max", "--session"]);
    let mut running = command
        .arg(session)
        .args(["--views", "12x2"])
        .args(form)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(running.stderr.take().unwrap()).lines();
    let reached = |line: &String| line.contains("16 of 24 views");
    lines.by_ref().map(Result::unwrap).find(reached).unwrap();
    let stopped = Command::new("kill")
        .args(["-INT", &running.id().to_string()])
        .status();
    assert!(stopped.unwrap().success());
    let last: Vec<String> = lines.map(Result::unwrap).collect();
    assert_eq!(running.wait().unwrap().code(), Some(130), "{last:?}");
    let said = last.iter().find(|line| line.contains("interrupted after"));
    let said = said.unwrap_or_else(|| panic!("{last:?}"));
    let words: Vec<&str> = said.split_whitespace().collect();
    let at = words.iter().position(|word| *word == "after").unwrap();
    let kept = words[at + 1].parse().unwrap();
    assert!((16..24).contains(&kept), "{said}");
    kept
}

fn figure(run: &Run, path: &str) -> f64 {
    let value = run.json.pointer(path).and_then(serde_json::Value::as_f64);
    value.unwrap_or_else(|| panic!("{path} is missing"))
}

/// The same views, stitched the article's way: form is lost, and its metric reports its own sampling.
fn the_article_loses_the_form(run: &Run) {
    assert_eq!(run.json["methods"][0]["method"], "surface");
    assert_eq!(run.json["methods"][1]["method"], "article");
    assert_eq!(run.json["methods"][1]["registered_views"], 24);
    assert_eq!(
        figure(run, "/methods/0/form/ovality_um"),
        figure(run, "/form/ovality_um")
    );
    // Every view is free to lie where its points want: more than half of the form is gone.
    assert!(figure(run, "/methods/1/form/ovality_um") < 10.0);
    assert!(figure(run, "/methods/1/form/taper_um").abs() < 7.5);
    // Half the mean spacing of 50 random points per mm², and the spread that goes with it, whatever the sensor: a Rayleigh
    // distribution, widened by the 6 µm of the die's form to less than a percent.
    let (mean, std) = (500.0 / 50f64.sqrt(), 0.5227 * 500.0 / 50f64.sqrt());
    assert!((figure(run, "/methods/1/merged/mean_um") / mean - 1.0).abs() < 0.05);
    assert!((figure(run, "/methods/1/merged/std_um") / std - 1.0).abs() < 0.05);
    // It keeps the views' centres at the height that the stage says, though the tilted die rises and falls by 0.2 degrees of
    // 41.45 mm as it turns: 102 µm of drift, where ours has none.
    let rises_um = 0.2_f64.to_radians() * 41.45e3 / 2f64.sqrt();
    for layer in 0..2 {
        let up = figure(
            run,
            &format!("/methods/1/drift/layers/{layer}/place/2/trend_um"),
        );
        // Twelve views that stray by about as much tell it to some 30 %: well above none, and not far beyond all of it.
        assert!((0.3..1.7).contains(&(up / rises_um)), "{up} µm");
        for axis in 0..3 {
            let ours = run
                .json
                .pointer(&format!("/methods/0/drift/layers/{layer}/place/{axis}"));
            assert!(
                ours.is_some_and(|trend| trend["drifts"] != true),
                "{ours:?}"
            );
        }
    }
    assert!(run.json["methods"][0]["drift"]["largest"].is_null());
    // How well ours lie is told about the form of the bore: that it is oval is no drift.
    for layer in run.json["methods"][0]["drift"]["layers"]
        .as_array()
        .unwrap()
    {
        assert_eq!(layer["rms"]["drifts"], false, "{layer}");
    }
    // The exact distances of the same points show how well they lie.
    assert!(figure(run, "/methods/1/exact/rms_um") < 10.0);
}

#[test]
fn form_is_kept_and_a_session_goes_on_where_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let session = folder.path().join("session");
    let report = folder.path().join("report");
    let kept = interrupted_after_the_first_capture(&session);
    let whole = oval_and_conical(&session, &report, "both");
    assert_eq!(whole.json["resumed_views"], kept);
    assert_eq!(whole.code, 0, "{} {}", whole.json["reason"], whole.stderr);
    the_article_loses_the_form(&whole);
    // A go is for what was looked at: a twelfth of the bore.
    let reason = whole.json["reason"].as_str().unwrap_or_default();
    let percent = 100.0 * figure(&whole, "/coverage_ratio");
    assert!((7.0..10.0).contains(&percent), "{percent} %");
    // Two bands of 8 mm, of 66 mm without a tenth of a module at either end.
    let face = 100.0 * 16.0 / 65.8;
    let said = format!(
        "go for 12 of 84 teeth at 2 heights ({face:.1} % of their face width), {percent:.1} % of the bore looked at"
    );
    assert!(reason.starts_with(&said), "{reason}");
    assert_eq!(whole.json["simulated"], true);
    for (what, truth_um) in [("/form/ovality_um", 20.0), ("/form/taper_um", 15.0)] {
        let got = figure(&whole, what);
        assert!(
            (got - truth_um).abs() <= 3.0,
            "{what}: {got} µm, {truth_um} µm was put in"
        );
    }
    // Teeth across the bore, where both were seen: as far apart as the die is oval there.
    let spacing = whole.json["spacing"].as_array().unwrap();
    assert!(spacing.len() >= 12, "{} pairs", spacing.len());
    for pair in spacing {
        let tooth = pair["teeth"][0].as_f64().unwrap();
        let angle = (tooth - 0.5) * std::f64::consts::TAU / 84.0;
        let error_um = pair["deviation_um"].as_f64().unwrap() - 20.0 * (2.0 * angle).cos();
        assert!(error_um.abs() <= 8.0, "{pair}: {error_um} µm off");
        // Three standard uncertainties.
        let u95_um = pair["u95_um"].as_f64().unwrap();
        assert!(
            error_um.abs() <= 3.0 / 1.96 * u95_um,
            "{pair}: {error_um} µm off"
        );
    }
    // The die was put down 0.5 mm off and 0.2 degrees askew. One view knows its place to some µm, 24 of them better; the
    // tilt is that over the 33 mm between the layers.
    let eccentric = figure(&whole, "/joint/found/eccentricity_mm");
    assert!((eccentric - 0.5).abs() < 0.01, "{eccentric} mm");
    let tilt = figure(&whole, "/joint/found/tilt_deg");
    assert!((tilt - 0.2).abs() < 0.01, "{tilt} degrees");
    assert_eq!(whole.json["frames"]["received"], (24 - kept) * 25);
    assert_eq!(whole.json["frames"]["bytes_copied"], 0);
    for key in [
        "features",
        "timing_ms",
        "registration",
        "versions",
        "hashes",
        "truth",
    ] {
        assert!(!whole.json[key].is_null(), "{key} is missing");
    }
    let page = std::fs::read_to_string(report.join("report.html")).unwrap();
    assert_eq!(page.matches("data:image/png;base64,").count(), 2);
    let share = format!("for 12 of 84 teeth,<br>{percent:.1} % of the bore");
    assert!(page.contains(&share) && page.contains("SIMULATED BENCH"));
    let cloud = std::fs::read(report.join("map.ply")).unwrap();
    assert!(cloud.starts_with(b"ply\nformat binary_little_endian 1.0\n"));

    // A damaged file is named and nothing is measured.
    let file = session.join("view-0005.points");
    let mut bytes = std::fs::read(&file).unwrap();
    bytes[1000] ^= 1;
    std::fs::write(&file, bytes).unwrap();
    let damaged = oval_and_conical(&session, &report, "surface");
    assert_eq!(damaged.code, 3);
    assert!(
        damaged.stderr.contains("view-0005.points is damaged"),
        "{}",
        damaged.stderr
    );
    // Without it, that view alone is captured again, and the result is the same within what one view is worth.
    std::fs::remove_file(&file).unwrap();
    let resumed = oval_and_conical(&session, &report, "surface");
    assert_eq!(
        resumed.code, 0,
        "{} {}",
        resumed.json["reason"], resumed.stderr
    );
    assert_eq!(resumed.json["resumed_views"], 23);
    assert_eq!(resumed.json["frames"]["received"], 25);
    let moved = figure(&resumed, "/form/ovality_um") - figure(&whole, "/form/ovality_um");
    assert!(moved.abs() < 1.0, "{moved} µm");
    // The article's map alone has no verdict.
    let article = oval_and_conical(&session, &report, "article");
    assert_eq!(article.code, 2);
    assert!(figure(&article, "/form/ovality_um") < 10.0);
    assert_eq!(article.json["features"].as_array().map(Vec::len), Some(0));
    let told = &article.json["methods"][1]["settings"];
    assert_eq!(told["denoise"], Value::Null);
    // The same session under the article's values, one of them otherwise: nothing is captured, everything is laid anew.
    let settings = folder.path().join("settings.toml");
    let settings = settings.to_str().unwrap();
    let written = run(flankscope().args(["article", "--write-settings", settings]));
    assert_eq!(written.code, 0, "{}", written.stderr);
    let values = std::fs::read_to_string(settings).unwrap();
    let other = values.replace("\nshare = 0.1 ", "\nshare = 0.05 ");
    let other = other.replace("\ninlier_ratio = 0.8 ", "\ninlier_ratio = 0.7 ");
    std::fs::write(settings, other).unwrap();
    let rest = ["--article-settings", settings];
    let preset = oval_and_conical_with(&session, &report, "article", &rest);
    let told = &preset.json["methods"][1]["settings"];
    assert_eq!(
        told["denoise"],
        serde_json::json!({"neighbours": 4, "std_ratio": 1.0})
    );
    let of = &told["registration"];
    assert_eq!([&told["share"], &of["inlier_ratio"]], [0.05, 0.7]);
    assert_eq!([&of["samples"], &of["most_iterations"]], [100_000, 25]);
    assert_eq!([&of["translation_mm"], &of["rotation_deg"]], [0.001, 0.005]);
    assert_eq!(preset.json["resumed_views"], 24);
    assert_ne!(
        preset.json["methods"][1]["rms_um"],
        article.json["methods"][1]["rms_um"]
    );
    let steps = preset.json["methods"][1]["iterations"].as_array().unwrap();
    assert!(
        steps
            .iter()
            .all(|n| (1..=25).contains(&n.as_u64().unwrap()))
            && steps.len() == 24
    );
    let page = std::fs::read_to_string(report.join("report.html")).unwrap();
    assert!(page.contains(
        "5 % of the points; 100000 reference points in ±10 mm by ±0.2 rad; 70 % of the pairs"
    ));
    // Its poses are its own, and nothing of the joint solve is said of them.
    let poses = |run: &Run| -> Vec<Value> {
        let views = run.json["registration"].as_array().expect("views");
        views
            .iter()
            .map(|view| view["tool_from_camera"].clone())
            .collect()
    };
    let (ours, its) = (poses(&resumed), poses(&article));
    assert!(
        its.iter()
            .zip(&ours)
            .all(|(its, ours)| its != ours && !its.is_null())
    );
    assert!(article.json.get("joint").is_none());
    assert!(article.json["registration"][0]["stray_turn_mdeg"].is_null());
    // Another scan does not mix with it, nor do points of another kind, nor another die on the bench.
    let refused = |args: &[&str], why: &str| {
        let [option, form] = bench(FORM);
        let form = [&option, &form, "--session", session.to_str().unwrap()];
        let other = scan_full(&[&form[..], args].concat());
        assert_eq!(other.code, 3);
        assert!(other.stderr.contains(why), "{}", other.stderr);
    };
    let of_pixels = head_of_pixels(folder.path());
    refused(
        &["--views", "12x2", "--head", &of_pixels],
        "holds another scan: its cores is",
    );
    refused(
        &["--views", "12x3"],
        "holds another scan: its views is 12x2",
    );
    refused(
        &["--views", "12x2", "--seed", "2"],
        "holds another scan: its bench is seed 1, ovality 20 um",
    );
}

#[test]
fn a_lost_view_is_captured_once_more_and_then_a_hole() {
    // Frame 5 of every capture is lost, so the first view is lost twice.
    let [option, fault] = bench("[camera]\nframe_fault = \"lose:5\"\n");
    let holed = scan(&["--views", "12x1", &option, &fault]);
    // A twelfth of what was planned is missing: the map stands, but it is no go.
    assert_eq!(holed.code, 2, "{} {}", holed.json["reason"], holed.stderr);
    let reason = holed.json["reason"].as_str().unwrap_or_default();
    assert!(reason.contains("2 of 24 planned flank fields"), "{reason}");
    assert!(reason.contains("11 of 84 teeth at 1 height"), "{reason}");
    let holes = holed.json["coverage"]["holes"].as_array().unwrap();
    assert_eq!(
        holes.len(),
        2,
        "both flanks of the lost view's tooth: {holes:?}"
    );
    assert!(
        holes.iter().all(|hole| hole["seen_ratio"] == 0.0),
        "{holes:?}"
    );
    assert!(
        holed.json["features"]
            .as_array()
            .is_some_and(|f| f.len() >= 22)
    );
    assert_eq!(holed.json["frames"]["recaptured_views"], 1);
    let lost: Vec<_> = holed.json["registration"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|view| view["status"] == "lost")
        .collect();
    assert_eq!(lost.len(), 1, "{lost:?}");
    assert_eq!(lost[0]["view"], 0);
    assert!(lost[0]["reason"].is_string(), "{lost:?}");
}

fn feature<'a>(run: &'a Run, tooth: u64, flank: &str) -> &'a serde_json::Value {
    let features = run.json["features"].as_array();
    let found = features.into_iter().flatten().find(|feature| {
        feature["tooth"].as_u64() == Some(tooth) && feature["flank"].as_str() == Some(flank)
    });
    found.unwrap_or_else(|| panic!("no {flank} flank of tooth {tooth}: {}", run.json["reason"]))
}

/// The demo die as a mesh in slices of 0.75 mm, and whether a vertex of it lies on the left flank of tooth 11 between two
/// heights: the left flank of a tooth that twelve views look at.
fn die(height_mm: [f64; 2]) -> (Mesh, Vec<bool>) {
    let gear = demo_gear();
    let slices = Meshing {
        axial_slices: 88,
        ..Meshing::default()
    };
    let mesh = gear.mesh(&slices).unwrap();
    let [low, high] = [height_mm[0] - 1e-6, height_mm[1] + 1e-6];
    let on_flank = |p: &[f64; 3]| {
        let radius = p[0].hypot(p[1]);
        let off_rad = p[1].atan2(p[0]).rem_euclid(std::f64::consts::TAU)
            - gear.flank_angle_rad(11, Flank::Left, radius);
        let on = radius < gear.root_radius_mm + 1e-6 && off_rad.abs() < 1e-6;
        on && (low..high).contains(&p[2])
    };
    let chosen = mesh.vertices.iter().map(on_flank).collect();
    (mesh, chosen)
}

/// A scan of one layer around that stands on the bench as this mesh: views look at 29 to 37 mm of teeth 4, 11, 18, ...
fn scan_of_mesh(mesh: &Mesh) -> Run {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("die.ply");
    let mut bytes = Vec::new();
    write_ply(mesh, &mut bytes).unwrap();
    std::fs::write(&path, bytes).unwrap();
    scan_full(&["--views", "12x1", "--die-mesh", path.to_str().unwrap()])
}

/// All flanks but the left one of tooth 11 are go.
#[track_caller]
fn assert_others_go(run: &Run) {
    for of in run.json["features"].as_array().unwrap() {
        if (of["tooth"].as_u64(), of["flank"].as_str()) != (Some(11), Some("left")) {
            assert_eq!(of["verdict"], "go", "{of}");
        }
    }
    assert_eq!(run.json["features"].as_array().map(Vec::len), Some(24));
}

#[test]
fn damage_of_an_eighth_of_a_flank_is_no_go_and_other_flanks_stay_go() {
    if !flankscope_test_requisites::dear() {
        return;
    }
    // 200 um gone over an eighth of the height, a sixth of what the view looks at.
    let (mut mesh, worn) = die([36.0, 44.25]);
    let gear = demo_gear();
    for (p, _) in mesh.vertices.iter_mut().zip(worn).filter(|(_, worn)| *worn) {
        let [nx, ny] = gear.flank_normal(11, Flank::Left, p[0].hypot(p[1]));
        p[0] -= 0.2 * nx;
        p[1] -= 0.2 * ny;
    }
    let worn = scan_of_mesh(&mesh);
    assert_eq!(worn.code, 1, "{} {}", worn.json["reason"], worn.stderr);
    let reason = worn.json["reason"].as_str().unwrap_or_default();
    assert!(reason.starts_with("no-go: tooth 11 left;"), "{reason}");
    let found = feature(&worn, 11, "left");
    let why = found["reason"].as_str().unwrap_or_default();
    assert!(
        why.starts_with("wear ") && why.contains("beyond the stop limit"),
        "{why}"
    );
    let [wear_um, u95_um, mean_um] =
        ["wear_um", "u95_um", "mean_um"].map(|key| found[key].as_f64().unwrap());
    assert!((wear_um - 200.0).abs() < u95_um, "{wear_um} +- {u95_um} um");
    // What was judged before: below the stop limit.
    assert!((20.0..50.0).contains(&mean_um), "{mean_um} um");
    let [low, high] = [0, 1].map(|k| found["detail"]["zone_height_mm"][k].as_f64().unwrap());
    assert!((low - 29.0).abs() < 1e-9 && (high - 37.0).abs() < 1e-9);
    assert_others_go(&worn);
}

#[test]
fn a_patch_that_no_view_saw_is_never_go() {
    let (mut mesh, lost) = die([32.25, 33.0]);
    mesh.triangles
        .retain(|t| !t.iter().all(|&v| lost[v as usize]));
    let holed = scan_of_mesh(&mesh);
    assert_eq!(holed.code, 2, "{} {}", holed.json["reason"], holed.stderr);
    let found = feature(&holed, 11, "left");
    // An eleventh of what the view was asked for: enough was measured, but not the disc that fits into the hole.
    assert_eq!(found["code"], "hidden", "{found}");
    assert!(found["coverage_ratio"].as_f64().unwrap() > 0.8, "{found}");
    let hidden_um = found["detail"]["hidden_um"].as_f64().unwrap();
    assert!(hidden_um > 250.0, "{hidden_um} um");
    assert_others_go(&holed);
}

/// A scan by a method with these lines as the article's settings.
fn told(method: &str, lines: &str) -> Run {
    let folder = tempfile::tempdir().unwrap();
    let settings = folder.path().join("settings.toml");
    std::fs::write(&settings, lines).unwrap();
    let settings = settings.to_str().unwrap();
    let method = ["--views", "12x1", "--method", method];
    scan(&[&method[..], &["--article-settings", settings]].concat())
}

#[test]
fn the_articles_settings_need_its_method() {
    let wrong = told("surface", "mask_dn = 20.0\n");
    assert_eq!(wrong.code, 3);
    let said = "--article-settings is for the article's method: add --method article";
    assert!(wrong.stderr.contains(said), "{}", wrong.stderr);
}

#[test]
fn settings_that_cannot_be_are_named_with_what_can() {
    for (table, line, can) in [
        ("", "mask_dn = 70000", "0 to 65535 counts"),
        ("", "share = nan", "0.0001 to 1 of the points"),
        ("", "share = 0.0", "0.0001 to 1 of the points"),
        ("", "merged_per_mm2 = inf", "0.1 to 2000 points per mm2"),
        ("", "voxel_mm = 0.0", "above 0"),
        ("", "order = \"0.5\"", "inf"),
        ("", "serial_inlier_ratio = 2.0", "0.01 to 1"),
        ("", "voxels_mm = 0.1", "voxel_mm"),
        ("", "first_pose = 0.1", "unknown field"),
        (
            "registration.region",
            "half_height_mm = -1.0",
            "0.1 to 1000 mm",
        ),
        ("registration.region", "half_angle_rad = 3.2", "to 3.14"),
        ("registration", "samples = 10", "100 to 10000000"),
        (
            "registration",
            "inlier_ratio = 1.1",
            "0.01 to 1 of the pairs",
        ),
        ("registration", "most_iterations = 0", "1 to 1000"),
        ("registration", "translation_mm = 2.0", "0 to 1 mm"),
        ("registration", "rotation_deg = -0.1", "0 to 1 degrees"),
        ("registration", "seed = 3", "unknown field"),
        ("denoise", "neighbours = 0\nstd_ratio = 1.0", "1 to 100"),
        ("denoise", "std_ratio = 1.0", "`neighbours`"),
    ] {
        let (lines, place) = match table {
            "" => (format!("{line}\n"), 1),
            table => (format!("[{table}]\n{line}\n"), 2),
        };
        let wrong = told("article", &lines);
        assert_eq!(wrong.code, 3, "{line}");
        assert!(wrong.stderr.contains(can), "{line}: {}", wrong.stderr);
        // What is missing from a table is missed at its head.
        let place = match line {
            "std_ratio = 1.0" => 1,
            _ => place,
        };
        let place = format!("settings.toml:{place}: ");
        assert!(wrong.stderr.contains(&place), "{line}: {}", wrong.stderr);
    }
}

#[test]
fn views_that_are_no_grid_are_refused() {
    let wrong = scan(&["--views", "84"]);
    assert_eq!(wrong.code, 3);
    assert!(wrong.stderr.contains("84x7"), "{}", wrong.stderr);
}
