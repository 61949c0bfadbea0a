//! Ear clipping of a simple polygon.

/// Twice the signed area of a triangle, positive if counter-clockwise.
fn cross(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// Triangles (indices into `polygon`, counter-clockwise) that fill a simple counter-clockwise polygon.
///
/// Of all ears the one with the shortest new edge is clipped first, which keeps slivers away from long edges. Cubic in the
/// worst case: meant for one pitch of a gear (about 100 points). `None` if the polygon is not simple.
pub(crate) fn fill_polygon(polygon: &[[f64; 2]]) -> Option<Vec<[usize; 3]>> {
    let mut left: Vec<usize> = (0..polygon.len()).collect();
    let mut triangles = Vec::with_capacity(polygon.len().saturating_sub(2));
    while left.len() > 3 {
        let (ear, _) = (0..left.len())
            .filter(|&i| is_ear(polygon, &left, i))
            .map(|i| {
                let (a, _, c) = around(&left, i);
                let (pa, pc) = (polygon[a], polygon[c]);
                (i, (pa[0] - pc[0]).hypot(pa[1] - pc[1]))
            })
            .min_by(|x, y| x.1.total_cmp(&y.1))?;
        let (a, b, c) = around(&left, ear);
        triangles.push([a, b, c]);
        left.remove(ear);
    }
    let last: [usize; 3] = left.try_into().ok()?;
    (cross(polygon[last[0]], polygon[last[1]], polygon[last[2]]) > 0.0)
        .then(|| triangles.push(last))?;
    Some(triangles)
}

fn around(left: &[usize], i: usize) -> (usize, usize, usize) {
    let n = left.len();
    (left[(i + n - 1) % n], left[i], left[(i + 1) % n])
}

fn is_ear(polygon: &[[f64; 2]], left: &[usize], i: usize) -> bool {
    let (a, b, c) = around(left, i);
    let (pa, pb, pc) = (polygon[a], polygon[b], polygon[c]);
    if cross(pa, pb, pc) <= 0.0 {
        return false;
    }
    left.iter()
        .filter(|&&v| v != a && v != b && v != c)
        .all(|&v| {
            let p = polygon[v];
            cross(pa, pb, p) < 0.0 || cross(pb, pc, p) < 0.0 || cross(pc, pa, p) < 0.0
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_comb_is_filled_exactly() {
        // Five teeth: strongly non-convex; areas are exact in binary.
        let mut comb = vec![[0.0, -1.0], [10.0, -1.0]];
        for k in (0..5).rev() {
            let x = f64::from(2 * k);
            comb.extend([[x + 1.5, 0.0], [x + 1.0, 4.0], [x + 0.5, 0.0]]);
        }
        let triangles = fill_polygon(&comb).expect("the comb is simple");
        assert_eq!(triangles.len(), comb.len() - 2);
        let area: f64 = triangles
            .iter()
            .map(|t| 0.5 * cross(comb[t[0]], comb[t[1]], comb[t[2]]))
            .sum();
        let shoelace: f64 = (0..comb.len())
            .map(|i| {
                let (p, q) = (comb[i], comb[(i + 1) % comb.len()]);
                0.5 * (p[0] * q[1] - p[1] * q[0])
            })
            .sum();
        assert_eq!(area, shoelace);
    }

    #[test]
    fn a_clockwise_polygon_is_refused() {
        assert_eq!(
            fill_polygon(&[[0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, 0.0]]),
            None
        );
    }
}
