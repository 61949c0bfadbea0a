//! Shared by the integration tests: random numbers, the ring gear, and a place for the skip message.
#![allow(dead_code)]

use std::path::PathBuf;

use flankscope_gear_cad::{GearKind, GearSpec, Meshing};
use flankscope_metrology::io::Unit;
use flankscope_metrology::io::mesh::{self, TriMesh};
use flankscope_test_requisites::shared;

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

/// Chord error of [`ring84_spec`]'s mesh, mm: below the 4.3 um of the ring from another CAD kernel.
const CHORD_ERROR_MM: f64 = 4e-3;

/// The ring gear that most tests measure: 84 internal teeth of module 1.
pub fn ring84_spec() -> GearSpec {
    GearSpec {
        kind: GearKind::Internal,
        teeth: 84,
        module_mm: 1.0,
        pressure_angle_rad: 20f64.to_radians(),
        tip_radius_mm: 41.0,
        root_radius_mm: 43.25,
        root_fillet_radius_mm: 0.0,
        turned_rad: 0.0,
        body_radius_mm: 51.25,
        height_mm: [0.0, 66.0],
    }
}

/// A gear as a mesh with chords this near to its involutes, mm.
pub fn mesh_of(gear: &GearSpec, chord_error_mm: f64) -> TriMesh {
    let solid = gear
        .mesh(&Meshing {
            chord_error_mm,
            ..Meshing::default()
        })
        .unwrap();
    TriMesh {
        vertices: solid.vertices,
        triangles: solid.triangles,
    }
}

/// Runs a test on the ring gear, and on that of another CAD kernel if it is there.
pub fn on_every_ring84(body: impl Fn(TriMesh)) {
    body(mesh_of(&ring84_spec(), CHORD_ERROR_MM));
    if let Some(path) = shared("data/cad-ring84/ring84.stl") {
        body(mesh::load(&path, Unit::Mm).unwrap());
    }
}

/// The same for tests that want a file.
pub fn on_every_ring84_file(body: impl Fn(PathBuf)) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("ring84.stl");
    let solid = mesh_of(&ring84_spec(), CHORD_ERROR_MM);
    mesh::write_stl(&mut std::fs::File::create(&path).unwrap(), &solid).unwrap();
    body(path);
    if let Some(path) = shared("data/cad-ring84/ring84.stl") {
        body(path);
    }
}
