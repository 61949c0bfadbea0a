//! An order in which neighbours in space follow each other, for queries that arrive in any order.

use rayon::prelude::*;

use crate::bvh::Aabb;

/// Bits per axis of a place on the Z curve.
const AXIS_BITS: u32 = 10;
/// The curve's upper bits number the cells that are worked on one by one.
const CELL_BITS: u32 = 12;
const CELLS: usize = 1 << CELL_BITS;
/// Points per parallel task.
const CHUNK: usize = 1 << 16;
/// Mean step over the box's diagonal below which an order is as good as it needs to be.
const SHORT_STEP: f64 = 0.02;

/// Applies `map` to the points in the order of a Z curve, piece by piece, and returns its results in the points' own order;
/// none when the points already follow each other closely (sorted, or as scanned), so that there is nothing to win.
/// `points` are finite. The pieces do not depend on the number of threads.
pub(crate) fn map_along_curve<T: Copy + Send + Sync>(
    points: &[[f64; 3]],
    map: impl Fn(&[[f64; 3]]) -> Vec<T> + Sync,
) -> Option<Vec<T>> {
    let bounds = scattered(points)?;
    let extent = (0..3)
        .map(|k| bounds.high[k] - bounds.low[k])
        .fold(0.0, f64::max);
    let scale = f64::from((1u32 << AXIS_BITS) - 1) / extent;
    let key = |point: &[f64; 3]| {
        let cell = |k: usize| spread(((point[k] - bounds.low[k]) * scale) as u32);
        cell(0) | cell(1) << 1 | cell(2) << 2
    };
    // Each chunk of points by cell; then each cell's points, collected from all chunks, along the curve inside it. The
    // results go back the same way, so that memory is only ever read and written in runs.
    let chunks: Vec<Chunk> = points
        .par_chunks(CHUNK)
        .map(|points| Chunk::new(points, key))
        .collect();
    let cells: Vec<Vec<T>> = (0..CELLS)
        .into_par_iter()
        .map(|cell| {
            let runs = chunks.iter().map(|chunk| chunk.run(cell));
            let own: Vec<(u32, [f64; 3])> = runs.flatten().copied().collect();
            let mut order: Vec<u64> = (0u64..)
                .zip(&own)
                .map(|(at, (key, _))| u64::from(*key) << 32 | at)
                .collect();
            order.sort_unstable();
            let at = |item: &u64| *item as u32 as usize;
            let along: Vec<[f64; 3]> = order.iter().map(|item| own[at(item)].1).collect();
            let found = map(&along);
            let mut results = found.clone();
            for (item, result) in order.iter().zip(found) {
                results[at(item)] = result;
            }
            results
        })
        .collect();
    // Where each chunk's run begins in each cell.
    let mut next = vec![0usize; CELLS];
    let begins: Vec<Vec<usize>> = chunks
        .iter()
        .map(|chunk| {
            let begin = next.clone();
            for (cell, next) in next.iter_mut().enumerate() {
                *next += chunk.run(cell).len();
            }
            begin
        })
        .collect();
    let back: Vec<Vec<T>> = chunks
        .par_iter()
        .zip(begins)
        .map(|(chunk, begins)| {
            let sorted: Vec<T> = (0..CELLS)
                .flat_map(|cell| &cells[cell][begins[cell]..begins[cell] + chunk.run(cell).len()])
                .copied()
                .collect();
            chunk.place.iter().map(|&at| sorted[at as usize]).collect()
        })
        .collect();
    Some(back.concat())
}

/// The points' box, unless they already follow each other closely.
fn scattered(points: &[[f64; 3]]) -> Option<Aabb> {
    let boxes: Vec<Aabb> = points.par_chunks(CHUNK).map(Aabb::around).collect();
    let mut bounds = Aabb::EMPTY;
    boxes.iter().for_each(|aabb| bounds.grow(aabb));
    let step = |pair: &[[f64; 3]]| {
        let along = |k: usize| (pair[1][k] - pair[0][k]).abs();
        along(0).max(along(1)).max(along(2))
    };
    let steps: Vec<f64> = points
        .par_chunks(CHUNK)
        .map(|points| points.windows(2).map(step).sum())
        .collect();
    let limit = SHORT_STEP * bounds.diagonal2().sqrt() * points.len() as f64;
    (steps.iter().sum::<f64>() > limit).then_some(bounds)
}

/// A run of the points, sorted by cell.
struct Chunk {
    /// Place on the curve, and the point.
    sorted: Vec<(u32, [f64; 3])>,
    /// Where each cell begins, and the end.
    starts: Vec<u32>,
    /// Where each point went.
    place: Vec<u32>,
}

impl Chunk {
    fn new(points: &[[f64; 3]], key: impl Fn(&[f64; 3]) -> u32) -> Self {
        let keys: Vec<u32> = points.iter().map(key).collect();
        let cell = |key: u32| (key >> (3 * AXIS_BITS - CELL_BITS)) as usize % CELLS;
        let mut starts = vec![0u32; CELLS + 1];
        for &key in &keys {
            starts[cell(key) + 1] += 1;
        }
        for i in 0..CELLS {
            starts[i + 1] += starts[i];
        }
        let mut next = starts.clone();
        let mut sorted = vec![(0, [0.0; 3]); points.len()];
        let put = |(&key, &point): (&u32, &[f64; 3])| {
            let at = &mut next[cell(key)];
            sorted[*at as usize] = (key, point);
            *at += 1;
            *at - 1
        };
        let place = keys.iter().zip(points).map(put).collect();
        Self {
            sorted,
            starts,
            place,
        }
    }

    fn run(&self, cell: usize) -> &[(u32, [f64; 3])] {
        &self.sorted[self.starts[cell] as usize..self.starts[cell + 1] as usize]
    }
}

/// Every third bit.
fn spread(x: u32) -> u32 {
    let x = (x | x << 16) & 0x0300_00FF;
    let x = (x | x << 8) & 0x0300_F00F;
    let x = (x | x << 4) & 0x030C_30C3;
    (x | x << 2) & 0x0924_9249
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::uniform;

    #[test]
    fn scattered_points_are_visited_in_order_and_results_come_back_in_theirs() {
        let points: Vec<[f64; 3]> = (0..150_000)
            .map(|i| std::array::from_fn(|k| 80.0 * uniform(2, 3 * i + k as u64) - 7.0))
            .collect();
        let length = |points: &[[f64; 3]]| -> f64 {
            let step = |p: &[[f64; 3]]| (0..3).map(|k| (p[1][k] - p[0][k]).abs()).sum::<f64>();
            points.windows(2).map(step).sum()
        };
        let walked = std::sync::Mutex::new(0.0);
        let same = map_along_curve(&points, |piece| {
            *walked.lock().unwrap() += length(piece);
            piece.to_vec()
        });
        assert_eq!(same.as_deref(), Some(&points[..]));
        assert!(walked.into_inner().unwrap() < 0.1 * length(&points));
    }

    #[test]
    fn ordered_and_coinciding_points_are_left_alone() {
        let line: Vec<[f64; 3]> = (0..5_000).map(|i| [f64::from(i), 0.0, 0.0]).collect();
        assert_eq!(map_along_curve(&line, <[_]>::to_vec), None);
        assert_eq!(map_along_curve(&[[1.0; 3]; 10], <[_]>::to_vec), None);
        assert_eq!(map_along_curve(&[], <[[f64; 3]]>::to_vec), None);
    }
}
