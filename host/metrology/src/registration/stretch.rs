//! Do the teeth that a view saw stand as far apart as the CAD's?
//!
//! A view of a die with another module, or with another number of teeth on the same circle, lies on the CAD almost well: it is
//! right in the middle and off at both ends. Laid on with one degree of freedom more, a stretch along the circumference, it
//! shows. A real die's pitch errors add up to nothing around the bore; those of a wrong CAD are the same in every view.

use nalgebra::{Matrix4, Vector4};

use crate::surface::Closest;

/// Points farther off the surface than this are no part of it, mm.
const REACH_MM: f64 = 0.5;
/// Fewer points do not tell.
const LEAST_POINTS: usize = 100;

/// By what share of itself a view's distance along the circumference is longer than the CAD's, from its points (tool frame,
/// mm) and what they lie on; shifts across the axis and a turn about it are fitted along. None for too few points, or for
/// points that do not tell a stretch from these.
pub fn around(points: &[[f64; 3]], closest: &[Closest]) -> Option<f64> {
    let used = || {
        points
            .iter()
            .zip(closest)
            .filter(|(_, hit)| hit.is_smooth() && hit.signed_distance_mm.abs() <= REACH_MM)
    };
    let count = used().count();
    if count < LEAST_POINTS {
        return None;
    }
    let (x, y) = used().fold((0.0, 0.0), |(x, y), (p, _)| (x + p[0], y + p[1]));
    let (x, y) = (x / count as f64, y / count as f64);
    let middle_rad = f64::atan2(y, x);
    let mut matrix = Matrix4::zeros();
    let mut right = Vector4::zeros();
    for (p, hit) in used() {
        let (radius_mm, angle_rad) = (p[0].hypot(p[1]), p[1].atan2(p[0]));
        let (sin, cos) = angle_rad.sin_cos();
        let tangential = hit.normal[1] * cos - hit.normal[0] * sin;
        let turned = (angle_rad - middle_rad + std::f64::consts::PI)
            .rem_euclid(std::f64::consts::TAU)
            - std::f64::consts::PI;
        let turn = (p[0] - x) * hit.normal[1] - (p[1] - y) * hit.normal[0];
        let row = Vector4::new(
            hit.normal[0],
            hit.normal[1],
            turn,
            tangential * radius_mm * turned,
        );
        matrix += row * row.transpose();
        right += row * hit.signed_distance_mm;
    }
    Some(matrix.cholesky()?.solve(&right)[3])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gear::tests::ring84;
    use crate::gear::{Flank, GearData};
    use crate::surface::Feature;

    /// Points on flanks and tips of three teeth about +x, displaced as `moved` says.
    fn view(
        gear: &GearData,
        moved: impl Fn([f64; 3]) -> [f64; 2],
    ) -> (Vec<[f64; 3]>, Vec<Closest>) {
        let (mut points, mut hits) = (Vec::new(), Vec::new());
        let mut push = |point: [f64; 3], normal: [f64; 3]| {
            let [dx, dy] = moved(point);
            points.push([point[0] + dx, point[1] + dy, point[2]]);
            hits.push(Closest {
                point,
                signed_distance_mm: normal[0] * dx + normal[1] * dy,
                normal,
                triangle: 0,
                feature: Feature::Face,
                smoothness: 1.0,
            });
        };
        for tooth in [83, 84, 1, 2] {
            for step in 0..20 {
                let radius = gear.tip_radius_mm + 0.1 + 0.08 * f64::from(step);
                for flank in Flank::BOTH {
                    let on = |r: f64| gear.flank_point(tooth, flank, r, 30.0).unwrap();
                    let (a, b) = (on(radius - 1e-4), on(radius + 1e-4));
                    let length = (b[0] - a[0]).hypot(b[1] - a[1]);
                    let sign = flank.sign();
                    push(
                        on(radius),
                        [
                            -sign * (b[1] - a[1]) / length,
                            sign * (b[0] - a[0]) / length,
                            0.0,
                        ],
                    );
                }
                let (sin, cos) = gear.tooth_centre_rad(tooth).sin_cos();
                let tip = gear.tip_radius_mm;
                push([tip * cos, tip * sin, f64::from(step)], [-cos, -sin, 0.0]);
            }
        }
        (points, hits)
    }

    #[test]
    fn a_stretch_is_told_from_shifts_and_turns() {
        let gear = ring84();
        // One tooth less on the same circle: 1/83 wider; also shifted and turned.
        for stretch in [0.0, 1.0 / 83.0, -2e-3] {
            let (points, hits) = view(&gear, |[x, y, _]| {
                let (radius, angle) = (x.hypot(y), y.atan2(x));
                let along = stretch * radius * angle;
                [
                    20e-3 - 1e-3 * y - along * angle.sin(),
                    -30e-3 + 1e-3 * (x - 41.0) + along * angle.cos(),
                ]
            });
            let found = around(&points, &hits).unwrap();
            // The points themselves are where they were displaced to: second order of 0.06 mm in 5.
            assert!((found - stretch).abs() < 2e-4, "{found} for {stretch}");
        }
        let (points, hits) = view(&gear, |_| [0.0; 2]);
        assert_eq!(around(&points[..90], &hits[..90]), None);
    }
}
