//! Selection of the CAD's facets that belong to a patch.

use std::collections::HashMap;

use nalgebra::Vector3;

use super::PatchError;
use crate::io::mesh::{TriMesh, weld};
use crate::space::unit_normal;
use crate::surface::Surface;

/// A seed lies so near to the CAD, mm: farther away it is a slip of the pen.
pub const ON_CAD_MM: f64 = 0.1;

/// Facets around a seed face as it does within this angle, unless a tool file says otherwise, degrees.
pub const SEED_ANGLE_DEG: f64 = 10.0;

/// Selection of a patch's facets.
#[derive(Debug, Clone, PartialEq)]
pub enum Pick {
    /// The facets around a point that hang together by their edges and face as the one at the point does within an angle, rad.
    Seed([f64; 3], f64),
    /// These triangles of the CAD file, counted from 0.
    Facets(Vec<u32>),
    /// All that lies in the box.
    All,
}

impl Pick {
    /// The triangles.
    ///
    /// # Errors
    /// The seed is off the CAD, or there is no such triangle.
    pub(super) fn triangles(
        &self,
        name: &str,
        mesh: &TriMesh,
        surface: &Surface,
    ) -> Result<Vec<u32>, PatchError> {
        match self {
            Self::All => Ok((0..mesh.triangles.len() as u32).collect()),
            Self::Facets(facets) => {
                let count = mesh.triangles.len();
                if let Some(&got) = facets.iter().find(|&&i| i as usize >= count) {
                    return Err(PatchError::NoFacet {
                        name: name.into(),
                        got,
                        count,
                    });
                }
                let mut facets = facets.clone();
                facets.sort_unstable();
                facets.dedup();
                Ok(facets)
            }
            Self::Seed(at_mm, angle_rad) => {
                let hit = surface.closest(*at_mm);
                let off_mm = hit.signed_distance_mm.abs();
                if off_mm > ON_CAD_MM {
                    return Err(PatchError::OffCad {
                        name: name.into(),
                        key: "seed_mm",
                        off_mm,
                        limit_mm: ON_CAD_MM,
                    });
                }
                Ok(grown(mesh, hit.triangle, *angle_rad))
            }
        }
    }
}

/// The triangles that hang together with `seed` and face as it does.
fn grown(mesh: &TriMesh, seed: u32, angle_rad: f64) -> Vec<u32> {
    let (_, joined) = weld(&mesh.vertices);
    let sides = |triangle: u32| {
        let ids = mesh.triangles[triangle as usize].map(|corner| joined[corner as usize]);
        [(0, 1), (1, 2), (2, 0)].map(|(a, b)| (ids[a].min(ids[b]), ids[a].max(ids[b])))
    };
    let mut beside: HashMap<(u32, u32), Vec<u32>> = HashMap::new();
    for triangle in 0..mesh.triangles.len() as u32 {
        for side in sides(triangle) {
            beside.entry(side).or_default().push(triangle);
        }
    }
    let normal = |triangle: u32| unit_normal(mesh.corners(triangle as usize)).map(Vector3::from);
    let Some(direction) = normal(seed) else {
        return vec![seed];
    };
    let least = angle_rad.cos();
    let mut belongs = vec![false; mesh.triangles.len()];
    belongs[seed as usize] = true;
    let mut open = vec![seed];
    let mut all = vec![seed];
    while let Some(triangle) = open.pop() {
        for side in sides(triangle) {
            for &next in beside.get(&side).into_iter().flatten() {
                // A triangle without area faces nowhere: it joins those beside it.
                let faces = normal(next).is_none_or(|n| n.dot(&direction) >= least);
                if faces && !std::mem::replace(&mut belongs[next as usize], true) {
                    open.push(next);
                    all.push(next);
                }
            }
        }
    }
    all.sort_unstable();
    all
}
