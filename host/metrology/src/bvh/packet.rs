//! Closest points of several queries at once: neighbours share their way through the hierarchy.
//!
//! Each query of a packet keeps its own bound; a box is entered when any of them might find something in it. Everything
//! up to the choice of candidates is f32, one lane per query, in loops that the compiler turns into vectors of whatever
//! width the processor has. What is chosen is measured in f64, query by query, as in [`Bvh::closest`].

use nalgebra::Vector3;

use super::{Bvh, Found, MAX_DEPTH, WIDTH, coarse};
use crate::leaf::{ERROR_RATIO, LANES};

/// Queries per packet.
pub(crate) const QUERIES: usize = 8;

/// One number per query.
pub(crate) type Each = [f32; QUERIES];

/// What a packet leaves to the next: memory, and where the last query ended.
pub(crate) struct PacketScratch {
    stack: Vec<(f32, u32, u32)>,
    candidates: Vec<Candidate>,
    leaf: u32,
}

/// A triangle that may be nearest to some query.
struct Candidate {
    place: u32,
    /// Bit i: the i-th query's foot lies inside for certain.
    inside: u8,
    /// Estimated squared distances.
    estimates: Each,
}

impl PacketScratch {
    pub fn new() -> Self {
        Self {
            stack: Vec::with_capacity(3 * MAX_DEPTH + WIDTH),
            candidates: Vec::with_capacity(256),
            leaf: 0,
        }
    }
}

/// Larger of two numbers, one instruction (unlike `f32::max`, which minds NaN).
#[inline(always)]
pub(crate) fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// Smaller of two numbers, likewise.
#[inline(always)]
pub(crate) fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

impl Bvh {
    /// The closest triangle to each of the finite points, which should be near each other.
    #[inline(always)]
    pub fn closest_packet(
        &self,
        points: &[[f64; 3]; QUERIES],
        scratch: &mut PacketScratch,
    ) -> [Found; QUERIES] {
        let q: [Each; 3] = [0, 1, 2].map(|k| points.map(|p| coarse(p[k])));
        // What f32 may lose. An estimate is off by one slack at most, so that the nearest triangle's is at most two above
        // the smallest.
        let mut slack: Each = [0.0; QUERIES];
        for i in 0..QUERIES {
            let size = q[0][i].abs() + q[1][i].abs() + q[2][i].abs();
            slack[i] = 2.0 * ERROR_RATIO * (self.extent + size);
        }
        let mut least: Each = [f32::INFINITY; QUERIES];
        let mut limit: Each = [f32::INFINITY; QUERIES];
        let PacketScratch {
            stack,
            candidates,
            leaf: hint,
        } = scratch;
        candidates.clear();
        let first = (*hint).min(self.leaves.len() as u32 - 1);
        self.try_leaf(first, &q, &slack, &mut least, &mut limit, candidates);
        stack.clear();
        stack.push((0.0, 0, 0));
        while let Some((nearest, child, count)) = stack.pop() {
            // The bounds may have shrunk since: `nearest` is the smallest distance of any query.
            let mut widest = 0.0;
            for limit in limit {
                widest = larger(widest, limit);
            }
            if nearest > widest {
                continue;
            }
            if count > 0 {
                if child != first {
                    self.try_leaf(child, &q, &slack, &mut least, &mut limit, candidates);
                }
                continue;
            }
            let node = &self.nodes[child as usize];
            let begin = stack.len();
            for slot in 0..WIDTH {
                let (low, high) = (
                    [0, 1, 2].map(|k: usize| node.low[k][slot]),
                    [0, 1, 2].map(|k: usize| node.high[k][slot]),
                );
                let mut nearest = f32::INFINITY;
                let mut entered = false;
                for i in 0..QUERIES {
                    let mut distance2 = 0.0;
                    for k in 0..3 {
                        let outside = larger(larger(low[k] - q[k][i], q[k][i] - high[k]), 0.0);
                        distance2 += outside * outside;
                    }
                    entered |= distance2 <= limit[i];
                    nearest = smaller(nearest, distance2);
                }
                if !entered {
                    continue;
                }
                // Insertion into the new part of the stack, nearest on top.
                stack.push((nearest, node.child[slot], node.count[slot]));
                let mut at = stack.len() - 1;
                while at > begin && stack[at - 1].0 < stack[at].0 {
                    stack.swap(at - 1, at);
                    at -= 1;
                }
            }
        }
        let mut best = [None::<Found>; QUERIES];
        for Candidate {
            place,
            inside,
            estimates,
        } in candidates.iter()
        {
            let mut promising = 0u32;
            for i in 0..QUERIES {
                promising |= u32::from(estimates[i] <= limit[i]) << i;
            }
            let triangle = &self.triangles[*place as usize];
            while promising != 0 {
                let i = promising.trailing_zeros() as usize % QUERIES;
                promising &= promising - 1;
                let point = Vector3::from(points[i]);
                let nearest = if inside >> i & 1 == 1 {
                    triangle.foot(point)
                } else {
                    triangle.nearest(point)
                };
                if best[i].is_none_or(|b| nearest.distance2_mm2 < b.nearest.distance2_mm2) {
                    best[i] = Some(Found {
                        place: *place,
                        nearest,
                    });
                }
            }
        }
        let found = std::array::from_fn(|i| {
            // Estimates of finite points are finite, so every query has a candidate.
            best[i].unwrap_or_else(|| Found {
                place: 0,
                nearest: self.triangles[0].nearest(Vector3::from(points[i])),
            })
        });
        *hint = found[QUERIES - 1].place / LANES as u32;
        found
    }

    /// Estimates the leaf's triangles, keeps those that may be nearest to some query, and tightens the bounds.
    #[inline(always)]
    fn try_leaf(
        &self,
        leaf: u32,
        q: &[Each; 3],
        slack: &Each,
        least: &mut Each,
        limit: &mut Each,
        candidates: &mut Vec<Candidate>,
    ) {
        let of_leaf = &self.leaves[leaf as usize];
        for lane in 0..LANES {
            let (estimates, inside) = of_leaf.distances2_of(lane, q, slack);
            let mut promising = false;
            for i in 0..QUERIES {
                promising |= estimates[i] <= limit[i];
            }
            if !promising {
                continue;
            }
            candidates.push(Candidate {
                place: leaf * LANES as u32 + lane as u32,
                inside,
                estimates,
            });
            for i in 0..QUERIES {
                least[i] = smaller(least[i], estimates[i]);
                let reach = least[i].sqrt() * (1.0 + 4e-7) + slack[i];
                limit[i] = reach * reach * (1.0 + 4e-7);
            }
        }
    }
}
