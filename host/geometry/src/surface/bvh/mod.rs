//! Bounding volume hierarchy for closest-point queries on triangles.
//!
//! Built top-down by the surface area heuristic (binned), then collapsed to eight children per node whose boxes lie side
//! by side in f32, rounded outwards: one node test is a dozen vector operations. Boxes only decide what
//! is visited, so they may be coarse; triangles are f64 and decide the answer.

mod packet;

use nalgebra::Vector3;
use rayon::prelude::*;
use wide::{f32x4, f32x8};

use crate::space::Aabb;
use crate::surface::triangle::{Feature, NearestOnTriangle, Prepared};
use crate::surface::triangle_packet::{ERROR_RATIO, LANES, TrianglePacket};
pub(crate) use packet::{Each, PacketScratch, QUERIES, larger, smaller};

const WIDTH: usize = 8;
const LEAF_TRIANGLES: usize = LANES;
const BINS: usize = 16;
/// Below this many triangles a subtree is built on the current thread.
const PARALLEL_FROM: usize = 1 << 13;

/// Eight child boxes side by side, and what they hold.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
struct Node {
    low: [[f32; WIDTH]; 3],
    high: [[f32; WIDTH]; 3],
    child: [u32; WIDTH],
    /// Triangles in the child when it is a leaf, else 0.
    count: [u32; WIDTH],
}

impl Node {
    const EMPTY: Self = Self {
        low: [[f32::INFINITY; WIDTH]; 3],
        high: [[f32::NEG_INFINITY; WIDTH]; 3],
        child: [0; WIDTH],
        count: [0; WIDTH],
    };

    fn set(&mut self, slot: usize, aabb: &Aabb, child: u32, count: u32) {
        for k in 0..3 {
            self.low[k][slot] = (aabb.low[k] as f32).next_down();
            self.high[k][slot] = (aabb.high[k] as f32).next_up();
        }
        self.child[slot] = child;
        self.count[slot] = count;
    }

    /// Squared distances from the box between `from` and `to` to the eight boxes.
    #[inline(always)]
    fn distances2(&self, from: &[f32; 3], to: &[f32; 3]) -> f32x8 {
        let outside = |k: usize| {
            let (low, high) = (f32x8::from(self.low[k]), f32x8::from(self.high[k]));
            let (below, above) = (low - f32x8::splat(to[k]), f32x8::splat(from[k]) - high);
            below.fast_max(above).fast_max(f32x8::ZERO)
        };
        let [x, y, z] = [outside(0), outside(1), outside(2)];
        x * x + y * y + z * z
    }
}

/// The hierarchy over a set of triangles.
#[derive(Debug, Clone)]
pub(crate) struct Bvh {
    nodes: Vec<Node>,
    leaves: Vec<TrianglePacket>,
    /// [`LANES`] per leaf; unused ones repeat the leaf's first.
    triangles: Vec<Prepared>,
    ids: Vec<u32>,
    /// Sum of the sizes of a corner's coordinates, the largest: scales the slack for rounding.
    extent: f32,
}

/// A closest triangle: place in the hierarchy, and the closest point.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Found {
    pub place: u32,
    pub nearest: NearestOnTriangle,
}

impl Found {
    pub const NONE: Self = Self {
        place: 0,
        nearest: NearestOnTriangle {
            point: Vector3::new(0.0, 0.0, 0.0),
            distance2_mm2: f64::INFINITY,
            feature: Feature::Face,
        },
    };
}

enum Tree {
    TrianglePacket { start: u32, count: u32 },
    Fork { children: Box<[(Aabb, Tree); 2]> },
}

#[derive(Clone, Copy)]
struct TriangleReference {
    aabb: Aabb,
    centre: [f64; 3],
    id: u32,
}

impl Bvh {
    /// Builds the hierarchy over `items`: corner positions and the caller's number of each triangle. `items` is not empty.
    pub fn new(items: &[([[f64; 3]; 3], u32)]) -> Self {
        let mut references: Vec<TriangleReference> = items
            .par_iter()
            .with_min_len(1 << 12)
            .enumerate()
            .map(|(index, (corners, _))| {
                let aabb = Aabb::around(corners);
                TriangleReference {
                    aabb,
                    centre: aabb.centre(),
                    id: index as u32,
                }
            })
            .collect();
        let tree = split(&mut references, 0);
        let mut nodes = Vec::with_capacity(items.len() / 2);
        let mut ranges = Vec::with_capacity(items.len() / 2);
        flatten(&tree, &references, &mut nodes, &mut ranges);
        let leaves = ranges
            .par_iter()
            .with_min_len(1 << 10)
            .map(|&(start, count)| {
                let mut corners = [[[0.0; 3]; 3]; LANES];
                let own = &references[start as usize..(start + count) as usize];
                for (corners, reference) in corners.iter_mut().zip(own) {
                    *corners = items[reference.id as usize].0;
                }
                TrianglePacket::new(&corners[..own.len()])
            })
            .collect();
        let (triangles, ids) = ranges
            .par_iter()
            .with_min_len(1 << 10)
            .flat_map_iter(|&(start, count)| {
                (0..LANES as u32).map(move |lane| start + if lane < count { lane } else { 0 })
            })
            .map(|at| {
                let (corners, id) = items[references[at as usize].id as usize];
                (Prepared::new(corners), id)
            })
            .unzip();
        let size = |corner: &[f64; 3]| corner.iter().map(|c| c.abs()).sum::<f64>();
        let extent = items
            .iter()
            .flat_map(|(corners, _)| corners.iter().map(size));
        Self {
            nodes,
            leaves,
            triangles,
            ids,
            extent: extent.fold(0.0, f64::max) as f32,
        }
    }

    /// Unit normal of the triangle at `place`; zero when it has no area.
    #[inline(always)]
    pub fn normal(&self, place: u32) -> Vector3<f64> {
        self.triangles[place as usize].normal()
    }

    /// The caller's number of the triangle at `place`.
    pub fn id(&self, place: u32) -> u32 {
        self.ids[place as usize]
    }

    /// The closest triangle to `p`, which must be finite. The plain version of [`Bvh::closest_packet`].
    pub fn closest(&self, p: [f64; 3]) -> Found {
        let p64 = Vector3::from(p);
        let q = p.map(coarse);
        // Rounding error of f32 in the tests of boxes and leaves.
        let slack = ERROR_RATIO * (self.extent + q[0].abs() + q[1].abs() + q[2].abs());
        let limit_of = |distance2: f64| {
            let reach = distance2.sqrt() as f32 * (1.0 + 4e-7) + slack;
            // Finite, or the empty slots of a node, infinitely far away, would be entered.
            (reach * reach * (1.0 + 4e-7)).min(f32::MAX)
        };
        let wide = q.map(f32x4::splat);
        let mut best = Found {
            place: 0,
            nearest: self.triangles[0].nearest(p64),
        };
        let mut limit = limit_of(best.nearest.distance2_mm2);
        // (squared distance, child, count); depth is bounded by the build, with all siblings but one left behind per level.
        let mut stack = [(0.0, 0, 0); STACK];
        let mut top = 1;
        while top > 0 {
            top -= 1;
            let (distance2, child, count) = stack[top];
            if distance2 > limit {
                continue;
            }
            if count > 0 {
                let estimates = self.leaves[child as usize].distances2(&wide);
                let mut promising = estimates.simd_le(f32x4::splat(limit)).to_bitmask();
                promising &= (1 << count) - 1;
                while promising != 0 {
                    let place = child * LANES as u32 + promising.trailing_zeros();
                    promising &= promising - 1;
                    if place == best.place {
                        continue;
                    }
                    let nearest = self.triangles[place as usize].nearest(p64);
                    if nearest.distance2_mm2 < best.nearest.distance2_mm2 {
                        best = Found { place, nearest };
                        limit = limit_of(nearest.distance2_mm2);
                    }
                }
                continue;
            }
            let node = &self.nodes[child as usize];
            let distances2 = node.distances2(&q, &q);
            let mut near = distances2.simd_le(f32x8::splat(limit)).to_bitmask();
            let distances2 = distances2.to_array();
            let first = top;
            while near != 0 {
                let slot = near.trailing_zeros() as usize % WIDTH;
                near &= near - 1;
                let distance2 = distances2[slot];
                // Insertion into the new part of the stack, nearest on top.
                let mut at = top;
                while at > first && stack[at - 1].0 < distance2 {
                    stack[at] = stack[at - 1];
                    at -= 1;
                }
                stack[at] = (distance2, node.child[slot], node.count[slot]);
                top += 1;
            }
        }
        best
    }
}

/// Coordinates beyond this are taken for this in f32, in which the square of a larger one has no room, mm. That only decides
/// what is visited, and from so far away the slack for rounding has every triangle measured in f64.
const FARTHEST: f64 = 1e18;

#[inline(always)]
fn coarse(coordinate: f64) -> f32 {
    coordinate.clamp(-FARTHEST, FARTHEST) as f32
}

const MAX_DEPTH: usize = 64;
/// Room for a way down, on which every level leaves all children but one for later.
const STACK: usize = (WIDTH - 1) * MAX_DEPTH + WIDTH;

fn split(references: &mut [TriangleReference], offset: u32) -> Tree {
    split_at_depth(references, offset, 0)
}

fn split_at_depth(references: &mut [TriangleReference], offset: u32, depth: usize) -> Tree {
    if references.len() <= LEAF_TRIANGLES {
        return Tree::TrianglePacket {
            start: offset,
            count: references.len() as u32,
        };
    }
    let middle = partition(references, depth);
    let (left, right) = references.split_at_mut(middle);
    let (left_box, right_box) = (bounds(left), bounds(right));
    let right_offset = offset + middle as u32;
    let (a, b) = if left.len() + right.len() >= PARALLEL_FROM {
        rayon::join(
            || split_at_depth(left, offset, depth + 1),
            || split_at_depth(right, right_offset, depth + 1),
        )
    } else {
        (
            split_at_depth(left, offset, depth + 1),
            split_at_depth(right, right_offset, depth + 1),
        )
    };
    Tree::Fork {
        children: Box::new([(left_box, a), (right_box, b)]),
    }
}

fn bounds(references: &[TriangleReference]) -> Aabb {
    let mut all = Aabb::EMPTY;
    for reference in references {
        all.grow(&reference.aabb);
    }
    all
}

/// Orders the references into two non-empty parts and returns where the second starts.
fn partition(references: &mut [TriangleReference], depth: usize) -> usize {
    let mut centres = Aabb::EMPTY;
    for reference in references.iter() {
        centres.grow(&Aabb {
            low: reference.centre,
            high: reference.centre,
        });
    }
    let mut best: Option<(f64, usize, usize)> = None;
    for axis in 0..3 {
        let (low, extent) = (centres.low[axis], centres.high[axis] - centres.low[axis]);
        if extent <= 0.0 {
            continue;
        }
        let mut bins = [(Aabb::EMPTY, 0usize); BINS];
        for reference in references.iter() {
            let bin = bin_of(reference.centre[axis], low, extent);
            bins[bin].0.grow(&reference.aabb);
            bins[bin].1 += 1;
        }
        let mut right_cost = [0.0; BINS];
        let (mut aabb, mut count) = (Aabb::EMPTY, 0);
        for bin in (1..BINS).rev() {
            aabb.grow(&bins[bin].0);
            count += bins[bin].1;
            right_cost[bin] = if count > 0 {
                aabb.half_area() * count as f64
            } else {
                0.0
            };
        }
        let (mut aabb, mut count) = (Aabb::EMPTY, 0);
        for bin in 1..BINS {
            aabb.grow(&bins[bin - 1].0);
            count += bins[bin - 1].1;
            if count == 0 || count == references.len() {
                continue;
            }
            let cost = aabb.half_area() * count as f64 + right_cost[bin];
            if best.is_none_or(|(least, ..)| cost < least) {
                best = Some((cost, axis, bin));
            }
        }
    }
    // Late in a lopsided tree, and for coinciding centres, halving by count bounds the depth.
    if let Some((_, axis, bin)) = best.filter(|_| depth < MAX_DEPTH / 2) {
        let (low, extent) = (centres.low[axis], centres.high[axis] - centres.low[axis]);
        let mut middle = 0;
        for index in 0..references.len() {
            if bin_of(references[index].centre[axis], low, extent) < bin {
                references.swap(index, middle);
                middle += 1;
            }
        }
        return middle;
    }
    let extent = |k: usize| centres.high[k] - centres.low[k];
    let axis = (0..3).max_by(|&i, &j| extent(i).total_cmp(&extent(j)));
    let axis = axis.unwrap_or(0);
    let middle = references.len() / 2;
    references.select_nth_unstable_by(middle, |a, b| {
        a.centre[axis]
            .total_cmp(&b.centre[axis])
            .then(a.id.cmp(&b.id))
    });
    middle
}

fn bin_of(centre: f64, low: f64, extent: f64) -> usize {
    (((centre - low) / extent * BINS as f64) as usize).min(BINS - 1)
}

/// Collapses the binary tree to eight children per node; the root is node 0.
fn flatten(
    tree: &Tree,
    references: &[TriangleReference],
    nodes: &mut Vec<Node>,
    leaves: &mut Vec<(u32, u32)>,
) -> u32 {
    let index = nodes.len();
    nodes.push(Node::EMPTY);
    let mut slots: Vec<(Aabb, &Tree)> = vec![(bounds(references), tree)];
    // Open the widest fork until the node is full.
    while slots.len() < WIDTH {
        let widest = slots
            .iter()
            .enumerate()
            .filter(|(_, (_, tree))| matches!(tree, Tree::Fork { .. }))
            .max_by(|(_, a), (_, b)| a.0.half_area().total_cmp(&b.0.half_area()))
            .map(|(at, _)| at);
        let Some(at) = widest else { break };
        let (_, Tree::Fork { children }) = slots.swap_remove(at) else {
            break;
        };
        let [a, b] = children.as_ref();
        slots.push((a.0, &a.1));
        slots.push((b.0, &b.1));
    }
    for (slot, (aabb, tree)) in slots.into_iter().enumerate() {
        let (child, count) = match tree {
            Tree::TrianglePacket { start, count } => {
                leaves.push((*start, *count));
                (leaves.len() as u32 - 1, *count)
            }
            Tree::Fork { .. } => (flatten(tree, &[], nodes, leaves), 0),
        };
        nodes[index].set(slot, &aabb, child, count);
    }
    index as u32
}
