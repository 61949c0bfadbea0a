//! Merging overlapping views: one point per occupied voxel.

use rayon::prelude::*;

use crate::space::Aabb;

/// Points per parallel task. Fixed, so that every bit is independent of the thread count.
const CHUNK: usize = 1 << 16;
/// Voxels are spread over this many parts by a hash of their number; a part's table then fits the cache.
const PARTS: usize = 256;
/// Bits per axis in a voxel number.
const AXIS_BITS: u32 = 21;

/// Reasons for which points are not merged.
#[derive(Debug, thiserror::Error, PartialEq)]
#[non_exhaustive]
pub enum MergeError {
    /// No usable voxel size.
    #[error("the voxel size is {voxel_mm} mm; right would be a finite number above 0")]
    VoxelSize {
        /// The size given.
        voxel_mm: f64,
    },
    /// A cloud so large that its voxels cannot be numbered.
    #[error(
        "the cloud spans {voxels:.3e} voxels of {voxel_mm} mm along {axis}, at most {most} can be numbered; take larger voxels"
    )]
    TooManyVoxels {
        /// `x`, `y` or `z`.
        axis: char,
        /// Voxels along it.
        voxels: f64,
        /// The size given, mm.
        voxel_mm: f64,
        /// Most voxels along an axis.
        most: u32,
    },
    /// More points than can be numbered.
    #[error("{points} points, at most 4294967295 can be merged")]
    TooManyPoints {
        /// Points given.
        points: usize,
    },
    /// The best point of a voxel needs an uncertainty of each.
    #[error("{sigmas} standard uncertainties for {points} points; right would be one for each")]
    SigmaCount {
        /// Points given.
        points: usize,
        /// Uncertainties given.
        sigmas: usize,
    },
}

/// A point and its number in the cloud.
#[derive(Clone, Copy)]
struct VoxelEntry {
    point: [f64; 3],
    index: u32,
}

/// A chunk's points, those of each part together.
struct Sorted {
    entries: Vec<VoxelEntry>,
    /// Start of each part; one more for the end.
    starts: Vec<u32>,
}

/// A voxel in use.
#[derive(Clone, Copy)]
struct Voxel {
    number: u64,
    sum: [f64; 3],
    count: u32,
    /// The first point in it.
    first: u32,
}

/// Checks a voxel size before anything large is loaded.
///
/// # Errors
/// [`MergeError::VoxelSize`] unless it is finite and above 0.
pub fn check_voxel_size(voxel_mm: f64) -> Result<(), MergeError> {
    if voxel_mm.is_finite() && voxel_mm > 0.0 {
        Ok(())
    } else {
        Err(MergeError::VoxelSize { voxel_mm })
    }
}

/// Replaces the points (finite, mm) in each cube of `voxel_mm` by their centroid. Cubes are counted from the cloud's smallest
/// coordinates. The results come in the order of each cube's first point, the same bytes on any number of threads.
///
/// # Errors
/// [`MergeError`] for a size that is no size, or a cloud with too many voxels or points to number.
pub fn voxel_centroids(points: &[[f64; 3]], voxel_mm: f64) -> Result<Vec<[f64; 3]>, MergeError> {
    let numbering = Numbering::from_points(points, voxel_mm)?;
    if points.is_empty() {
        return Ok(Vec::new());
    }
    let chunks: Vec<Sorted> = points
        .par_chunks(CHUNK)
        .enumerate()
        .map(|(chunk, points)| by_part(points, (chunk * CHUNK) as u32, &numbering))
        .collect();
    let parts: Vec<Vec<Voxel>> = (0..PARTS)
        .into_par_iter()
        .map(|part| fill(&chunks, part, &numbering))
        .collect();
    drop(chunks);
    // Every part has its voxels in the order of their first points, so each chunk of points finds its own side by side.
    let ordered: Vec<Vec<[f64; 3]>> = (0..points.len().div_ceil(CHUNK))
        .into_par_iter()
        .map(|chunk| in_order(&parts, chunk))
        .collect();
    Ok(ordered.concat())
}

/// The points (finite, mm) of every cube of `voxel_mm`, by their numbers in order; the cubes are those of [`voxel_centroids`], in
/// the same order.
///
/// # Errors
/// As [`voxel_centroids`].
pub fn voxel_groups(points: &[[f64; 3]], voxel_mm: f64) -> Result<Vec<Vec<u32>>, MergeError> {
    let numbered = by_voxel(points, voxel_mm)?;
    let mut groups: Vec<Vec<u32>> = numbered
        .chunk_by(|a, b| a.0 == b.0)
        .map(|voxel| voxel.iter().map(|(_, index)| *index).collect())
        .collect();
    groups.par_sort_unstable_by_key(|group| group.first().copied());
    Ok(groups)
}

/// The number of the point (finite, mm) with the least standard uncertainty in every cube of `voxel_mm`, of equal ones the first; the
/// cubes are those of [`voxel_centroids`], in the same order. The same numbers on any number of threads.
///
/// # Errors
/// As [`voxel_centroids`], and [`MergeError::SigmaCount`] unless there is one `sigma_mm` for each point.
pub fn voxel_best(
    points: &[[f64; 3]],
    sigma_mm: &[f32],
    voxel_mm: f64,
) -> Result<Vec<u32>, MergeError> {
    if sigma_mm.len() != points.len() {
        return Err(MergeError::SigmaCount {
            points: points.len(),
            sigmas: sigma_mm.len(),
        });
    }
    let numbered = by_voxel(points, voxel_mm)?;
    let sigma_of = |index: u32| sigma_mm[index as usize];
    let mut first_and_best: Vec<(u32, u32)> = numbered
        .chunk_by(|a, b| a.0 == b.0)
        .filter_map(|voxel| {
            // Of equal uncertainties `min_by` takes the first, and a voxel's points are in order.
            let by_sigma =
                |a: &&(u64, u32), b: &&(u64, u32)| sigma_of(a.1).total_cmp(&sigma_of(b.1));
            let best = voxel.iter().min_by(by_sigma)?;
            Some((voxel.first()?.1, best.1))
        })
        .collect();
    first_and_best.par_sort_unstable();
    Ok(first_and_best.into_iter().map(|(_, best)| best).collect())
}

/// Every point's voxel and number, sorted by both.
fn by_voxel(points: &[[f64; 3]], voxel_mm: f64) -> Result<Vec<(u64, u32)>, MergeError> {
    let numbering = Numbering::from_points(points, voxel_mm)?;
    let mut numbered: Vec<(u64, u32)> = points
        .par_iter()
        .zip(0..points.len() as u32)
        .map(|(point, index)| (numbering.number(point), index))
        .collect();
    numbered.par_sort_unstable();
    Ok(numbered)
}

struct Numbering {
    low: [f64; 3],
    voxel_mm: f64,
}

impl Numbering {
    /// Of the cubes that these points lie in.
    fn from_points(points: &[[f64; 3]], voxel_mm: f64) -> Result<Self, MergeError> {
        check_voxel_size(voxel_mm)?;
        if u32::try_from(points.len()).is_err() {
            return Err(MergeError::TooManyPoints {
                points: points.len(),
            });
        }
        let boxes: Vec<Aabb> = points.par_chunks(CHUNK).map(Aabb::around).collect();
        let mut bounds = Aabb::EMPTY;
        boxes.iter().for_each(|aabb| bounds.grow(aabb));
        for (k, axis) in ['x', 'y', 'z'].into_iter().enumerate() {
            let voxels = (bounds.high[k] - bounds.low[k]) / voxel_mm;
            let most = 1u32 << AXIS_BITS;
            // An overflowed span is infinite, so it is refused here too.
            if voxels >= f64::from(most) {
                return Err(MergeError::TooManyVoxels {
                    axis,
                    voxels,
                    voxel_mm,
                    most,
                });
            }
        }
        Ok(Self {
            low: bounds.low,
            voxel_mm,
        })
    }

    #[inline]
    fn number(&self, point: &[f64; 3]) -> u64 {
        let along = |k: usize| ((point[k] - self.low[k]) / self.voxel_mm) as u64;
        along(0) | along(1) << AXIS_BITS | along(2) << (2 * AXIS_BITS)
    }
}

#[inline]
fn hash(number: u64) -> u64 {
    let mixed = number.wrapping_mul(0x9E37_79B9_7F4A_7C15);
    (mixed ^ (mixed >> 32)).wrapping_mul(0xD6E8_FEB8_6659_FD93)
}

fn part_of(hash: u64) -> usize {
    (hash >> 56) as usize % PARTS
}

/// Counting sort of a chunk by part; points of a part stay in order.
fn by_part(points: &[[f64; 3]], base: u32, numbering: &Numbering) -> Sorted {
    let part: Vec<u8> = points
        .iter()
        .map(|p| part_of(hash(numbering.number(p))) as u8)
        .collect();
    let mut starts = vec![0u32; PARTS + 1];
    for &part in &part {
        starts[usize::from(part) + 1] += 1;
    }
    for part in 0..PARTS {
        starts[part + 1] += starts[part];
    }
    let mut at = starts.clone();
    let unset = VoxelEntry {
        point: [0.0; 3],
        index: 0,
    };
    let mut entries = vec![unset; points.len()];
    for (i, (&point, &part)) in points.iter().zip(&part).enumerate() {
        let slot = &mut at[usize::from(part)];
        entries[*slot as usize] = VoxelEntry {
            point,
            index: base + i as u32,
        };
        *slot += 1;
    }
    Sorted { entries, starts }
}

/// The voxels of one part in the order of their first points.
fn fill(chunks: &[Sorted], part: usize, numbering: &Numbering) -> Vec<Voxel> {
    const FREE: u32 = u32::MAX;
    let of = |chunk: &Sorted| chunk.starts[part] as usize..chunk.starts[part + 1] as usize;
    let total: usize = chunks.iter().map(|chunk| of(chunk).len()).sum();
    let capacity = (2 * total).next_power_of_two().max(2);
    let mask = capacity - 1;
    let mut slots = vec![FREE; capacity];
    let mut voxels: Vec<Voxel> = Vec::with_capacity(total);
    for entry in chunks.iter().flat_map(|chunk| &chunk.entries[of(chunk)]) {
        let number = numbering.number(&entry.point);
        let mut slot = hash(number) as usize & mask;
        loop {
            match slots[slot] {
                FREE => {
                    slots[slot] = voxels.len() as u32;
                    voxels.push(Voxel {
                        number,
                        sum: entry.point,
                        count: 1,
                        first: entry.index,
                    });
                    break;
                }
                at if voxels[at as usize].number == number => {
                    let voxel = &mut voxels[at as usize];
                    for k in 0..3 {
                        voxel.sum[k] += entry.point[k];
                    }
                    voxel.count += 1;
                    break;
                }
                _ => slot = (slot + 1) & mask,
            }
        }
    }
    voxels
}

/// Centroids of the voxels whose first point lies in `chunk`, in its order.
fn in_order(parts: &[Vec<Voxel>], chunk: usize) -> Vec<[f64; 3]> {
    let range = (chunk * CHUNK) as u32..((chunk + 1) * CHUNK).min(u32::MAX as usize) as u32;
    let mut slots = vec![[f64::NAN; 3]; CHUNK];
    for part in parts {
        let from = part.partition_point(|voxel| voxel.first < range.start);
        for voxel in part[from..]
            .iter()
            .take_while(|voxel| range.contains(&voxel.first))
        {
            slots[(voxel.first - range.start) as usize] =
                voxel.sum.map(|s| s / f64::from(voxel.count));
        }
    }
    slots.retain(|centroid| !centroid[0].is_nan());
    slots
}

#[cfg(test)]
mod tests {
    use super::*;
    use flankscope_foundation::random::uniform;
    use std::collections::HashMap;

    fn cloud(count: u64) -> Vec<[f64; 3]> {
        (0..count)
            .map(|i| {
                [0, 1, 2].map(|k| (if k == 2 { 0.3 } else { 5.0 }) * uniform(4, 3 * i + k) - 1.0)
            })
            .collect()
    }

    /// Voxels in a map, sums in the order of the points.
    fn brute_force(points: &[[f64; 3]], voxel_mm: f64) -> Vec<[f64; 3]> {
        let low: [f64; 3] =
            [0, 1, 2].map(|k| points.iter().map(|p| p[k]).fold(f64::INFINITY, f64::min));
        let mut place = HashMap::new();
        let mut sums: Vec<([f64; 3], f64)> = Vec::new();
        for p in points {
            let key = [0, 1, 2].map(|k| ((p[k] - low[k]) / voxel_mm).floor() as i64);
            let at = *place.entry(key).or_insert_with(|| {
                sums.push(([0.0; 3], 0.0));
                sums.len() - 1
            });
            for (sum, c) in sums[at].0.iter_mut().zip(p) {
                *sum += c;
            }
            sums[at].1 += 1.0;
        }
        sums.iter().map(|(sum, n)| sum.map(|s| s / n)).collect()
    }

    #[test]
    fn merging_agrees_with_a_map_of_voxels_in_order_and_value() {
        let points = cloud(150_000);
        for voxel_mm in [0.02, 0.3, 100.0] {
            let merged = voxel_centroids(&points, voxel_mm).unwrap();
            assert_eq!(merged, brute_force(&points, voxel_mm), "{voxel_mm} mm");
            // The groups are the same voxels: their sums in order give the same bytes.
            let groups = voxel_groups(&points, voxel_mm).unwrap();
            let centroid = |group: &Vec<u32>| {
                [0, 1, 2].map(|k| {
                    let sum = group
                        .iter()
                        .fold(0.0, |sum, &i| sum + points[i as usize][k]);
                    sum / group.len() as f64
                })
            };
            assert_eq!(groups.iter().map(centroid).collect::<Vec<_>>(), merged);
        }
    }

    /// Few different values, so that many voxels have several points of the least.
    fn uncertainties(count: u64) -> Vec<f32> {
        (0..count)
            .map(|i| 0.001 * (1.0 + (5.0 * uniform(9, i)).floor() as f32))
            .collect()
    }

    #[test]
    fn the_best_point_of_every_voxel_is_that_of_a_map_of_voxels() {
        let points = cloud(150_000);
        let sigma_mm = uncertainties(150_000);
        let low: [f64; 3] =
            [0, 1, 2].map(|k| points.iter().map(|p| p[k]).fold(f64::INFINITY, f64::min));
        for voxel_mm in [0.02, 0.3, 100.0] {
            let mut place = HashMap::new();
            let mut best: Vec<u32> = Vec::new();
            for (p, index) in points.iter().zip(0u32..) {
                let key = [0, 1, 2].map(|k| ((p[k] - low[k]) / voxel_mm).floor() as i64);
                let at = *place.entry(key).or_insert_with(|| {
                    best.push(index);
                    best.len() - 1
                });
                if sigma_mm[index as usize] < sigma_mm[best[at] as usize] {
                    best[at] = index;
                }
            }
            let found = voxel_best(&points, &sigma_mm, voxel_mm);
            assert_eq!(found, Ok(best), "{voxel_mm} mm");
        }
    }

    #[test]
    fn one_and_many_threads_give_the_same_bytes() {
        let points = cloud(200_000);
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            let merged = pool.install(|| voxel_centroids(&points, 0.05)).unwrap();
            merged
                .as_flattened()
                .iter()
                .map(|c| c.to_bits())
                .collect::<Vec<_>>()
        };
        assert_eq!(run(1), run(5));
        let sigma_mm = uncertainties(200_000);
        let best = |threads| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            pool.install(|| voxel_best(&points, &sigma_mm, 0.05))
        };
        assert_eq!(best(1), best(5));
    }

    #[test]
    fn what_cannot_be_merged_is_refused() {
        assert_eq!(voxel_centroids(&[], 0.1), Ok(Vec::new()));
        assert_eq!(voxel_groups(&[], 0.1), Ok(Vec::new()));
        assert_eq!(voxel_best(&[], &[], 0.1), Ok(Vec::new()));
        let lacking = MergeError::SigmaCount {
            points: 1,
            sigmas: 0,
        };
        assert_eq!(voxel_best(&[[0.0; 3]], &[], 0.1), Err(lacking));
        for voxel_mm in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let refused = voxel_centroids(&[[0.0; 3]], voxel_mm);
            assert!(matches!(refused, Err(MergeError::VoxelSize { .. })));
        }
        let far = [[0.0; 3], [0.0, 3e6, 0.0]];
        assert!(matches!(
            voxel_centroids(&far, 1.0),
            Err(MergeError::TooManyVoxels { axis: 'y', .. })
        ));
        assert_eq!(voxel_centroids(&far, 2.0).map(|m| m.len()), Ok(2));
    }
}
