//! Distance of a patch's facets from the curved surface that they stand for.

use std::collections::HashMap;

use nalgebra::Vector3;

use super::Patch;
use crate::io::mesh::{TriMesh, weld};

/// A facet and its extent perpendicular to one of its edges.
struct Side {
    triangle: u32,
    extent_mm: f64,
}

impl Patch {
    /// Estimate of the largest distance between facets and surface, mm: where the normals of neighbours differ by an angle, the surface is
    /// taken to turn by it over the wider of the two, as a circle whose chord that facet is. Zero of a plane.
    #[must_use]
    pub fn chord_error_mm(&self, mesh: &TriMesh) -> f64 {
        let (_, joined) = weld(&mesh.vertices);
        let mut sides: HashMap<(u32, u32), Side> = HashMap::new();
        let mut largest_mm = 0.0_f64;
        for &triangle in &self.triangles {
            let corners = mesh.corners(triangle as usize).map(Vector3::from);
            let ids = mesh.triangles[triangle as usize].map(|corner| joined[corner as usize]);
            for [a, b, c] in [[0, 1, 2], [1, 2, 0], [2, 0, 1]] {
                let Some(along) = (corners[b] - corners[a]).try_normalize(0.0) else {
                    continue;
                };
                let extent_mm = (corners[c] - corners[a]).cross(&along).norm();
                let edge = (ids[a].min(ids[b]), ids[a].max(ids[b]));
                let own = Side {
                    triangle,
                    extent_mm,
                };
                let Some(other) = sides.insert(edge, own) else {
                    continue;
                };
                let turn_rad = between_rad(mesh, [triangle, other.triangle]);
                // The sagitta of a chord w over which the tangent turns by an angle: w times an eighth of it.
                largest_mm = largest_mm.max(extent_mm.max(other.extent_mm) * turn_rad / 8.0);
            }
        }
        largest_mm
    }
}

/// Angle between the normals of two triangles; zero where one of them has no area.
fn between_rad(mesh: &TriMesh, triangles: [u32; 2]) -> f64 {
    let [a, b] = triangles.map(|triangle| {
        let [p, q, r] = mesh.corners(triangle as usize).map(Vector3::from);
        (q - p).cross(&(r - p))
    });
    // Exact for small angles, where the arc cosine of a product is not.
    a.cross(&b).norm().atan2(a.dot(&b))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::patch::{PatchSpec, Patches, Pick};
    use crate::surface::Surface;

    /// A strip of a cylinder about z, of so many facets over 20 degrees, on a block that closes it.
    fn bowed(radius_mm: f64, facets: u32) -> TriMesh {
        let mut outline: Vec<[f64; 2]> = (0..=facets)
            .map(|k| {
                let angle = (f64::from(k) / f64::from(facets) - 0.5) * 20f64.to_radians();
                [radius_mm * angle.cos(), radius_mm * angle.sin()]
            })
            .collect();
        outline.push([0.0, 0.0]);
        let n = outline.len() as u32;
        let vertices = [0.0, 8.0]
            .into_iter()
            .flat_map(|z| outline.iter().map(move |&[x, y]| [x, y, z]))
            .collect();
        let mut triangles = Vec::new();
        for i in 0..n {
            let next = (i + 1) % n;
            triangles.push([i, next, n + i]);
            triangles.push([next, n + next, n + i]);
        }
        for i in 0..n - 2 {
            triangles.push([n - 1, i + 1, i]);
            triangles.push([2 * n - 1, n + i, n + i + 1]);
        }
        TriMesh {
            vertices,
            triangles,
        }
    }

    #[test]
    fn facets_of_a_cylinder_lie_off_it_by_their_sagitta_and_of_a_plane_not() {
        let seed = |name: &str, at_mm: [f64; 3], datum: &[&str]| PatchSpec {
            name: name.into(),
            pick: Pick::Seed(at_mm, 0.3),
            box_mm: None,
            origin_mm: None,
            up: None,
            zone_mm: None,
            datum: datum.iter().map(|name| (*name).into()).collect(),
        };
        for facets in [4, 16] {
            let mesh = bowed(30.0, facets);
            let surface = Surface::new(&mesh).unwrap();
            let half_rad = 0.5 * 20f64.to_radians() / f64::from(facets);
            let on_facet = 30.0 * half_rad.cos();
            let at_mm = [on_facet * half_rad.cos(), on_facet * half_rad.sin(), 4.0];
            let specs = [
                seed("bow", at_mm, &["end"]),
                seed("end", [15.0, 0.1, 8.0], &[]),
            ];
            let patches = Patches::new(&specs, &mesh, &surface, 0.25).unwrap();
            let [bow_mm, end_mm] =
                [1, 2].map(|number| patches.get(number).unwrap().chord_error_mm(&mesh));
            let sagitta_mm = 30.0 * (1.0 - half_rad.cos());
            assert!(
                (bow_mm / sagitta_mm - 1.0).abs() < 0.01,
                "{facets}: {bow_mm}"
            );
            assert_eq!(end_mm, 0.0);
        }
    }
}
