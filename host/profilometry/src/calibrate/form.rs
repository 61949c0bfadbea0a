//! Planes and spheres through measured points, and how far the points lie off them.

use std::collections::HashMap;

use nalgebra::{Isometry3, Matrix3, Matrix4, Point3, SymmetricEigen, Vector3, Vector4};

use flankscope_foundation::order::quantile;
use flankscope_foundation::rigid::nearest_rotation;

/// Residuals of a fit.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Residuals {
    /// Distance of each point from the fitted surface, signed.
    pub off_mm: Vec<f64>,
}

/// At most this part of the points may be discarded before a form is judged (VDI/VDE 2634, parts 2 and 3).
const DISCARDED: f64 = 0.003;

impl Residuals {
    /// Root mean square.
    pub fn rms_mm(&self) -> f64 {
        let squares: f64 = self.off_mm.iter().map(|off| off * off).sum();
        (squares / self.off_mm.len() as f64).sqrt()
    }

    /// Means over squares of `side_mm` across the view, of `points` in the camera frame that these are the residuals of. Squares at
    /// the rim, of less than half the usual number of points, do not count.
    pub fn averaged_over_squares(&self, points: &[[f64; 3]], side_mm: f64) -> Self {
        let mut squares: HashMap<[i64; 2], (f64, f64)> = HashMap::new();
        for (&[x, y, _], off) in points.iter().zip(&self.off_mm) {
            let square = [x, y].map(|x| (x / side_mm).floor() as i64);
            let (count, sum) = squares.entry(square).or_default();
            *count += 1.0;
            *sum += off;
        }
        let mut counts: Vec<f64> = squares.values().map(|(count, _)| *count).collect();
        let least = 0.5 * quantile(&mut counts, 0.5).unwrap_or(0.0);
        Self {
            off_mm: squares
                .into_values()
                .filter(|(count, _)| *count >= least)
                .map(|(count, sum)| sum / count)
                .collect(),
        }
    }

    /// Largest minus smallest, without the farthest 0.3 % of the points.
    pub fn range_mm(&self) -> f64 {
        let mut off = self.off_mm.clone();
        off.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
        let kept = off.len() - (DISCARDED * off.len() as f64) as usize;
        let (low, high) = off[..kept]
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &x| {
                (low.min(x), high.max(x))
            });
        high - low
    }
}

/// The plane with the least squared distances; `None` for fewer than four points.
pub(crate) fn plane(points: &[[f64; 3]]) -> Option<Residuals> {
    if points.len() < 4 {
        return None;
    }
    let (centre, covariance) = moments(points);
    let eigen = SymmetricEigen::new(covariance);
    let normal = eigen
        .eigenvectors
        .column(eigen.eigenvalues.imin())
        .into_owned();
    let off = |&p: &[f64; 3]| normal.dot(&(Vector3::from(p) - centre));
    Some(Residuals {
        off_mm: points.iter().map(off).collect(),
    })
}

fn moments(points: &[[f64; 3]]) -> (Vector3<f64>, Matrix3<f64>) {
    let count = points.len() as f64;
    let centre: Vector3<f64> = points
        .iter()
        .map(|&p| Vector3::from(p))
        .sum::<Vector3<f64>>()
        / count;
    let spread = |&p: &[f64; 3]| {
        let away = Vector3::from(p) - centre;
        away * away.transpose()
    };
    (
        centre,
        points.iter().map(spread).sum::<Matrix3<f64>>() / count,
    )
}

/// A point and its partner.
pub(crate) type PointPair = ([f64; 3], [f64; 3]);

/// Root mean square distance between points and their partners after the best rigid motion; `None` as of [`rigid_motion`].
pub(crate) fn rigid_rms_mm(pairs: &[PointPair]) -> Option<f64> {
    let motion = rigid_motion(pairs)?;
    let square =
        |(from, to): &PointPair| (motion * Point3::from(*from) - Point3::from(*to)).norm_squared();
    let squares: f64 = pairs.iter().map(square).sum();
    Some((squares / pairs.len() as f64).sqrt())
}

/// The rigid motion that lays points onto their partners best (Kabsch 1976); `None` for fewer than three pairs or points on a line.
pub(crate) fn rigid_motion(pairs: &[PointPair]) -> Option<Isometry3<f64>> {
    if pairs.len() < 3 {
        return None;
    }
    let count = pairs.len() as f64;
    let mean = |which: fn(&PointPair) -> [f64; 3]| {
        pairs
            .iter()
            .map(|p| Vector3::from(which(p)))
            .sum::<Vector3<f64>>()
            / count
    };
    let (from_centre, to_centre) = (mean(|p| p.0), mean(|p| p.1));
    let away = |(from, to): &PointPair| {
        (
            Vector3::from(*from) - from_centre,
            Vector3::from(*to) - to_centre,
        )
    };
    let cross: Matrix3<f64> = pairs
        .iter()
        .map(|pair| {
            let (from, to) = away(pair);
            to * from.transpose()
        })
        .sum();
    let svd = cross.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    if !(svd.singular_values[1] > 1e-12 * svd.singular_values[0]) {
        return None;
    }
    // The smallest direction is mirrored where a plain product would mirror all of space.
    let mirror = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()));
    let rotation = u * mirror * v_t;
    let rotation = nearest_rotation(&rotation);
    let shift = to_centre - rotation * from_centre;
    Some(Isometry3::from_parts(shift.into(), rotation))
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct FittedSphere {
    pub centre_mm: Point3<f64>,
    pub radius_mm: f64,
    pub residuals: Residuals,
}

/// The sphere with the least squared distances, radius free, by Gauss and Newton from the algebraic fit; `None` for points
/// that show no curvature.
pub(crate) fn sphere(points: &[[f64; 3]]) -> Option<FittedSphere> {
    if points.len() < 10 {
        return None;
    }
    let (mean, _) = moments(points);
    // |p|^2 = 2 p c + (r^2 - |c|^2), about the mean of the points.
    let mut matrix = Matrix4::<f64>::zeros();
    let mut right = Vector4::<f64>::zeros();
    for &p in points {
        let p = Vector3::from(p) - mean;
        let row = (2.0 * p).push(1.0);
        matrix += row * row.transpose();
        right += row * p.norm_squared();
    }
    let start = matrix.cholesky()?.solve(&right);
    let mut centre = start.xyz();
    let mut radius_mm = (start.w + centre.norm_squared()).sqrt();
    for _ in 0..50 {
        let mut matrix = Matrix4::<f64>::zeros();
        let mut right = Vector4::<f64>::zeros();
        for &p in points {
            let away = Vector3::from(p) - mean - centre;
            let distance = away.norm();
            let row = (-away / distance).push(-1.0);
            matrix += row * row.transpose();
            right -= row * (distance - radius_mm);
        }
        let step = matrix.cholesky()?.solve(&right);
        centre += step.xyz();
        radius_mm += step.w;
        if step.norm() < 1e-9 {
            let off = |&p: &[f64; 3]| (Vector3::from(p) - mean - centre).norm() - radius_mm;
            return Some(FittedSphere {
                centre_mm: Point3::from(mean + centre),
                radius_mm,
                residuals: Residuals {
                    off_mm: points.iter().map(off).collect(),
                },
            });
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cap_of_a_sphere_gives_the_whole_sphere() {
        let mut points = Vec::new();
        for i in 0..40 {
            for j in 0..10 {
                let (azimuth, polar) = (f64::from(i) * 0.157, 0.08 * f64::from(j + 1));
                let (sin, cos) = polar.sin_cos();
                points.push([
                    5.0 + 1.2 * sin * azimuth.cos(),
                    -3.0 + 1.2 * sin * azimuth.sin(),
                    20.0 - 1.2 * cos,
                ]);
            }
        }
        let found = sphere(&points).unwrap();
        assert!((found.centre_mm - Point3::new(5.0, -3.0, 20.0)).norm() < 1e-9);
        assert!((found.radius_mm - 1.2).abs() < 1e-9);
        assert!(found.residuals.range_mm() < 1e-9);
        // Of 400 points the farthest 0.3 % are one: with two dents of 3 um, one remains in the range.
        let centre = Vector3::new(5.0, -3.0, 20.0);
        for i in [7, 209] {
            let away = Vector3::from(points[i]) - centre;
            points[i] = (centre + (1.0 - 0.003 / 1.2) * away).into();
        }
        let dent = sphere(&points).unwrap().residuals;
        assert!(
            (dent.range_mm() - 0.003).abs() < 1e-4,
            "{}",
            dent.range_mm()
        );
    }

    #[test]
    fn a_tilted_plane_and_a_rigid_motion_leave_nothing() {
        let points: Vec<[f64; 3]> = (0..100)
            .map(|i| {
                let (x, y) = (f64::from(i % 10), f64::from(i / 10));
                [
                    x,
                    y,
                    4.0 + 0.3 * x - 0.1 * y + if i == 55 { 1e-3 } else { 0.0 },
                ]
            })
            .collect();
        let off = plane(&points).unwrap();
        let slope = (1.0f64 + 0.09 + 0.01).sqrt();
        assert!(
            (off.range_mm() - 1e-3 / slope).abs() < 2e-5,
            "{}",
            off.range_mm()
        );
        let turn = nalgebra::Rotation3::from_euler_angles(0.4, -1.0, 2.0);
        let pairs: Vec<_> = points
            .iter()
            .map(|&p| {
                (
                    p,
                    (turn * Vector3::from(p) + Vector3::new(1.0, 2.0, 3.0)).into(),
                )
            })
            .collect();
        assert!(rigid_rms_mm(&pairs).unwrap() < 1e-12);
        let longer: Vec<_> = pairs
            .iter()
            .map(|&(p, q)| (p.map(|x| 1.001 * x), q))
            .collect();
        let (_, spread) = moments(&points);
        let expected = 1e-3 * spread.trace().sqrt();
        assert!((rigid_rms_mm(&longer).unwrap() / expected - 1.0).abs() < 0.01);
    }
}
