//! The axis that the deviations are stated about: the tool's own, or the one that fits the flanks best.

use nalgebra::{Matrix5, Vector5};
use rayon::prelude::*;
use serde::Serialize;

use super::PointNearFlank;
use super::gather::OwnPoints;
use crate::gear::{Flank, GearData};

/// Axis of the flanks against that of the tool.
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
    /// Takes this motion's share out of the deviations of a flank.
    pub(super) fn take_out(&self, gear: &GearData, own: &mut OwnPoints) {
        let [x, y] = self.offset_um.map(|um| 1e-3 * um);
        let half_mm = half_face_mm(gear);
        let [tilt_x, tilt_y] = self.tilt_mrad.map(|mrad| 1e-3 * mrad * half_mm);
        let rotation = 1e-3 * self.rotation_mrad * gear.base_radius_mm();
        let motion = Vector5::new(x, y, tilt_x, tilt_y, rotation);
        let (tooth, flank) = (own.tooth, own.flank);
        own.take_out(|point| row(gear, (tooth, flank), point).dot(&motion));
    }
}

/// Fits offset, tilt and rotation to the deviations. None when the flanks seen do not fix all five, as those of one side
/// of the gear alone do not.
///
/// A small motion (t, w) moves the surface at p by n . (t + w x p) along its normal n; about the axis of a spur gear
/// nothing fixes the shift along it.
pub(super) fn fit(gear: &GearData, flanks: &[OwnPoints]) -> Option<AxisFit> {
    let of_flank = |own: &OwnPoints| {
        let (mut information, mut gradient) = (Matrix5::<f64>::zeros(), Vector5::<f64>::zeros());
        for point in own.points() {
            let row = row(gear, (own.tooth, own.flank), &point);
            information += row * row.transpose();
            gradient += row * point.deviation_mm;
        }
        (information, gradient)
    };
    let sums: Vec<(Matrix5<f64>, Vector5<f64>)> = flanks.par_iter().map(of_flank).collect();
    let (mut information, mut gradient) = (Matrix5::<f64>::zeros(), Vector5::<f64>::zeros());
    for (of_flank, towards) in sums {
        information += of_flank;
        gradient += towards;
    }
    let points: usize = flanks.iter().map(OwnPoints::len).sum();
    let count = points.max(1) as f64;
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

/// Derivatives of a point's deviation by the components of a motion. All components are lengths: tilts times half the face width,
/// the rotation times the base radius.
fn row(gear: &GearData, (tooth, flank): (u32, Flank), point: &PointNearFlank) -> Vector5<f64> {
    let middle_mm = 0.5 * (gear.height_mm[0] + gear.height_mm[1]);
    let z = (point.height_mm - middle_mm) / half_face_mm(gear);
    let radius_mm = point.roll_mm.hypot(gear.base_radius_mm());
    let beyond = gear.half_tooth_rad(radius_mm).unwrap_or(0.0);
    let angle = gear.tooth_centre_rad(tooth) + flank.sign() * beyond;
    let on_flank = [radius_mm * angle.cos(), radius_mm * angle.sin(), 0.0];
    let [nx, ny, _] = gear.flank_normal(flank, on_flank);
    Vector5::new(nx, ny, -ny * z, nx * z, flank.sign())
}

fn half_face_mm(gear: &GearData) -> f64 {
    0.5 * (gear.height_mm[1] - gear.height_mm[0]).max(1e-9)
}
