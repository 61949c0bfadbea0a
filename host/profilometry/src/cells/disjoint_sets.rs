//! Union-find (Galler and Fisher 1964): which members hang together.

/// Disjoint sets of the members `0..count`; a root stores the size of its set, negated.
pub(crate) struct DisjointSets {
    parents: Vec<i32>,
}

impl DisjointSets {
    pub fn new(count: usize) -> Self {
        Self {
            parents: vec![-1; count],
        }
    }

    /// Sets of consecutive members, each part numbered from zero.
    pub fn beside_each_other(parts: &[Self]) -> Self {
        let mut parents = Vec::new();
        for part in parts {
            let first = parents.len() as i32;
            let moved = |&parent: &i32| if parent < 0 { parent } else { parent + first };
            parents.extend(part.parents.iter().map(moved));
        }
        Self { parents }
    }

    pub fn root(&mut self, mut member: usize) -> usize {
        while self.parents[member] >= 0 {
            let parent = self.parents[member] as usize;
            if self.parents[parent] >= 0 {
                self.parents[member] = self.parents[parent];
            }
            member = parent;
        }
        member
    }

    pub fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        if a == b {
            return;
        }
        let (small, large) = if self.parents[a] > self.parents[b] {
            (a, b)
        } else {
            (b, a)
        };
        self.parents[large] += self.parents[small];
        self.parents[small] = large as i32;
    }

    pub fn size_of(&mut self, member: usize) -> usize {
        let root = self.root(member);
        self.parents[root].unsigned_abs() as usize
    }
}
