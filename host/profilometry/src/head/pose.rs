//! Rigid transforms as files write them.

use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};

use flankscope_foundation::rigid::{self, Rigid, RigidError};
use flankscope_foundation::textfile::{self, BadValue};

/// A rotation and a translation, named `<to>_from_<from>` where it is used.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RigidTransform {
    /// Row by row.
    pub rotation: [[f64; 3]; 3],
    /// Translation.
    pub translation_mm: [f64; 3],
}

impl RigidTransform {
    /// Applies it to a point.
    pub fn point(&self, point: [f64; 3]) -> [f64; 3] {
        let rotated = self.direction(point);
        std::array::from_fn(|axis| rotated[axis] + self.translation_mm[axis])
    }

    /// Applies the rotation alone.
    pub fn direction(&self, vector: [f64; 3]) -> [f64; 3] {
        self.rotation
            .map(|row| row[0] * vector[0] + row[1] * vector[1] + row[2] * vector[2])
    }

    /// As a 4x4 matrix, row by row.
    pub fn rows(&self) -> [[f64; 4]; 4] {
        let [r, t] = [self.rotation, [self.translation_mm; 3]];
        let row = |i: usize| [r[i][0], r[i][1], r[i][2], t[i][i]];
        [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
    }

    /// The rotation as it is written.
    pub(crate) fn matrix(&self) -> Matrix3<f64> {
        Matrix3::from_fn(|row, column| self.rotation[row][column])
    }

    /// As a transform between frames; the rotation is the nearest one to the file's digits.
    ///
    /// # Errors
    /// [`RigidError`] unless it is a rotation to 1e-5 and finite.
    pub fn rigid<To, From>(&self) -> Result<Rigid<To, From>, RigidError> {
        Rigid::from_rows(&self.rows())
    }

    #[rustfmt::skip]
    pub(crate) fn check(&self, table: &str) -> Result<(), BadValue> {
        let Self { rotation, translation_mm } = self;
        let is_rotation = rigid::rotation(&self.matrix()).is_ok();
        let is_near = translation_mm.iter().all(|value| value.abs() <= 1e6);
        textfile::require(&[
            (is_rotation, &format!("{table}.rotation"), rotation, "must be a rotation matrix, row by row: orthonormal to 1e-5 and right-handed"),
            (is_near, &format!("{table}.translation_mm"), translation_mm, "must be finite millimetres"),
        ])
    }
}
