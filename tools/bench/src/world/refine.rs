//! Conforming mesh refinement: an edge is split for all its triangles or for none, so no crack can open.

use flankscope_gear_cad::Mesh;
use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

/// Midpoint vertex of each edge to be halved.
type Halves = HashMap<(u32, u32), u32, BuildHasherDefault<EdgeHasher>>;

/// Hash of two vertex indices. They are not chosen by an attacker, so good mixing is sufficient.
#[derive(Default)]
struct EdgeHasher(u64);

impl Hasher for EdgeHasher {
    fn write(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.write_u32(u32::from(byte));
        }
    }

    fn write_u32(&mut self, number: u32) {
        let mixed = (self.0 ^ u64::from(number)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        self.0 = mixed ^ (mixed >> 29);
    }

    fn finish(&self) -> u64 {
        self.0
    }
}

/// Halves every edge longer than `longest_mm` of the tagged triangles for which `wanted` holds, until none is left.
///
/// The criterion applies to whole triangles instead of edges: if only one long side of a sliver were selected, the fan of its
/// parts would be long and selected again, and so on. Every triangle at a halved edge is divided, tagged or not; parts keep the
/// tag. New points lie on the old triangles, so the surface does not change.
///
/// A triangle at the rim that is repeatedly halved along one side would become a fan of slivers as long as itself, which rays may
/// miss. So its longest side is halved, too, once it is more than [`GRADING`] times as long as the halved one: the pieces grow
/// outwards gradually.
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

/// See [`refine`].
const GRADING: f64 = 1.9;

fn key(a: u32, b: u32) -> (u32, u32) {
    (a.min(b), a.max(b))
}

/// Midpoint vertex of each edge to be halved; the vertices are added to the mesh in a fixed order.
fn halved_edges<T: Copy>(
    mesh: &mut Mesh,
    tags: &[Option<T>],
    longest_mm: f64,
    wanted: &impl Fn(T, [[f64; 3]; 3]) -> bool,
) -> Halves {
    let mut halves = Halves::default();
    for (triangle, tag) in mesh.triangles.iter().zip(tags) {
        let Some(tag) = *tag else { continue };
        if !wanted(tag, triangle.map(|v| mesh.vertices[v as usize])) {
            continue;
        }
        for edge in sides(*triangle) {
            if length2(&mesh.vertices, edge) > longest_mm * longest_mm {
                halve(&mut mesh.vertices, &mut halves, edge);
            }
        }
    }
    // An edge halved for one triangle is halved for its neighbour, whose longest side may then be too long.
    let mut before = 0;
    while halves.len() > before {
        before = halves.len();
        // Most triangles have no halved edge, which two tests of their corners show.
        let mut at_end = vec![false; mesh.vertices.len()];
        for &(p, q) in halves.keys() {
            at_end[p as usize] = true;
            at_end[q as usize] = true;
        }
        for triangle in &mesh.triangles {
            if triangle.iter().filter(|&&v| at_end[v as usize]).count() < 2 {
                continue;
            }
            let lengths2 = sides(*triangle).map(|edge| (length2(&mesh.vertices, edge), edge));
            let longest = lengths2
                .into_iter()
                .fold(lengths2[0], |a, b| if b.0 > a.0 { b } else { a });
            let too_long = |(short2, edge): &(f64, (u32, u32))| {
                halves.contains_key(edge) && longest.0 > GRADING * GRADING * short2
            };
            if lengths2.iter().any(too_long) {
                halve(&mut mesh.vertices, &mut halves, longest.1);
            }
        }
    }
    halves
}

fn sides([a, b, c]: [u32; 3]) -> [(u32, u32); 3] {
    [key(a, b), key(b, c), key(c, a)]
}

fn length2(vertices: &[[f64; 3]], (p, q): (u32, u32)) -> f64 {
    let (p, q) = (vertices[p as usize], vertices[q as usize]);
    (0..3).map(|k| (p[k] - q[k]).powi(2)).sum()
}

fn halve(vertices: &mut Vec<[f64; 3]>, halves: &mut Halves, edge: (u32, u32)) {
    let [p, q] = [edge.0, edge.1].map(|v| vertices[v as usize]);
    halves.entry(edge).or_insert_with(|| {
        vertices.push([0, 1, 2].map(|k| 0.5 * (p[k] + q[k])));
        vertices.len() as u32 - 1
    });
}

/// Pieces of a triangle with halved edges, in the same orientation.
fn divide(vertices: &[[f64; 3]], [a, b, c]: [u32; 3], halves: &Halves, out: &mut Vec<[u32; 3]>) {
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

/// Triangle `a, b, c` with midpoints `m` on ab and `n` on bc: cuts off the corner at b, and splits the rest along its shorter diagonal.
fn corner_off(vertices: &[[f64; 3]], [a, m, b, n, c]: [u32; 5], out: &mut Vec<[u32; 3]>) {
    out.push([m, b, n]);
    if length2(vertices, (a, n)) < length2(vertices, (m, c)) {
        out.extend([[a, m, n], [a, n, c]]);
    } else {
        out.extend([[a, m, c], [m, n, c]]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rim_of_a_refined_strip_is_no_fan() {
        // A strip of two long triangles to be refined, beside one of two that are not selected.
        let [x, z] = [0.4, 66.0];
        let corner = |i: u32| [f64::from(i % 3) * x, 0.0, f64::from(i / 3) * z];
        let mut mesh = Mesh {
            vertices: (0..6).map(corner).collect(),
            triangles: vec![[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]],
        };
        let mut tags = vec![Some(()), Some(()), None, None];
        refine(&mut mesh, &mut tags, 0.1, |(), _| true);

        let area = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|i| nalgebra::Vector3::from(mesh.vertices[i as usize]));
            0.5 * (b - a).cross(&(c - a)).norm()
        };
        let total: f64 = mesh.triangles.iter().map(area).sum();
        assert!((total - 2.0 * x * z).abs() < 1e-9);
        for (triangle, tag) in mesh.triangles.iter().zip(&tags) {
            let longest2 = sides(*triangle).map(|edge| length2(&mesh.vertices, edge));
            assert!(tag.is_none() || longest2.iter().all(|l| *l <= 0.1 * 0.1));
        }
        // An inner edge has two triangles, one at the outline has one: no crack.
        let mut edges = HashMap::new();
        let mut around = vec![0; mesh.vertices.len()];
        for triangle in &mesh.triangles {
            for edge in sides(*triangle) {
                *edges.entry(edge).or_insert(0) += 1;
            }
            for &vertex in triangle {
                around[vertex as usize] += 1;
            }
        }
        let on_outline = |v: u32| {
            let [px, _, pz] = mesh.vertices[v as usize];
            px == 0.0 || px == 2.0 * x || pz == 0.0 || pz == z
        };
        for (&(p, q), &count) in &edges {
            assert!(count == 2 || count == 1 && on_outline(p) && on_outline(q));
        }
        // Halving graded triangles keeps angles away from zero, unlike a fan of a thousand.
        assert!(
            around.iter().all(|&count| count <= 24),
            "{:?}",
            around.iter().max()
        );
    }
}
