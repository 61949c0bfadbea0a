//! Instructions of every stage of a check, counted by valgrind: the same number on every run, whatever else the machine does.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Mutex;

use super::data;
use crate::tests;

/// A stage, as an example runs it in a function of its own.
struct Stage {
    example: &'static str,
    name: &'static str,
    work: &'static str,
    /// Millions of instructions when it was last judged good: Rust 1.95, development profile with one code generation unit a crate, AVX2.
    good: f64,
}

/// The views are those of `tools/demo/examples/capture.rs`, everything else is of `host/metrology/examples/kernels.rs`.
#[rustfmt::skip]
const STAGES: [Stage; 8] = [
    Stage { example: "capture", name: "high12", work: "a view of 25 frames to points, core by core", good: 705.0 },
    Stage { example: "capture", name: "scan16", work: "a view of 17 frames to points", good: 1042.5 },
    Stage { example: "capture", name: "insitu12", work: "a view of 13 frames to points", good: 766.2 },
    Stage { example: "kernels", name: "outliers", work: "100 000 points of a view, k = 20", good: 1418.4 },
    Stage { example: "kernels", name: "register", work: "100 000 points", good: 247.6 },
    Stage { example: "kernels", name: "distance", work: "100 000 sorted points, 6 720 triangles", good: 145.0 },
    Stage { example: "kernels", name: "wear", work: "100 000 points, both flanks of three teeth", good: 603.7 },
    Stage { example: "kernels", name: "merge", work: "300 000 points, 0.05 mm", good: 87.9 },
];
/// More than this above it is a regression; as much below, and the number wants to be brought up to date.
const TOLERANCE: f64 = 0.03;
/// glibc copies and computes in one way on every processor; by itself it takes what suits the one it runs on, which moves counts by up to 10 %.
const SAME_LIBRARY: &str = "glibc.cpu.hwcaps=-AVX2,-FMA,-ERMS,-FSRM,-AVX_Fast_Unaligned_Load:glibc.cpu.x86_non_temporal_threshold=0xc0000";
/// Points of the ring's clouds: what the kernels take of them.
const RING_POINTS: usize = 300_000;

/// Counts every stage and fails if one became dearer, or so much cheaper that the next regression would hide behind it.
///
/// # Errors
/// What valgrind or a stage said, and every stage that is beyond the tolerance.
pub fn check(root: &Path) -> Result<(), String> {
    if flankscope_test_requisites::on_path("valgrind").is_none() {
        return Err("valgrind is missing; get it: apt-get install valgrind".into());
    }
    if !has_avx2() {
        println!("nothing counted: the numbers are those of a processor with AVX2");
        return Ok(());
    }
    let folder = crate::target().join("instruction-data");
    data::make(&folder, RING_POINTS)?;
    let examples = tests::build(root, Some(1))?.examples;
    let counts = Mutex::new(HashMap::new());
    tests::on_every_core(&STAGES, |stage| {
        let count = examples
            .get(stage.example)
            .ok_or_else(|| format!("no example {} was built", stage.example))
            .and_then(|program| millions(program, stage, &folder));
        let mut counts = counts.lock().unwrap_or_else(|broken| broken.into_inner());
        counts.insert(stage.name, count);
    });
    let mut counts = counts
        .into_inner()
        .unwrap_or_else(|broken| broken.into_inner());
    println!("| stage | work | million instructions | last judged good |\n|---|---|---|---|");
    let mut off = Vec::new();
    for Stage {
        name, work, good, ..
    } in &STAGES
    {
        let count = counts.remove(name);
        let millions = count.unwrap_or_else(|| Err(format!("{name} was not counted")))?;
        println!("| {name} | {work} | {millions:.1} | {good} |");
        if (millions / good - 1.0).abs() > TOLERANCE {
            off.push(format!(
                "{name}: {millions:.1} million instructions instead of {good}: mend what became dearer, or enter the new number in \
                 tools/xtask/src/bench/instructions.rs and BENCHMARK.md and say why"
            ));
        }
    }
    if off.is_empty() {
        Ok(())
    } else {
        Err(off.join("\n       "))
    }
}

fn has_avx2() -> bool {
    #[cfg(target_arch = "x86_64")]
    return is_x86_feature_detected!("avx2") && is_x86_feature_detected!("bmi2");
    #[cfg(not(target_arch = "x86_64"))]
    false
}

fn millions(program: &PathBuf, stage: &Stage, data: &Path) -> Result<f64, String> {
    let output = Command::new("valgrind")
        .args([
            "--tool=callgrind",
            "--callgrind-out-file=/dev/null",
            "--collect-atstart=no",
        ])
        .arg(format!("--toggle-collect=*{}*counted*", stage.example))
        .arg(program)
        .args(["counted", stage.name])
        .arg(data)
        .env("GLIBC_TUNABLES", SAME_LIBRARY)
        .output()
        .map_err(|error| format!("valgrind: {error}"))?;
    let said = String::from_utf8_lossy(&output.stderr);
    let collected = said
        .lines()
        .find_map(|line| line.split_once("Collected :")?.1.trim().parse::<f64>().ok());
    match collected {
        Some(count) if output.status.success() => Ok(count * 1e-6),
        _ => Err(format!("valgrind did not count {}:\n{said}", stage.name)),
    }
}
