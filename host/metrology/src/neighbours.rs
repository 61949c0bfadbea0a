//! Mean distance of every point of a cloud to its k nearest others, exactly.
//!
//! Neighbouring points have nearly the same neighbours, so the cloud is cut into small boxes (a balanced k-d tree), the
//! candidates around a box are gathered once, and every point of the box is compared with all of them in one vectorised
//! sweep. A search tree asked point by point spends most of its time walking from the root.

use rayon::prelude::*;

use crate::bvh::Aabb;
use crate::simd;

/// A point and its number in the cloud.
#[derive(Clone, Copy)]
struct Entry {
    point: [f64; 3],
    index: u32,
}

/// The cloud, ordered so that every box's points lie together.
struct Boxes {
    entries: Vec<Entry>,
    /// Implicit binary tree: node i has the children 2 i + 1 and 2 i + 2, the last level is the boxes.
    nodes: Vec<Aabb>,
    /// Number of boxes, a power of two.
    leaves: usize,
}

impl Boxes {
    /// Boxes of at most `most` points.
    fn new(points: &[[f64; 3]], most: usize) -> Self {
        let leaves = points.len().div_ceil(most).next_power_of_two();
        let mut entries: Vec<Entry> = points
            .iter()
            .enumerate()
            .map(|(index, &point)| Entry {
                point,
                index: index as u32,
            })
            .collect();
        order(&mut entries, leaves);
        let mut nodes = vec![Aabb::EMPTY; 2 * leaves - 1];
        let n = entries.len();
        for leaf in 0..leaves {
            for entry in &entries[start(leaf, leaves, n)..start(leaf + 1, leaves, n)] {
                nodes[leaves - 1 + leaf].grow(&Aabb::at(entry.point));
            }
        }
        for node in (0..leaves - 1).rev() {
            let [left, right] = [nodes[2 * node + 1], nodes[2 * node + 2]];
            nodes[node].grow(&left);
            nodes[node].grow(&right);
        }
        Self {
            entries,
            nodes,
            leaves,
        }
    }

    fn of(&self, leaf: usize) -> &[Entry] {
        let n = self.entries.len();
        &self.entries[start(leaf, self.leaves, n)..start(leaf + 1, self.leaves, n)]
    }

    /// Gathers all points within `reach` of the box, and few others.
    fn gather(&self, around: &Aabb, reach: f64, into: &mut Candidates) {
        into.clear();
        let reach2 = reach * reach;
        let mut stack = [0u32; 64];
        let mut top = 1;
        while top > 0 {
            top -= 1;
            let node = stack[top] as usize;
            if self.nodes[node].distance2(around) > reach2 {
                continue;
            }
            if node >= self.leaves - 1 {
                for entry in self.of(node + 1 - self.leaves) {
                    if around.distance2(&Aabb::at(entry.point)) <= reach2 {
                        into.push(entry.point);
                    }
                }
            } else {
                stack[top] = 2 * node as u32 + 1;
                stack[top + 1] = 2 * node as u32 + 2;
                top += 2;
            }
        }
    }
}

/// First entry of box `leaf`: halving `n` again and again as [`order`] does.
fn start(leaf: usize, leaves: usize, n: usize) -> usize {
    let (mut low, mut count, mut width, mut at) = (0, n, leaves, leaf);
    if leaf == leaves {
        return n;
    }
    while width > 1 {
        let left = count / 2;
        width /= 2;
        if at >= width {
            at -= width;
            low += left;
            count -= left;
        } else {
            count = left;
        }
    }
    low
}

/// Orders the entries into `leaves` boxes by halving along the longest side.
fn order(entries: &mut [Entry], leaves: usize) {
    if leaves < 2 || entries.len() < 2 {
        return;
    }
    let mut all = Aabb::EMPTY;
    for entry in entries.iter() {
        all.grow(&Aabb::at(entry.point));
    }
    let side = |k: &usize| all.high[*k] - all.low[*k];
    let axis = (0..3).max_by(|a, b| side(a).total_cmp(&side(b)));
    let axis = axis.unwrap_or(0);
    let middle = entries.len() / 2;
    entries.select_nth_unstable_by(middle, |a, b| a.point[axis].total_cmp(&b.point[axis]));
    let (left, right) = entries.split_at_mut(middle);
    if left.len() > 1 << 11 {
        rayon::join(|| order(left, leaves / 2), || order(right, leaves / 2));
    } else {
        order(left, leaves / 2);
        order(right, leaves / 2);
    }
}

/// Points side by side.
#[derive(Default)]
struct Candidates {
    x: Vec<f64>,
    y: Vec<f64>,
    z: Vec<f64>,
}

impl Candidates {
    fn clear(&mut self) {
        self.x.clear();
        self.y.clear();
        self.z.clear();
    }

    fn push(&mut self, [x, y, z]: [f64; 3]) {
        self.x.push(x);
        self.y.push(y);
        self.z.push(z);
    }
}

/// Squared distances, as the bits of non-negative numbers: their order is that of the numbers.
#[derive(Default)]
struct Distances {
    all: Vec<u64>,
    near: Vec<u64>,
}

impl Distances {
    /// Squared distances from `p` to the candidates, then those up to `limit2` in `near`.
    #[inline(always)]
    fn measure(&mut self, from: &Candidates, [px, py, pz]: [f64; 3], limit2: f64) {
        let n = from.x.len();
        self.all.resize(n, 0);
        self.near.resize(n, 0);
        let (x, y, z) = (&from.x[..n], &from.y[..n], &from.z[..n]);
        let all = &mut self.all[..n];
        for i in 0..n {
            let (dx, dy, dz) = (x[i] - px, y[i] - py, z[i] - pz);
            all[i] = (dx * dx + dy * dy + dz * dz).to_bits();
        }
        let limit = limit2.to_bits();
        let mut kept = 0;
        for &bits in all.iter() {
            self.near[kept] = bits;
            kept += usize::from(bits <= limit);
        }
        self.near.truncate(kept);
    }

    /// The `count`-th smallest of `near` (from 0), which moves all smaller ones before it.
    fn select(&mut self, count: usize) -> f64 {
        f64::from_bits(*self.near.select_nth_unstable(count).1)
    }
}

/// Mean distance of every point to its `k` nearest others, mm, in order; none when there are not enough points. `points`
/// are finite. The same bytes on any number of threads.
pub(crate) fn mean_distances(points: &[[f64; 3]], k: usize) -> Option<Vec<f64>> {
    if k == 0 || points.len() <= k || u32::try_from(points.len()).is_err() {
        return None;
    }
    // A box holds enough points for its middle one to have most of its neighbours inside.
    let boxes = Boxes::new(points, (2 * k).max(24));
    let per_leaf: Vec<Vec<f64>> = (0..boxes.leaves)
        .into_par_iter()
        .with_min_len(16)
        .map_init(
            || (Candidates::default(), Distances::default()),
            |(candidates, distances), leaf| {
                simd::with_widest(
                    #[inline(always)]
                    || leaf_means(&boxes, leaf, k, candidates, distances),
                )
            },
        )
        .collect();
    let mut means = vec![0.0; points.len()];
    let in_order = per_leaf.iter().flatten();
    for (entry, mean) in boxes.entries.iter().zip(in_order) {
        means[entry.index as usize] = *mean;
    }
    Some(means)
}

/// Mean distances of one box's points, in its order.
#[inline(always)]
fn leaf_means(
    boxes: &Boxes,
    leaf: usize,
    k: usize,
    candidates: &mut Candidates,
    distances: &mut Distances,
) -> Vec<f64> {
    let own = boxes.of(leaf);
    let around = boxes.nodes[boxes.leaves - 1 + leaf];
    // How far the k-th neighbour is: about as far as that of the box's middle, and a little more for its other points.
    let middle = around.centre();
    candidates.clear();
    own.iter().for_each(|entry| candidates.push(entry.point));
    distances.measure(candidates, middle, f64::INFINITY);
    let reach2 = if own.len() > k {
        1.6 * distances.select(k)
    } else {
        around.diagonal2()
    };
    boxes.gather(&around, reach2.sqrt(), candidates);
    own.iter()
        .map(|entry| {
            distances.measure(candidates, entry.point, reach2);
            if distances.near.len() <= k {
                alone(boxes, entry.point, k, reach2)
            } else {
                mean_of_nearest(distances, k)
            }
        })
        .collect()
}

/// A point whose neighbours are farther than its box's: the reach doubles until they are inside.
#[cold]
fn alone(boxes: &Boxes, point: [f64; 3], k: usize, mut reach2: f64) -> f64 {
    let (mut candidates, mut distances) = (Candidates::default(), Distances::default());
    loop {
        // From zero (coinciding points) it grows to the smallest step that the coordinates resolve, then on.
        reach2 = (4.0 * reach2).max(1e-24 * boxes.nodes[0].diagonal2());
        boxes.gather(&Aabb::at(point), reach2.sqrt() * (1.0 + 1e-12), &mut candidates);
        distances.measure(&candidates, point, reach2);
        if distances.near.len() > k {
            return mean_of_nearest(&mut distances, k);
        }
        if candidates.x.len() == boxes.entries.len() {
            distances.measure(&candidates, point, f64::INFINITY);
            return mean_of_nearest(&mut distances, k);
        }
    }
}

/// Mean of the `k` distances after the smallest, which is the point's own.
#[inline(always)]
fn mean_of_nearest(distances: &mut Distances, k: usize) -> f64 {
    distances.select(k);
    let nearest = &distances.near[..=k];
    let sum: f64 = nearest.iter().map(|&bits| f64::from_bits(bits).sqrt()).sum();
    sum / k as f64
}
