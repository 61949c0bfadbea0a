//! Mean distance of every point of a cloud to its k nearest others, exactly.
//!
//! Neighbouring points have nearly the same neighbours, so the cloud is cut into small boxes (a balanced k-d tree), the
//! candidates around a box are gathered once, and every point of the box is compared with all of them in one vectorised
//! sweep. A search tree asked point by point spends most of its time walking from the root.

use std::ops::Range;

use rayon::prelude::*;
use wide::f64x4;

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
    points: Columns,
    /// Number in the cloud of every point.
    index: Vec<u32>,
    /// Implicit binary tree: node i has the children 2 i + 1 and 2 i + 2, the last level is the boxes.
    nodes: Vec<Aabb>,
    /// Number of boxes, a power of two.
    leaves: usize,
}

impl Boxes {
    /// Boxes of at most `most` points.
    fn new(points: &[[f64; 3]], most: usize) -> Self {
        let leaves = points.len().div_ceil(most).next_power_of_two();
        let entry = |(index, &point): (usize, &[f64; 3])| Entry {
            point,
            index: index as u32,
        };
        let mut entries: Vec<Entry> = points.iter().enumerate().map(entry).collect();
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
        let column = |k: usize| entries.iter().map(|e| e.point[k]).collect();
        Self {
            points: Columns {
                x: column(0),
                y: column(1),
                z: column(2),
            },
            index: entries.iter().map(|e| e.index).collect(),
            nodes,
            leaves,
        }
    }

    #[inline(always)]
    fn of(&self, leaf: usize) -> Range<usize> {
        let n = self.index.len();
        start(leaf, self.leaves, n)..start(leaf + 1, self.leaves, n)
    }

    /// Gathers the points within `reach2` (squared) of the box.
    #[inline(always)]
    fn gather(&self, around: &Aabb, reach2: f64, into: &mut Columns) {
        into.clear();
        let mut stack = [0u32; 64];
        let mut top = 1;
        while top > 0 {
            top -= 1;
            let node = stack[top] as usize;
            if node >= self.leaves - 1 {
                let range = self.of(node + 1 - self.leaves);
                into.extend_near(&self.points, range, around, reach2);
                continue;
            }
            for child in [2 * node + 1, 2 * node + 2] {
                stack[top] = child as u32;
                top += usize::from(self.nodes[child].distance2(around) <= reach2);
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
struct Columns {
    x: Vec<f64>,
    y: Vec<f64>,
    z: Vec<f64>,
}

impl Columns {
    fn clear(&mut self) {
        self.x.clear();
        self.y.clear();
        self.z.clear();
    }

    fn at(&self, index: usize) -> [f64; 3] {
        [self.x[index], self.y[index], self.z[index]]
    }

    /// Adds those points of a range that lie within `reach2` (squared) of a box. All are written and the end moves only
    /// past those that stay, because a branch per point would be guessed wrongly half the time.
    #[inline(always)]
    fn extend_near(&mut self, from: &Self, range: Range<usize>, around: &Aabb, reach2: f64) {
        let (x, y, z) = (
            &from.x[range.clone()],
            &from.y[range.clone()],
            &from.z[range],
        );
        let (n, old) = (x.len(), self.x.len());
        self.x.resize(old + n, 0.0);
        self.y.resize(old + n, 0.0);
        self.z.resize(old + n, 0.0);
        let mut kept = old;
        for i in 0..n {
            let point = [x[i], y[i], z[i]];
            [self.x[kept], self.y[kept], self.z[kept]] = point;
            kept += usize::from(around.distance2(&Aabb::at(point)) <= reach2);
        }
        self.x.truncate(kept);
        self.y.truncate(kept);
        self.z.truncate(kept);
    }
}

/// Squared distances from one point to all candidates.
#[derive(Default)]
struct Distances {
    all: Vec<f64>,
    near: Vec<f64>,
}

impl Distances {
    #[inline(always)]
    fn measure(&mut self, from: &Columns, [px, py, pz]: [f64; 3]) {
        let n = from.x.len();
        self.all.resize(n, 0.0);
        let (x, y, z) = (&from.x[..n], &from.y[..n], &from.z[..n]);
        let all = &mut self.all[..n];
        for i in 0..n {
            let (dx, dy, dz) = (x[i] - px, y[i] - py, z[i] - pz);
            all[i] = dx * dx + dy * dy + dz * dz;
        }
    }

    #[inline(always)]
    fn count_to(&self, limit2: f64) -> usize {
        let mut count = 0u64;
        for &distance2 in &self.all {
            count += u64::from(distance2 <= limit2);
        }
        count as usize
    }

    /// Mean of the `k` distances after the smallest, which is the point's own; none when fewer than `k + 1` lie within
    /// `limit2` (squared).
    ///
    /// On a surface the number of neighbours grows with the squared distance, so the limit that leaves exactly `k + 1` is
    /// found by interpolation in a few sweeps, each a handful of vector comparisons.
    #[inline(always)]
    fn mean_of_nearest(&mut self, k: usize, limit2: f64) -> Option<f64> {
        const MOST_SWEEPS: usize = 12;
        let wanted = k + 1;
        let (mut low, mut low_count) = (0.0, 0usize);
        let (mut high, mut high_count) = (limit2, self.count_to(limit2));
        if high_count < wanted {
            return None;
        }
        let mut sweeps = 0;
        while high_count > wanted && sweeps < MOST_SWEEPS {
            let share = (wanted as f64 + 0.5 - low_count as f64) / (high_count - low_count) as f64;
            let middle = low + share.clamp(0.02, 0.98) * (high - low);
            let count = self.count_to(middle);
            if count < wanted {
                (low, low_count) = (middle, count);
            } else {
                (high, high_count) = (middle, count);
            }
            sweeps += 1;
        }
        let n = self.all.len();
        self.near.resize(n, 0.0);
        let near = &mut self.near[..n];
        let mut kept = 0;
        for all in self.all.chunks(64) {
            // One in ten or fewer stays: they are marked many at once, then only they are visited.
            let mut staying = within(all, high);
            while staying != 0 {
                // There is room: `kept` counts some of the distances before this one.
                near[kept] = all[staying.trailing_zeros() as usize];
                kept += 1;
                staying &= staying - 1;
            }
        }
        if kept > wanted {
            // Equal distances, or an uneven crowd.
            near[..kept].select_nth_unstable_by(k, f64::total_cmp);
        }
        let near = &mut near[..wanted];
        for distance2 in near.iter_mut() {
            *distance2 = distance2.sqrt();
        }
        Some(near.iter().sum::<f64>() / k as f64)
    }
}

/// Bit i is set when the i-th of up to 64 values does not exceed `limit`.
#[inline(always)]
fn within(values: &[f64], limit: f64) -> u64 {
    let (fours, rest) = values.as_chunks::<4>();
    let mut bits = 0;
    for (i, four) in fours.iter().enumerate() {
        let low = f64x4::from(*four).simd_le(f64x4::splat(limit));
        bits |= u64::from(low.to_bitmask()) << (4 * i);
    }
    for (i, value) in rest.iter().enumerate() {
        bits |= u64::from(*value <= limit) << (4 * fours.len() + i);
    }
    bits
}

/// Mean distance of every point to its `k` nearest others, mm, in order; none when there are not enough points. `points`
/// are finite. The same bytes on any number of threads.
pub(crate) fn mean_distances(points: &[[f64; 3]], k: usize) -> Option<Vec<f64>> {
    if k == 0 || points.len() <= k || u32::try_from(points.len()).is_err() {
        return None;
    }
    // A box holds enough points for its middle one to have most of its neighbours inside.
    let boxes = Boxes::new(points, (2 * k).max(LEAST_BOX));
    let per_task: Vec<Vec<f64>> = (0..boxes.leaves.div_ceil(LEAVES_PER_TASK))
        .into_par_iter()
        .map(|task| {
            let leaves = task * LEAVES_PER_TASK..((task + 1) * LEAVES_PER_TASK).min(boxes.leaves);
            simd::with_widest(
                #[inline(always)]
                || means_of_leaves(&boxes, leaves, k),
            )
        })
        .collect();
    let mut means = vec![0.0; points.len()];
    for (&index, mean) in boxes.index.iter().zip(per_task.iter().flatten()) {
        means[index as usize] = *mean;
    }
    Some(means)
}

/// Points per box, at least, and boxes per parallel task.
const LEAST_BOX: usize = 32;
const LEAVES_PER_TASK: usize = 64;
/// Squared reach around a box over the squared distance from its middle to the k-th neighbour. Of 1.2, 1.35, 1.6 and 2.0 the
/// best compromise between random clouds (larger: fewer points asked again alone) and rasters (smaller: fewer candidates).
const REACH_RATIO: f64 = 1.6;

/// Mean distances of the points of some boxes, in their order.
#[inline(always)]
fn means_of_leaves(boxes: &Boxes, leaves: Range<usize>, k: usize) -> Vec<f64> {
    let (mut candidates, mut distances) = (Columns::default(), Distances::default());
    let mut means = Vec::new();
    for leaf in leaves {
        let own = boxes.of(leaf);
        let around = boxes.nodes[boxes.leaves - 1 + leaf];
        // How far the k-th neighbour is: about as far as from the box's middle, and a little more for its other points.
        candidates.clear();
        candidates.extend_near(&boxes.points, own.clone(), &around, f64::INFINITY);
        distances.measure(&candidates, around.centre());
        let reach2 = if own.len() > k {
            REACH_RATIO * *distances.all.select_nth_unstable_by(k, f64::total_cmp).1
        } else {
            around.diagonal2()
        };
        boxes.gather(&around, reach2, &mut candidates);
        for index in own {
            let point = boxes.points.at(index);
            distances.measure(&candidates, point);
            let mean = distances.mean_of_nearest(k, reach2);
            means.push(match mean {
                Some(mean) => mean,
                None => alone(boxes, point, k, reach2),
            });
        }
    }
    means
}

/// A point whose neighbours are farther than its box's: the reach doubles until they are inside.
#[cold]
#[inline(never)]
fn alone(boxes: &Boxes, point: [f64; 3], k: usize, mut reach2: f64) -> f64 {
    let (mut candidates, mut distances) = (Columns::default(), Distances::default());
    // From zero (coinciding points) it grows to the smallest step that the coordinates resolve, then on.
    let least2 = 1e-24 * boxes.nodes[0].diagonal2();
    loop {
        reach2 = if reach2 > 0.0 { 4.0 * reach2 } else { least2 };
        boxes.gather(&Aabb::at(point), reach2, &mut candidates);
        distances.measure(&candidates, point);
        if let Some(mean) = distances.mean_of_nearest(k, reach2) {
            return mean;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::uniform;

    fn brute_force(points: &[[f64; 3]], k: usize) -> Vec<f64> {
        let mean = |p: &[f64; 3]| {
            let away = |q: &[f64; 3]| (0..3).map(|c| (p[c] - q[c]).powi(2)).sum::<f64>();
            let mut all: Vec<f64> = points.iter().map(away).collect();
            all.sort_by(f64::total_cmp);
            all[1..=k].iter().map(|d| d.sqrt()).sum::<f64>() / k as f64
        };
        points.iter().map(mean).collect()
    }

    /// A wavy raster with jitter, some points far off it, a clump of equal ones and a second clump far away.
    fn cloud() -> Vec<[f64; 3]> {
        let mut points: Vec<[f64; 3]> = (0..4_000u64)
            .map(|i| {
                let (x, y) = ((i % 80) as f64 * 0.025, (i / 80) as f64 * 0.025);
                let off = if i % 97 == 0 { 1.0 } else { 0.005 };
                [40.0 + x, y, (6.0 * y).sin() + off * uniform(1, i)]
            })
            .collect();
        points.extend([[40.5, 0.5, 0.2]; 70]);
        points.extend((0..40).map(|i| [-900.0, 1e-3 * f64::from(i % 7), 0.0]));
        points
    }

    #[test]
    fn means_are_those_of_brute_force() {
        let points = cloud();
        for k in [1, 8, 20, 75, 4_000] {
            let found = mean_distances(&points, k).unwrap();
            for (i, (found, expected)) in found.iter().zip(brute_force(&points, k)).enumerate() {
                // The same numbers in another order of summation.
                let off = (found - expected).abs();
                assert!(off <= 1e-12 * (1.0 + expected), "point {i}, k = {k}: {off}");
            }
        }
        let apart = [[-1e300, 0.0, 0.0], [1e300, 0.0, 0.0], [0.0, 1.0, 0.0]];
        assert_eq!(mean_distances(&apart, 2).unwrap().len(), 3);
        assert_eq!(mean_distances(&[[1.0; 3]; 50], 9).unwrap(), [0.0; 50]);
    }

    #[test]
    fn any_processor_and_any_number_of_threads_give_the_same_bytes() {
        let points = cloud();
        let bits = |means: Vec<f64>| means.into_iter().map(f64::to_bits).collect::<Vec<_>>();
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            bits(pool.install(|| mean_distances(&points, 8)).unwrap())
        };
        assert_eq!(run(1), run(5));
        let boxes = Boxes::new(&points, 32);
        let plain = means_of_leaves(&boxes, 0..boxes.leaves, 8);
        let widest = simd::with_widest(
            #[inline(always)]
            || means_of_leaves(&boxes, 0..boxes.leaves, 8),
        );
        assert_eq!(bits(plain), bits(widest));
    }
}
