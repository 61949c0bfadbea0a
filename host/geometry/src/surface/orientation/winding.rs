//! Which triangles share an edge, and whether their windings agree.

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
