//! Instructions of the hot kernels, counted by valgrind: the same number on every run, whatever else the machine does.

use std::path::Path;
use std::process::Command;

/// Kernels of `host/metrology/examples/kernels.rs`, and the millions of instructions that each took when it was last judged
/// good. Rust 1.95, release, AVX2.
const KERNELS: [(&str, &str, f64); 4] = [
    ("distance", "100 000 sorted points, 6 720 triangles", 47.7),
    ("register", "100 000 points", 187.8),
    ("outliers", "100 000 points of a view, k = 20", 507.0),
    ("merge", "300 000 points, 0.05 mm", 85.6),
];
/// More than this above it is a regression; as much below, and the number wants to be brought up to date.
const TOLERANCE: f64 = 0.03;

/// Counts every kernel on the benchmark's data and fails if one became dearer.
pub fn check(data: &Path) -> Result<(), String> {
    if flankscope_test_requisites::on_path("valgrind").is_none() {
        return Err("valgrind is missing; get it: apt-get install valgrind".into());
    }
    crate::run(crate::cargo(&[
        "build",
        "--release",
        "-q",
        "-p",
        "flankscope-metrology",
        "--example",
        "kernels",
    ]))?;
    let target = crate::target();
    println!("| kernel | work | million instructions | last judged good |\n|---|---|---|---|");
    let mut dearer = Vec::new();
    for (kernel, work, good) in KERNELS {
        let output = Command::new("valgrind")
            .args([
                "--tool=callgrind",
                "--callgrind-out-file=/dev/null",
                "--collect-atstart=no",
                "--toggle-collect=*kernels*counted*",
            ])
            .arg(target.join("release/examples/kernels"))
            .arg(data)
            .arg(kernel)
            .output()
            .map_err(|error| format!("valgrind: {error}"))?;
        let said = String::from_utf8_lossy(&output.stderr);
        let count = said
            .lines()
            .find_map(|line| line.split_once("Collected :")?.1.trim().parse::<f64>().ok())
            .ok_or_else(|| format!("valgrind did not count {kernel}:\n{said}"))?;
        let millions = count * 1e-6;
        println!("| {kernel} | {work} | {millions:.1} | {good} |");
        if millions > good * (1.0 + TOLERANCE) {
            dearer.push(format!(
                "{kernel}: {millions:.1} million instructions, {good} were enough"
            ));
        }
    }
    if dearer.is_empty() {
        Ok(())
    } else {
        Err(dearer.join("\n       "))
    }
}
