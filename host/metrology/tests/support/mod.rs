//! Shared by the integration tests: random numbers, foreign data, and a place for the skip message.
#![allow(dead_code)]

use std::path::PathBuf;

use flankscope_metrology::mesh::{self, TriMesh, Unit};

/// A small generator (SplitMix64), so that a test's numbers do not depend on the code under test.
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Standard normal by Box and Muller.
    pub fn normal(&mut self) -> f64 {
        let u = 1.0 - self.uniform();
        let v = self.uniform();
        (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
    }
}

/// The internal gear from another CAD kernel, or a visible skip.
pub fn ring84(test: &str) -> Option<TriMesh> {
    let path = ring84_path(test)?;
    Some(mesh::load(&path, Unit::Mm).unwrap())
}

pub fn ring84_path(test: &str) -> Option<PathBuf> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR"))
        .join("../../../shared/data/cad-ring84/ring84.stl");
    if !path.exists() {
        println!("SKIPPED {test}: shared/data/cad-ring84/ring84.stl is not there");
        return None;
    }
    Some(path)
}
