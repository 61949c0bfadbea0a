//! Inside and outside of several closed bodies in one mesh, which may overlap, touch or hold one another, and of their cavities.

use nalgebra::Vector3;
use rayon::prelude::*;

use super::Surface;
use crate::io::mesh::{MeshError, TriMesh};

/// The closed parts of a mesh.
#[derive(Debug)]
pub(super) struct Bodies(Vec<Body>);

/// A closed part. By itself it has a plain inside, so that the nearest of its own triangles tells it.
#[derive(Debug)]
struct Body {
    surface: Surface,
    /// Its triangles are wound counter-clockwise seen from inside: the shell of a cavity.
    is_cavity: bool,
}

impl Bodies {
    /// The bodies of a mesh, each the numbers of its triangles.
    ///
    /// # Errors
    /// As [`Surface::new`].
    pub(super) fn new(mesh: &TriMesh, bodies: &[Vec<u32>]) -> Result<Self, MeshError> {
        let body = |triangles: &Vec<u32>| Body::new(mesh, triangles);
        bodies
            .par_iter()
            .map(body)
            .collect::<Result<_, _>>()
            .map(Self)
    }

    /// Whether a point is in the material: in more bodies than cavities.
    pub(super) fn hold(&self, p: [f64; 3]) -> bool {
        let winding = |body: &Body| match (body.encloses(p), body.is_cavity) {
            (false, _) => 0,
            (true, false) => 1,
            (true, true) => -1,
        };
        self.0.iter().map(winding).sum::<i32>() > 0
    }
}

impl Body {
    fn new(mesh: &TriMesh, triangles: &[u32]) -> Result<Self, MeshError> {
        let corners = |&index: &u32| mesh.corners(index as usize);
        let vertices: Vec<[f64; 3]> = triangles.iter().flat_map(corners).collect();
        let first = vertices
            .first()
            .copied()
            .map_or(Vector3::zeros(), Vector3::from);
        let volume6_mm3 = |corners: &[[f64; 3]]| {
            let at = |k: usize| Vector3::from(corners[k]) - first;
            at(0).dot(&at(1).cross(&at(2)))
        };
        let is_cavity = vertices.chunks_exact(3).map(volume6_mm3).sum::<f64>() < 0.0;
        let triangles = (0..triangles.len() as u32).map(|n| [3 * n, 3 * n + 1, 3 * n + 2]);
        let triangles = triangles.collect();
        let surface = Surface::new(&TriMesh {
            vertices,
            triangles,
        })?;
        Ok(Self { surface, is_cavity })
    }

    fn encloses(&self, p: [f64; 3]) -> bool {
        let bounds = self.surface.bounds();
        let is_near = (0..3).all(|k| bounds.low[k] <= p[k] && p[k] <= bounds.high[k]);
        is_near && (self.surface.closest(p).signed_distance_mm < 0.0) != self.is_cavity
    }
}
