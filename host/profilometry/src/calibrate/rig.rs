//! Camera and projector with their relative pose: where a dot of a plate appears in both images.

use flankscope_foundation::rigid::nearest_rotation;
use nalgebra::{Isometry3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use crate::head::residual::SIDE;
use crate::head::{Pinhole, RigidTransform};

/// Both lenses and the pose between them.
#[derive(Clone, Debug)]
pub(crate) struct Rig {
    pub camera: Pinhole,
    pub projector: Pinhole,
    pub projector_from_camera: Isometry3<f64>,
}

/// Where a dot appears: camera column and row, projector column and row, px.
pub(crate) type ImagePoint = [f64; 4];

impl Rig {
    /// Where a dot of radius `radius_mm` at `at_mm` of the plate appears; `None` behind camera or projector.
    pub fn image(
        &self,
        camera_from_plate: &Isometry3<f64>,
        at_mm: [f64; 2],
        radius_mm: f64,
    ) -> Option<ImagePoint> {
        let [seen, lit] = self.directions(camera_from_plate, at_mm, radius_mm)?;
        let [u, v] = self.camera.pixel(seen);
        let [column, row] = self.projector.pixel(lit);
        Some([u, v, column, row])
    }

    /// Derivatives of [`Self::image`] by the coefficients of both lenses' residual fields (columns and rows of the camera, columns of
    /// the projector): coefficient, coordinate of the image point, derivative. Empty for lenses without fields.
    pub fn field_slopes(
        &self,
        camera_from_plate: &Isometry3<f64>,
        at_mm: [f64; 2],
        radius_mm: f64,
    ) -> Vec<(usize, usize, f64)> {
        let (Some(camera), Some(projector)) = (&self.camera.residual, &self.projector.residual)
        else {
            return Vec::new();
        };
        let Some([seen, lit]) = self.directions(camera_from_plate, at_mm, radius_mm) else {
            return Vec::new();
        };
        let parts = [(camera, seen), (camera, seen), (projector, lit)];
        let slopes = parts
            .into_iter()
            .enumerate()
            .flat_map(|(coordinate, (field, at))| {
                let first = coordinate * SIDE * SIDE;
                let weights = field.weights(at).into_iter();
                weights.map(move |([row, column], weight)| {
                    (first + row * SIDE + column, coordinate, weight)
                })
            });
        slopes.collect()
    }

    /// Where a dot lies in the image planes `z = 1` of camera and projector.
    fn directions(
        &self,
        camera_from_plate: &Isometry3<f64>,
        at_mm: [f64; 2],
        radius_mm: f64,
    ) -> Option<[[f64; 2]; 2]> {
        let p_camera = centre_of_image(camera_from_plate, at_mm, radius_mm);
        let p_projector = self.projector_from_camera * p_camera;
        if !(p_camera.z > 0.0 && p_projector.z > 0.0) {
            return None;
        }
        Some([p_camera, p_projector].map(|p| [p.x / p.z, p.y / p.z]))
    }
}

/// The point of the plate, in the camera frame, whose image is the centre of a circle's elliptic image.
///
/// In perspective the centre of the ellipse is not the image of the circle's centre: it is that of `at - radius² g / depth`, where
/// `g` is the change of depth along the plate (pole of the line at infinity with respect to the image's conic).
fn centre_of_image(
    camera_from_plate: &Isometry3<f64>,
    at_mm: [f64; 2],
    radius_mm: f64,
) -> Point3<f64> {
    let depth_mm = (camera_from_plate * Point3::new(at_mm[0], at_mm[1], 0.0)).z;
    let along = camera_from_plate.rotation * Vector3::x();
    let across = camera_from_plate.rotation * Vector3::y();
    let back = radius_mm * radius_mm / depth_mm;
    camera_from_plate * Point3::new(at_mm[0] - back * along.z, at_mm[1] - back * across.z, 0.0)
}

/// Adds to an unknown of a lens: focal lengths, principal point (px), k1, k2, p1, p2.
pub(crate) fn step_lens(lens: &mut Pinhole, unknown: usize, by: f64) {
    match unknown {
        0 | 1 => lens.focal_px[unknown] += by,
        2 | 3 => lens.principal_px[unknown - 2] += by,
        _ => lens.distortion[unknown - 4] += by,
    }
}

/// Adds to an unknown of a pose: turns about the axes at its origin (rad), then its translation (mm).
pub(crate) fn step_pose(pose: &mut Isometry3<f64>, unknown: usize, by: f64) {
    match unknown {
        0..3 => {
            let turn = UnitQuaternion::from_scaled_axis(Vector3::ith(unknown, by));
            pose.rotation = UnitQuaternion::new_normalize((turn * pose.rotation).into_inner());
        }
        _ => pose.translation.vector[unknown - 3] += by,
    }
}

/// Of a transform whose file has been checked; the rotation is the nearest one to the file's digits.
pub(crate) fn isometry(file: &RigidTransform) -> Isometry3<f64> {
    Isometry3::from_parts(
        Translation3::from(Vector3::from(file.translation_mm)),
        nearest_rotation(&file.matrix()),
    )
}

pub(crate) fn transform(pose: &Isometry3<f64>) -> RigidTransform {
    let matrix: Rotation3<f64> = pose.rotation.to_rotation_matrix();
    RigidTransform {
        rotation: std::array::from_fn(|row| std::array::from_fn(|column| matrix[(row, column)])),
        translation_mm: pose.translation.vector.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The centre of an ellipse lies midway between its leftmost and rightmost points, whose tangents are parallel.
    #[test]
    fn a_tilted_circle_looks_like_an_ellipse_with_this_centre() {
        let lens = Pinhole {
            width_px: 1920,
            height_px: 1200,
            focal_px: [2530.0, 2530.0],
            principal_px: [960.0, 600.0],
            distortion: [0.0; 5],
            residual: None,
        };
        let rig = Rig {
            camera: lens.clone(),
            projector: lens,
            projector_from_camera: Isometry3::identity(),
        };
        let pose = Isometry3::from_parts(
            Translation3::new(0.7, -0.4, 22.0),
            UnitQuaternion::from_euler_angles(0.4, -0.5, 0.3),
        );
        let (at, radius) = ([1.5, -2.0], 0.5);
        let rim: Vec<[f64; 2]> = (0..2_000_000)
            .map(|i| {
                let (sin, cos) = (f64::from(i) * 1e-6 * std::f64::consts::PI).sin_cos();
                let p = pose * Point3::new(at[0] + radius * cos, at[1] + radius * sin, 0.0);
                rig.camera.pixel([p.x / p.z, p.y / p.z])
            })
            .collect();
        let by = |a: &&[f64; 2], b: &&[f64; 2]| a[0].total_cmp(&b[0]);
        let (left, right) = (
            rim.iter().min_by(by).unwrap(),
            rim.iter().max_by(by).unwrap(),
        );
        let [u, v, ..] = rig.image(&pose, at, radius).unwrap();
        let [centre_u, centre_v, ..] = rig.image(&pose, at, 0.0).unwrap();
        assert!((u - 0.5 * (left[0] + right[0])).abs() < 1e-4);
        assert!((v - 0.5 * (left[1] + right[1])).abs() < 1e-3);
        assert!(
            (u - centre_u).hypot(v - centre_v) > 0.1,
            "the difference matters"
        );
    }
}
