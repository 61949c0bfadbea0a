//! The command as a user runs it, and clouds to feed it.
#![allow(dead_code)] // each test binary uses its part

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

pub fn flankscope(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_flankscope"))
        .current_dir(folder)
        .env(
            "FLANKSCOPE_STATE",
            concat!(env!("CARGO_TARGET_TMPDIR"), "/station"),
        )
        // Its words are the same on every machine.
        .env("LC_ALL", "C")
        .args(args)
        .output()
        .unwrap()
}

pub fn json(output: &Output) -> Value {
    assert!(output.status.code().is_some());
    serde_json::from_slice(&output.stdout)
        .unwrap_or_else(|e| panic!("{e}: {}", String::from_utf8_lossy(&output.stderr)))
}

/// Uniform numbers that do not come from the code under test.
pub struct Random(pub u64);

impl Random {
    pub fn uniform(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Sum of twelve uniforms less six: normal enough for noise.
    pub fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

pub fn write_xyz(path: &Path, points: &[[f64; 3]]) {
    let text: String = points
        .iter()
        .map(|p| format!("{} {} {}\n", p[0], p[1], p[2]))
        .collect();
    std::fs::write(path, text).unwrap();
}

pub fn assert_refused(folder: &Path, name: &str, output: &Output, words: &[&str]) {
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(3), "{name}: {text}");
    assert_eq!(text.trim_end().lines().count(), 1, "{name}: {text}");
    for word in words {
        assert!(text.contains(word), "{name}: {word:?} is not in {text}");
    }
    assert!(output.stdout.is_empty(), "{name}");
    assert!(!folder.join("out.ply").exists(), "{name}: half-written");
}
