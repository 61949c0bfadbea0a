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

use std::sync::LazyLock;

use flankscope_foundation::simd::with_widest;
use rayon::prelude::*;

use super::field::{Field, WearSample};
use super::unseen::Unseen;
use flankscope_foundation::random::normal;

/// Cells across a disc's diameter: the noise of cells and holes as small as this are told apart.
pub(super) const CELLS_ACROSS: f64 = 5.0;
/// Steps of the lattice per cell. With two no disc lies farther than 0.14 of its radius from one that is tried.
const STEPS_PER_CELL: usize = 2;
/// Places from which the largest mean is climbed to, and how often the step is halved.
const CLIMBS: usize = 6;
const HALVINGS: usize = 3;
/// Simulated captures: the scatter of a maximum is then known to 7 %.
const DRAWS: usize = 100;
/// Parts along each side of a cell by which its overlap with a disc is counted.
const PARTS: usize = 8;
/// Samples, or draws of noise, that are summed side by side. A fixed number, so that sums are the same on every processor.
const LANES: usize = 8;

/// Normal deviates, used over and over: the same for every flank, so that the same points give the same bytes.
static DEVIATES: LazyLock<Vec<f32>> =
    LazyLock::new(|| (0..1 << 16).map(|i| normal(0x5eed, i) as f32).collect());

/// Draws them in advance, which shortens the first evaluation.
pub(super) fn prepare() {
    LazyLock::force(&DEVIATES);
}

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

/// Overlaps of the cells around a cell with a disc on its middle: offsets and shares of the disc.
struct Kernel(Vec<([isize; 2], f64)>);

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

    /// Overlaps of a disc on the middle of a cell.
    fn kernel(&self) -> Kernel {
        let reach = [0, 1].map(|k| (self.radius_mm / self.field.cell_mm[k] + 0.5).floor() as isize);
        let mut overlaps = Vec::new();
        for row in -reach[1]..=reach[1] {
            for column in -reach[0]..=reach[0] {
                let corner = [
                    (column as f64 - 0.5) * self.field.cell_mm[0],
                    (row as f64 - 0.5) * self.field.cell_mm[1],
                ];
                let area = overlap_mm2(corner, self.field.cell_mm, self.radius_mm);
                if area > 0.0 {
                    overlaps.push(([column, row], area));
                }
            }
        }
        // The midpoint rule's error of the sum is no hole.
        let whole: f64 = overlaps.iter().map(|(_, area)| area).sum();
        for (_, share) in &mut overlaps {
            *share /= whole;
        }
        Kernel(overlaps)
    }

    /// Cells on whose middle a disc lies in the zone.
    fn middles(&self) -> Vec<[usize; 2]> {
        let within = |axis: usize| {
            let (length, cell) = (self.field.size_mm()[axis], self.field.cell_mm[axis]);
            let count = [self.field.columns, self.field.rows][axis];
            // A hundredth of a cell: where the disc just fits, rounding must not take the only place away.
            let slack = 0.01 * cell;
            (0..count).filter(move |&i| {
                let middle = (i as f64 + 0.5) * cell;
                middle >= self.radius_mm - slack && middle <= length - self.radius_mm + slack
            })
        };
        let columns: Vec<usize> = within(0).collect();
        within(1)
            .flat_map(|row| columns.iter().map(move |&column| [column, row]))
            .collect()
    }

    /// Bias of the maximum of loss and of proud material by noise, as stated and scaled; and the maximum's scatter by the
    /// scaled noise, mm. Both feel the same draws of noise, whose means over the discs are computed once.
    fn of_noise(&self, noise_scale: f64) -> [[f64; 3]; 2] {
        let kernel = self.kernel();
        let padded = Padded::new(self.field, &kernel);
        // Unmeasured cells contribute neither wear nor noise.
        let value = padded.pad(self.field.wear_mm.iter().copied());
        let sigma = padded.pad(self.field.variance_mm2.iter().map(|v| v.sqrt()));
        let places: Vec<usize> = self
            .middles()
            .into_iter()
            .map(|at| padded.index(at))
            .collect();
        let means: Vec<f32> = places.iter().map(|&at| padded.mean(&value, at)).collect();
        let largest = [1.0_f32, -1.0].map(|sign| {
            means
                .iter()
                .map(|mean| sign * mean)
                .fold(f32::NEG_INFINITY, f32::max)
        });
        if !largest.iter().all(|largest| largest.is_finite()) {
            return [[f64::NAN; 3]; 2];
        }
        // A disc so far below the largest that no noise lifts it above takes no part.
        let weights2: f64 = kernel.0.iter().map(|(_, share)| share * share).sum();
        let worst = f64::from(sigma.iter().copied().fold(0.0, f32::max)) * weights2.sqrt();
        let reach = (8.0 * worst * noise_scale) as f32;
        // A disc is no rival on a side where it starts at minus infinity.
        let rivals: Vec<(usize, [f32; 2])> = places
            .into_iter()
            .zip(means)
            .map(|(at, mean)| {
                let of = |k: usize, mean: f32| {
                    if mean >= largest[k] - reach {
                        mean
                    } else {
                        f32::NEG_INFINITY
                    }
                };
                (at, [of(0, mean), of(1, -mean)])
            })
            .filter(|(_, of)| of.iter().any(|mean| mean.is_finite()))
            .collect();
        let groups = (0..DRAWS.div_ceil(LANES)).into_par_iter().map(|group| {
            with_widest(
                #[inline(always)]
                || padded.most_by_noise(&sigma, group * LANES, &rivals, noise_scale as f32),
            )
        });
        let groups: Vec<_> = groups.collect();
        let mut lifts = [[[0.0_f64; 2]; DRAWS]; 2];
        for draw in 0..DRAWS {
            for side in 0..2 {
                let most = groups[draw / LANES][side].map(|lanes| lanes[draw % LANES]);
                lifts[side][draw] = most.map(|most| f64::from(most - largest[side]));
            }
        }
        lifts.map(|lifts| {
            let mean = |k: usize| lifts.iter().map(|l| l[k]).sum::<f64>() / DRAWS as f64;
            let scaled = mean(1);
            let squares: f64 = lifts.iter().map(|l| (l[1] - scaled).powi(2)).sum();
            [
                mean(0).max(0.0),
                scaled.max(0.0),
                (squares / (DRAWS - 1) as f64).sqrt(),
            ]
        })
    }

    /// The largest mean loss that any disc with unseen parts can have when holes and unseen parts lost what `of_hole` and
    /// `of_part` say of each cell, if that is more than was seen, mm; none when every disc was seen whole.
    fn with_holes(
        &self,
        of_hole: impl Fn(usize) -> f64,
        of_part: impl Fn(usize, Unseen) -> f64,
    ) -> Option<f64> {
        let (kernel, middles) = (self.kernel(), self.middles());
        let mut worst: Option<f64> = None;
        for [column, row] in middles {
            let (mut unseen, mut sum) = (0.0, 0.0);
            for &([dx, dy], share) in &kernel.0 {
                let (x, y) = (column as isize + dx, row as isize + dy);
                if !(0..self.field.columns as isize).contains(&x)
                    || !(0..self.field.rows as isize).contains(&y)
                {
                    continue;
                }
                let cell = y as usize * self.field.columns + x as usize;
                let wear = self.field.wear_mm[cell];
                if wear.is_finite() {
                    let part = self.unseen.get(cell).copied().unwrap_or_default();
                    let hidden = share * part.share;
                    unseen += hidden;
                    sum += share * wear + hidden * (of_part(cell, part) - wear).max(0.0);
                } else {
                    unseen += share;
                    sum += share * of_hole(cell);
                }
            }
            if unseen > 0.0 {
                worst = Some(worst.unwrap_or(f64::NEG_INFINITY).max(sum));
            }
        }
        worst
    }

    /// The largest mean loss that any disc can have when holes lost `depth_mm` and unseen parts of cells what is supposed of
    /// them, at most as much, mm; none when every disc was seen whole.
    pub fn hidden_mm(&self, depth_mm: f64) -> Option<f64> {
        self.with_holes(|_| depth_mm, |_, part| part.depth_mm.min(depth_mm))
    }

    /// The same when every hole is as deep as the deepest cell at its rim.
    pub fn as_rims_mm(&self) -> Option<f64> {
        let rims_mm = self.rims_mm();
        self.with_holes(|cell| rims_mm[cell], |cell, _| rims_mm[cell])
    }

    /// The same, but cells hidden by walls lost the supposed depth, at most `depth_mm`.
    pub fn behind_walls_mm(&self, depth_mm: f64) -> Option<f64> {
        let rims_mm = self.rims_mm();
        let of_part = |cell: usize, part: Unseen| match part.behind_walls {
            true => part.depth_mm.min(depth_mm),
            false => rims_mm[cell],
        };
        self.with_holes(|cell| rims_mm[cell], of_part)
    }

    /// Wear of the deepest cell around each cell, or around the hole that it lies in, mm.
    fn rims_mm(&self) -> Vec<f64> {
        let field = self.field;
        let holes = field.groups(|i| !field.wear_mm[i].is_finite());
        let mut depth = vec![0.0_f64; field.wear_mm.len()];
        for (i, depth) in depth.iter_mut().enumerate() {
            *depth = field
                .around(i)
                .map(|c| field.wear_mm[c])
                .fold(0.0, f64::max);
        }
        for hole in holes {
            let rim = hole.iter().flat_map(|&i| field.around(i));
            // f64::max passes over the cells of the hole itself.
            let deepest = rim.map(|i| field.wear_mm[i]).fold(0.0, f64::max);
            for i in hole {
                depth[i] = deepest;
            }
        }
        depth
    }
}

/// Cells with a margin as wide as a disc, so that a mean over a disc needs no check of the zone's border.
struct Padded {
    columns: usize,
    rows: usize,
    margin: [usize; 2],
    /// Steps to the cells of a disc, and their shares of it.
    steps: Vec<(isize, f32)>,
}

impl Padded {
    fn new(field: &Field, kernel: &Kernel) -> Self {
        let margin = [0, 1].map(|k| {
            let reach = kernel.0.iter().map(|(step, _)| step[k].unsigned_abs());
            reach.max().unwrap_or(0)
        });
        let columns = field.columns + 2 * margin[0];
        let step =
            |&([dx, dy], share): &([isize; 2], f64)| (dy * columns as isize + dx, share as f32);
        Self {
            columns,
            rows: field.rows + 2 * margin[1],
            margin,
            steps: kernel.0.iter().map(step).collect(),
        }
    }

    fn index(&self, [column, row]: [usize; 2]) -> usize {
        (row + self.margin[1]) * self.columns + column + self.margin[0]
    }

    /// A field's cells; zero where they are not finite.
    fn pad(&self, cells: impl Iterator<Item = f64>) -> Vec<f32> {
        let mut padded = vec![0.0; self.columns * self.rows];
        let inner = self.columns - 2 * self.margin[0];
        for (i, value) in cells.enumerate().filter(|(_, value)| value.is_finite()) {
            padded[self.index([i % inner, i / inner])] = value as f32;
        }
        padded
    }

    /// Mean over the disc on a cell of the zone.
    fn mean(&self, cells: &[f32], at: usize) -> f32 {
        let cell = |step: isize| cells[at.wrapping_add_signed(step)];
        self.steps
            .iter()
            .map(|&(step, share)| share * cell(step))
            .sum()
    }

    /// The largest mean of any rival in each of so many draws of noise from `first_draw` on, by side: with the noise as stated, and scaled.
    #[inline(always)]
    fn most_by_noise(
        &self,
        sigma: &[f32],
        first_draw: usize,
        rivals: &[(usize, [f32; 2])],
        noise_scale: f32,
    ) -> [[[f32; LANES]; 2]; 2] {
        let deviates = &*DEVIATES;
        let mut noise = vec![[0.0_f32; LANES]; sigma.len()];
        for lane in 0..LANES {
            let first = (first_draw + lane) * sigma.len();
            for (i, noise) in noise.iter_mut().enumerate() {
                noise[lane] = sigma[i] * deviates[(first + i) % deviates.len()];
            }
        }
        let mut most = [[[f32::NEG_INFINITY; LANES]; 2]; 2];
        for &(at, means) in rivals {
            let mut of_noise = [0.0_f32; LANES];
            for &(step, share) in &self.steps {
                let cell = &noise[at.wrapping_add_signed(step)];
                for lane in 0..LANES {
                    of_noise[lane] += share * cell[lane];
                }
            }
            for side in 0..2 {
                for (k, scale) in [1.0, noise_scale].into_iter().enumerate() {
                    let most = &mut most[side][k];
                    for lane in 0..LANES {
                        let mean = means[side] + scale * of_noise[lane];
                        most[lane] = if mean > most[lane] { mean } else { most[lane] };
                    }
                }
            }
        }
        most
    }
}

/// Radius of a disc, mm.
pub(super) fn radius_mm(area_mm2: f64) -> f64 {
    (area_mm2 / std::f64::consts::PI).sqrt()
}

/// Area that a rectangle shares with a disc about the origin, mm2; exact along one axis, by the midpoint rule along the other.
fn overlap_mm2(corner: [f64; 2], size: [f64; 2], radius_mm: f64) -> f64 {
    let strip = size[1] / PARTS as f64;
    (0..PARTS)
        .map(|i| {
            let y = corner[1] + (i as f64 + 0.5) * strip;
            let half = (radius_mm * radius_mm - y * y).max(0.0).sqrt();
            strip * (half.min(corner[0] + size[0]) - (-half).max(corner[0])).max(0.0)
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    impl Discs<'_> {
        /// One side alone, step by step: what [`Discs::largest`] has to equal. The largest mean loss (`sign` 1) or the largest
        /// mean height of proud material (-1). None when no disc fits.
        ///
        /// `noise_scale` is the ratio of the cells' noise to the stated one.
        fn largest_of(&self, sign: f64, noise_scale: f64) -> Option<Peak> {
            if !self.fits() {
                return None;
            }
            let [columns, rows] = [0, 1].map(|axis| self.lattice(axis, STEPS_PER_CELL));
            let mut tried: Vec<(f64, [f64; 2])> = Vec::with_capacity(columns.len() * rows.len());
            for &y in &rows {
                for &x in &columns {
                    tried.push((self.mean_mm([x, y], sign), [x, y]));
                }
            }
            let count = CLIMBS.min(tried.len());
            tried.select_nth_unstable_by(count - 1, |a, b| b.0.total_cmp(&a.0));
            let (raw_mm, at_mm) = tried[..count]
                .iter()
                .map(|&from| self.climb(from, sign))
                .max_by(|a, b| a.0.total_cmp(&b.0))?;
            let [bias_mm, scaled_bias_mm, scatter_mm] = self.of_noise_of(sign, noise_scale);
            Some(Peak {
                raw_mm,
                at_mm,
                bias_mm,
                // Only the bias of the stated noise is subtracted: the excess over it might be wear.
                // Rectangular between the two.
                u_mm: scatter_mm
                    .hypot((scaled_bias_mm - bias_mm) / 3f64.sqrt())
                    .hypot(self.sampling_mm(at_mm, noise_scale)),
            })
        }

        /// By how much noise lifts the maximum: as stated, scaled; and the maximum's scatter by the scaled noise, mm.
        fn of_noise_of(&self, sign: f64, noise_scale: f64) -> [f64; 3] {
            let kernel = self.kernel();
            let padded = Padded::new(self.field, &kernel);
            // Unmeasured cells contribute neither wear nor noise.
            let value = padded.pad(self.field.wear_mm.iter().map(|&w| sign * w));
            let sigma = padded.pad(self.field.variance_mm2.iter().map(|v| v.sqrt()));
            let places: Vec<usize> = self
                .middles()
                .into_iter()
                .map(|at| padded.index(at))
                .collect();
            let means: Vec<f32> = places.iter().map(|&at| padded.mean(&value, at)).collect();
            let largest = means.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            if !largest.is_finite() {
                return [f64::NAN; 3];
            }
            // A disc so far below the largest that no noise lifts it above takes no part.
            let weights2: f64 = kernel.0.iter().map(|(_, share)| share * share).sum();
            let worst = f64::from(sigma.iter().copied().fold(0.0, f32::max)) * weights2.sqrt();
            let reach = (8.0 * worst * noise_scale) as f32;
            let rivals: Vec<(usize, f32)> = places
                .into_iter()
                .zip(means)
                .filter(|(_, mean)| *mean >= largest - reach)
                .collect();
            let deviates = &*DEVIATES;
            let mut lifts = [[0.0_f64; 2]; DRAWS];
            let mut noise = vec![0.0_f32; sigma.len()];
            for (draw, lift) in lifts.iter_mut().enumerate() {
                for (i, noise) in noise.iter_mut().enumerate() {
                    *noise = sigma[i] * deviates[(draw * sigma.len() + i) % deviates.len()];
                }
                let mut most = [f32::NEG_INFINITY; 2];
                for &(at, mean) in &rivals {
                    let of_noise = padded.mean(&noise, at);
                    most = [
                        most[0].max(mean + of_noise),
                        most[1].max(mean + noise_scale as f32 * of_noise),
                    ];
                }
                *lift = most.map(|m| f64::from(m - largest));
            }
            let mean = |k: usize| lifts.iter().map(|l| l[k]).sum::<f64>() / DRAWS as f64;
            let scaled = mean(1);
            let squares: f64 = lifts.iter().map(|l| (l[1] - scaled).powi(2)).sum();
            [
                mean(0).max(0.0),
                scaled.max(0.0),
                (squares / (DRAWS - 1) as f64).sqrt(),
            ]
        }
    }

    #[test]
    fn both_sides_at_once_are_as_each_alone() {
        for seed in 0..12 {
            let mut field = Field::unmeasured([1.7, 6.0], 0.11);
            let samples: Vec<WearSample> = (0..6000)
                .map(|i| {
                    let u = |k: u64| flankscope_foundation::random::uniform(seed, 3 * i + k);
                    let at_mm = [1.7 * u(0), 6.0 * u(1)];
                    let step = if at_mm[1] > 4.0 && seed % 3 == 0 {
                        0.05
                    } else {
                        0.0
                    };
                    WearSample::of_point(at_mm, step + 1e-3 * normal(seed + 50, i), 0.25e-6)
                })
                .filter(|s| seed % 2 == 0 || s.at_mm[0] < 1.2 || s.at_mm[1] > 2.0)
                .collect();
            let mut sums = vec![[0.0; 3]; field.wear_mm.len()];
            for s in &samples {
                if let Some(cell) = field.cell_at(s.at_mm) {
                    sums[cell][0] += 1.0;
                    sums[cell][1] += s.wear_mm;
                    sums[cell][2] += s.variance_mm2;
                }
            }
            for (i, [n, wear, variance]) in sums.into_iter().enumerate() {
                field.wear_mm[i] = wear / n;
                field.variance_mm2[i] = variance / (n * n);
            }
            let discs = Discs::new(&field, &samples, 0.25);
            let both = discs.largest(1.7).unwrap();
            let alone = [1.0, -1.0].map(|sign| discs.largest_of(sign, 1.7).unwrap());
            assert_eq!(both, alone, "{seed}");
        }
    }
}
