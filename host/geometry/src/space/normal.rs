//! Unit normal of a triangle.

use nalgebra::Vector3;

/// A triangle is flat to a segment when its height is below this share of its longest edge: the segment then replaces
/// it with an error of that height, at most 1e-10 mm for an edge of 100 mm.
const FLAT_RATIO: f64 = 1e-12;

/// Unit normal of a triangle, or none when it has no area.
pub fn unit_normal(corners: [[f64; 3]; 3]) -> Option<[f64; 3]> {
    let [a, b, c] = corners.map(Vector3::from);
    let (ab, ac, bc) = (b - a, c - a, c - b);
    let cross = ab.cross(&ac);
    let twice_area = cross.norm();
    let longest2 = ab
        .norm_squared()
        .max(ac.norm_squared())
        .max(bc.norm_squared());
    (twice_area > FLAT_RATIO * longest2).then(|| (cross / twice_area).into())
}
