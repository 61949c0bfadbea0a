//! The axis that the deviations are stated about: the tool's own, or the one that fits the flanks best.

use nalgebra::{Matrix5, Vector5};
use serde::Serialize;

use super::FlankPoint;
use crate::gear::GearData;

/// How the flanks lie about the tool's axis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct AxisFit {
    /// Offset at mid face, um.
    pub offset_um: [f64; 2],
    /// Tilt about x and y, mrad.
    pub tilt_mrad: [f64; 2],
    /// Rotation about the axis, mrad.
    pub rotation_mrad: f64,
}

impl AxisFit {
    /// Takes this motion's share out of the deviations.
    pub(super) fn take_out(&self, gear: &GearData, points: &mut [FlankPoint]) {
        let [x, y] = self.offset_um.map(|um| 1e-3 * um);
        let half_mm = half_face_mm(gear);
        let [tilt_x, tilt_y] = self.tilt_mrad.map(|mrad| 1e-3 * mrad * half_mm);
        let rotation = 1e-3 * self.rotation_mrad * gear.base_radius_mm();
        let motion = Vector5::new(x, y, tilt_x, tilt_y, rotation);
        for point in points {
            point.deviation_mm -= row(gear, point).dot(&motion);
        }
    }
}

/// Fits offset, tilt and rotation to the deviations. None when the flanks seen do not fix all five, as those of one side
/// of the gear alone do not.
///
/// A small motion (t, w) moves the surface at p by n . (t + w x p) along its normal n; about the axis of a spur gear
/// nothing fixes the shift along it.
pub(super) fn fit(gear: &GearData, points: &[FlankPoint]) -> Option<AxisFit> {
    let (mut information, mut gradient) = (Matrix5::<f64>::zeros(), Vector5::<f64>::zeros());
    for point in points {
        let row = row(gear, point);
        information += row * row.transpose();
        gradient += row * point.deviation_mm;
    }
    let count = points.len().max(1) as f64;
    let eigen = nalgebra::SymmetricEigen::new(information / count);
    // Flanks all round give 0.5, 0.5, 0.17, 0.17 and 1; a quarter of the ring still a hundredth of that.
    if eigen.eigenvalues.min() < 1e-3 {
        return None;
    }
    let motion = information.cholesky()?.solve(&gradient);
    let half_mm = half_face_mm(gear);
    Some(AxisFit {
        offset_um: [1e3 * motion[0], 1e3 * motion[1]],
        tilt_mrad: [1e3 * motion[2] / half_mm, 1e3 * motion[3] / half_mm],
        rotation_mrad: 1e3 * motion[4] / gear.base_radius_mm(),
    })
}

/// What each part of a motion does to the deviation of a point. All parts are lengths: tilts times half the face width, the
/// rotation times the base radius.
fn row(gear: &GearData, point: &FlankPoint) -> Vector5<f64> {
    let middle_mm = 0.5 * (gear.height_mm[0] + gear.height_mm[1]);
    let z = (point.height_mm - middle_mm) / half_face_mm(gear);
    let [nx, ny] = point.normal;
    Vector5::new(nx, ny, -ny * z, nx * z, point.sign)
}

fn half_face_mm(gear: &GearData) -> f64 {
    0.5 * (gear.height_mm[1] - gear.height_mm[0]).max(1e-9)
}
