//! The measurand: the largest mean loss over any disc of a stated area that lies in the zone.
//!
//! ```text
//!  points ──► mean over every disc of a fine lattice, every cell of equal weight ──► largest, climbed to from the best places
//!  cells' noise ──► the same means of simulated noise ──► bias and scatter of a maximum
//!  cells without points ──► what a disc that holds some may hide
//! ```
//!
//! Nothing is presumed of the damage's shape, and no point counts less because it lies deep. A part of a disc in which
//! nothing was measured counts as having lost nothing, so that the figure never exceeds what was seen; what may be lost there
//! is said beside it.

// Lanes are counted: an iterator over several arrays at once hides from the compiler what a vector holds.
#![allow(clippy::needless_range_loop)]

mod holes;
mod noise;
mod overlap;
#[cfg(test)]
mod tests;

use flankscope_foundation::simd::with_widest;
use rayon::prelude::*;

use super::field::{Field, WearSample};
use super::unseen::Unseen;
pub(super) use noise::prepare;
use overlap::overlap_mm2;

/// Cells across a disc's diameter: the noise of cells and holes as small as this are told apart.
pub(super) const CELLS_ACROSS: f64 = 5.0;
/// Steps of the lattice per cell. With two no disc lies farther than 0.14 of its radius from one that is tried.
const STEPS_PER_CELL: usize = 2;
/// Places from which the largest mean is climbed to, and how often the step is halved.
const CLIMBS: usize = 6;
const HALVINGS: usize = 3;
/// Samples, or draws of noise, that are summed side by side. A fixed number, so that sums are the same on every processor.
const LANES: usize = 8;

/// The largest mean over a disc.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Peak {
    /// As read, mm.
    pub raw_mm: f64,
    /// Its middle from the zone's corner along profile and height, mm.
    pub at_mm: [f64; 2],
    /// Bias of such a maximum by noise of the stated size, mm.
    pub bias_mm: f64,
    /// Standard uncertainty by noise, and by where its points happen to lie, mm.
    pub u_mm: f64,
}

/// The points of a zone, sorted by cells.
pub(super) struct Discs<'a> {
    field: &'a Field,
    samples: &'a [WearSample],
    /// Samples by cell: `order[start[i]..start[i + 1]]`.
    order: Vec<u32>,
    start: Vec<u32>,
    sorted: Sorted,
    /// Unseen share of each measured cell; empty where every cell was seen whole.
    unseen: Vec<Unseen>,
    radius_mm: f64,
}

/// The samples in the order of their cells, a column each: what is summed over discs.
struct Sorted {
    x_mm: Vec<f64>,
    y_mm: Vec<f64>,
    wear_mm: Vec<f64>,
    /// One part in the number of samples of its cell.
    share: Vec<f64>,
}

impl<'a> Discs<'a> {
    pub fn new(field: &'a Field, samples: &'a [WearSample], area_mm2: f64) -> Self {
        let cell_of: Vec<Option<usize>> = samples.iter().map(|s| field.cell_at(s.at_mm)).collect();
        let mut start = vec![0_u32; field.wear_mm.len() + 1];
        for cell in cell_of.iter().flatten() {
            start[cell + 1] += 1;
        }
        for i in 1..start.len() {
            start[i] += start[i - 1];
        }
        let mut next = start.clone();
        let mut order = vec![0; start.last().map_or(0, |&n| n as usize)];
        for (i, cell) in cell_of.iter().enumerate() {
            if let Some(cell) = *cell {
                order[next[cell] as usize] = i as u32;
                next[cell] += 1;
            }
        }
        let column = |of: fn(&WearSample) -> f64| {
            let sorted = order.iter().map(|&i| of(&samples[i as usize]));
            sorted.collect::<Vec<f64>>()
        };
        let shares = start.array_windows().flat_map(|[from, to]| {
            let count = (to - from) as usize;
            std::iter::repeat_n(1.0 / count as f64, count)
        });
        Self {
            sorted: Sorted {
                x_mm: column(|sample| sample.at_mm[0]),
                y_mm: column(|sample| sample.at_mm[1]),
                wear_mm: column(|sample| sample.wear_mm),
                share: shares.collect(),
            },
            field,
            samples,
            order,
            start,
            unseen: Vec::new(),
            radius_mm: radius_mm(area_mm2),
        }
    }

    /// The same with the unseen share of each cell.
    pub fn with_unseen(self, unseen: Vec<Unseen>) -> Self {
        Self { unseen, ..self }
    }

    /// The cells.
    pub fn field(&self) -> &'a Field {
        self.field
    }

    /// The samples of a cell.
    pub fn of_cell(&self, cell: usize) -> impl Iterator<Item = &WearSample> {
        let range = self.start[cell] as usize..self.start[cell + 1] as usize;
        self.order[range].iter().map(|&i| &self.samples[i as usize])
    }

    /// Whether a disc fits into the zone at all.
    pub fn fits(&self) -> bool {
        self.field
            .size_mm()
            .iter()
            .all(|length| *length >= 2.0 * self.radius_mm)
    }

    /// Cells that a disc may touch, along one axis.
    fn touched(&self, axis: usize, middle_mm: f64) -> std::ops::Range<usize> {
        let count = [self.field.columns, self.field.rows][axis];
        let cell_mm = self.field.cell_mm[axis];
        let low = ((middle_mm - self.radius_mm) / cell_mm).floor().max(0.0) as usize;
        let high = ((middle_mm + self.radius_mm) / cell_mm).floor() as usize + 1;
        low..high.min(count)
    }

    /// Mean over the disc about `middle`, mm: of its measured part, times that part's share. Every measured cell counts by
    /// the share of its points that lie in the disc, wherever points are dense or sparse.
    fn mean_mm(&self, middle: [f64; 2], sign: f64) -> f64 {
        let [sum, weight] = with_widest(
            #[inline(always)]
            || self.sums(middle),
        );
        if weight == 0.0 {
            return 0.0;
        }
        sign * sum / weight * (1.0 - self.unmeasured_share(middle))
    }

    /// Sum of the wear over the disc about `middle`, every sample by its share of its cell, mm, and of these shares.
    #[inline(always)]
    fn sums(&self, middle: [f64; 2]) -> [f64; 2] {
        let squared = self.radius_mm * self.radius_mm;
        let columns = self.touched(0, middle[0]);
        let (mut sums, mut weights) = ([0.0; LANES], [0.0; LANES]);
        for row in self.touched(1, middle[1]) {
            // The cells of a row follow each other.
            let first = row * self.field.columns;
            let range = self.start[first + columns.start] as usize
                ..self.start[first + columns.end] as usize;
            let of = &self.sorted;
            let mut add = |lane: usize, [x, y, wear, share]: [f64; 4]| {
                let (x, y) = (x - middle[0], y - middle[1]);
                let share = if x * x + y * y <= squared { share } else { 0.0 };
                sums[lane] += share * wear;
                weights[lane] += share;
            };
            let [x, y, wear, share] = [&of.x_mm, &of.y_mm, &of.wear_mm, &of.share]
                .map(|column| column[range.clone()].as_chunks::<LANES>());
            for chunk in 0..x.0.len() {
                let [x, y] = [&x.0[chunk], &y.0[chunk]];
                let [wear, share] = [&wear.0[chunk], &share.0[chunk]];
                for lane in 0..LANES {
                    add(lane, [x[lane], y[lane], wear[lane], share[lane]]);
                }
            }
            for lane in 0..x.1.len() {
                add(lane, [x.1[lane], y.1[lane], wear.1[lane], share.1[lane]]);
            }
        }
        [sums, weights].map(|lanes| lanes.iter().sum())
    }

    /// Standard uncertainty of the mean over the disc about `middle` by where its points happen to lie, mm: on an edge of damage
    /// a point more on the one side or the other changes it. From how much the points of a cell differ beyond their noise;
    /// a slope leaves next to nothing within a cell.
    fn sampling_mm(&self, middle: [f64; 2], noise_scale: f64) -> f64 {
        let squared = self.radius_mm * self.radius_mm;
        let (mut variance, mut weight) = (0.0, 0.0);
        for row in self.touched(1, middle[1]) {
            for column in self.touched(0, middle[0]) {
                let cell = row * self.field.columns + column;
                let count = f64::from(self.start[cell + 1] - self.start[cell]);
                let inside = || {
                    self.of_cell(cell).filter(|sample| {
                        let [x, y] = [0, 1].map(|k| sample.at_mm[k] - middle[k]);
                        x * x + y * y <= squared
                    })
                };
                let n = inside().count() as f64;
                let share = n / count.max(1.0);
                weight += share;
                if n >= 2.0 {
                    let mean = inside().map(|s| s.wear_mm).sum::<f64>() / n;
                    let squares: f64 = inside().map(|s| (s.wear_mm - mean).powi(2)).sum();
                    let of_noise =
                        noise_scale * noise_scale * self.field.variance_mm2[cell] * count / n;
                    let of_mean = squares / (n - 1.0) / n;
                    variance += share * share * (of_mean - of_noise).max(0.0);
                }
            }
        }
        if weight > 0.0 {
            variance.sqrt() / weight
        } else {
            0.0
        }
    }

    /// Share of the disc about `middle` that lies in cells without points.
    fn unmeasured_share(&self, middle: [f64; 2]) -> f64 {
        let mut unmeasured = 0.0;
        for row in self.touched(1, middle[1]) {
            for column in self.touched(0, middle[0]) {
                let cell = row * self.field.columns + column;
                if self.start[cell + 1] == self.start[cell] {
                    let corner = [
                        column as f64 * self.field.cell_mm[0] - middle[0],
                        row as f64 * self.field.cell_mm[1] - middle[1],
                    ];
                    unmeasured += overlap_mm2(corner, self.field.cell_mm, self.radius_mm);
                }
            }
        }
        unmeasured / (std::f64::consts::PI * self.radius_mm * self.radius_mm)
    }

    /// Middles of the discs of the lattice.
    fn lattice(&self, axis: usize, steps_per_cell: usize) -> Vec<f64> {
        let length_mm = self.field.size_mm()[axis];
        let room_mm = length_mm - 2.0 * self.radius_mm;
        let step_mm = self.field.cell_mm[axis] / steps_per_cell as f64;
        let count = (room_mm / step_mm).ceil().max(1.0) as usize;
        // Both ends are tried.
        (0..=count)
            .map(|i| self.radius_mm + room_mm * i as f64 / count as f64)
            .collect()
    }

    /// The largest mean loss and the largest mean height of proud material. None when no disc fits.
    ///
    /// `noise_scale` is the ratio of the cells' noise to the stated one.
    pub fn largest(&self, noise_scale: f64) -> Option<[Peak; 2]> {
        if !self.fits() {
            return None;
        }
        let [columns, rows] = [0, 1].map(|axis| self.lattice(axis, STEPS_PER_CELL));
        let of_row = |&y: &f64| {
            let middles = columns.iter().map(move |&x| [x, y]);
            middles.map(|middle| (self.mean_mm(middle, 1.0), middle))
        };
        let mut tried: Vec<(f64, [f64; 2])> = rows.par_iter().flat_map_iter(of_row).collect();
        let loss = self.highest(tried.clone(), 1.0)?;
        for (mean, _) in &mut tried {
            *mean = -*mean;
        }
        let proud = self.highest(tried, -1.0)?;
        let noise = self.of_noise(noise_scale);
        let peak = |(raw_mm, at_mm), [bias_mm, scaled_bias_mm, scatter_mm]: [f64; 3]| Peak {
            raw_mm,
            at_mm,
            bias_mm,
            // Only the bias of the stated noise is subtracted: the excess over it might be wear.
            // Rectangular between the two.
            u_mm: scatter_mm
                .hypot((scaled_bias_mm - bias_mm) / 3f64.sqrt())
                .hypot(self.sampling_mm(at_mm, noise_scale)),
        };
        Some([peak(loss, noise[0]), peak(proud, noise[1])])
    }

    /// Climbs from the best of the discs tried.
    fn highest(&self, mut tried: Vec<(f64, [f64; 2])>, sign: f64) -> Option<(f64, [f64; 2])> {
        let count = CLIMBS.min(tried.len());
        tried.select_nth_unstable_by(count - 1, |a, b| b.0.total_cmp(&a.0));
        tried[..count]
            .iter()
            .map(|&from| self.climb(from, sign))
            .max_by(|a, b| a.0.total_cmp(&b.0))
    }

    /// To the largest mean near a place.
    fn climb(&self, from: (f64, [f64; 2]), sign: f64) -> (f64, [f64; 2]) {
        let size = self.field.size_mm();
        let mut best = from;
        let mut step_mm = self.field.cell_mm[0].min(self.field.cell_mm[1]) / STEPS_PER_CELL as f64;
        for _ in 0..HALVINGS {
            step_mm *= 0.5;
            let [x, y] = best.1;
            for [dx, dy] in [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]] {
                let middle = [x + dx * step_mm, y + dy * step_mm];
                let inside = (0..2)
                    .all(|k| (self.radius_mm..=size[k] - self.radius_mm).contains(&middle[k]));
                let mean = if inside {
                    self.mean_mm(middle, sign)
                } else {
                    f64::NEG_INFINITY
                };
                if mean > best.0 {
                    best = (mean, middle);
                }
            }
        }
        best
    }
}

/// Radius of a disc, mm.
pub(super) fn radius_mm(area_mm2: f64) -> f64 {
    (area_mm2 / std::f64::consts::PI).sqrt()
}
