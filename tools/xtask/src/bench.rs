//! `cargo xtask bench`: our figures beside those of the tools people use today, on the same files in one run.

mod checks;
mod data;
mod instructions;
mod plot;

pub use checks::run as checks;
pub use instructions::check as instructions;

use std::path::Path;
use std::process::Command;

use serde_json::Value;

/// One row: what was measured, with the names under which our benchmark and the peers report it.
struct Row {
    work: &'static str,
    ours: &'static str,
    /// Name of the peer's figure(s); several are added.
    peers: &'static [(&'static str, &'static [&'static str])],
    /// Points per run, for rates.
    points: usize,
    /// Wanted ratio.
    target: f64,
}

const MILLION: usize = data::RING_POINTS;
const HUNDRED: usize = data::FEATURE_POINTS;

#[rustfmt::skip]
const ROWS: &[Row] = &[
    Row { work: "register 100 000 points", ours: "register", points: HUNDRED, target: 40.0, peers: &[
        ("small_gicp prepare + align", &["small_gicp/prepare", "small_gicp/align"]),
        ("small_gicp align alone", &["small_gicp/align"]),
        ("open3d ICP", &["open3d/register"]),
    ] },
    Row { work: "signed distance, 6 720 triangles, random", ours: "distance/coarse/random", points: MILLION, target: 10.0, peers: &[("open3d signed", &["open3d/distance/coarse/random"]), ("open3d unsigned", &["open3d/unsigned/coarse/random"])] },
    Row { work: "signed distance, 6 720 triangles, sorted", ours: "distance/coarse/sorted", points: MILLION, target: 10.0, peers: &[("open3d signed", &["open3d/distance/coarse/sorted"]), ("open3d unsigned", &["open3d/unsigned/coarse/sorted"])] },
    Row { work: "signed distance, 6 720 triangles, scan", ours: "distance/coarse/scan", points: MILLION, target: 10.0, peers: &[("open3d signed", &["open3d/distance/coarse/scan"]), ("open3d unsigned", &["open3d/unsigned/coarse/scan"])] },
    Row { work: "signed distance, 620 928 triangles, random", ours: "distance/fine/random", points: MILLION, target: 10.0, peers: &[("open3d signed", &["open3d/distance/fine/random"]), ("open3d unsigned", &["open3d/unsigned/fine/random"])] },
    Row { work: "signed distance, 620 928 triangles, sorted", ours: "distance/fine/sorted", points: MILLION, target: 10.0, peers: &[("open3d signed", &["open3d/distance/fine/sorted"]), ("open3d unsigned", &["open3d/unsigned/fine/sorted"])] },
    Row { work: "signed distance, 620 928 triangles, scan", ours: "distance/fine/scan", points: MILLION, target: 10.0, peers: &[("open3d signed", &["open3d/distance/fine/scan"]), ("open3d unsigned", &["open3d/unsigned/fine/scan"])] },
    Row { work: "sample 100 000 points, 620 928 triangles", ours: "sample", points: HUNDRED, target: 10.0, peers: &[("open3d", &["open3d/sample"])] },
    Row { work: "outliers, 100 000 random points, k = 20", ours: "outliers/feature/20", points: HUNDRED, target: 8.0, peers: &[("open3d", &["open3d/outliers/feature/20"])] },
    Row { work: "outliers, 100 000 points of a view, k = 20", ours: "outliers/view/20", points: HUNDRED, target: 8.0, peers: &[("open3d", &["open3d/outliers/view/20"])] },
    Row { work: "outliers, 100 000 points of a view, k = 8", ours: "outliers/view/8", points: HUNDRED, target: 8.0, peers: &[("open3d", &["open3d/outliers/view/8"])] },
    Row { work: "voxel merge 0.05 mm, random", ours: "merge/random", points: MILLION, target: 20.0, peers: &[("open3d", &["open3d/merge/random"])] },
    Row { work: "voxel merge 0.05 mm, scan", ours: "merge/scan", points: MILLION, target: 20.0, peers: &[("open3d", &["open3d/merge/scan"])] },
    Row { work: "load PLY, 620 928 triangles", ours: "load/ply", points: 0, target: 8.0, peers: &[("open3d", &["open3d/load/ply"]), ("trimesh", &["trimesh/load/ply"])] },
    Row { work: "load STL, 620 928 triangles", ours: "load/stl", points: 0, target: 8.0, peers: &[("open3d", &["open3d/load/stl"]), ("trimesh", &["trimesh/load/stl"])] },
    Row { work: "prepare surface, 6 720 triangles (once per tool)", ours: "prepare/coarse", points: 0, target: 2.0, peers: &[("open3d BVH", &["open3d/prepare/coarse"])] },
    Row { work: "prepare surface, 620 928 triangles (once per tool)", ours: "prepare/fine", points: 0, target: 2.0, peers: &[("open3d BVH", &["open3d/prepare/fine"])] },
];

/// Runs everything; `peers` is a Python environment made as `tools/peers/README.md` says.
pub fn run(root: &Path, peers: Option<&str>) -> Result<(), String> {
    let folder = root.join("target/bench-data");
    data::make(&folder, data::RING_POINTS)?;
    let mut figures = Vec::new();
    let arguments = [
        "run",
        "--release",
        "-q",
        "-p",
        "flankscope-metrology",
        "--example",
        "bench",
        "--",
    ];
    let mut ours = super::cargo(&arguments);
    ours.arg(&folder).env("RAYON_NUM_THREADS", "2");
    figures.extend(lines(ours)?);
    match peers {
        Some(environment) => {
            let mut python = Command::new(Path::new(environment).join("bin/python"));
            python
                .arg(root.join("tools/peers/bench.py"))
                .arg(&folder)
                .env("OMP_NUM_THREADS", "2");
            figures.extend(lines(python)?);
        }
        None => eprintln!("no peers: give --peers VENV (see tools/peers/README.md)"),
    }
    let mut capture = super::cargo(&[
        "run",
        "--release",
        "-q",
        "-p",
        "flankscope-demo",
        "--example",
        "capture",
    ]);
    capture.env("RAYON_NUM_THREADS", "2");
    let capture = lines(capture)?;
    println!("{}", table(&figures));
    for figure in capture {
        println!("{figure}");
    }
    plots(root, &figures)
}

/// How cost grows, as pictures in `docs/bench`.
fn plots(root: &Path, figures: &[Value]) -> Result<(), String> {
    let curve = |name: &'static str, work: &str, of: &str| plot::Curve {
        name,
        points: {
            let prefix = format!("growth/{work}/{of}/");
            let mut points: Vec<(f64, f64)> = figures
                .iter()
                .filter_map(|figure| {
                    let size = figure["name"].as_str()?.strip_prefix(&prefix)?;
                    Some((size.parse().ok()?, figure["ms"].as_f64()?))
                })
                .collect();
            points.sort_by(|a, b| a.0.total_cmp(&b.0));
            points
        },
    };
    let pictures = [
        (
            "points",
            "growth with the points",
            "points",
            vec![
                curve("distance, 6 720 triangles", "distance", "points"),
                curve("voxel merge", "merge", "points"),
                curve("registration", "register", "points"),
                curve("outliers, k = 20", "outliers", "points"),
            ],
        ),
        (
            "triangles",
            "growth with the triangles",
            "triangles",
            vec![
                curve("preparing the surface", "prepare", "triangles"),
                curve("distance, a million points", "distance", "triangles"),
            ],
        ),
        (
            "views",
            "growth with the views merged, 97 000 points each",
            "views",
            vec![curve("voxel merge", "merge", "views")],
        ),
    ];
    let folder = root.join("docs/bench");
    for (file, title, size, curves) in pictures {
        if let Some(svg) = plot::svg(title, size, &curves) {
            plot::save(&folder, file, &svg)?;
        }
    }
    Ok(())
}

/// Runs a benchmark that prints one JSON object per line.
fn lines(mut command: Command) -> Result<Vec<Value>, String> {
    eprintln!("$ {command:?}");
    let output = command
        .stderr(std::process::Stdio::inherit())
        .output()
        .map_err(|error| format!("{command:?} could not start: {error}"))?;
    if !output.status.success() {
        return Err(format!("{command:?} ended with {}", output.status));
    }
    String::from_utf8_lossy(&output.stdout)
        .lines()
        .filter(|line| line.starts_with('{'))
        .map(|line| serde_json::from_str(line).map_err(|error| format!("{line}: {error}")))
        .collect()
}

fn table(figures: &[Value]) -> String {
    let ms = |name: &str| {
        let found = figures.iter().find(|f| f["name"] == name)?;
        found["ms"].as_f64()
    };
    let mut text = String::from(
        "| work | ours, ms | ours, processor ms | ours, M points/s | peer | peer, ms | ratio | wanted |\n\
         |---|---|---|---|---|---|---|---|\n",
    );
    for row in ROWS {
        let Some(own) = ms(row.ours) else { continue };
        let rate = match row.points {
            0 => String::new(),
            points => format!("{:.1}", points as f64 / own / 1e3),
        };
        let wanted = match row.target {
            0.0 => String::new(),
            target => format!("{target}x"),
        };
        let processor = figures.iter().find(|f| f["name"] == row.ours);
        let cpu = processor
            .and_then(|f| f["cpu_ms"].as_f64())
            .unwrap_or(f64::NAN);
        let mut shown = false;
        for (peer, names) in row.peers {
            let Some(theirs) = names.iter().map(|name| ms(name)).sum::<Option<f64>>() else {
                continue;
            };
            shown = true;
            text += &format!(
                "| {} | {own:.1} | {cpu:.1} | {rate} | {peer} | {theirs:.1} | {:.1}x | {wanted} |\n",
                row.work,
                theirs / own
            );
        }
        if !shown {
            text += &format!(
                "| {} | {own:.1} | {cpu:.1} | {rate} | | | | {wanted} |\n",
                row.work
            );
        }
    }
    for figure in figures.iter().filter(|f| f["note"].is_string()) {
        text += &format!(
            "\n{}: {}",
            figure["name"].as_str().unwrap_or_default(),
            figure["note"].as_str().unwrap_or_default()
        );
    }
    text
}
