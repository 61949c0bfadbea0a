//! Area-uniform random points on a mesh (the reference cloud of the nearest-point metric), and the region of interest.

use rayon::prelude::*;

use crate::io::mesh::TriMesh;
use flankscope_foundation::random::uniform;

const CHUNK: usize = 1 << 13;

/// Twenty-four bytes each: no memory holds more for long.
const MOST_POINTS: usize = 1_000_000_000;

/// Reasons for which a mesh is not sampled.
#[derive(Debug, thiserror::Error, PartialEq)]
#[non_exhaustive]
pub enum SampleError {
    /// Nothing to sample.
    #[error(
        "the mesh has no area ({area_mm2} mm2 in {triangles} triangles); sampling needs a surface"
    )]
    NoArea {
        /// Total area.
        area_mm2: f64,
        /// Number of triangles.
        triangles: usize,
    },
    /// No points wanted.
    #[error("0 points wanted; right would be at least 1")]
    NoPoints,
    /// More points than fit anywhere.
    #[error("{count} points wanted; right would be at most {MOST_POINTS}")]
    TooMany {
        /// How many.
        count: usize,
    },
    /// A box that contains nothing.
    #[error("no triangle lies in the region of interest")]
    NothingInRegion,
}

/// Draws `count` points uniformly by area. The same mesh, count and seed give the same bytes on any number of threads.
///
/// Within a triangle A, B, C a point is A(1 - s) + B s(1 - v) + C s v with s = sqrt(u): the strip at parameter s has a
/// length proportional to s, so s needs the density 2 s (its distribution function s^2 is inverted by the root), and on
/// the strip v is uniform.
///
/// # Errors
/// [`SampleError`] for no area or no points.
pub fn sample(mesh: &TriMesh, count: usize, seed: u64) -> Result<Vec<[f64; 3]>, SampleError> {
    if count == 0 {
        return Err(SampleError::NoPoints);
    }
    if count > MOST_POINTS {
        return Err(SampleError::TooMany { count });
    }
    let cumulative = cumulative_areas(mesh);
    let area_mm2 = cumulative.last().copied().unwrap_or(0.0);
    if area_mm2 <= 0.0 {
        return Err(SampleError::NoArea {
            area_mm2,
            triangles: mesh.triangles.len(),
        });
    }
    let guide = Guide::new(&cumulative, area_mm2);
    let mut points = vec![[0.0; 3]; count];
    points
        .par_chunks_mut(CHUNK)
        .enumerate()
        .for_each(|(chunk, points)| {
            for (i, point) in points.iter_mut().enumerate() {
                let draw = 3 * (chunk * CHUNK + i) as u64;
                let target = uniform(seed, draw) * area_mm2;
                let [a, b, c] = mesh.corners(guide.find(&cumulative, target));
                let s = uniform(seed, draw + 1).sqrt();
                let v = uniform(seed, draw + 2);
                let (wa, wb, wc) = (1.0 - s, s * (1.0 - v), s * v);
                *point = std::array::from_fn(|k| wa * a[k] + wb * b[k] + wc * c[k]);
            }
        });
    Ok(points)
}

/// Whether point `index` is among a random `share` of the points: the same answer for the same seed.
pub fn drawn(seed: u64, index: u64, share: f64) -> bool {
    uniform(seed, index) < share
}

/// Area of a mesh, mm2.
pub fn area_mm2(mesh: &TriMesh) -> f64 {
    cumulative_areas(mesh).last().copied().unwrap_or(0.0)
}

/// Running sum of the triangles' areas, mm2. Chunk sums are added in order, so the result does not depend on threads.
fn cumulative_areas(mesh: &TriMesh) -> Vec<f64> {
    let mut cumulative = vec![0.0; mesh.triangles.len()];
    let totals: Vec<f64> = cumulative
        .par_chunks_mut(CHUNK)
        .enumerate()
        .map(|(chunk, sums)| {
            let mut total = 0.0;
            for (i, sum) in sums.iter_mut().enumerate() {
                total += area(mesh.corners(chunk * CHUNK + i));
                *sum = total;
            }
            total
        })
        .collect();
    let before: Vec<f64> = totals
        .iter()
        .scan(0.0, |sum, total| Some(std::mem::replace(sum, *sum + total)))
        .collect();
    cumulative
        .par_chunks_mut(CHUNK)
        .zip(before)
        .for_each(|(sums, before)| sums.iter_mut().for_each(|sum| *sum += before));
    cumulative
}

/// A shortcut into the running sum: where the search for a target starts. A bisection of half a million sums misses the cache
/// at almost every step; from here the triangle is a step or two away.
struct Guide {
    /// For every slot of equal area the first triangle whose sum exceeds the slot's beginning.
    first: Vec<u32>,
    slots_per_mm2: f64,
}

impl Guide {
    fn new(cumulative: &[f64], area_mm2: f64) -> Self {
        let slots = cumulative.len().div_ceil(2);
        let slots_per_mm2 = slots as f64 / area_mm2;
        let target = |slot: usize| slot as f64 / slots_per_mm2;
        let mut first = vec![0u32; slots + 1];
        first
            .par_chunks_mut(CHUNK)
            .enumerate()
            .for_each(|(chunk, first)| {
                // The chunk's first slot by bisection; every further one a step or two on.
                let mut triangle = cumulative.partition_point(|&sum| sum <= target(chunk * CHUNK));
                for (i, first) in first.iter_mut().enumerate() {
                    while triangle < cumulative.len()
                        && cumulative[triangle] <= target(chunk * CHUNK + i)
                    {
                        triangle += 1;
                    }
                    *first = triangle.min(cumulative.len() - 1) as u32;
                }
            });
        Self {
            first,
            slots_per_mm2,
        }
    }

    /// The first triangle whose sum exceeds `target`, or the last one.
    #[inline]
    fn find(&self, cumulative: &[f64], target: f64) -> usize {
        let slot = (target * self.slots_per_mm2) as usize;
        let mut triangle = self.first[slot.min(self.first.len() - 1)] as usize;
        // Rounding may have put the target into the slot after its own.
        while triangle > 0 && cumulative[triangle - 1] > target {
            triangle -= 1;
        }
        while triangle + 1 < cumulative.len() && cumulative[triangle] <= target {
            triangle += 1;
        }
        triangle
    }
}

#[inline]
fn area([a, b, c]: [[f64; 3]; 3]) -> f64 {
    let ab: [f64; 3] = std::array::from_fn(|k| b[k] - a[k]);
    let ac: [f64; 3] = std::array::from_fn(|k| c[k] - a[k]);
    let cross = [
        ab[1] * ac[2] - ab[2] * ac[1],
        ab[2] * ac[0] - ab[0] * ac[2],
        ab[0] * ac[1] - ab[1] * ac[0],
    ];
    0.5 * cross.iter().map(|c| c * c).sum::<f64>().sqrt()
}

/// The part of CAD that a view can see: a window about the view's centre of mass in cylinder coordinates of the tool axis z.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Region {
    /// Half height of the window, mm.
    pub half_height_mm: f64,
    /// Half width of the window, rad.
    pub half_angle_rad: f64,
    /// Only points nearer to the axis than this belong to the toothing, mm.
    pub radial_threshold_mm: f64,
}

impl Default for Region {
    /// The article's window: +-10 mm, +-0.2 rad, 50 mm.
    fn default() -> Self {
        Self {
            half_height_mm: 10.0,
            half_angle_rad: 0.2,
            radial_threshold_mm: 50.0,
        }
    }
}

impl Region {
    /// Whether `point` lies in the window about `centre`, mm (tool frame).
    pub fn contains(&self, centre: [f64; 3], point: [f64; 3]) -> bool {
        let angle = turned(point[1].atan2(point[0]) - centre[1].atan2(centre[0]));
        (point[2] - centre[2]).abs() <= self.half_height_mm
            && angle.abs() <= self.half_angle_rad
            && point[0].hypot(point[1]) <= self.radial_threshold_mm
    }

    /// The triangles that may reach into the window about `centre`: all that do, and some beside it.
    pub fn part(&self, centre: [f64; 3], mesh: &TriMesh) -> TriMesh {
        let towards = centre[1].atan2(centre[0]);
        let mut part = TriMesh {
            vertices: Vec::new(),
            triangles: Vec::new(),
        };
        for index in 0..mesh.triangles.len() {
            let corners = mesh.corners(index);
            let span = |value: fn([f64; 3], f64) -> f64| {
                let values = corners.map(|corner| value(corner, towards));
                let low = values.into_iter().fold(f64::INFINITY, f64::min);
                [low, values.into_iter().fold(f64::NEG_INFINITY, f64::max)]
            };
            let height = span(|[_, _, z], _| z);
            let radius = span(|[x, y, _], _| x.hypot(y));
            // Seen from the window the cut of the angle is on the far side; a triangle that spans it is over there.
            let angle = span(|[x, y, _], towards| turned(y.atan2(x) - towards));
            let beside = height[1] < centre[2] - self.half_height_mm
                || height[0] > centre[2] + self.half_height_mm
                || radius[0] > self.radial_threshold_mm
                || angle[1] < -self.half_angle_rad
                || angle[0] > self.half_angle_rad
                || angle[1] - angle[0] > std::f64::consts::PI;
            if !beside {
                let first = part.vertices.len() as u32;
                part.vertices.extend(corners);
                part.triangles.push([first, first + 1, first + 2]);
            }
        }
        part
    }

    /// Draws `count` points uniformly by area on the part of the mesh in the window about `centre`.
    ///
    /// # Errors
    /// [`SampleError::NothingInRegion`] when no surface is there.
    pub fn sample(
        &self,
        centre: [f64; 3],
        mesh: &TriMesh,
        count: usize,
        seed: u64,
    ) -> Result<Vec<[f64; 3]>, SampleError> {
        /// A window that holds less than one in so many points of its triangles holds none of them.
        const MOST_BESIDE: usize = 1000;
        let part = self.part(centre, mesh);
        if part.triangles.is_empty() {
            return Err(SampleError::NothingInRegion);
        }
        let mut inside = Vec::with_capacity(count);
        let mut round = 0;
        while inside.len() < count {
            let before = inside.len();
            let drawn = sample(&part, count, seed.wrapping_add(round))?;
            inside.extend(self.trim(centre, &drawn));
            if inside.len() < before + count.div_ceil(MOST_BESIDE) {
                return Err(SampleError::NothingInRegion);
            }
            round += 1;
        }
        inside.truncate(count);
        Ok(inside)
    }

    /// The points in the window about `centre`, in order.
    pub fn trim(&self, centre: [f64; 3], points: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let inside = |point: &&[f64; 3]| self.contains(centre, **point);
        points.iter().filter(inside).copied().collect()
    }
}

/// An angle brought to -pi..pi.
fn turned(angle_rad: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    (angle_rad + PI).rem_euclid(TAU) - PI
}

/// Centre of mass of a cloud, mm; none when empty.
pub fn centre_of_mass(points: &[[f64; 3]]) -> Option<[f64; 3]> {
    let mut sum = [0.0; 3];
    for point in points {
        for k in 0..3 {
            sum[k] += point[k];
        }
    }
    (!points.is_empty()).then(|| sum.map(|s| s / points.len() as f64))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_window_is_sampled_as_if_the_whole_mesh_was_and_the_rest_dropped() {
        // A tube of 36 facets, 60 mm high, radius 40, and another one around it that is out of reach.
        let mut tube = TriMesh {
            vertices: Vec::new(),
            triangles: Vec::new(),
        };
        for radius in [40.0, 60.0] {
            for facet in 0..36 {
                let at = |step: i32, z: f64| {
                    let angle = f64::from(facet + step) * std::f64::consts::TAU / 36.0;
                    [radius * angle.cos(), radius * angle.sin(), z]
                };
                let first = tube.vertices.len() as u32;
                tube.vertices
                    .extend([at(0, 0.0), at(1, 0.0), at(1, 60.0), at(0, 60.0)]);
                tube.triangles
                    .extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
            }
        }
        let region = Region::default();
        // One window in the middle, one across the cut of the angle and the upper end.
        for centre in [[40.0, 0.0, 30.0], [-40.0, 1e-9, 58.0]] {
            let got = region.sample(centre, &tube, 20_000, 3).unwrap();
            assert_eq!(got.len(), 20_000);
            assert!(got.iter().all(|&point| region.contains(centre, point)));
            let all = region.trim(centre, &sample(&tube, 2_000_000, 4).unwrap());
            // The same distribution: means agree within five of their standard deviations.
            for k in 0..3 {
                let mean = |points: &[[f64; 3]]| {
                    points.iter().map(|p| p[k]).sum::<f64>() / points.len() as f64
                };
                let (a, b) = (mean(&got), mean(&all));
                let variance =
                    got.iter().map(|p| (p[k] - a).powi(2)).sum::<f64>() / got.len() as f64;
                let sigma = (variance * (1.0 / got.len() as f64 + 1.0 / all.len() as f64)).sqrt();
                assert!((a - b).abs() < 5.0 * sigma, "{k}: {a} {b}");
            }
        }
        let beyond = region.sample([40.0, 0.0, 300.0], &tube, 100, 1);
        assert_eq!(beyond, Err(SampleError::NothingInRegion));
    }

    #[test]
    fn the_shortcut_finds_what_a_search_of_the_sums_finds() {
        // Areas over nine decades, with runs of none.
        let mut total = 0.0;
        let cumulative: Vec<f64> = (0..5_000u64)
            .map(|i| {
                if i % 7 > 2 {
                    total += 10f64.powf(9.0 * uniform(5, i) - 6.0);
                }
                total
            })
            .collect();
        let guide = Guide::new(&cumulative, total);
        let mut targets: Vec<f64> = (0..20_000).map(|i| total * uniform(6, i)).collect();
        targets.extend(cumulative.iter().flat_map(|&sum| [sum, sum.next_down()]));
        for target in targets.into_iter().filter(|&t| (0.0..=total).contains(&t)) {
            let searched = cumulative.partition_point(|&sum| sum <= target);
            let searched = searched.min(cumulative.len() - 1);
            assert_eq!(guide.find(&cumulative, target), searched, "{target}");
        }
    }
}
