//! Triangles that repeat others.

use rayon::prelude::*;

use crate::io::mesh::TriMesh;

/// Drops triangles between the same three positions as an earlier one, whichever way they are wound; returns how many.
pub(super) fn drop_repeated(mesh: &mut TriMesh, joined: &[u32]) -> usize {
    let mut keys: Vec<([u32; 3], u32)> = mesh
        .triangles
        .par_iter()
        .zip(0..mesh.triangles.len() as u32)
        .map(|(corners, index)| {
            let mut key = corners.map(|i| joined[i as usize]);
            key.sort_unstable();
            (key, index)
        })
        .collect();
    keys.par_sort_unstable();
    let mut repeats = vec![false; keys.len()];
    for same in keys.chunk_by(|a, b| a.0 == b.0) {
        for (_, index) in &same[1..] {
            repeats[*index as usize] = true;
        }
    }
    let before = mesh.triangles.len();
    let mut repeat = repeats.into_iter();
    mesh.triangles.retain(|_| repeat.next() == Some(false));
    before - mesh.triangles.len()
}
