//! Ovality and taper of the piece: to views that are laid on the CAD they look like small motions.

use nalgebra::{SMatrix, SVector, Vector3};

/// Number of form parameters.
pub(super) const FORMS: usize = 3;

pub(super) const NAMES: [&str; FORMS] = ["ovality along x and y", "ovality between them", "taper"];

/// Prior standard deviations: amplitudes of the second harmonic of the radius, mm, and growth of the radius per height. Wide
/// enough for any die that still works: a form that is worth knowing must not be taken for an error of the stages.
const SIGMA: [f64; FORMS] = [20e-3, 20e-3, 0.5e-3];

/// Ovality and taper of the piece, as parameters of the adjustment.
#[derive(Debug, Clone)]
pub(super) struct SharedForm {
    /// In units of their prior standard deviations.
    pub parameters: SVector<f64, FORMS>,
    /// At which height the taper is nought, mm.
    pub height_mm: f64,
}

impl SharedForm {
    /// None, with its middle at a height.
    pub fn none(height_mm: f64) -> Self {
        Self {
            parameters: SVector::zeros(),
            height_mm,
        }
    }

    /// The motion (rotation about the view's centre, translation) that the form of the wall at `centre` looks like.
    pub fn slope(&self, centre: Vector3<f64>) -> SMatrix<f64, 6, FORMS> {
        let mut slope = SMatrix::zeros();
        let radius_mm = centre.x.hypot(centre.y);
        if radius_mm <= 0.0 {
            return slope;
        }
        let outwards = Vector3::new(centre.x / radius_mm, centre.y / radius_mm, 0.0);
        let around = Vector3::z().cross(&outwards);
        let (sin, cos) = (2.0 * centre.y.atan2(centre.x)).sin_cos();
        let above_mm = centre.z - self.height_mm;
        // Per parameter: how far the wall stands out, and how it turns with that: growing along the wall it turns about the
        // axis, growing upwards it leans.
        let walls = [
            (cos, Vector3::z() * (2.0 * sin / radius_mm)),
            (sin, Vector3::z() * (-2.0 * cos / radius_mm)),
            (above_mm, around),
        ];
        for (column, (out, turn)) in walls.into_iter().enumerate() {
            // Laid on the CAD, a view moves against what the wall does.
            let sigma = -SIGMA[column];
            slope
                .fixed_view_mut::<3, 1>(0, column)
                .copy_from(&(turn * sigma));
            slope
                .fixed_view_mut::<3, 1>(3, column)
                .copy_from(&(outwards * (out * sigma)));
        }
        slope
    }
}

/// Standard uncertainty of ovality (of either amplitude, as largest minus smallest radius) and taper over a height, mm, from
/// the covariance of the parameters.
pub(super) fn sigma_mm(covariance: &SMatrix<f64, FORMS, FORMS>, over_mm: f64) -> [f64; 2] {
    let of = |k: usize| SIGMA[k] * covariance[(k, k)].max(0.0).sqrt();
    [2.0 * of(0).max(of(1)), of(2) * over_mm]
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Rotation3, Vector6};

    #[test]
    fn the_wall_around_a_view_moves_as_its_motion_says() {
        // Radius of an oval and conical wall; a view's field around a place; the wall's displacement there against the
        // negative motion of the view.
        let (a, b, taper) = (7e-3, -4e-3, 0.2e-3);
        let out_mm = |p: Vector3<f64>| {
            let angle = p.y.atan2(p.x);
            a * (2.0 * angle).cos() + b * (2.0 * angle).sin() + taper * (p.z - 33.0)
        };
        let form = SharedForm::none(33.0);
        let parameters = SVector::<f64, 3>::new(a / SIGMA[0], b / SIGMA[1], taper / SIGMA[2]);
        for angle in [0.0, 0.4, 2.0, -2.7_f64] {
            let centre = Rotation3::from_axis_angle(&Vector3::z_axis(), angle)
                * Vector3::new(41.5, 0.0, 50.0);
            let motion: Vector6<f64> = form.slope(centre) * parameters;
            let (turn, shift) = (motion.fixed_rows::<3>(0), motion.fixed_rows::<3>(3));
            let outwards = Vector3::new(angle.cos(), angle.sin(), 0.0);
            let around = Vector3::z().cross(&outwards);
            for (along, up) in [(0.0, 0.0), (1.0, 0.0), (-1.0, 2.0), (0.5, -3.0)] {
                let arm = around * along + Vector3::z() * up;
                let moved = -(turn.cross(&arm) + shift).dot(&outwards);
                let expected = out_mm(centre + arm);
                // Second order over 1 mm of arc: half of 4 (8 µm) / 41.5² mm².
                assert!(
                    (moved - expected).abs() < 1e-5,
                    "{moved} mm, {expected} mm at {angle} rad"
                );
            }
        }
    }
}
