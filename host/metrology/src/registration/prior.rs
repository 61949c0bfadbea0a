//! Expected pose with its covariance, from the positions of the stages.

use nalgebra::{Isometry3, Matrix3, Matrix6, Point3, Vector3, Vector6};

use flankscope_foundation::rigid::{Cloud, Rigid, Tool};

/// A pose with the covariance of a small motion that follows it in tool coordinates: rotation about `pivot_mm` (rad), then
/// translation (mm).
#[derive(Debug, Clone)]
pub struct Prior {
    /// Expected pose.
    pub tool_from_cloud: Rigid<Tool, Cloud>,
    /// Point about which the rotations are meant, usually on the stage axis, tool coordinates.
    pub pivot_mm: [f64; 3],
    /// Covariance of (rotation x, y, z in rad; translation x, y, z in mm).
    pub covariance: Matrix6<f64>,
}

impl Prior {
    /// A prior with independent directions.
    pub fn independent(
        tool_from_cloud: Rigid<Tool, Cloud>,
        rotation_rad: [f64; 3],
        translation_mm: [f64; 3],
    ) -> Self {
        let [a, b, c] = rotation_rad.map(|s| s * s);
        let [d, e, f] = translation_mm.map(|s| s * s);
        Self {
            tool_from_cloud,
            pivot_mm: [0.0; 3],
            covariance: Matrix6::from_diagonal(&Vector6::new(a, b, c, d, e, f)),
        }
    }

    /// The prior as seen in a solver's variables: rotation about `centre` times `arm`, translation.
    pub(super) fn scaled(&self, centre: Vector3<f64>, arm: f64) -> Option<ScaledPrior> {
        let information = self.covariance.cholesky()?.inverse();
        let d = Vector3::from(self.pivot_mm) - centre;
        // A rotation w about the centre moves the pivot by w x d = -[d]x w.
        let cross = Matrix3::new(0.0, -d.z, d.y, d.z, 0.0, -d.x, -d.y, d.x, 0.0);
        let mut pivot_from_centre = Matrix6::identity();
        pivot_from_centre
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&(Matrix3::identity() / arm));
        pivot_from_centre
            .fixed_view_mut::<3, 3>(3, 0)
            .copy_from(&(-cross / arm));
        Some(ScaledPrior {
            expected: *self.tool_from_cloud.isometry(),
            pivot: Point3::from(self.pivot_mm),
            information,
            pivot_from_centre,
        })
    }
}

/// A prior prepared for one registration.
pub(super) struct ScaledPrior {
    expected: Isometry3<f64>,
    pivot: Point3<f64>,
    information: Matrix6<f64>,
    pivot_from_centre: Matrix6<f64>,
}

impl ScaledPrior {
    /// Information matrix in the solver's variables.
    pub fn information(&self) -> Matrix6<f64> {
        self.pivot_from_centre.transpose() * self.information * self.pivot_from_centre
    }

    /// Gradient of half the squared Mahalanobis distance at `pose`.
    pub fn gradient(&self, pose: &Isometry3<f64>) -> Vector6<f64> {
        self.pivot_from_centre.transpose() * self.information * self.offset(pose)
    }

    /// Squared Mahalanobis distance of `pose` from the expected one.
    pub fn distance2(&self, pose: &Isometry3<f64>) -> f64 {
        let offset = self.offset(pose);
        offset.dot(&(self.information * offset))
    }

    fn offset(&self, pose: &Isometry3<f64>) -> Vector6<f64> {
        let motion = pose * self.expected.inverse();
        let rotation = motion.rotation.scaled_axis();
        let translation = motion * self.pivot - self.pivot;
        Vector6::new(
            rotation.x,
            rotation.y,
            rotation.z,
            translation.x,
            translation.y,
            translation.z,
        )
    }
}
