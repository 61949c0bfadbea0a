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
