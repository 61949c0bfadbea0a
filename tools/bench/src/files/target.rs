//! `target.toml`: poses of plates and sphere, and the pattern printed on the plates.

use std::path::Path;

use serde::Deserialize;

use super::{FileError, Placement, read};

/// Positions of the three larger dots that mark the centre of a plate, in pitches.
pub const KEYS: [[i32; 2]; 3] = [[0, 0], [2, 0], [0, 1]];

/// The part of a target file that the bench uses.
#[derive(Clone, Debug, Deserialize)]
pub struct TargetFile {
    /// Standard uncertainty of each plate's position.
    pub pose_sigma_mm: f64,
    /// Standard uncertainty of each plate's orientation.
    pub pose_sigma_rad: f64,
    /// The printed pattern.
    pub dots: Dots,
    /// The plate without print.
    pub blank: Plate,
    /// The printed plates.
    pub plate: Vec<Plate>,
    /// Further plates without print.
    #[serde(default)]
    pub test_blank: Vec<Plate>,
    pub sphere: Option<Sphere>,
    /// Further spheres.
    #[serde(default)]
    pub test_sphere: Vec<Sphere>,
}

/// A square grid of dark dots; three of them are larger.
#[derive(Clone, Copy, Debug, Deserialize)]
pub struct Dots {
    /// Distance between neighbouring dots.
    pub pitch_mm: f64,
    /// Diameter of a dot.
    pub diameter_mm: f64,
    /// Diameter of the three larger ones.
    pub key_diameter_mm: f64,
}

/// One plate; the origin of its frame is on its surface, with z normal to it.
#[derive(Clone, Copy, Debug, Deserialize)]
pub struct Plate {
    /// Its pose.
    pub tool_from_plate: Placement,
}

#[derive(Clone, Copy, Debug, Deserialize)]
pub struct Sphere {
    /// Its centre in the tool frame.
    pub centre_mm: [f64; 3],
    pub diameter_mm: f64,
    /// Another sphere in the same field.
    pub partner: Option<Partner>,
}

/// The other sphere of a pair.
#[derive(Clone, Copy, Debug, Deserialize)]
pub struct Partner {
    /// Its centre in the tool frame.
    pub centre_mm: [f64; 3],
    pub diameter_mm: f64,
}

impl TargetFile {
    /// Reads `target.toml`.
    pub fn load(path: &Path) -> Result<Self, FileError> {
        read(path)
    }
}
