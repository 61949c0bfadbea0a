//! Rigid transforms between frames of reference, which are types, so that a transform can only be applied to points of its own frame.
//!
//! All frames are right-handed, millimetres. [`Tool`]: die axis = z. [`Stage`]: z = rotation axis of the stage.
//! [`Camera`]: x along columns, y along rows, z into the scene. [`Projector`]: the same for the pattern. [`Cloud`]: whatever
//! frame a foreign cloud is in.

use std::marker::PhantomData;
use std::ops::Mul;

use nalgebra::{Isometry3, Matrix3, Matrix4, Point3, Rotation3, Translation3, UnitQuaternion};

macro_rules! frames {
    ($($(#[$doc:meta])* $name:ident),*) => {$(
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum $name {}
    )*};
}

frames! {
    /// Coordinates of the die as it is.
    Tool,
    /// Rotary stage.
    Stage,
    /// Measuring camera.
    Camera,
    /// Pattern projector.
    Projector,
    /// A cloud whose frame is not known yet.
    Cloud
}

/// A rigid transform that takes points of `From` to `To`.
///
/// ```
/// use flankscope_foundation::rigid::{Camera, Rigid, Stage, Tool};
/// use nalgebra::Isometry3;
/// let tool_from_stage: Rigid<Tool, Stage> = Rigid::from_isometry(Isometry3::identity());
/// let stage_from_camera: Rigid<Stage, Camera> = Rigid::from_isometry(Isometry3::translation(1.0, 0.0, 0.0));
/// let tool_from_camera: Rigid<Tool, Camera> = tool_from_stage * stage_from_camera;
/// assert_eq!(tool_from_camera.apply([0.0, 2.0, 0.0]), [1.0, 2.0, 0.0]);
/// ```
///
/// The wrong order does not compile:
/// ```compile_fail
/// use flankscope_foundation::rigid::{Camera, Rigid, Stage, Tool};
/// use nalgebra::Isometry3;
/// let tool_from_stage: Rigid<Tool, Stage> = Rigid::from_isometry(Isometry3::identity());
/// let stage_from_camera: Rigid<Stage, Camera> = Rigid::from_isometry(Isometry3::identity());
/// let wrong = stage_from_camera * tool_from_stage;
/// ```
pub struct Rigid<To, From>(Isometry3<f64>, PhantomData<fn() -> (To, From)>);

/// Why a matrix is no rigid transform.
#[derive(Debug, thiserror::Error, PartialEq)]
#[non_exhaustive]
pub enum RigidError {
    /// NaN or infinity.
    #[error("row {row}, column {column} of the transform is {value}; every element must be finite")]
    NonFinite {
        /// Row, from 0.
        row: usize,
        /// Column, from 0.
        column: usize,
        /// The value.
        value: f64,
    },
    /// Last row.
    #[error(
        "the transform's last row is {row:?}; right would be [0, 0, 0, 1] (row-major, points as columns)"
    )]
    LastRow {
        /// The row.
        row: [f64; 4],
    },
    /// Scale or shear.
    #[error(
        "the transform's 3x3 part is off a rotation by {error:.3e} (largest element of R^T R - I), allowed is {limit:.0e}: it scales or shears"
    )]
    NotOrthonormal {
        /// Largest deviation.
        error: f64,
        /// Limit.
        limit: f64,
    },
    /// Mirror.
    #[error(
        "the transform mirrors (determinant {determinant:.6}); right would be a rotation (determinant 1)"
    )]
    Mirrored {
        /// Determinant of the 3x3 part.
        determinant: f64,
    },
}

/// How far a matrix from a file may be off a rotation, largest element of RᵀR − 1: what six printed digits leave.
const ORTHONORMAL_TO: f64 = 1e-5;

/// The rotation nearest to a matrix from a file.
///
/// # Errors
/// [`RigidError::NotOrthonormal`] or [`RigidError::Mirrored`] if the matrix is none even up to 1e-5, as printed ones are.
pub fn rotation(matrix: &Matrix3<f64>) -> Result<UnitQuaternion<f64>, RigidError> {
    let error = (matrix.transpose() * matrix - Matrix3::identity()).amax();
    if error.is_nan() || error > ORTHONORMAL_TO {
        return Err(RigidError::NotOrthonormal {
            error,
            limit: ORTHONORMAL_TO,
        });
    }
    let determinant = matrix.determinant();
    if determinant < 0.0 {
        return Err(RigidError::Mirrored { determinant });
    }
    Ok(nearest_rotation(matrix))
}

/// The rotation nearest to a matrix that is one up to the digits of its file.
pub fn nearest_rotation(matrix: &Matrix3<f64>) -> UnitQuaternion<f64> {
    // Newton's iteration for the polar decomposition; from 1e-5 two steps reach rounding.
    let mut rotation = *matrix;
    for _ in 0..3 {
        if let Some(inverse) = rotation.try_inverse() {
            rotation = 0.5 * (rotation + inverse.transpose());
        }
    }
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation))
}

impl<To, From> Rigid<To, From> {
    /// Names the frames of a bare isometry: the one place where a wrong name can slip in.
    pub fn from_isometry(isometry: Isometry3<f64>) -> Self {
        Self(isometry, PhantomData)
    }

    /// The bare isometry.
    pub fn isometry(&self) -> &Isometry3<f64> {
        &self.0
    }

    /// The transform back.
    pub fn inverse(&self) -> Rigid<From, To> {
        Rigid::from_isometry(self.0.inverse())
    }

    /// A point of `From`, mm, seen in `To`.
    pub fn apply(&self, point: [f64; 3]) -> [f64; 3] {
        (self.0 * Point3::from(point)).into()
    }

    /// Reads a 4x4 row-major matrix.
    ///
    /// # Errors
    /// [`RigidError`] unless it is a rotation and a translation. Rounding of printed matrices up to 1e-5 is accepted and
    /// removed by taking the nearest rotation.
    pub fn from_rows(rows: &[[f64; 4]; 4]) -> Result<Self, RigidError> {
        for (row, values) in rows.iter().enumerate() {
            if let Some(column) = values.iter().position(|v| !v.is_finite()) {
                return Err(RigidError::NonFinite {
                    row,
                    column,
                    value: values[column],
                });
            }
        }
        let expected = [0.0, 0.0, 0.0, 1.0];
        if (0..4).any(|k| (rows[3][k] - expected[k]).abs() > 1e-9) {
            return Err(RigidError::LastRow { row: rows[3] });
        }
        let rotation = rotation(&Matrix3::from_fn(|r, c| rows[r][c]))?;
        let translation = Translation3::new(rows[0][3], rows[1][3], rows[2][3]);
        Ok(Self::from_isometry(Isometry3::from_parts(
            translation,
            rotation,
        )))
    }

    /// The 4x4 row-major matrix.
    pub fn to_rows(&self) -> [[f64; 4]; 4] {
        let matrix: Matrix4<f64> = self.0.to_homogeneous();
        std::array::from_fn(|r| std::array::from_fn(|c| matrix[(r, c)]))
    }
}

impl<A, B, C> Mul<Rigid<B, C>> for Rigid<A, B> {
    type Output = Rigid<A, C>;
    fn mul(self, right: Rigid<B, C>) -> Rigid<A, C> {
        Rigid::from_isometry(self.0 * right.0)
    }
}

impl<To, From> Clone for Rigid<To, From> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<To, From> Copy for Rigid<To, From> {}

impl<To, From> PartialEq for Rigid<To, From> {
    fn eq(&self, other: &Self) -> bool {
        self.0 == other.0
    }
}

impl<To, From> std::fmt::Debug for Rigid<To, From> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.fmt(f)
    }
}
