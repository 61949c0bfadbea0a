//! Closest points of several queries at once: neighbours share their way through the hierarchy.
//!
//! Each query of a packet keeps its own bound; a box is entered when any of them might find something in it,
//! which is asked only of those that are near the packet's own box. Everything
//! up to the choice of candidates is f32, one lane per query, in loops that the compiler turns into vectors of whatever
//! width the processor has. What is chosen is measured in f64, query by query, as in [`Bvh::closest`].

use std::hint::black_box;

use nalgebra::Vector3;
use wide::f32x8;

use super::{Bvh, Found, STACK, WIDTH, coarse};
use crate::surface::triangle_packet::{ERROR_RATIO, LANES};

/// Queries per packet.
pub(crate) const QUERIES: usize = crate::space::morton::TOGETHER;

/// One number per query.
pub(crate) type Each = [f32; QUERIES];

/// State that a packet passes to the next: buffers, and the end of the last query.
pub(crate) struct PacketScratch {
    stack: Vec<(f32, u32, u32)>,
    candidates: Vec<Candidate>,
    leaf: u32,
}

/// A triangle that may be nearest to some query.
struct Candidate {
    place: u32,
    /// Bit i: the i-th query's foot on its plane lies inside for certain.
    inside: u8,
    /// Estimated squared distances.
    estimates: Each,
}

impl PacketScratch {
    pub fn new() -> Self {
        Self {
            stack: Vec::with_capacity(STACK),
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

/// The extreme of a packet, halving it: a chain from the first to the last would keep the compiler from using vectors.
#[inline(always)]
fn reduce(each: &Each, extreme: impl Fn(f32, f32) -> f32) -> f32 {
    let mut half = [0.0; QUERIES / 2];
    for i in 0..QUERIES / 2 {
        half[i] = extreme(each[i], each[i + QUERIES / 2]);
    }
    extreme(extreme(half[0], half[2]), extreme(half[1], half[3]))
}

impl Bvh {
    /// The closest triangle to each of the finite points, at most [`QUERIES`], which should be near each other: the first
    /// of `found`.
    #[expect(
        clippy::needless_range_loop,
        reason = "several arrays run side by side"
    )]
    #[inline(always)]
    pub fn closest_packet(
        &self,
        points: &[[f64; 3]],
        scratch: &mut PacketScratch,
        found: &mut [Found; QUERIES],
    ) {
        let Some(last) = points.len().checked_sub(1) else {
            return;
        };
        // Plain loops, here and below: what `array::map` makes of these is not vectors.
        let mut q: [Each; 3] = [[0.0; QUERIES]; 3];
        for i in 0..QUERIES {
            // A packet that is not full is filled with its last point.
            let point = &points[i.min(last)];
            for k in 0..3 {
                q[k][i] = coarse(point[k]);
            }
        }
        // Rounding error of f32. An estimate is off by one slack at most, so that the nearest triangle's is at most two above
        // the smallest.
        let mut slack: Each = [0.0; QUERIES];
        for i in 0..QUERIES {
            let size = q[0][i].abs() + q[1][i].abs() + q[2][i].abs();
            slack[i] = 2.0 * ERROR_RATIO * (self.extent + size);
        }
        let (mut from, mut to) = ([0.0; 3], [0.0; 3]);
        for k in 0..3 {
            (from[k], to[k]) = (reduce(&q[k], smaller), reduce(&q[k], larger));
        }
        let (mut least, mut limit): (Each, Each) =
            ([f32::INFINITY; QUERIES], [f32::INFINITY; QUERIES]);
        // Kept in memory: split into registers one by one, they are put together again in odd shapes, not in whole vectors.
        let (q, slack, least, limit) = (
            black_box(&q),
            black_box(&slack),
            black_box(&mut least),
            black_box(&mut limit),
        );
        let PacketScratch {
            stack,
            candidates,
            leaf: hint,
        } = scratch;
        candidates.clear();
        let first = (*hint).min(self.leaves.len() as u32 - 1);
        let mut widest = self.try_leaf(first, q, slack, least, limit, candidates);
        stack.clear();
        stack.push((0.0, 0, 0));
        while let Some((nearest, child, count)) = stack.pop() {
            // The bounds may have shrunk since.
            if nearest > widest {
                continue;
            }
            if count > 0 {
                if child != first {
                    widest = self.try_leaf(child, q, slack, least, limit, candidates);
                }
                continue;
            }
            let node = &self.nodes[child as usize];
            let distances2 = node.distances2(&from, &to);
            let mut near = distances2.simd_le(f32x8::splat(widest)).to_bitmask();
            let distances2 = distances2.to_array();
            let begin = stack.len();
            while near != 0 {
                let slot = near.trailing_zeros() as usize % WIDTH;
                near &= near - 1;
                // Near the packet's box; near any of its points?
                let mut entered = false;
                for i in 0..QUERIES {
                    let mut distance2 = 0.0;
                    for k in 0..3 {
                        let (low, high) = (node.low[k][slot], node.high[k][slot]);
                        let outside = larger(larger(low - q[k][i], q[k][i] - high), 0.0);
                        distance2 += outside * outside;
                    }
                    entered |= distance2 <= limit[i];
                }
                if !entered {
                    continue;
                }
                // Insertion into the new part of the stack, nearest on top.
                stack.push((distances2[slot], node.child[slot], node.count[slot]));
                let mut at = stack.len() - 1;
                while at > begin && stack[at - 1].0 < stack[at].0 {
                    stack.swap(at - 1, at);
                    at -= 1;
                }
            }
        }
        let wanted = (1 << points.len().min(QUERIES)) - 1;
        let mut have = 0u32;
        for candidate in candidates.iter() {
            let mut promising = 0u32;
            for i in 0..QUERIES {
                promising |= u32::from(candidate.estimates[i] <= limit[i]) << i;
            }
            promising &= wanted;
            let triangle = &self.triangles[candidate.place as usize];
            while promising != 0 {
                let i = promising.trailing_zeros() as usize % QUERIES;
                promising &= promising - 1;
                let point = Vector3::from(points[i]);
                let nearest = if candidate.inside >> i & 1 == 1 {
                    triangle.foot(point)
                } else {
                    triangle.nearest(point)
                };
                if have >> i & 1 == 0 || nearest.distance2_mm2 < found[i].nearest.distance2_mm2 {
                    have |= 1 << i;
                    found[i] = Found {
                        place: candidate.place,
                        nearest,
                    };
                }
            }
        }
        // Estimates of finite points are finite, so every query has had a candidate; if not, any is better than none.
        let mut without = wanted & !have;
        while without != 0 {
            let i = without.trailing_zeros() as usize % QUERIES;
            without &= without - 1;
            found[i] = self.closest(points[i]);
        }
        *hint = found[last.min(QUERIES - 1)].place / LANES as u32;
    }

    /// Estimates the leaf's triangles, keeps those that may be nearest to some query, and tightens the bounds,
    /// of which the widest is returned.
    #[inline(always)]
    fn try_leaf(
        &self,
        leaf: u32,
        q: &[Each; 3],
        slack: &Each,
        least: &mut Each,
        limit: &mut Each,
        candidates: &mut Vec<Candidate>,
    ) -> f32 {
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
        reduce(limit, larger)
    }
}
