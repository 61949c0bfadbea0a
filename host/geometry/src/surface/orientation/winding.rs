//! Which triangles share an edge, and whether their windings agree.

use nalgebra::Vector3;
use rayon::prelude::*;

/// A side of a triangle: its two corners in the order of their numbers, and whether the triangle runs from first to second.
pub(super) struct Edge {
    pub(super) ends: (u32, u32),
    pub(super) triangle: u32,
    pub(super) forward: bool,
}

/// The sides of all triangles that do not name a position twice, those of one edge beside each other.
pub(super) fn edges(ids: &[[u32; 3]]) -> Vec<Edge> {
    let mut edges: Vec<Edge> = Vec::with_capacity(3 * ids.len());
    for (triangle, &[a, b, c]) in ids.iter().enumerate() {
        if a == b || b == c || c == a {
            continue;
        }
        edges.extend([(a, b), (b, c), (c, a)].map(|(from, to)| Edge {
            ends: (from.min(to), from.max(to)),
            triangle: triangle as u32,
            forward: from < to,
        }));
    }
    edges.par_sort_unstable_by_key(|edge| (edge.ends, edge.triangle));
    edges
}

/// Angle between two faces that count as one plane, rad.
const FLAT_RAD: f64 = 1e-9;

/// The triangles at an edge where bodies touch, in pairs that enclose material; none unless there are four or more, half of them in
/// each direction, that alternate around the edge.
pub(super) fn mates(edge: &[Edge], ids: &[[u32; 3]], places: &[[f64; 3]]) -> Option<Vec<[u32; 2]>> {
    let forward = edge.iter().filter(|side| side.forward).count();
    if edge.len() < 4 || 2 * forward != edge.len() {
        return None;
    }
    let place = |corner: u32| Vector3::from(places[corner as usize]);
    let (from, to) = edge[0].ends;
    let along = (place(to) - place(from)).normalize();
    let across = |side: &Edge| {
        let corners = ids[side.triangle as usize];
        let third = corners.into_iter().find(|&c| c != from && c != to)?;
        let away = place(third) - place(from);
        Some(away - along * away.dot(&along))
    };
    let zero = across(&edge[0])?;
    let mut around = Vec::with_capacity(edge.len());
    for side in edge {
        let away = across(side)?;
        let angle = along.dot(&zero.cross(&away)).atan2(zero.dot(&away));
        let is_first = angle.abs() < FLAT_RAD;
        let angle = if is_first {
            0.0
        } else {
            angle.rem_euclid(std::f64::consts::TAU)
        };
        around.push((angle, side));
    }
    // Material lies behind a face that runs backward along the edge; of two faces in one plane it ends before it begins again.
    let order = |a: &(f64, &Edge), b: &(f64, &Edge)| match (a.0 - b.0).abs() < FLAT_RAD {
        true => b.1.forward.cmp(&a.1.forward),
        false => a.0.total_cmp(&b.0),
    };
    around.sort_by(order);
    let begin = around.iter().position(|(_, side)| !side.forward)?;
    around.rotate_left(begin);
    let pairs = around.chunks_exact(2).map(|pair| {
        let alternate = !pair[0].1.forward && pair[1].1.forward;
        alternate.then(|| [pair[0].1.triangle, pair[1].1.triangle])
    });
    pairs.collect()
}

/// Disjoint sets whose members know whether they are wound as their set's root.
pub(super) struct Parities {
    parent: Vec<u32>,
    against_parent: Vec<bool>,
}

impl Parities {
    pub(super) fn new(count: usize) -> Self {
        Self {
            parent: (0..count as u32).collect(),
            against_parent: vec![false; count],
        }
    }

    /// Root of a member's set, and whether the member is wound against it.
    pub(super) fn root(&mut self, member: usize) -> (usize, bool) {
        let (mut root, mut against) = (member, false);
        while self.parent[root] as usize != root {
            against ^= self.against_parent[root];
            root = self.parent[root] as usize;
        }
        // Everything on the way then hangs at the root.
        let (mut at, mut left) = (member, against);
        while self.parent[at] as usize != root && at != root {
            let next = self.parent[at] as usize;
            let own = self.against_parent[at];
            self.parent[at] = root as u32;
            self.against_parent[at] = left;
            left ^= own;
            at = next;
        }
        (root, against)
    }

    /// Joins the sets of two members, of which one is wound against the other or not; false if that contradicts what is known.
    pub(super) fn join(&mut self, a: usize, b: usize, against: bool) -> bool {
        let ((root_a, a_against), (root_b, b_against)) = (self.root(a), self.root(b));
        let between = a_against ^ b_against ^ against;
        if root_a == root_b {
            return !between;
        }
        // The smaller number stays root: the first triangle of a part.
        let (root, child) = (root_a.min(root_b), root_a.max(root_b));
        self.parent[child] = root as u32;
        self.against_parent[child] = between;
        true
    }
}
