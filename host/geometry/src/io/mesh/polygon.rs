//! Faces of more than three corners, cut into triangles.
//!
//! A fan from the first corner is right for convex faces only: of others it covers what lies outside of the face. Those are cut
//! in the plane of their vector area (Newell; "earcut" after Eberly, Triangulation by ear clipping) and the triangles' area is
//! compared with the face's, so that a face that crosses itself is refused.

use earcut::Earcut;
use nalgebra::Vector3;

use super::MeshError;
use crate::io::faces::Faces;

/// Triangles may cover this share more or less than the face: what rounding leaves of coordinates in single precision.
const AREA_TOLERANCE: f64 = 1e-4;
/// Cutting a face may take the square of its corners.
const MOST_CORNERS: usize = 10_000;

/// All faces as triangles, in their order.
///
/// # Errors
/// [`MeshError::IndexOutOfRange`], [`MeshError::Polygon`].
pub(super) fn into_triangles(
    faces: Faces,
    vertices: &[[f64; 3]],
) -> Result<Vec<[u32; 3]>, MeshError> {
    let Faces {
        triangles,
        polygons,
    } = faces;
    if polygons.is_empty() {
        return Ok(triangles);
    }
    let mut all = Vec::with_capacity(triangles.len() + 2 * polygons.len());
    let mut taken = 0;
    let mut cutter = Cutter::default();
    for polygon in &polygons {
        all.extend_from_slice(&triangles[taken..polygon.after]);
        taken = polygon.after;
        cutter.cut(vertices, polygon.face, &polygon.corners, &mut all)?;
    }
    all.extend_from_slice(&triangles[taken..]);
    Ok(all)
}

#[derive(Default)]
struct Cutter {
    earcut: Earcut<f64>,
    found: Vec<u32>,
}

impl Cutter {
    fn cut(
        &mut self,
        vertices: &[[f64; 3]],
        face: usize,
        corners: &[u32],
        into: &mut Vec<[u32; 3]>,
    ) -> Result<(), MeshError> {
        let mut at = Vec::with_capacity(corners.len());
        for &index in corners {
            let vertex = vertices.get(index as usize);
            at.push(*vertex.ok_or(MeshError::IndexOutOfRange {
                triangle: face,
                index: i64::from(index),
                vertices: vertices.len(),
            })?);
        }
        let Some(plane) = in_plane(&at) else {
            // Without area, or of a coordinate that is no number: the whole mesh is asked about both.
            into.extend(fan(corners));
            return Ok(());
        };
        let area2 = area2(&plane);
        let of = |[a, b, c]: [usize; 3]| cross(plane[a], plane[b], plane[c]);
        let count = corners.len();
        let is_fan = (1..count - 1).all(|i| of([0, i, i + 1]) >= 0.0);
        if is_fan && (0..count).all(|i| of([i, (i + 1) % count, (i + 2) % count]) >= 0.0) {
            into.extend(fan(corners));
            return Ok(());
        }
        if count > MOST_CORNERS {
            return Err(MeshError::Corners {
                face,
                corners: count,
                most: MOST_CORNERS,
            });
        }
        self.found.clear();
        self.earcut
            .earcut(plane.iter().copied(), &[], &mut self.found);
        let mut covered2 = 0.0;
        for triangle in self.found.as_chunks::<3>().0 {
            let mut triangle = triangle.map(|i| i as usize);
            let own2 = of(triangle);
            if own2 < 0.0 {
                triangle.swap(1, 2);
            }
            covered2 += own2.abs();
            into.push(triangle.map(|i| corners[i]));
        }
        if (covered2 - area2).abs() > AREA_TOLERANCE * area2 {
            return Err(MeshError::Polygon {
                face,
                corners: count,
            });
        }
        Ok(())
    }
}

fn fan(corners: &[u32]) -> impl Iterator<Item = [u32; 3]> {
    corners[1..]
        .windows(2)
        .map(|pair| [corners[0], pair[0], pair[1]])
}

/// The corners in the plane of their vector area, from which they run counter-clockwise; none of a face without area.
fn in_plane(corners: &[[f64; 3]]) -> Option<Vec<[f64; 2]>> {
    let origin = Vector3::from(corners[0]);
    let from_first = |point: &[f64; 3]| Vector3::from(*point) - origin;
    let sides = corners[1..].windows(2);
    let area: Vector3<f64> = sides
        .map(|pair| from_first(&pair[0]).cross(&from_first(&pair[1])))
        .sum();
    let normal = area.try_normalize(0.0).filter(|n| n.x.is_finite())?;
    let across = normal.cross(&Vector3::ith(normal.iamin(), 1.0)).normalize();
    let up = normal.cross(&across);
    let flat = |point| {
        let point = from_first(point);
        [point.dot(&across), point.dot(&up)]
    };
    Some(corners.iter().map(flat).collect())
}

/// Twice the signed area of a triangle.
fn cross(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

fn area2(plane: &[[f64; 2]]) -> f64 {
    plane[1..]
        .windows(2)
        .map(|pair| cross(plane[0], pair[0], pair[1]))
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Corners of a plane figure, tilted in space.
    fn tilted(flat: &[[f64; 2]]) -> Vec<[f64; 3]> {
        let at = |[x, y]: [f64; 2]| [0.6 * x - 30.0, y + 7.0, 0.8 * x];
        flat.iter().copied().map(at).collect()
    }

    fn cut(vertices: &[[f64; 3]]) -> Result<Vec<[u32; 3]>, MeshError> {
        let mut faces = Faces::default();
        let corners: Vec<u32> = (0..vertices.len() as u32).collect();
        faces.push(&corners);
        into_triangles(faces, vertices)
    }

    /// Area, and which way round, of triangles in the plane of the tilt.
    fn areas(vertices: &[[f64; 3]], triangles: &[[u32; 3]]) -> (f64, bool) {
        let up = Vector3::new(-0.8, 0.0, 0.6);
        let signed = triangles.iter().map(|t| {
            let [a, b, c] = t.map(|i| Vector3::from(vertices[i as usize]));
            0.5 * (b - a).cross(&(c - a)).dot(&up)
        });
        let all: Vec<f64> = signed.collect();
        (
            all.iter().map(|a| a.abs()).sum(),
            all.iter().all(|a| *a >= 0.0),
        )
    }

    #[test]
    fn a_convex_face_is_a_fan() {
        let square = tilted(&[[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]]);
        assert_eq!(cut(&square).unwrap(), [[0, 1, 2], [0, 2, 3]]);
    }

    #[test]
    fn concave_faces_are_covered_and_nothing_beside_them() {
        let comb: Vec<[f64; 2]> = (0..20)
            .map(|i| [f64::from(i), if i % 2 == 0 { 5.0 } else { 0.5 }])
            .chain([[19.0, 0.0], [0.0, 0.0]])
            .rev()
            .collect();
        // 19 trapezoids of width 1 between heights 5 and 0.5.
        let comb_area = 19.0 * 2.75;
        let l: Vec<[f64; 2]> = [[0, 0], [3, 0], [3, 1], [1, 1], [1, 3], [0, 3]]
            .map(|p: [i32; 2]| p.map(f64::from))
            .to_vec();
        for (flat, area) in [(comb, comb_area), (l, 5.0)] {
            // From every corner on, and from either side.
            for turn in 0..flat.len() {
                let mut flat = flat.clone();
                flat.rotate_left(turn);
                for backwards in [false, true] {
                    if backwards {
                        flat.reverse();
                    }
                    let vertices = tilted(&flat);
                    let triangles = cut(&vertices).unwrap();
                    let (covered, forward) = areas(&vertices, &triangles);
                    assert!((covered - area).abs() < 1e-9, "{covered} of {area}");
                    assert_eq!(forward, !backwards);
                }
            }
        }
    }

    #[test]
    fn a_face_that_crosses_itself_is_refused() {
        let star: Vec<[f64; 2]> = (0..5)
            .map(|i| f64::from(2 * i) / 5.0 * std::f64::consts::TAU)
            .map(|angle| [angle.cos(), angle.sin()])
            .collect();
        assert!(matches!(
            cut(&tilted(&star)),
            Err(MeshError::Polygon { corners: 5, .. })
        ));
    }

    #[test]
    fn a_face_of_too_many_corners_is_cut_only_where_it_is_a_fan() {
        let round = |count: usize, dent: f64| -> Vec<[f64; 2]> {
            let at = |i: usize| {
                let angle = i as f64 / count as f64 * std::f64::consts::TAU;
                let radius = if i == 1 { dent } else { 1.0 };
                [radius * angle.cos(), radius * angle.sin()]
            };
            (0..count).map(at).collect()
        };
        let many = MOST_CORNERS + 1;
        assert!(cut(&tilted(&round(MOST_CORNERS, 0.5))).is_ok());
        assert!(cut(&tilted(&round(many, 1.0))).is_ok());
        assert!(matches!(
            cut(&tilted(&round(many, 0.5))),
            Err(MeshError::Corners { corners, most, .. }) if (corners, most) == (many, MOST_CORNERS)
        ));
    }

    #[test]
    fn order_is_kept_and_indices_are_checked() {
        let mut faces = Faces::default();
        faces.push(&[0, 1, 2]);
        faces.push(&[0, 1, 2, 3]);
        faces.push(&[1, 2, 3]);
        assert_eq!(faces.len(), 3);
        let square = tilted(&[[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]]);
        assert_eq!(
            into_triangles(faces.clone(), &square).unwrap(),
            [[0, 1, 2], [0, 1, 2], [0, 2, 3], [1, 2, 3]]
        );
        assert!(matches!(
            into_triangles(faces, &square[..3]),
            Err(MeshError::IndexOutOfRange {
                triangle: 1,
                index: 3,
                vertices: 3
            })
        ));
    }
}
