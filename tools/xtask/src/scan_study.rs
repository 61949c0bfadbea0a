//! Both ways to stitch a scan, over several seeds: what is left of a form that was put into the die.

use std::fmt::Write as _;
use std::path::Path;

use serde_json::Value;

/// What is put into the die, µm.
const OVALITY_UM: f64 = 20.0;
const TAPER_UM: f64 = 15.0;
/// Views of each scan.
const VIEWS: &str = "12x8";
/// Their layers.
const LAYERS: f64 = 8.0;
const SEEDS: std::ops::RangeInclusive<u64> = 1..=5;

/// Scans with every seed and writes `docs/study/scan.md`.
pub fn run(root: &Path, commit: &str) -> Result<(), String> {
    let mut scans = Vec::new();
    for seed in SEEDS {
        eprintln!("scan {seed} of {}", SEEDS.end());
        scans.push((seed, scan(root, seed)?));
    }
    let page = page(&scans, commit)?;
    let path = root.join("docs/study/scan.md");
    std::fs::write(&path, page).map_err(|error| format!("{}: {error}", path.display()))
}

fn scan(root: &Path, seed: u64) -> Result<Value, String> {
    let bench = root.join("target/scan-study.toml");
    let form = format!("[die]\novality_um = {OVALITY_UM:?}\ntaper_um = {TAPER_UM:?}\n");
    std::fs::write(&bench, form).map_err(|error| format!("{}: {error}", bench.display()))?;
    let seed = seed.to_string();
    let mut cargo = crate::cargo(&["run", "--release", "--quiet", "--", "scan", "--quiet"]);
    cargo.args(["--json", "-", "--speed", "max", "--method", "both"]);
    cargo.args(["--views", VIEWS, "--seed", &seed]);
    cargo.arg("--bench").arg(&bench);
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

/// The distances across the bore against the die's.
struct Spacing {
    pairs: usize,
    worst_um: f64,
    /// Mean expanded uncertainty, µm.
    u95_um: f64,
    /// Distances within it.
    covered: usize,
}

fn spacing(scan: &Value) -> Result<Spacing, String> {
    let pairs = scan["spacing"].as_array().ok_or("spacing is missing")?;
    let (mut worst_um, mut sum_um, mut covered) = (0.0_f64, 0.0, 0);
    for pair in pairs {
        let angle = (number(pair, "/teeth/0")? - 0.5) * std::f64::consts::TAU / 84.0;
        let error_um = number(pair, "/deviation_um")? - OVALITY_UM * (2.0 * angle).cos();
        let u95_um = number(pair, "/u95_um")?;
        worst_um = worst_um.max(error_um.abs());
        sum_um += u95_um;
        covered += usize::from(error_um.abs() <= u95_um);
    }
    Ok(Spacing {
        pairs: pairs.len(),
        worst_um,
        u95_um: sum_um / pairs.len().max(1) as f64,
        covered,
    })
}

/// Steps between layers before and after overlaps counted, and the uncertainties of ovality and taper.
fn steps_line(seed: u64, scan: &Value) -> Result<String, String> {
    let take = |path: &str| number(scan, path);
    Ok(format!(
        "| {seed} | {:.0} | {:.2} | {:.2} | {:.1} ± {:.1} | {:.1} ± {:.1} | {:.3} |",
        take("/joint/steps/up/pairs")?,
        take("/joint/steps/up/before_um")?,
        take("/joint/steps/up/after_um")?,
        take("/form/ovality_um")?,
        take("/form/ovality_u95_um")?,
        take("/form/taper_um")?,
        take("/form/taper_u95_um")?,
        take("/joint/found/vertical_lean_mrad/1")?,
    ))
}

fn page(scans: &[(u64, Value)], commit: &str) -> Result<String, String> {
    let mut page = format!(
        "# What a scan keeps of the die's form\n\n\
         Made by `cargo xtask study --scan` at commit `{commit}`.\n\n\
         A die that is {OVALITY_UM} µm oval and {TAPER_UM} µm conical, put on the simulated bench 0.5 mm off and 0.2° askew, \
         with a hand-eye known to 1° and 0.5 mm, an encoder with harmonics and axes that are not parallel; {VIEWS} views, \
         every seed with other errors. The same captured views are stitched in one joint solve on the surface (`surface`) and \
         view by view on random CAD points, as in the article (`article`). `exact` is the root mean square of the exact \
         distances in the merged map, `one view` and `merged` are mean ± standard deviation by the method's own metric. A drift is \
         the part of where the views lie, against what all of them share, that neighbours in a layer have in common \
         (Durbin–Watson beyond chance).\n\n\
         | seed | method | ovality, µm | taper, µm | exact, µm | one view, µm | merged, µm | drift of places, µm | stitching, s |\n\
         |---|---|---|---|---|---|---|---|---|\n"
    );
    let mut worst = [[0.0_f64; 2]; 2];
    let (mut lines, mut steps) = (String::new(), String::new());
    for (seed, scan) in scans {
        for (index, method) in ["surface", "article"].into_iter().enumerate() {
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
        let Spacing {
            pairs,
            worst_um,
            u95_um,
            covered,
        } = spacing(scan)?;
        writeln!(
            lines,
            "| {seed} | {pairs} | {worst_um:.1} | {u95_um:.1} | {covered} |"
        )
        .map_err(|error| error.to_string())?;
        writeln!(steps, "{}", steps_line(*seed, scan)?).map_err(|error| error.to_string())?;
    }
    write!(
        page,
        "\nFarthest from what was put in: `surface` {:.1} µm of ovality and {:.1} µm of taper, `article` {:.1} and {:.1} µm.\n\n\
         ## Steps between layers\n\n\
         Neighbours in height share a strip of 2 mm. Root mean square of the steps between them, with every view laid on the CAD \
         alone and with what neighbours say of each other; a solve that took the lean of the wall for one of the head would leave \
         {:.1} µm. Ovality and taper with their expanded uncertainties (95 %); the lean of the vertical axis towards the wall looks \
         like a taper and stays an assumption.\n\n\
         | seed | pairs | steps alone, µm | together, µm | ovality, µm | taper, µm | lean, mrad |\n|---|---|---|---|---|---|---|\n{steps}\n\
         ## Distances across the bore\n\n\
         Teeth half a turn apart, where both were seen: the distance in the map (`surface`) against the die's, and how many are within \
         their stated uncertainty.\n\n\
         | seed | pairs | farthest off, µm | U95, µm | within it |\n|---|---|---|---|---|\n{lines}",
        worst[0][0],
        worst[0][1],
        worst[1][0],
        worst[1][1],
        TAPER_UM / LAYERS
    )
    .map_err(|error| error.to_string())?;
    Ok(page)
}
