//! What the bench reads of the files that describe a die, a head and a target: its own few keys of them, by readers of its own.
//!
//! `docs/formats` describes the files. Who measures checks them; the bench takes from them what stands on it.

mod head;
pub mod mesh;
mod optics;
pub mod pictures;
mod target;
mod tool;

use std::path::{Path, PathBuf};

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde::Deserialize;
use serde::de::DeserializeOwned;

pub use head::{HeadFile, Lens};
pub use optics::{FILE as OPTICS_FILE, MadeHead, made_head_beside};
pub use target::{Dots, KEYS, Partner, Plate, Sphere, TargetFile};
pub use tool::{Cad, Gear, Inspect, Kind, ToolFile, Unit};

/// Why a file says nothing of use to the bench.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FileError {
    /// The file cannot be read.
    #[error("cannot read {}: {cause}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Cause.
        cause: std::io::Error,
    },
    /// Not TOML, a missing key or a wrong type.
    #[error("{}: {cause}", path.display())]
    Toml {
        /// The file.
        path: PathBuf,
        /// Cause, with its place.
        cause: Box<toml::de::Error>,
    },
    /// A number that nothing can have.
    #[error("{}: {key} = {got}; must be {expected}", path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// The key.
        key: &'static str,
        /// Its value.
        got: f64,
        /// What would be right.
        expected: &'static str,
    },
}

fn read<T: DeserializeOwned>(path: &Path) -> Result<T, FileError> {
    parse(path, &text(path)?)
}

fn text(path: &Path) -> Result<String, FileError> {
    std::fs::read_to_string(path).map_err(|cause| FileError::Read {
        path: path.to_path_buf(),
        cause,
    })
}

fn parse<T: DeserializeOwned>(path: &Path, text: &str) -> Result<T, FileError> {
    toml::from_str(text).map_err(|cause| FileError::Toml {
        path: path.to_path_buf(),
        cause: Box::new(cause),
    })
}

/// A pose as files state it.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
pub struct Placement {
    /// Row by row.
    pub rotation: [[f64; 3]; 3],
    /// Translation, mm.
    pub translation_mm: [f64; 3],
}

impl From<&Isometry3<f64>> for Placement {
    fn from(pose: &Isometry3<f64>) -> Self {
        let matrix = pose.rotation.to_rotation_matrix();
        Self {
            rotation: std::array::from_fn(|row| {
                std::array::from_fn(|column| matrix[(row, column)])
            }),
            translation_mm: pose.translation.vector.into(),
        }
    }
}

impl From<&Placement> for Isometry3<f64> {
    fn from(file: &Placement) -> Self {
        let matrix = Matrix3::from_fn(|row, column| file.rotation[row][column]);
        let rotation =
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
        Isometry3::from_parts(
            Translation3::from(Vector3::from(file.translation_mm)),
            rotation,
        )
    }
}
