//! The article's figures of a kept scan, as a user makes them: against the drawing, direct counts, and points picked from the file
//! that is written for it.

use std::f64::consts::TAU;
use std::path::Path;

use flankscope_gear_cad::Flank;
use flankscope_instrument::acquisition::Recording;
use flankscope_metrology::io::{Unit, cloud};
use flankscope_profilometry::FrameKind;
use flankscope_profilometry::io::images::load_grey;
use flankscope_test_requisites::dear;
use flankscope_tests::{Run, demo_gear, flankscope, run};
use serde_json::Value;

type Rows = [[f64; 4]; 4];
type Rows3 = [[f64; 3]; 3];

fn article(args: &[&str]) -> Run {
    let common = ["article", "--quiet", "--json", "-"];
    run(flankscope().args(common).args(args))
}

fn scan(args: &[&str]) -> Run {
    let common = ["scan", "--quiet", "--json", "-", "--speed", "max"];
    run(flankscope().args(common).args(args))
}

/// The points of a view as the session keeps them: x, y, z in the camera's frame, mm, and how much the fringes oscillate.
fn kept(session: &Path, view: usize, points: u64) -> Vec<([f64; 3], f32)> {
    let bytes = std::fs::read(session.join(format!("view-{view:04}.points"))).unwrap();
    let float = |bytes: &[u8]| f32::from_le_bytes(bytes.try_into().unwrap());
    let point = |of: &[u8]| {
        let at = |k: usize| float(&of[4 * k..4 * k + 4]);
        ([0, 1, 2].map(|k| f64::from(at(k))), at(4))
    };
    bytes
        .chunks_exact(20)
        .take(points as usize)
        .map(point)
        .collect()
}

fn moved(rows: &Rows, p: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|i| (0..3).map(|k| rows[i][k] * p[k]).sum::<f64>() + rows[i][3])
}

fn pose(of: &Value) -> Rows {
    serde_json::from_value(of.clone()).unwrap()
}

fn alignment<'a>(of: &'a Run, name: &str) -> &'a Value {
    let all = of.json["alignments"].as_array().unwrap();
    all.iter().find(|of| of["name"] == name).unwrap()
}

/// How far points that should lie on the drawing's flanks lie off it at `centre`, outwards and around, mm: the shift and turn about
/// the axis that explain best how far they are off along the flanks' normals.
fn off_mm(points: &[[f64; 3]], centre: [f64; 3]) -> [f64; 2] {
    let gear = demo_gear();
    let pitch = TAU / f64::from(gear.teeth);
    let towards = centre[1].atan2(centre[0]);
    let (mut normal, mut right) = ([[0.0; 3]; 3], [0.0; 3]);
    for &[x, y, _] in points {
        let (radius, angle) = (x.hypot(y), y.atan2(x));
        if !(gear.tip_radius_mm + 0.4..gear.root_radius_mm - 0.4).contains(&radius) {
            continue;
        }
        let [a, b] = [Flank::Left, Flank::Right].map(|flank| {
            let at = gear.flank_angle_rad(1, flank, radius);
            let off = (angle - at + 0.5 * pitch).rem_euclid(pitch) - 0.5 * pitch;
            // The flank's normal, outwards from the axis and around it.
            let [nx, ny] = gear.flank_normal(1, flank, radius);
            let (sin, cos) = at.sin_cos();
            (off * radius, [nx * cos + ny * sin, ny * cos - nx * sin])
        });
        let (off, [n_out, n_around]) = if a.0.abs() < b.0.abs() { a } else { b };
        // In the axes of the centre.
        let (sin, cos) = (angle - towards).sin_cos();
        let n = [n_out * cos - n_around * sin, n_out * sin + n_around * cos];
        let from = [x - centre[0], y - centre[1]];
        let (sin, cos) = towards.sin_cos();
        let from = [from[0] * cos + from[1] * sin, from[1] * cos - from[0] * sin];
        let row = [n[0], n[1], n[1] * from[0] - n[0] * from[1]];
        for i in 0..3 {
            for k in 0..3 {
                normal[i][k] += row[i] * row[k];
            }
            right[i] += row[i] * off * n_around;
        }
    }
    // Cramer's rule.
    let determinant = |m: &Rows3| {
        m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1])
            - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
            + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
    };
    [0, 1].map(|column| {
        let mut with = normal;
        for i in 0..3 {
            with[i][column] = right[i];
        }
        determinant(&with) / determinant(&normal)
    })
}

#[test]
fn figures_agree_with_drawing_and_counts_and_picked_pairs_start_a_scan() {
    if !dear() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (session, report) = (path("session"), path("report"));
    let scanned = scan(&["--views", "84x1", "--session", &session]);
    assert_eq!(
        scanned.json["registration"].as_array().map(Vec::len),
        Some(84),
        "{}",
        scanned.stderr
    );
    let made = article(&["--scan", &session, "--report", &report]);
    assert_eq!(made.code, 0, "{}", made.stderr);
    let session = Path::new(&session);
    let manifest = std::fs::read_to_string(session.join("manifest.json")).unwrap();
    let manifest: Value = serde_json::from_str(&manifest).unwrap();
    let points = |view: usize| {
        let of = &manifest["views"][view.to_string()]["points"];
        kept(session, view, of.as_u64().unwrap())
    };

    // What thresholds leave of every seventh view.
    let fringes: Vec<f32> = (0..84)
        .step_by(7)
        .flat_map(points)
        .map(|(_, dn)| dn)
        .collect();
    for of in made.json["threshold"].as_array().unwrap() {
        let threshold = of["threshold_dn"].as_f64().unwrap();
        let left = fringes
            .iter()
            .filter(|&&dn| f64::from(dn) >= threshold)
            .count();
        let ratio = left as f64 / fringes.len() as f64;
        assert!(
            (of["points_ratio"].as_f64().unwrap() - ratio).abs() < 1e-12,
            "{of}"
        );
    }
    let step = &made.json["steps"][0];
    let lit = points(0).iter().filter(|(_, dn)| *dn >= 40.0).count();
    assert_eq!(step["masked"].as_u64(), Some(lit as u64));

    // The die is as drawn: how far serially laid views lie off, the drawing tells.
    let laid = |name: &str, view: usize| -> Vec<[f64; 3]> {
        let rows = pose(&alignment(&made, name)["tool_from_camera"][view]);
        points(view).iter().map(|(p, _)| moved(&rows, *p)).collect()
    };
    let centre = |points: &[[f64; 3]]| {
        [0, 1, 2].map(|k| points.iter().map(|p| p[k]).sum::<f64>() / points.len() as f64)
    };
    let said = &made.json["serial"][0]["off_um"];
    let mut compared = 0;
    for view in 0..84 {
        let said_mm = [0, 1].map(|k| said[view][k].as_f64().unwrap() / 1e3);
        // Farther off, points would be taken for the next flank's.
        if said_mm[0].hypot(said_mm[1]) > 0.3 {
            break;
        }
        let at = laid("serial", view);
        let told_mm = off_mm(&at, centre(&at));
        for (told, said) in told_mm.into_iter().zip(said_mm) {
            assert!(
                (told - said).abs() < 0.005 + 0.05 * said.abs(),
                "view {view}: {told_mm:?} {said_mm:?}"
            );
        }
        compared += 1;
    }
    assert!(compared >= 3, "{compared}");
    // Ours and the article's lie on the drawing all around.
    for name in ["article", "surface"] {
        let at = laid(name, 42);
        let told_mm = off_mm(&at, centre(&at));
        assert!(
            told_mm.iter().all(|mm| mm.abs() < 0.01),
            "{name}: {told_mm:?}"
        );
    }
    let exact_um = |name: &str| alignment(&made, name)["exact"]["rms_um"].as_f64().unwrap();
    assert!(exact_um("serial") > 5.0 * exact_um("article"));
    // The die stands 0.5 mm off the axis: positions alone are off by as much as that, seen from where the first view was laid.
    assert!(
        (200.0..1500.0).contains(&exact_um("positions")),
        "{}",
        exact_um("positions")
    );

    // The first view starts at its own tooth: half a pitch off at most, and as far as the die stands off the axis.
    let initial = &made.json["initial_transformation"];
    let first: Vec<[f64; 3]> = points(initial["view"].as_u64().unwrap() as usize)
        .iter()
        .map(|(p, _)| moved(&pose(&initial["tool_from_camera"]), *p))
        .collect();
    let half_pitch_mm = 0.5 * TAU / 84.0 * demo_gear().root_radius_mm;
    let (start, end) = (centre(&first), centre(&laid("article", 0)));
    let apart_mm = (0..3)
        .map(|k| (start[k] - end[k]).powi(2))
        .sum::<f64>()
        .sqrt();
    assert!(
        apart_mm > 0.0 && apart_mm < half_pitch_mm + 0.5,
        "{apart_mm}"
    );

    let page = std::fs::read_to_string(folder.path().join("report/article.html")).unwrap();
    assert!(page.contains("SIMULATED BENCH") && page.matches("<svg").count() >= 15);
    // Cameras, the initial transformation, three of the CAD, two of the cloud, each another one.
    let pictures = page.split("src=\"data:image/png").skip(1);
    let pictures: std::collections::BTreeSet<&str> =
        pictures.filter_map(|rest| rest.split('"').next()).collect();
    assert_eq!(pictures.len(), 7);

    // Somebody picks pairs from the first view, to a fifth of a millimetre.
    let first = folder.path().join("report/first-view.ply");
    let first = cloud::load(&first, Unit::Mm).unwrap();
    let rows = pose(&scanned.json["registration"][0]["tool_from_camera"]);
    let picks = first.points.len() / 8;
    let text: String = first
        .points
        .iter()
        .step_by(picks)
        .map(|&p| {
            let [x, y, z] = moved(&rows, p).map(|c| (5.0 * c).round() / 5.0);
            format!("{},{},{},{x},{y},{z}\n", p[0], p[1], p[2])
        })
        .collect();
    let pairs = path("pairs.csv");
    std::fs::write(&pairs, text).unwrap();
    // Beside them.
    let settings = path("settings.toml");
    std::fs::write(&settings, "pairs = \"pairs.csv\"\n").unwrap();
    let picked = scan(&[
        "--views",
        "84x1",
        "--session",
        session.to_str().unwrap(),
        "--method",
        "article",
        "--article-settings",
        &settings,
    ]);
    let method = &picked.json["methods"][1];
    assert_eq!(method["start"], "picked pairs", "{}", picked.stderr);
    assert_eq!(method["registered_views"], 84);
    assert_eq!(picked.json["resumed_views"], 84);
    let rows = pose(&picked.json["registration"][0]["tool_from_camera"]);
    let at: Vec<[f64; 3]> = points(0).iter().map(|(p, _)| moved(&rows, *p)).collect();
    let told_mm = off_mm(&at, centre(&at));
    assert!(told_mm.iter().all(|mm| mm.abs() < 0.01), "{told_mm:?}");
}

#[test]
fn cross_sections_are_of_the_frames_that_were_saved_and_views_far_apart_are_not_laid_on_each_other()
{
    if !dear() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (session, frames, report) = (path("session"), path("frames"), path("report"));
    let views = [
        "--views",
        "12x1",
        "--session",
        &session,
        "--save-frames",
        &frames,
    ];
    let scanned = scan(&views);
    assert!(
        Path::new(&session).join("manifest.json").exists(),
        "{}",
        scanned.stderr
    );
    let made = article(&["--scan", &session, "--frames", &frames, "--report", &report]);
    assert_eq!(made.code, 0, "{}", made.stderr);
    let why = made.json["serial_refused"].as_str().unwrap();
    assert!(why.contains("of their points in common"), "{why}");
    assert_eq!(made.json["serial"].as_array().map(Vec::len), Some(0));
    assert!(
        made.json["alignments"]
            .as_array()
            .unwrap()
            .iter()
            .all(|of| of["name"] != "serial")
    );
    // The frames are plain images: the same counts, and their spread by hand.
    let sections = &made.json["sections"];
    let counts: Vec<Vec<f64>> = serde_json::from_value(sections["counts"].clone()).unwrap();
    let std: Vec<f64> = serde_json::from_value(sections["std_dn"].clone()).unwrap();
    let row = sections["cut_px"].as_u64().unwrap() as usize;
    let exposure_us = sections["exposure_us"].as_u64().unwrap() as u32;
    let plan = Recording::open(Path::new(&frames)).unwrap();
    let at = plan
        .plan
        .exposures_us
        .iter()
        .position(|&us| us == exposure_us)
        .unwrap();
    let first = Path::new(&frames).join(&plan.index.view[0].folder);
    let finest = plan.plan.patterns.sets.len() - 1;
    let kept = plan.plan.frames(&first).unwrap();
    let images: Vec<_> = kept
        .iter()
        .filter(|(kind, _)| matches!(kind, FrameKind::Fringe { exposure, set, .. } if (*exposure, *set) == (at, finest)))
        .map(|(_, image)| load_grey(image, [1920, 1200]).unwrap())
        .collect();
    assert!(images.len() >= 3 && images.len() == counts.len());
    for x in (0..1920).step_by(37) {
        let values: Vec<f64> = images
            .iter()
            .map(|image| f64::from(image.pixels[row * 1920 + x]))
            .collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let squares: f64 = values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64;
        let got: Vec<f64> = counts.iter().map(|step| step[x]).collect();
        assert_eq!(got, values, "{x}");
        assert!(
            (std[x] - (squares - mean * mean).max(0.0).sqrt()).abs() < 1e-3,
            "{x}"
        );
    }
    let page = std::fs::read_to_string(folder.path().join("report/article.html")).unwrap();
    assert!(page.contains("figures 11 to 13"));
    // Frames of another scan.
    let index = Path::new(&frames).join("frames.toml");
    let text = std::fs::read_to_string(&index).unwrap();
    std::fs::write(&index, text.replace("\"12x1\"", "\"13x1\"")).unwrap();
    let other = article(&["--scan", &session, "--frames", &frames, "--report", &report]);
    assert_eq!(other.code, 3);
    assert!(
        other.stderr.contains("is of 13x1, the scan of 12x1"),
        "{}",
        other.stderr
    );
}

#[test]
fn views_that_are_not_there_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let report = path("report");
    let nobodys = article(&["--report", &report]);
    assert_eq!(nobodys.code, 3);
    assert!(
        nobodys.stderr.contains("--scan <DIR>"),
        "{}",
        nobodys.stderr
    );
    let gone = article(&["--scan", &path("gone"), "--report", &report]);
    assert_eq!(gone.code, 3);
    assert!(
        gone.stderr.contains("gone/manifest.json"),
        "{}",
        gone.stderr
    );
    assert!(!folder.path().join("gone").exists());
    let settings = path("settings.toml");
    std::fs::write(&settings, "serial_inlier_ratio = 2.0\n").unwrap();
    let told = ["--report", &report, "--article-settings", &settings];
    let wrong = article(&[&["--scan", &path("gone")], &told[..]].concat());
    assert_eq!(wrong.code, 3);
    assert!(wrong.stderr.contains("0.01 to 1"), "{}", wrong.stderr);
    let written = std::fs::read_dir(&report).unwrap().count();
    assert_eq!(written, 0);
}
