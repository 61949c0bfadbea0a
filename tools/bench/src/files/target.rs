//! `target.toml`: where plates and sphere stand, and what is printed on the plates.

use std::path::Path;

use serde::Deserialize;

use super::{FileError, Placement, read};

/// Places of the three larger dots that mark the middle of a plate, in pitches.
pub const KEYS: [[i32; 2]; 3] = [[0, 0], [2, 0], [0, 1]];

/// The bench's part of a target file.
#[derive(Clone, Debug, Deserialize)]
pub struct TargetFile {
    /// Standard uncertainty of each plate's place.
    pub pose_sigma_mm: f64,
    /// Standard uncertainty of each plate's orientation.
    pub pose_sigma_rad: f64,
    /// What is printed on the plates.
    pub dots: Dots,
    /// The plate without print.
    pub blank: Plate,
    /// The printed plates.
    pub plate: Vec<Plate>,
    /// Further ones without print.
    #[serde(default)]
    pub test_blank: Vec<Plate>,
    /// A sphere beside them.
    pub sphere: Option<Sphere>,
    /// Further ones.
    #[serde(default)]
    pub test_sphere: Vec<Sphere>,
}

/// A square grid of dark dots; three of them are larger.
#[derive(Clone, Copy, Debug, Deserialize)]
pub struct Dots {
    /// From dot to dot.
    pub pitch_mm: f64,
    /// Diameter of a dot.
    pub diameter_mm: f64,
    /// Diameter of the three larger ones.
    pub key_diameter_mm: f64,
}

/// One plate; its frame lies in its surface with z out of it.
#[derive(Clone, Copy, Debug, Deserialize)]
pub struct Plate {
    /// Where it stands.
    pub tool_from_plate: Placement,
}

/// A sphere.
#[derive(Clone, Copy, Debug, Deserialize)]
pub struct Sphere {
    /// Its centre in the tool frame.
    pub centre_mm: [f64; 3],
    /// Its diameter.
    pub diameter_mm: f64,
    /// Another one in the same field.
    pub partner: Option<Partner>,
}

/// The other sphere of a pair.
#[derive(Clone, Copy, Debug, Deserialize)]
pub struct Partner {
    /// Its centre in the tool frame.
    pub centre_mm: [f64; 3],
    /// Its diameter.
    pub diameter_mm: f64,
}

impl TargetFile {
    /// Reads `target.toml`.
    ///
    /// # Errors
    /// [`FileError`].
    pub fn load(path: &Path) -> Result<Self, FileError> {
        read(path)
    }
}
