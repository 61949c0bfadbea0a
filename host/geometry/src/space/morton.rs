//! An order in which neighbours in space follow each other, for queries that arrive in any order.

use rayon::prelude::*;

use crate::space::Aabb;

/// Bits per axis of a place on the Z curve.
const AXIS_BITS: u32 = 10;
/// The curve's upper bits number the cells that are worked on one by one.
const CELL_BITS: u32 = 12;
const CELLS: usize = 1 << CELL_BITS;
/// The bits below them order the points inside a cell: 8 bits per axis in all.
const PART_BITS: u32 = 12;
const PARTS: usize = 1 << PART_BITS;
/// Points per parallel task.
const CHUNK: usize = 1 << 16;
/// The same, for points that are in order.
const PIECE: usize = 1 << 10;
/// Neighbours are asked about together, so many at a time.
pub(crate) const TOGETHER: usize = 8;
/// Points that fill a surface as large as the square of their box's diagonal are diagonal / sqrt(points) apart, and a patch
/// of [`TOGETHER`] of them is some three of that wide. Up to four times as wide, an order is as good as it needs to be.
const WIDE: f64 = 12.0;
/// Every so many patches are looked at.
const LOOK_AT: usize = 8;

/// Has `map` fill `results`, as long as the points, from the points in the order of a Z curve, piece by piece; each result
/// ends up at its point's own place. False, and nothing done, when the points already follow each other closely, so that
/// there is nothing to win. `points` are finite. The pieces do not depend on the number of threads.
pub(crate) fn map_along_curve<T: Copy + Send + Sync>(
    points: &[[f64; 3]],
    results: &mut [T],
    empty: T,
    map: impl Fn(&[[f64; 3]], &mut [T]) + Sync,
) -> bool {
    if points.len() <= CHUNK {
        return map_few_along_curve(points, results, map);
    }
    let Some(bounds) = scattered(points) else {
        return false;
    };
    let key = keys(bounds);
    // Each chunk of points by cell; then each cell's points, collected from all chunks, along the curve inside it. The
    // results go back the same way, so that memory is only ever read and written in runs.
    let chunks: Vec<Chunk> = points
        .par_chunks(CHUNK)
        .map(|points| Chunk::new(points, &key))
        .collect();
    let cells: Vec<Vec<T>> = (0..CELLS)
        .into_par_iter()
        .map(|cell| {
            let count = chunks.iter().map(|chunk| chunk.run(cell).len()).sum();
            let places = places_along(&chunks, cell);
            let own = || chunks.iter().flat_map(|chunk| chunk.run(cell));
            let mut along = vec![[0.0; 3]; count];
            for ((_, point), &place) in own().zip(&places) {
                along[place as usize] = *point;
            }
            let mut found = vec![empty; count];
            map(&along, &mut found);
            places.iter().map(|&place| found[place as usize]).collect()
        })
        .collect();
    // Start of each chunk's run in each cell.
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
    chunks
        .par_iter()
        .zip(begins)
        .zip(results.par_chunks_mut(CHUNK))
        .for_each(|((chunk, begins), results)| {
            let sorted: Vec<T> = (0..CELLS)
                .flat_map(|cell| &cells[cell][begins[cell]..begins[cell] + chunk.run(cell).len()])
                .copied()
                .collect();
            for (result, &at) in results.iter_mut().zip(&chunk.place) {
                *result = sorted[at as usize];
            }
        });
    true
}

/// As [`map_along_curve`], for points that are put in order as a whole in less time than cell by cell.
fn map_few_along_curve<T: Copy + Send + Sync>(
    points: &[[f64; 3]],
    results: &mut [T],
    map: impl Fn(&[[f64; 3]], &mut [T]) + Sync,
) -> bool {
    let Some(order) = along_curve(points) else {
        return false;
    };
    let along: Vec<[f64; 3]> = order.iter().map(|&at| points[at as usize]).collect();
    let mut found = results.to_vec();
    found
        .par_chunks_mut(PIECE)
        .zip(along.par_chunks(PIECE))
        .for_each(|(found, along)| map(along, found));
    for (&at, found) in order.iter().zip(found) {
        results[at as usize] = found;
    }
    true
}

/// Numbers of the points in the order of a Z curve; none when they already follow each other closely.
pub fn along_curve(points: &[[f64; 3]]) -> Option<Vec<u32>> {
    let key = keys(scattered(points)?);
    let keys: Vec<u32> = points.iter().map(key).collect();
    let mut order: Vec<u32> = (0..points.len() as u32).collect();
    // By the lower digits first: each pass keeps the order of the one before.
    for shift in [
        3 * AXIS_BITS - CELL_BITS - PART_BITS,
        3 * AXIS_BITS - CELL_BITS,
    ] {
        let digit = |at: u32| (keys[at as usize] >> shift) as usize % PARTS;
        let mut next = vec![0u32; PARTS];
        for &at in &order {
            next[digit(at)] += 1;
        }
        let mut begin = 0;
        for next in &mut next {
            (*next, begin) = (begin, begin + *next);
        }
        let before = order.clone();
        for at in before {
            let next = &mut next[digit(at)];
            order[*next as usize] = at;
            *next += 1;
        }
    }
    Some(order)
}

/// Places of points in a box on the curve.
fn keys(bounds: Aabb) -> impl Fn(&[f64; 3]) -> u32 + Sync {
    let low = bounds.low;
    let extent = (0..3).map(|k| bounds.high[k] - low[k]).fold(0.0, f64::max);
    let scale = f64::from((1u32 << AXIS_BITS) - 1) / extent;
    move |point| {
        let cell = |k: usize| spread(((point[k] - low[k]) * scale) as u32);
        cell(0) | cell(1) << 1 | cell(2) << 2
    }
}

/// Rank of each of the cell's points along the curve inside the cell, by counting on the next bits of their keys:
/// those of one place keep their order.
fn places_along(chunks: &[Chunk], cell: usize) -> Vec<u32> {
    let own = || chunks.iter().flat_map(|chunk| chunk.run(cell));
    // Not many more parts than points: to count on empty ones costs as much.
    let bits = (usize::BITS
        - chunks
            .iter()
            .map(|chunk| chunk.run(cell).len())
            .sum::<usize>()
            .leading_zeros()
        + 1)
    .min(PART_BITS);
    let parts = 1 << bits;
    let part = |key: u32| (key >> (3 * AXIS_BITS - CELL_BITS - bits)) as usize % parts;
    let mut next = vec![0u32; parts];
    for (key, _) in own() {
        next[part(*key)] += 1;
    }
    let mut begin = 0;
    for next in &mut next {
        (*next, begin) = (begin, begin + *next);
    }
    own()
        .map(|(key, _)| {
            let next = &mut next[part(*key)];
            *next += 1;
            *next - 1
        })
        .collect()
}

/// The points' box, unless they already follow each other closely.
fn scattered(points: &[[f64; 3]]) -> Option<Aabb> {
    let boxes: Vec<Aabb> = points.par_chunks(CHUNK).map(Aabb::around).collect();
    let mut bounds = Aabb::EMPTY;
    boxes.iter().for_each(|aabb| bounds.grow(aabb));
    let widths: Vec<(f64, f64)> = points
        .par_chunks(CHUNK)
        .map(|points| {
            let patches = points.chunks_exact(TOGETHER).step_by(LOOK_AT);
            let width = |patch| Aabb::around(patch).diagonal2().sqrt();
            patches.fold((0.0, 0.0), |(sum, count), patch| {
                (sum + width(patch), count + 1.0)
            })
        })
        .collect();
    let (sum, count) = widths
        .iter()
        .fold((0.0, 0.0), |(sum, count), of| (sum + of.0, count + of.1));
    let mean = if count > 0.0 { sum / count } else { 0.0 };
    let spacing = bounds.diagonal2().sqrt() / (points.len() as f64).sqrt();
    (mean > WIDE * spacing).then_some(bounds)
}

/// A run of the points, sorted by cell.
struct Chunk {
    /// Place on the curve, and the point.
    sorted: Vec<(u32, [f64; 3])>,
    /// Start of each cell, and the end.
    starts: Vec<u32>,
    /// New index of each point.
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
    use flankscope_foundation::random::uniform;

    #[test]
    fn scattered_points_are_visited_in_order_and_results_come_back_in_theirs() {
        for count in [20_000, 150_000] {
            let points: Vec<[f64; 3]> = (0..count)
                .map(|i| std::array::from_fn(|k| 80.0 * uniform(2, 3 * i + k as u64) - 7.0))
                .collect();
            let length = |points: &[[f64; 3]]| -> f64 {
                let step = |p: &[[f64; 3]]| (0..3).map(|k| (p[1][k] - p[0][k]).abs()).sum::<f64>();
                points.windows(2).map(step).sum()
            };
            let walked = std::sync::Mutex::new(0.0);
            let mut same = vec![[0.0; 3]; points.len()];
            let done = map_along_curve(&points, &mut same, [0.0; 3], |piece, results| {
                *walked.lock().unwrap() += length(piece);
                results.copy_from_slice(piece);
            });
            assert!(done);
            assert_eq!(same, points);
            assert!(walked.into_inner().unwrap() < 0.1 * length(&points));
        }
    }

    #[test]
    fn ordered_and_coinciding_points_are_left_alone() {
        let line: Vec<[f64; 3]> = (0..5_000).map(|i| [f64::from(i), 0.0, 0.0]).collect();
        for points in [&line[..], &[[1.0; 3]; 10], &[]] {
            let mut untouched = vec![0; points.len()];
            let done = map_along_curve(points, &mut untouched, 0, |_, _| panic!("asked"));
            assert!(!done);
        }
    }
}
