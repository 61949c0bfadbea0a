//! Conforming refinement: an edge is split for all its triangles or for none, so no crack can open.

use flankscope_gear_cad::Mesh;
use std::collections::HashMap;

/// Halves every edge longer than `longest_mm` of the tagged triangles for which `wanted` holds, until none is left.
///
/// Whole triangles are asked, not edges: where only one long side of a sliver were wanted, the fan of its parts would
/// itself be long and wanted, and so on. Every triangle at a halved edge is divided, tagged or not; parts keep the tag of
/// the whole. New points lie on the old triangles: the surface does not move.
pub(crate) fn refine<T: Copy>(
    mesh: &mut Mesh,
    tags: &mut Vec<Option<T>>,
    longest_mm: f64,
    wanted: impl Fn(T, [[f64; 3]; 3]) -> bool,
) {
    loop {
        let halves = halved_edges(mesh, tags, longest_mm, &wanted);
        if halves.is_empty() {
            return;
        }
        let mut triangles = Vec::with_capacity(mesh.triangles.len() + 2 * halves.len());
        let mut new_tags = Vec::with_capacity(triangles.capacity());
        for (&triangle, &tag) in mesh.triangles.iter().zip(tags.iter()) {
            let before = triangles.len();
            divide(&mesh.vertices, triangle, &halves, &mut triangles);
            new_tags.resize(new_tags.len() + triangles.len() - before, tag);
        }
        mesh.triangles = triangles;
        *tags = new_tags;
    }
}

fn key(a: u32, b: u32) -> (u32, u32) {
    (a.min(b), a.max(b))
}

/// Middle vertex of each edge to be halved; the vertices are added to the mesh in a fixed order.
fn halved_edges<T: Copy>(
    mesh: &mut Mesh,
    tags: &[Option<T>],
    longest_mm: f64,
    wanted: &impl Fn(T, [[f64; 3]; 3]) -> bool,
) -> HashMap<(u32, u32), u32> {
    let mut halves = HashMap::new();
    for (triangle, tag) in mesh.triangles.iter().zip(tags) {
        let Some(tag) = *tag else { continue };
        if !wanted(tag, triangle.map(|v| mesh.vertices[v as usize])) {
            continue;
        }
        for side in 0..3 {
            let edge = key(triangle[side], triangle[(side + 1) % 3]);
            let [p, q] = [edge.0, edge.1].map(|v| mesh.vertices[v as usize]);
            let length2: f64 = (0..3).map(|k| (p[k] - q[k]).powi(2)).sum();
            if length2 > longest_mm * longest_mm && !halves.contains_key(&edge) {
                halves.insert(edge, mesh.vertices.len() as u32);
                mesh.vertices.push([0, 1, 2].map(|k| 0.5 * (p[k] + q[k])));
            }
        }
    }
    halves
}

/// Pieces of a triangle whose edges are halved as `halves` says, in the same sense of rotation.
fn divide(
    vertices: &[[f64; 3]],
    [a, b, c]: [u32; 3],
    halves: &HashMap<(u32, u32), u32>,
    out: &mut Vec<[u32; 3]>,
) {
    let half = |p, q| halves.get(&key(p, q)).copied();
    match (half(a, b), half(b, c), half(c, a)) {
        (None, None, None) => out.push([a, b, c]),
        (Some(m), None, None) => out.extend([[a, m, c], [m, b, c]]),
        (None, Some(m), None) => out.extend([[b, m, a], [m, c, a]]),
        (None, None, Some(m)) => out.extend([[c, m, b], [m, a, b]]),
        (Some(m), Some(n), None) => corner_off(vertices, [a, m, b, n, c], out),
        (None, Some(m), Some(n)) => corner_off(vertices, [b, m, c, n, a], out),
        (Some(n), None, Some(m)) => corner_off(vertices, [c, m, a, n, b], out),
        (Some(m), Some(n), Some(o)) => out.extend([[a, m, o], [m, b, n], [o, n, c], [m, n, o]]),
    }
}

/// Triangle `a, b, c` with middles `m` on ab and `n` on bc: the corner at b, and the rest along its shorter diagonal.
fn corner_off(vertices: &[[f64; 3]], [a, m, b, n, c]: [u32; 5], out: &mut Vec<[u32; 3]>) {
    let distance2 = |p: u32, q: u32| -> f64 {
        let (p, q) = (vertices[p as usize], vertices[q as usize]);
        (0..3).map(|k| (p[k] - q[k]).powi(2)).sum()
    };
    out.push([m, b, n]);
    if distance2(a, n) < distance2(m, c) {
        out.extend([[a, m, n], [a, n, c]]);
    } else {
        out.extend([[a, m, c], [m, n, c]]);
    }
}
