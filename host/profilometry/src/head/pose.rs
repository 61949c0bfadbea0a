//! Rigid transforms as files write them.

use serde::{Deserialize, Serialize};

use crate::textfile::BadValue;

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

    pub(crate) fn check(&self, table: &str) -> Result<(), BadValue> {
        let bad = |got: [f64; 3]| {
            BadValue::new(
                format!("{table}.rotation"),
                got,
                "must be a rotation matrix, row by row: orthonormal to 1e-5 and right-handed",
            )
        };
        let r = &self.rotation;
        for i in 0..3 {
            for j in 0..3 {
                let product: f64 = (0..3).map(|k| r[i][k] * r[j][k]).sum();
                let ideal = f64::from(u8::from(i == j));
                // Nine printed digits of a single-precision calibration leave about 1e-7.
                if !((product - ideal).abs() < 1e-5) {
                    return Err(bad(r[i]));
                }
            }
        }
        let determinant = r[0][0] * (r[1][1] * r[2][2] - r[1][2] * r[2][1])
            - r[0][1] * (r[1][0] * r[2][2] - r[1][2] * r[2][0])
            + r[0][2] * (r[1][0] * r[2][1] - r[1][1] * r[2][0]);
        if determinant < 0.0 {
            return Err(bad(r[2]));
        }
        if self
            .translation_mm
            .iter()
            .any(|value| value.is_nan() || value.abs() > 1e6)
        {
            return Err(BadValue::new(
                format!("{table}.translation_mm"),
                self.translation_mm,
                "must be finite millimetres",
            ));
        }
        Ok(())
    }
}
