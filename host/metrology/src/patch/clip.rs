//! The part of a flat polygon that lies in a box (Sutherland and Hodgman, Communications of the ACM 17, 32, 1974).

use nalgebra::Vector3;

/// A flat convex polygon cut by the six faces of a box; fewer than three corners where nothing of it lies inside. A side that
/// is infinite cuts nothing.
pub(super) fn clipped(
    corners: &[Vector3<f64>],
    low: [f64; 3],
    high: [f64; 3],
) -> Vec<Vector3<f64>> {
    let mut polygon = corners.to_vec();
    for axis in 0..3 {
        for (limit, sign) in [(low[axis], 1.0), (high[axis], -1.0)] {
            if limit.is_finite() {
                polygon = cut(&polygon, |p| sign * (p[axis] - limit));
            }
        }
    }
    polygon
}

/// The part of a polygon on which `inside` is not negative.
fn cut(polygon: &[Vector3<f64>], inside: impl Fn(&Vector3<f64>) -> f64) -> Vec<Vector3<f64>> {
    let mut kept = Vec::with_capacity(polygon.len() + 1);
    let Some(mut before) = polygon.last() else {
        return kept;
    };
    for here in polygon {
        let (a, b) = (inside(before), inside(here));
        if (a < 0.0) != (b < 0.0) {
            kept.push(before + (here - before) * (a / (a - b)));
        }
        if b >= 0.0 {
            kept.push(*here);
        }
        before = here;
    }
    kept
}

/// Area of a flat polygon times its normal, mm2: by triangles from its first corner.
pub(super) fn area_vector(polygon: &[Vector3<f64>]) -> Vector3<f64> {
    let fan = polygon.windows(2).skip(1);
    polygon.first().map_or_else(Vector3::zeros, |first| {
        fan.map(|side| 0.5 * (side[0] - first).cross(&(side[1] - first)))
            .sum()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_triangle_in_a_box_keeps_the_area_that_it_has_there() {
        let triangle = [[0.0, 0.0, 1.0], [4.0, 0.0, 1.0], [0.0, 4.0, 1.0]].map(Vector3::from);
        let all = [f64::NEG_INFINITY; 3];
        let area = |low, high| area_vector(&clipped(&triangle, low, high)).z;
        let open = [f64::INFINITY; 3];
        assert!((area(all, open) - 8.0).abs() < 1e-12);
        // The unit square at its corner; a square that its long side halves; the strip below y = 1, a trapezium of 4 and 3.
        assert!((area([0.0; 3], [1.0, 1.0, 2.0]) - 1.0).abs() < 1e-12);
        assert!((area([1.0, 1.0, 0.0], [3.0, 3.0, 2.0]) - 2.0).abs() < 1e-12);
        assert!((area(all, [f64::INFINITY, 1.0, f64::INFINITY]) - 3.5).abs() < 1e-12);
        // Above, beside.
        assert_eq!(area([0.0, 0.0, 1.1], [1.0, 1.0, 2.0]), 0.0);
        assert_eq!(area([5.0, 5.0, 0.0], [6.0, 6.0, 2.0]), 0.0);
    }
}
