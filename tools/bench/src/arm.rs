//! A robot arm that carries the head: its pose is read from a file, which the program that simulates the arm writes.
//!
//! The file is one line of JSON: the camera's true pose in the die's frame as rows of a 4 x 4 matrix in mm, in the form that a
//! pose program is asked for it (docs/formats/station.md, "Poses from outside"). It is read at every exposure, so it must be
//! replaced atomically (written under another name, then renamed).

use std::path::PathBuf;

use anyhow::{Context, ensure};
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion};

/// Tolerance for the orthonormality of the rotation.
const ORTHONORMAL: f64 = 1e-6;
/// Largest file; a pose takes 400 bytes.
const FILE_BYTES: u64 = 16 * 1024;

/// The file with the arm's pose.
#[derive(Debug)]
pub struct Arm {
    file: PathBuf,
}

impl Arm {
    /// Uses this file, which is read at every exposure.
    pub fn at(file: PathBuf) -> Self {
        Self { file }
    }

    /// Pose of the camera.
    ///
    /// # Errors
    /// The file is missing, or its content is not a pose.
    pub fn tool_from_camera(&self) -> anyhow::Result<Isometry3<f64>> {
        let file = self.file.display();
        let length = std::fs::metadata(&self.file).map(|data| data.len());
        let length = length.with_context(|| format!("{file}: the arm says nowhere"))?;
        ensure!(length <= FILE_BYTES, "{file}: {length} bytes are no pose");
        let text = std::fs::read_to_string(&self.file).with_context(|| file.to_string())?;
        pose(&text).with_context(|| file.to_string())
    }
}

/// Parses a rigid pose.
fn pose(text: &str) -> anyhow::Result<Isometry3<f64>> {
    let rows: [[f64; 4]; 4] = serde_json::from_str(text)?;
    let turn = Matrix3::from_fn(|row, column| rows[row][column]);
    let off = (turn.transpose() * turn - Matrix3::identity()).amax();
    // Written so that NaN fails the test.
    ensure!(
        off < ORTHONORMAL && turn.determinant() > 0.0 && rows[3] == [0.0, 0.0, 0.0, 1.0],
        "no rigid pose: {text}"
    );
    let shift = [rows[0][3], rows[1][3], rows[2][3]];
    ensure!(
        shift.iter().all(|mm| mm.abs() < 1e4),
        "no place within 10 m: {shift:?}"
    );
    let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(turn));
    Ok(Isometry3::from_parts(Translation3::from(shift), turn))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    #[test]
    fn rows_are_a_pose_or_none() {
        // A rotation of 90 degrees about z, then a shift by 1, 2, 3.
        let good = "[[0,-1,0,1],[1,0,0,2],[0,0,1,3],[0,0,0,1]]";
        let moved = pose(good).unwrap() * Point3::new(1.0, 0.0, 0.0);
        assert!((moved - Point3::new(1.0, 3.0, 3.0)).norm() < 1e-12);
        for bad in [
            "",
            "[[NaN]]",
            "[[0,-1,0,1],[1,0,0,2],[0,0,1,3]]",
            "[[0,-1,0,1],[1,0,0,2],[0,0,1,3],[0,0,0,2]]",
            "[[0,-1,0,1],[1,0,0,2],[0,0,-1,3],[0,0,0,1]]",
            "[[0,-1,0,1],[1,0.1,0,2],[0,0,1,3],[0,0,0,1]]",
            "[[0,-1,0,1e9],[1,0,0,2],[0,0,1,3],[0,0,0,1]]",
            "[[0,-1e200,0,1],[1e200,0,0,2],[0,0,1,3],[0,0,0,1]]",
        ] {
            assert!(pose(bad).is_err(), "{bad}");
        }
    }
}
