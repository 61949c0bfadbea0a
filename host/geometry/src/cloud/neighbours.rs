//! Mean distance of every point of a cloud to its k nearest others, exactly.
//!
//! Neighbouring points have nearly the same neighbours, so the cloud is cut into small boxes (a balanced k-d tree), the
//! candidates around a box are gathered once, and every point of the box is compared with all of them in one vectorised
//! sweep. A search tree asked point by point spends most of its time walking from the root.

use std::ops::Range;

use rayon::prelude::*;
use wide::f32x8;

use crate::space::Aabb;
use flankscope_foundation::simd;

/// A point and its number in the cloud.
#[derive(Clone, Copy)]
struct TreeEntry {
    point: [f64; 3],
    index: u32,
}

/// The cloud, ordered so that every box's points lie together.
struct Boxes {
    points: Vec<[f64; 3]>,
    /// Number in the cloud of every point.
    index: Vec<u32>,
    /// First point of every box, and the end.
    starts: Vec<u32>,
    /// Implicit binary tree: node i has the children 2 i + 1 and 2 i + 2, the last level is the boxes.
    nodes: Vec<Aabb>,
    /// Number of boxes, a power of two.
    leaves: usize,
}

impl Boxes {
    /// Boxes of `most` to twice as many points.
    fn new(points: &[[f64; 3]], most: usize) -> Self {
        let leaves = 1 << points.len().div_ceil(most).ilog2();
        let entry = |(index, &point): (usize, &[f64; 3])| TreeEntry {
            point,
            index: index as u32,
        };
        let mut entries: Vec<TreeEntry> = points.iter().enumerate().map(entry).collect();
        order(&mut entries, leaves);
        let mut nodes = vec![Aabb::EMPTY; 2 * leaves - 1];
        let n = entries.len();
        let starts: Vec<u32> = (0..=leaves)
            .map(|leaf| start(leaf, leaves, n) as u32)
            .collect();
        for leaf in 0..leaves {
            for entry in &entries[starts[leaf] as usize..starts[leaf + 1] as usize] {
                nodes[leaves - 1 + leaf].grow(&Aabb::at(entry.point));
            }
        }
        for node in (0..leaves - 1).rev() {
            let [left, right] = [nodes[2 * node + 1], nodes[2 * node + 2]];
            nodes[node].grow(&left);
            nodes[node].grow(&right);
        }
        Self {
            points: entries.iter().map(|e| e.point).collect(),
            index: entries.iter().map(|e| e.index).collect(),
            starts,
            nodes,
            leaves,
        }
    }

    #[inline(always)]
    fn points_of_leaf(&self, leaf: usize) -> Range<usize> {
        self.starts[leaf] as usize..self.starts[leaf + 1] as usize
    }

    /// Gathers the points within `reach2` (squared) of the box.
    #[inline(always)]
    fn gather(&self, around: &Aabb, reach2: f64, into: &mut Vec<[f64; 3]>) {
        let mut stack = [0u32; 64];
        let mut top = 1;
        while top > 0 {
            top -= 1;
            let node = stack[top] as usize;
            if node >= self.leaves - 1 {
                let points = &self.points[self.points_of_leaf(node + 1 - self.leaves)];
                extend_near(into, points, around, reach2);
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
fn order(entries: &mut [TreeEntry], leaves: usize) {
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

/// Adds those points that lie within `reach2` (squared) of a box. All are written and the end moves only past those that
/// stay, because a branch per point would be guessed wrongly half the time.
#[inline(always)]
fn extend_near(into: &mut Vec<[f64; 3]>, points: &[[f64; 3]], around: &Aabb, reach2: f64) {
    let mut kept = into.len();
    into.resize(kept + points.len(), [0.0; 3]);
    for point in points {
        into[kept] = *point;
        kept += usize::from(around.distance2_to(point) <= reach2);
    }
    into.truncate(kept);
}

/// The candidates in f32, relative to a place among them, to tell cheaply which are near. Only those are measured in f64:
/// an error of rounding costs a needless measurement, never an answer.
#[derive(Default)]
struct Coarse {
    origin: [f64; 3],
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
    /// Distances are off by less than this, mm, plus [`ROUNDING`] of themselves.
    slack: f32,
    /// Squared distances from the last point measured.
    distances2: Vec<f32>,
}

/// A dozen roundings in f32.
const ROUNDING: f32 = 1e-6;
/// No search when the first guess leaves at most so many more than wanted.
const SPARE: usize = 6;

impl Coarse {
    /// `around` is the candidates' box.
    #[inline(always)]
    fn set(&mut self, candidates: &[[f64; 3]], around: &Aabb) {
        self.origin = around.centre();
        for (axis, column) in [&mut self.x, &mut self.y, &mut self.z]
            .into_iter()
            .enumerate()
        {
            let origin = self.origin[axis];
            column.clear();
            column.extend(candidates.iter().map(|c| (c[axis] - origin) as f32));
        }
        // Two coordinates, each at most half a diagonal and rounded once, along three axes.
        self.slack = ROUNDING * around.diagonal2().sqrt() as f32;
    }

    /// Measures all candidates from `point` and counts those within `limit2` (squared).
    #[inline(always)]
    fn measure(&mut self, point: [f64; 3], limit2: f32) -> usize {
        let n = self.x.len();
        self.distances2.resize(n, 0.0);
        let (x, y, z) = (&self.x[..n], &self.y[..n], &self.z[..n]);
        let distances2 = &mut self.distances2[..n];
        let [px, py, pz] = [0, 1, 2].map(|k: usize| (point[k] - self.origin[k]) as f32);
        let mut count = 0u32;
        for i in 0..n {
            let (dx, dy, dz) = (x[i] - px, y[i] - py, z[i] - pz);
            distances2[i] = dx * dx + dy * dy + dz * dz;
            count += u32::from(distances2[i] <= limit2);
        }
        count as usize
    }

    #[inline(always)]
    fn count_to(&self, limit2: f32) -> usize {
        let mut count = 0u32;
        for &distance2 in &self.distances2 {
            count += u32::from(distance2 <= limit2);
        }
        count as usize
    }

    /// A squared distance within which there are `wanted` candidates or a few more of those measured last; none when
    /// there are not so many within `reach2`. `limit2` holds `count` of them: the first guess.
    ///
    /// On a surface the number of neighbours grows with the squared distance, so that interpolation finds it in a few
    /// sweeps, each a handful of vector comparisons.
    #[inline(always)]
    fn limit_for(&self, wanted: usize, limit2: f32, count: usize, reach2: f32) -> Option<f32> {
        const MOST_SWEEPS: usize = 12;
        let (mut low, mut low_count) = (0.0, 0);
        let (mut high, mut high_count) = (limit2, count);
        if count < wanted {
            (low, low_count) = (limit2, count);
            (high, high_count) = (reach2, self.count_to(reach2));
            if high_count < wanted {
                return None;
            }
        }
        let mut sweeps = 0;
        while high_count > wanted + SPARE && sweeps < MOST_SWEEPS {
            let share = (wanted + SPARE / 2 - low_count) as f32 / (high_count - low_count) as f32;
            let middle = low + share.clamp(0.02, 0.98) * (high - low);
            let count = self.count_to(middle);
            if count < wanted {
                (low, low_count) = (middle, count);
            } else {
                (high, high_count) = (middle, count);
            }
            sweeps += 1;
        }
        Some(high)
    }
}

/// Measures the mean distance from points among candidates to the nearest of them.
#[derive(Default)]
struct NeighbourDistances {
    coarse: Coarse,
    near: Vec<f64>,
}

impl NeighbourDistances {
    /// Mean of the `k` distances after the smallest, which is the point's own; none when fewer than `k + 1` lie within
    /// `reach2` (squared). `guess2` is where the search begins, and where it ended.
    #[inline(always)]
    fn mean(
        &mut self,
        candidates: &[[f64; 3]],
        point: [f64; 3],
        k: usize,
        reach2: f64,
        guess2: &mut f32,
    ) -> Option<f64> {
        let wanted = k + 1;
        let count = self.coarse.measure(point, *guess2);
        *guess2 = self
            .coarse
            .limit_for(wanted, *guess2, count, reach2 as f32)?;
        // A point that is truly as near as the farthest of these appears within twice the slack.
        let radius = guess2.sqrt() * (1.0 + 2.0 * ROUNDING) + 2.0 * self.coarse.slack;
        let limit2 = radius * radius * (1.0 + ROUNDING);
        self.near.resize(candidates.len(), 0.0);
        let (mut place, mut kept) = (0, 0);
        for all in self.coarse.distances2.chunks(64) {
            // One in ten or fewer stays: they are marked many at once, then only they are visited.
            let mut staying = within(all, limit2);
            while staying != 0 {
                self.near[kept] = distance2(
                    &candidates[place + staying.trailing_zeros() as usize],
                    &point,
                );
                kept += 1;
                staying &= staying - 1;
            }
            place += 64;
        }
        if kept < wanted {
            // Coordinates that f32 has no room for.
            return None;
        }
        let near = &mut self.near[..kept];
        if near.len() > wanted + 2 * SPARE {
            // Equal distances, or an uneven crowd.
            near.select_nth_unstable_by(k, f64::total_cmp);
        } else {
            drop_largest(near, wanted);
        }
        let near = &mut near[..wanted];
        let mut farthest2 = 0.0_f64;
        for distance2 in near.iter_mut() {
            farthest2 = farthest2.max(*distance2);
            *distance2 = distance2.sqrt();
        }
        (farthest2 <= reach2).then(|| near.iter().sum::<f64>() / k as f64)
    }
}

#[inline(always)]
fn distance2(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    let (x, y, z) = (a[0] - b[0], a[1] - b[1], a[2] - b[2]);
    x * x + y * y + z * z
}

/// Moves the largest values behind the first `wanted`.
#[inline(always)]
fn drop_largest(values: &mut [f64], wanted: usize) {
    for last in (wanted..values.len()).rev() {
        let (mut at, mut largest) = (last, values[last]);
        for (i, &value) in values[..last].iter().enumerate() {
            if value > largest {
                (at, largest) = (i, value);
            }
        }
        values.swap(at, last);
    }
}

/// Bit i is set when the i-th of up to 64 values does not exceed `limit`.
#[inline(always)]
fn within(values: &[f32], limit: f32) -> u64 {
    let (eights, rest) = values.as_chunks::<8>();
    let mut bits = 0;
    for (i, eight) in eights.iter().enumerate() {
        let low = f32x8::from(*eight).simd_le(f32x8::splat(limit));
        bits |= u64::from(low.to_bitmask()) << (8 * i);
    }
    for (i, value) in rest.iter().enumerate() {
        bits |= u64::from(*value <= limit) << (8 * eights.len() + i);
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
const LEAST_BOX: usize = 16;
const LEAVES_PER_TASK: usize = 64;
/// Squared reach around a box over the squared distance from its middle to the k-th neighbour. Larger:
/// fewer points asked again alone (random clouds); smaller: fewer candidates (rasters).
const REACH_RATIO: f64 = 1.4;

/// Mean distances of the points of some boxes, in their order.
#[inline(always)]
fn means_of_leaves(boxes: &Boxes, leaves: Range<usize>, k: usize) -> Vec<f64> {
    let (mut candidates, mut nearest) = (Vec::new(), NeighbourDistances::default());
    let mut means = Vec::new();
    for leaf in leaves {
        let own = boxes.points_of_leaf(leaf);
        let around = boxes.nodes[boxes.leaves - 1 + leaf];
        // Distance of the k-th neighbour: about that from the box's middle, and a little more for its other points.
        let middle = around.centre();
        nearest.near.clear();
        let from_middle = |point| distance2(point, &middle);
        nearest
            .near
            .extend(boxes.points[own.clone()].iter().map(from_middle));
        let (guess2, ratio) = if own.len() > k {
            let middle = nearest.near.select_nth_unstable_by(k, f64::total_cmp);
            (*middle.1, REACH_RATIO)
        } else {
            (around.diagonal2(), 1.0)
        };
        let reach2 = ratio * guess2;
        candidates.clear();
        boxes.gather(&around, reach2, &mut candidates);
        nearest
            .coarse
            .set(&candidates, &around.widened(reach2.sqrt()));
        let mut guess2 = guess2 as f32;
        for index in own {
            let point = boxes.points[index];
            let mean = nearest.mean(&candidates, point, k, reach2, &mut guess2);
            means.push(match mean {
                Some(mean) => mean,
                None => alone(boxes, point, k, reach2),
            });
        }
    }
    means
}

/// A point whose neighbours are farther than its box's: the reach grows until they are inside.
#[cold]
#[inline(never)]
fn alone(boxes: &Boxes, point: [f64; 3], k: usize, mut reach2: f64) -> f64 {
    let (mut candidates, mut distances2) = (Vec::new(), Vec::new());
    // From zero (coinciding points) it grows to the smallest step that the coordinates resolve, then on.
    let least2 = 1e-24 * boxes.nodes[0].diagonal2();
    loop {
        reach2 = if reach2 > 0.0 { 2.0 * reach2 } else { least2 };
        candidates.clear();
        boxes.gather(&Aabb::at(point), reach2, &mut candidates);
        if candidates.len() <= k {
            continue;
        }
        distances2.clear();
        distances2.extend(candidates.iter().map(|at| distance2(at, &point)));
        let (nearer, farthest, _) = distances2.select_nth_unstable_by(k, f64::total_cmp);
        // `gather` takes what is as near as that, so that nothing nearer was left out.
        let sum = nearer.iter().map(|d| d.sqrt()).sum::<f64>() + farthest.sqrt();
        return sum / k as f64;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flankscope_foundation::random::uniform;

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
