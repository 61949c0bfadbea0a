//! A flank's zone cell by cell: stored in a baseline, drawn in reports, and searched for unmeasured areas.

use flankscope_foundation::order::{SIGMA_PER_MAD, median};
use serde::{Deserialize, Serialize};

use super::unseen::Unseen;

/// Cells of profile length by height, row by row from the lowest; NaN where nothing was measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Field {
    /// Cells along the profile.
    pub columns: usize,
    /// Cells along the height.
    pub rows: usize,
    /// Size of a cell along profile and height, mm.
    pub cell_mm: [f64; 2],
    /// Mean wear of each cell, mm, positive for loss.
    #[serde(with = "nan_as_null")]
    pub wear_mm: Vec<f64>,
    /// Variance of each mean from noise alone, mm2.
    #[serde(with = "nan_as_null")]
    pub variance_mm2: Vec<f64>,
}

/// One point in a zone, or the mean of several near to each other: its place from the zone's corner (along the profile, up the
/// height), its wear, and the variance of that by noise (NaN where it is not stated).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct WearSample {
    pub at_mm: [f64; 2],
    pub wear_mm: f64,
    pub variance_mm2: f64,
    /// Number of points whose mean it is.
    pub merged: f64,
    /// Sum of their squared differences from it, mm2.
    pub within_mm2: f64,
    /// Sum of their cubed differences from it, mm3.
    pub cubes_mm3: f64,
}

impl WearSample {
    /// A single point.
    pub fn of_point(at_mm: [f64; 2], wear_mm: f64, variance_mm2: f64) -> Self {
        Self {
            at_mm,
            wear_mm,
            variance_mm2,
            merged: 1.0,
            within_mm2: 0.0,
            cubes_mm3: 0.0,
        }
    }

    /// Sum of the cubed residuals of its points if their mean has this residual, mm3.
    pub fn cubes_about_mm3(&self, residual_mm: f64) -> f64 {
        self.merged * residual_mm.powi(3) + 3.0 * residual_mm * self.within_mm2 + self.cubes_mm3
    }
}

/// Two fields that cannot be compared.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error(
    "the reference has {}x{} cells of {:.4} x {:.4} mm, this zone {}x{} of {:.4} x {:.4} mm; record the baseline again with the same zone and wear area",
    theirs.0, theirs.1, theirs.2[0], theirs.2[1], ours.0, ours.1, ours.2[0], ours.2[1]
)]
pub struct Mismatch {
    ours: (usize, usize, [f64; 2]),
    theirs: (usize, usize, [f64; 2]),
}

/// A groove of one or two cells.
struct Groove {
    /// Its cells.
    run: Vec<usize>,
    /// Their depth in all below what lies on either side, mm.
    read_mm: f64,
    /// Wear of what lies on either side, mm.
    level_mm: f64,
    /// It has the rim of the zone for one side.
    is_at_rim: bool,
}

/// Light would come back from an opening without a visible floor from this much deeper than it does from a groove whose floor counts as
/// seen. Of ten points spread evenly over a wall the ratio of their moments tells its end to 11 % (standard deviation).
const FLOOR_SEEN: f64 = 1.15;
/// Least number of second differences for an estimate of noise.
const LEAST_DIFFERENCES: usize = 8;
/// A cell counts as a groove beyond so many standard deviations of noise: of the five thousand pairs of neighbours in a zone
/// none passes by chance.
const GROOVE_SIGMAS: f64 = 5.0;
/// Cells from the deepest cell of a groove of at most two to a cell beside it.
const GROOVE_SIDE: isize = 3;
/// All that an opening with an unseen floor reads lies on its far wall: in one cell, or in two where that is their border.
const MOST_GROOVE_CELLS: f64 = 2.0;

impl Field {
    /// A field without measurements: as many cells as fit, none smaller than `cell_mm`.
    pub(super) fn unmeasured(size_mm: [f64; 2], cell_mm: f64) -> Self {
        let [columns, rows] =
            size_mm.map(|length_mm| ((length_mm / cell_mm).floor() as usize).clamp(1, 10_000));
        Self {
            columns,
            rows,
            cell_mm: [size_mm[0] / columns as f64, size_mm[1] / rows as f64],
            wear_mm: vec![f64::NAN; columns * rows],
            variance_mm2: vec![f64::NAN; columns * rows],
        }
    }

    /// Sets every cell to the mean of its points; the noise variance of `reference`'s cells is added to that of the own ones.
    pub(super) fn average(&mut self, samples: &[WearSample], reference: Option<&Self>) {
        let mut sums = vec![[0.0_f64; 3]; self.wear_mm.len()];
        for sample in samples {
            if let Some(cell) = self.cell_at(sample.at_mm) {
                let [n, wear, variance] = sums[cell];
                sums[cell] = [
                    n + 1.0,
                    wear + sample.wear_mm,
                    variance + sample.variance_mm2,
                ];
            }
        }
        for (i, [n, wear, variance]) in sums.into_iter().enumerate() {
            let of_reference = reference.map_or(0.0, |r| r.variance_mm2[i]);
            // 0 / 0: not measured.
            self.wear_mm[i] = wear / n;
            self.variance_mm2[i] = variance / (n * n) + of_reference;
        }
    }

    /// Number of the cell around a place; none outside the zone.
    pub(super) fn cell_at(&self, at_mm: [f64; 2]) -> Option<usize> {
        let [column, row] = [0, 1].map(|k| at_mm[k] / self.cell_mm[k]);
        (column >= 0.0 && row >= 0.0)
            .then_some([column as usize, row as usize])
            .filter(|&[column, row]| column < self.columns && row < self.rows)
            .map(|[column, row]| row * self.columns + column)
    }

    /// Size of the zone along profile and height, mm.
    pub(super) fn size_mm(&self) -> [f64; 2] {
        [
            self.columns as f64 * self.cell_mm[0],
            self.rows as f64 * self.cell_mm[1],
        ]
    }

    /// Area of a cell, mm2.
    pub fn cell_area_mm2(&self) -> f64 {
        self.cell_mm[0] * self.cell_mm[1]
    }

    /// Measured cells.
    pub fn measured(&self) -> impl Iterator<Item = usize> {
        (0..self.wear_mm.len()).filter(|&i| self.wear_mm[i].is_finite())
    }

    /// Measured share of the zone.
    pub fn coverage(&self) -> f64 {
        self.measured().count() as f64 / self.wear_mm.len().max(1) as f64
    }

    /// Area of the measured cells that lost more than `depth_mm`, mm2.
    pub fn area_beyond_mm2(&self, depth_mm: f64) -> f64 {
        self.cell_area_mm2() * self.wear_mm.iter().filter(|&&w| w > depth_mm).count() as f64
    }

    /// # Errors
    /// The grids differ.
    pub(super) fn same_grid(&self, other: &Self) -> Result<(), Mismatch> {
        let shape = |f: &Self| (f.columns, f.rows, f.cell_mm);
        let near = (0..2).all(|k| (self.cell_mm[k] - other.cell_mm[k]).abs() < 1e-9);
        let full = other.wear_mm.len() == other.columns.saturating_mul(other.rows)
            && other.variance_mm2.len() == other.wear_mm.len();
        if near && full && (self.columns, self.rows) == (other.columns, other.rows) {
            Ok(())
        } else {
            Err(Mismatch {
                ours: shape(self),
                theirs: shape(other),
            })
        }
    }

    /// Ratio of the cells' noise to the stated one, from second differences of cells that follow each other along
    /// the height: a slope of any steepness leaves none, an edge only where it runs, and the median passes over those. At
    /// least 1: what is stated is photon noise, which nothing takes away.
    pub(super) fn noise_scale(&self) -> f64 {
        let mut sizes: Vec<f64> = Vec::new();
        for i in self.columns..self.wear_mm.len().saturating_sub(self.columns) {
            let [a, b, c] = [i - self.columns, i, i + self.columns];
            let difference = self.wear_mm[a] - 2.0 * self.wear_mm[b] + self.wear_mm[c];
            let variance = self.variance_mm2[a] + 4.0 * self.variance_mm2[b] + self.variance_mm2[c];
            let size = difference.abs() / variance.sqrt();
            if size.is_finite() {
                sizes.push(size);
            }
        }
        if sizes.len() < LEAST_DIFFERENCES {
            return 1.0;
        }
        median(&mut sizes).map_or(1.0, |size| (SIGMA_PER_MAD * size).max(1.0))
    }

    /// Share of each cell that a single opening with an unseen floor may take up.
    ///
    /// An opening too narrow for the camera to see its floor reads as a shallow groove: of width `w`, seen at an angle to the
    /// normal whose tangent is `slant`, its wall shows down to `w / slant`, and over cells of width `b` that reads
    /// `w² / (2 slant b)` in all. So a groove of one or two cells' width that reads `r` in all may be as wide as
    /// `√(2 r slant b)`, and nothing says how deep. But then depths up to `w / slant` must have come back: a groove from
    /// which light came back from clearly higher only (`reached_mm`, of its cells, below a level) shows its floor. In a wider one
    /// the rays tell (see `sight.rs`).
    ///
    /// `noise_scale` is the ratio of the cells' noise to the stated one.
    pub(super) fn grooves(
        &self,
        slant: f64,
        noise_scale: f64,
        reached_mm: impl Fn(&[usize], f64) -> f64,
    ) -> Vec<Unseen> {
        let cell_mm = self.cell_area_mm2().sqrt();
        let mut all = vec![Unseen::default(); self.wear_mm.len()];
        for cell in 0..self.wear_mm.len() {
            for step in [[1, 0], [0, 1], [1, 1], [1, -1]] {
                let Some(Groove {
                    run,
                    read_mm,
                    level_mm,
                    is_at_rim,
                }) = self.groove(cell, step, noise_scale)
                else {
                    continue;
                };
                let width_mm = (2.0 * read_mm * slant * cell_mm).sqrt();
                // Points along the groove: a cell has too few.
                let near = run.iter().flat_map(|&c| self.window(c, 1));
                let mut near: Vec<usize> = near.collect();
                near.sort_unstable();
                near.dedup();
                if FLOOR_SEEN * reached_mm(&near, level_mm) * slant < width_mm {
                    continue;
                }
                // Of a wall on the rim half of the points may lie outside of the zone.
                let width_mm = if is_at_rim {
                    2f64.sqrt() * width_mm
                } else {
                    width_mm
                };
                let share = width_mm / cell_mm / run.len() as f64;
                let unseen = Unseen::opening(share, width_mm, level_mm.max(0.0));
                for of in run {
                    if unseen.share > all[of].share {
                        all[of] = unseen;
                    }
                }
            }
        }
        all
    }

    /// Slopes of a cell and the cells around it along profile and height, each by least squares as if the other were
    /// none, which holds but for missing cells.
    pub(super) fn slopes(&self, cell: usize) -> [f64; 2] {
        let place = |c: usize, axis: usize| {
            let index = if axis == 0 {
                c % self.columns
            } else {
                c / self.columns
            };
            index as f64 * self.cell_mm[axis]
        };
        let along = |axis: usize| {
            let known = self
                .window(cell, 1)
                .filter(|&c| self.wear_mm[c].is_finite());
            let [mut count, mut x, mut w, mut xx, mut xw] = [0.0; 5];
            for c in known {
                let (at, wear) = (place(c, axis), self.wear_mm[c]);
                count += 1.0;
                x += at;
                w += wear;
                xx += at * at;
                xw += at * wear;
            }
            let spread = count * xx - x * x;
            if spread > 0.0 {
                (count * xw - x * w) / spread
            } else {
                0.0
            }
        };
        [along(0), along(1)]
    }

    /// The size of both.
    pub(super) fn slope(&self, cell: usize) -> f64 {
        let [along, up] = self.slopes(cell);
        along.hypot(up)
    }

    /// By how much the surface about one border of the block of nine cells lies deeper than about the opposite one, mm: the larger one of
    /// profile and height. Nought where either was not seen.
    pub(super) fn step_mm(&self, cell: usize) -> f64 {
        let (column, row) = (cell % self.columns, cell / self.columns);
        let depth = |column: Option<usize>, row: Option<usize>| {
            let (column, row) = (column?, row?);
            (column < self.columns && row < self.rows)
                .then(|| self.wear_mm[row * self.columns + column])
        };
        // Two cells to each side of a border, three along it.
        let border = |axis: usize, sign: isize| {
            let places =
                (1..3_isize).flat_map(|away| (-1..2_isize).map(move |along| [sign * away, along]));
            let depths = places.filter_map(|step| {
                let [across, up] = [step[axis], step[1 - axis]];
                depth(
                    column.checked_add_signed(across),
                    row.checked_add_signed(up),
                )
            });
            let (sum, count) = depths
                .filter(|mm| mm.is_finite())
                .fold((0.0, 0.0), |(sum, count), mm| (sum + mm, count + 1.0));
            sum / count
        };
        let step = |axis: usize| (border(axis, 1) - border(axis, -1)).abs();
        // The larger of a number and NaN is the number.
        step(0).max(step(1)).max(0.0)
    }

    /// The cells up to so many columns and rows away, and the cell itself.
    pub(super) fn window(&self, cell: usize, reach: usize) -> impl Iterator<Item = usize> + use<> {
        let (column, row) = (cell % self.columns, cell / self.columns);
        let rows = row.saturating_sub(reach)..(row + reach + 1).min(self.rows);
        let columns = column.saturating_sub(reach)..(column + reach + 1).min(self.columns);
        let across = self.columns;
        rows.flat_map(move |row| columns.clone().map(move |c| row * across + c))
    }

    /// Whether the zone has a cell so many columns and rows from `cell`.
    fn has(&self, cell: usize, [across, up]: [isize; 2]) -> bool {
        let within = |at: usize, by: isize, count: usize| {
            at.checked_add_signed(by).is_some_and(|there| there < count)
        };
        within(cell % self.columns, across, self.columns)
            && within(cell / self.columns, up, self.rows)
    }

    /// The groove across which `cell` is the deepest going by `step`. None where there is none, or a wider one, or a step from one
    /// level to another.
    fn groove(&self, cell: usize, [across, up]: [isize; 2], noise_scale: f64) -> Option<Groove> {
        let at = |steps: isize| {
            let column = (cell % self.columns).checked_add_signed(steps * across)?;
            let row = (cell / self.columns).checked_add_signed(steps * up)?;
            let there = row * self.columns + column;
            (column < self.columns && row < self.rows && self.wear_mm[there].is_finite())
                .then_some(there)
        };
        // Beyond a groove of two cells wherever it lies; near the zone's rim the last cell that there is, but not slantwise, where
        // a corner would cut a wider groove in two.
        let nearest = if across * up == 0 { 1 } else { GROOVE_SIDE };
        let level = |c: usize| (self.wear_mm[c], self.variance_mm2[c]);
        let side = |sign: isize| {
            let mut cells = (nearest..=GROOVE_SIDE).rev();
            cells.find_map(|k| at(sign * k)).map(level)
        };
        // An opening along the rim has one side. Beyond the rim the surface is supposed to go on as it slopes there.
        let beyond_rim = |sign: isize| {
            let is_rim = across * up == 0 && !self.has(cell, [sign * across, sign * up]);
            let [near, far] = [GROOVE_SIDE, 2 * GROOVE_SIDE].map(|k| at(-sign * k).map(level));
            let (near, far) = (near.filter(|_| is_rim)?, far.or(near)?);
            Some((2.0 * near.0 - far.0, 4.0 * near.1 + far.1))
        };
        let sides = [side(-1), side(1)];
        let (before, behind) = (
            sides[0].or_else(|| beyond_rim(-1))?,
            sides[1].or_else(|| beyond_rim(1))?,
        );
        let low = before.0.min(behind.0);
        let level_mm = before.0.max(behind.0);
        let depth_mm = self.wear_mm[cell] - level_mm;
        let beside_mm2 = before.1.max(behind.1);
        let noise_mm = noise_scale * (self.variance_mm2[cell] + beside_mm2).sqrt();
        // Comparisons with NaN are false: no groove. Beside a step there is a ripple; what its wall hides the rays tell.
        if !(depth_mm > GROOVE_SIGMAS * noise_mm && depth_mm > level_mm - low) {
            return None;
        }
        let within: Vec<(usize, f64)> = (1 - GROOVE_SIDE..GROOVE_SIDE)
            .filter_map(at)
            .map(|c| (c, (self.wear_mm[c] - level_mm).max(0.0)))
            .collect();
        let read_mm: f64 = within.iter().map(|(_, mm)| mm).sum();
        let deepest = within.iter().all(|(_, mm)| *mm <= depth_mm);
        (deepest && read_mm <= MOST_GROOVE_CELLS * depth_mm).then(|| {
            let most = within.iter().filter(|(_, mm)| *mm > 0.5 * depth_mm);
            Groove {
                run: most.map(|(c, _)| *c).collect(),
                read_mm,
                level_mm,
                is_at_rim: sides.contains(&None),
            }
        })
    }

    /// The cells that share a side or a corner with a cell.
    pub(super) fn around(&self, cell: usize) -> impl Iterator<Item = usize> + use<> {
        self.window(cell, 1).filter(move |&other| other != cell)
    }

    /// Groups of touching cells that pass `member`.
    pub(super) fn groups(&self, member: impl Fn(usize) -> bool) -> Vec<Vec<usize>> {
        let mut open: Vec<bool> = (0..self.wear_mm.len()).map(member).collect();
        let mut groups = Vec::new();
        for start in 0..open.len() {
            if !std::mem::take(&mut open[start]) {
                continue;
            }
            let mut group = vec![start];
            let mut next = 0;
            while let Some(&i) = group.get(next) {
                next += 1;
                for other in self.around(i) {
                    if std::mem::take(&mut open[other]) {
                        group.push(other);
                    }
                }
            }
            groups.push(group);
        }
        groups
    }
}

/// JSON has no NaN: an unmeasured cell is null there.
mod nan_as_null {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub fn serialize<S: Serializer>(values: &[f64], serializer: S) -> Result<S::Ok, S::Error> {
        let options: Vec<Option<f64>> =
            values.iter().map(|v| v.is_finite().then_some(*v)).collect();
        options.serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<f64>, D::Error> {
        let options = Vec::<Option<f64>>::deserialize(deserializer)?;
        Ok(options.into_iter().map(|v| v.unwrap_or(f64::NAN)).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flankscope_foundation::random::normal;

    /// Cells with noise of one millionth on a shape.
    fn field(shape: impl Fn(f64, f64) -> f64) -> Field {
        let mut field = Field::unmeasured([1.6, 8.0], 0.1);
        for i in 0..field.wear_mm.len() {
            let (x, y) = ((i % field.columns) as f64, (i / field.columns) as f64);
            field.wear_mm[i] = shape(x, y) + 1e-6 * normal(7, i as u64);
            field.variance_mm2[i] = 1e-12;
        }
        field
    }

    #[test]
    fn structure_is_no_noise() {
        // 1 280 second differences tell a standard deviation to about 3 %; the floor is what is stated.
        let scale = |shape: fn(f64, f64) -> f64| field(shape).noise_scale();
        assert!(scale(|_, _| 0.05) < 1.1);
        assert!(scale(|x, y| 0.01 * x - 0.03 * y) < 1.1);
        assert!(scale(|_, y| if y > 40.0 { 0.2 } else { 0.0 }) < 1.2);
        assert!(
            scale(|x, y| if (x - 8.0).hypot(y - 40.0) < 9.0 {
                0.2
            } else {
                0.0
            }) < 1.3
        );
        // Scatter from cell to cell without a trend is noise.
        let mut rough = field(|_, _| 0.0);
        for (i, w) in rough.wear_mm.iter_mut().enumerate() {
            *w = 4e-6 * normal(3, i as u64);
        }
        let found = rough.noise_scale();
        assert!((found - 4.0).abs() < 0.5, "{found}");
    }

    const SLANT: f64 = 1.7;

    /// Cells of 0.1 mm along the height as a camera sees them that looks along x: rays to a plane with an opening in it, each
    /// followed to the opening's far wall or floor, and its depth counted where that lies.
    fn seen_through(opening_mm: [f64; 2], depth_mm: f64, with_noise: bool) -> Field {
        let [from, to] = opening_mm;
        let mut sums = [(0.0, 0.0); 16];
        for ray in 0..16_000 {
            let x = 1e-4 * (f64::from(ray) + 0.5);
            let (foot, depth) = if !(from..to).contains(&x) {
                (x, 0.0)
            } else if (to - x) / SLANT < depth_mm {
                (to - 1e-9, (to - x) / SLANT)
            } else {
                (x + depth_mm * SLANT, depth_mm)
            };
            let sum = &mut sums[(foot / 0.1) as usize];
            *sum = (sum.0 + depth, sum.1 + 1.0);
        }
        let mut field = field(|x, _| sums[x as usize].0 / f64::max(sums[x as usize].1, 1.0));
        if !with_noise {
            for (i, wear) in field.wear_mm.iter_mut().enumerate() {
                *wear = sums[i % 16].0 / f64::max(sums[i % 16].1, 1.0);
            }
        }
        field
    }

    /// The depth from which light comes back out of an opening of that width.
    fn reached_mm(width_mm: f64) -> impl Fn(&[usize], f64) -> f64 {
        move |_, _| width_mm / SLANT
    }

    #[test]
    fn an_opening_with_an_unseen_floor_is_found_as_wide_as_it_is() {
        for (width_mm, offset_mm) in [
            (0.03, 0.01),
            (0.05, 0.02),
            (0.08, 0.005),
            (0.08, 0.06),
            (0.1, 0.0),
            (0.1, 0.05),
        ] {
            let from = 0.7 + offset_mm;
            let field = seen_through([from, from + width_mm], 1.0, true);
            let openings = field.grooves(SLANT, 1.0, reached_mm(width_mm));
            let row: f64 = openings[16 * 40..16 * 41].iter().map(|o| o.share).sum();
            // Across the border of two cells up to twice as many points share what the opening reads.
            assert!(
                0.1 * row > 0.7 * width_mm && 0.1 * row < 1.02 * width_mm,
                "{width_mm} at {offset_mm}: {}",
                0.1 * row
            );
        }
    }

    fn first_opening(
        field: &Field,
        reached_mm: impl Fn(&[usize], f64) -> f64,
    ) -> Option<[usize; 2]> {
        let openings = field.grooves(SLANT, 1.0, reached_mm);
        let found = openings.iter().position(|opening| opening.share > 0.0);
        found.map(|at| [at % 16, at / 16])
    }

    #[test]
    fn what_is_seen_to_its_floor_is_no_opening() {
        // A scratch three cells wide, a slope, a step, a flat flank, a bowl: whatever the deepest point.
        let scratch = seen_through([0.65, 0.95], 0.02, true);
        let shapes = [
            scratch,
            field(|x, _| 0.004 * x),
            field(|_, y| if y > 40.0 { 0.2 } else { 0.0 }),
            field(|_, _| 0.0),
            field(|x, y| (0.05 - 2e-3 * ((x - 8.0).powi(2) + (y - 40.0).powi(2))).max(0.0)),
        ];
        for (k, shape) in shapes.iter().enumerate() {
            let found = first_opening(shape, |_, _| f64::INFINITY);
            assert_eq!(found, None, "{k}: {:?}", &shape.wear_mm[..16]);
        }
        // A groove of one cell 15 µm deep all over would have to be 0.07 mm wide if its floor were hidden, and light would come
        // back from 42 µm.
        let hairline = field(|x, _| if x == 7.0 { 15e-3 } else { 0.0 });
        assert_eq!(first_opening(&hairline, |_, _| 16e-3), None);
        assert!(first_opening(&hairline, |_, _| 40e-3).is_some());
        // But where the noise is larger than what it reads, nothing is said.
        let mut loud = seen_through([0.72, 0.75], 1.0, false);
        let read_mm = loud.wear_mm.iter().copied().fold(0.0, f64::max);
        loud.variance_mm2.fill((0.2 * read_mm).powi(2));
        assert_eq!(first_opening(&loud, reached_mm(0.03)), None);
    }

    #[test]
    fn cells_cover_the_zone_and_nothing_else() {
        let field = Field::unmeasured([1.0, 0.5], 0.1);
        assert_eq!((field.columns, field.rows), (10, 5));
        assert_eq!(field.cell_at([0.0, 0.0]), Some(0));
        assert_eq!(field.cell_at([0.999, 0.499]), Some(49));
        for outside in [[-1e-9, 0.1], [1.001, 0.1], [0.1, 0.51], [f64::NAN, 0.1]] {
            assert_eq!(field.cell_at(outside), None, "{outside:?}");
        }
    }
}
