//! Files that describe a die, a head and a target: the bench reads the few keys that it uses with its own parsers.
//!
//! `docs/formats` describes the files. The instrument validates them; the bench only takes the geometry of its scene.

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

/// Why the bench cannot use a file.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// The file cannot be read.
    #[error("cannot read {}: {cause}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        cause: std::io::Error,
    },
    /// Not TOML, a missing key or a wrong type.
    #[error("{}: {cause}", path.display())]
    Toml {
        /// The file.
        path: PathBuf,
        /// Cause, with its position.
        cause: Box<toml::de::Error>,
    },
    /// A number is infinite or NaN.
    #[error("{}: {key} = {got}; must be a finite number", path.display())]
    NotFinite {
        /// The file.
        path: PathBuf,
        key: String,
        /// Its value.
        got: f64,
    },
    /// A value is out of range.
    #[error("{}: {key} = {got}; must be {expected}", path.display())]
    Value {
        /// The file.
        path: PathBuf,
        key: &'static str,
        got: f64,
        /// Expected values.
        expected: &'static str,
    },
}

fn read<T: DeserializeOwned>(path: &Path) -> Result<T, FileError> {
    parse(path, &text(path)?)
}

/// The path, if it is a regular file; reading a pipe or a device might never end.
///
/// # Errors
/// Errors of the operating system, or the path is not a regular file.
pub fn regular(path: &Path) -> std::io::Result<&Path> {
    if std::fs::metadata(path)?.is_file() {
        return Ok(path);
    }
    let why = "it is no regular file";
    Err(std::io::Error::new(std::io::ErrorKind::InvalidInput, why))
}

fn text(path: &Path) -> Result<String, FileError> {
    let read = regular(path).and_then(std::fs::read_to_string);
    read.map_err(|cause| FileError::Read {
        path: path.to_path_buf(),
        cause,
    })
}

fn parse<T: DeserializeOwned>(path: &Path, text: &str) -> Result<T, FileError> {
    let refused = |cause| FileError::Toml {
        path: path.to_path_buf(),
        cause: Box::new(cause),
    };
    let table: toml::Table = toml::from_str(text).map_err(refused)?;
    if let Some((key, got)) = not_finite(&toml::Value::Table(table)) {
        let path = path.to_path_buf();
        return Err(FileError::NotFinite { path, key, got });
    }
    toml::from_str(text).map_err(refused)
}

/// The first number of a file that is not finite or too large for a world, with its key.
fn not_finite(value: &toml::Value) -> Option<(String, f64)> {
    let below = |key: String, value: &toml::Value| {
        let (inner, got) = not_finite(value)?;
        let joint = if inner.is_empty() || inner.starts_with('[') {
            ""
        } else {
            "."
        };
        Some((format!("{key}{joint}{inner}"), got))
    };
    match value {
        toml::Value::Float(got) if !got.is_finite() => Some((String::new(), *got)),
        toml::Value::Array(all) => all
            .iter()
            .enumerate()
            .find_map(|(at, value)| below(format!("[{at}]"), value)),
        toml::Value::Table(table) => table
            .iter()
            .find_map(|(key, value)| below(key.clone(), value)),
        _ => None,
    }
}

/// A pose, as in the files.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
pub struct Placement {
    /// Rotation matrix, row by row.
    pub rotation: [[f64; 3]; 3],
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_that_are_none_stop_at_the_border() {
        let read = |text: &str| parse::<toml::Table>(Path::new("optics.toml"), text);
        assert!(read("a = 1.0\n[b]\nc = [1e300, 2]").is_ok());
        for (text, key) in [
            ("a = -inf", "a = -inf"),
            ("[b]\nc = nan", "b.c = NaN"),
            ("[b]\nc = [1.0, [inf]]", "b.c[1][0] = inf"),
        ] {
            let error = read(text).unwrap_err().to_string();
            assert!(
                error.contains(&format!("optics.toml: {key}; must be")),
                "{error}"
            );
        }
    }
}
