//! Both ways to stitch a scan, over several seeds: what is left of a form that was put into the die.

use std::fmt::Write as _;
use std::path::Path;

use serde_json::Value;

/// What is put into the die, µm.
const OVALITY_UM: f64 = 20.0;
const TAPER_UM: f64 = 15.0;
/// Views of each scan.
const VIEWS: &str = "12x4";
const SEEDS: std::ops::RangeInclusive<u64> = 1..=5;

/// Scans with every seed and writes `docs/study/scan.md`.
pub fn run(root: &Path) -> Result<(), String> {
    let mut scans = Vec::new();
    for seed in SEEDS {
        eprintln!("scan {seed} of {}", SEEDS.end());
        scans.push((seed, scan(root, seed)?));
    }
    let page = page(&scans)?;
    let path = root.join("docs/study/scan.md");
    std::fs::write(&path, page).map_err(|error| format!("{}: {error}", path.display()))
}

fn scan(root: &Path, seed: u64) -> Result<Value, String> {
    let (seed, ovality, taper) = (
        seed.to_string(),
        OVALITY_UM.to_string(),
        TAPER_UM.to_string(),
    );
    let mut cargo = crate::cargo(&["run", "--release", "--quiet", "--", "scan", "--quiet"]);
    cargo.args(["--json", "-", "--speed", "max", "--method", "both"]);
    cargo.args(["--views", VIEWS, "--seed", &seed]);
    cargo.args(["--ovality-um", &ovality, "--taper-um", &taper]);
    let output = cargo.current_dir(root).output();
    let output = output.map_err(|error| format!("{cargo:?}: {error}"))?;
    serde_json::from_slice(&output.stdout).map_err(|error| {
        let said = String::from_utf8_lossy(&output.stderr);
        format!("scan with seed {seed} gave no document ({error}): {said}")
    })
}

/// One way with one seed, in µm and s.
struct Row {
    ovality_um: f64,
    taper_um: f64,
    exact_um: f64,
    one_view_um: [f64; 2],
    merged_um: [f64; 2],
    drift: String,
    stitching_s: f64,
}

fn number(value: &Value, path: &str) -> Result<f64, String> {
    let found = value.pointer(path).and_then(Value::as_f64);
    found.ok_or_else(|| format!("{path} is missing"))
}

fn row(scan: &Value, method: usize) -> Result<Row, String> {
    let take = |path: &str| number(scan, &format!("/methods/{method}/{path}"));
    let creep = &scan["methods"][method]["drift"]["largest"];
    let drift = match (creep["trend_um"].as_f64(), creep["direction"].as_str()) {
        (Some(trend_um), Some(direction)) => format!("{trend_um:.1} {direction}"),
        _ => "none".into(),
    };
    Ok(Row {
        ovality_um: take("form/ovality_um")?,
        taper_um: take("form/taper_um")?,
        exact_um: take("exact/rms_um")?,
        one_view_um: [take("one_view/mean_um")?, take("one_view/std_um")?],
        merged_um: [take("merged/mean_um")?, take("merged/std_um")?],
        drift,
        stitching_s: take("stitching_ms")? / 1e3,
    })
}

/// Largest error of the distances across the bore, µm, and how many there are.
fn spacing(scan: &Value) -> Result<(f64, usize), String> {
    let pairs = scan["spacing"].as_array().ok_or("spacing is missing")?;
    let mut worst_um = 0.0_f64;
    for pair in pairs {
        let angle = (number(pair, "/teeth/0")? - 0.5) * std::f64::consts::TAU / 84.0;
        let error_um = number(pair, "/deviation_um")? - OVALITY_UM * (2.0 * angle).cos();
        worst_um = worst_um.max(error_um.abs());
    }
    Ok((worst_um, pairs.len()))
}

fn page(scans: &[(u64, Value)]) -> Result<String, String> {
    let mut page = format!(
        "# What a scan keeps of the die's form\n\n\
         A die that is {OVALITY_UM} µm oval and {TAPER_UM} µm conical, put on the simulated bench 0.5 mm off and 0.2° askew, \
         with a hand-eye known to 1° and 0.5 mm, an encoder with harmonics and axes that are not parallel; {VIEWS} views, \
         every seed with other errors. The same captured views are stitched in one joint solve on the surface (`surface`) and \
         view by view on random CAD points, as in the article (`paper`). `exact` is the root mean square of the exact \
         distances in the merged map, `one view` and `merged` are mean ± standard deviation by the method's own metric. A drift is \
         the part of where the views lie, against what all of them share, that neighbours in a layer have in common \
         (Durbin–Watson beyond chance).\n\n\
         ```sh\ncargo xtask study --scan\n```\n\n\
         | seed | method | ovality, µm | taper, µm | exact, µm | one view, µm | merged, µm | drift of places, µm | stitching, s |\n\
         |---|---|---|---|---|---|---|---|---|\n"
    );
    let mut worst = [[0.0_f64; 2]; 2];
    let mut lines = String::new();
    for (seed, scan) in scans {
        for (index, method) in ["surface", "paper"].into_iter().enumerate() {
            let row = row(scan, index)?;
            worst[index][0] = worst[index][0].max((row.ovality_um - OVALITY_UM).abs());
            worst[index][1] = worst[index][1].max((row.taper_um - TAPER_UM).abs());
            let ([one, one_std], [all, all_std]) = (row.one_view_um, row.merged_um);
            writeln!(
                page,
                "| {seed} | {method} | {:.1} | {:.1} | {:.1} | {one:.1} ± {one_std:.1} | {all:.1} ± {all_std:.1} | {} | {:.1} |",
                row.ovality_um, row.taper_um, row.exact_um, row.drift, row.stitching_s
            )
            .map_err(|error| error.to_string())?;
        }
        let (worst_um, pairs) = spacing(scan)?;
        writeln!(lines, "| {seed} | {pairs} | {worst_um:.1} |")
            .map_err(|error| error.to_string())?;
    }
    write!(
        page,
        "\nFarthest from what was put in: `surface` {:.1} µm of ovality and {:.1} µm of taper, `paper` {:.1} and {:.1} µm.\n\n\
         ## Distances across the bore\n\n\
         Teeth half a turn apart, where both were seen: the distance in the map (`surface`) against the die's.\n\n\
         | seed | pairs | farthest off, µm |\n|---|---|---|\n{lines}",
        worst[0][0], worst[0][1], worst[1][0], worst[1][1]
    )
    .map_err(|error| error.to_string())?;
    Ok(page)
}
