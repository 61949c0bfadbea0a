//! Wear over one flank's zone, cell by cell.

use serde::{Deserialize, Serialize};

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

/// What is not wear in the cells of a field.
pub(super) struct Noise {
    /// Standard deviation of a cell, in the mean over all, mm.
    pub mean_mm: f64,
    /// Variance of every cell, mm2.
    pub variances_mm2: Vec<f64>,
    /// Wear that is even along the height: of every cell the median of its column, mm.
    pub even_mm: Vec<f64>,
}

/// Cells to either side along profile and height whose scatter tells a cell's noise.
const NEAR: [usize; 2] = [2, 6];
/// Fewer tell nothing.
const LEAST_NEAR: usize = 8;
/// Noise below this share of what is stated is a chance of few cells.
const LEAST_SCALE: f64 = 0.3;

/// Two fields that cannot be compared.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error(
    "the reference has {}x{} cells of {:.4} x {:.4} mm, this zone {}x{} of {:.4} x {:.4} mm; record the baseline again with the same zone",
    theirs.0, theirs.1, theirs.2[0], theirs.2[1], ours.0, ours.1, ours.2[0], ours.2[1]
)]
pub struct Mismatch {
    ours: (usize, usize, [f64; 2]),
    theirs: (usize, usize, [f64; 2]),
}

impl Field {
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

    /// What was lost since `reference`: cells that either lacks are not measured.
    ///
    /// # Errors
    /// The grids differ.
    pub fn since(&self, reference: &Self) -> Result<Self, Mismatch> {
        let shape = |f: &Self| (f.columns, f.rows, f.cell_mm);
        let near = (0..2).all(|k| (self.cell_mm[k] - reference.cell_mm[k]).abs() < 1e-9);
        if !near || (self.columns, self.rows) != (reference.columns, reference.rows) {
            return Err(Mismatch {
                ours: shape(self),
                theirs: shape(reference),
            });
        }
        let pairs = |a: &[f64], b: &[f64], f: fn(f64, f64) -> f64| {
            a.iter().zip(b).map(|(&a, &b)| f(a, b)).collect()
        };
        Ok(Self {
            wear_mm: pairs(&self.wear_mm, &reference.wear_mm, |a, b| a - b),
            variance_mm2: pairs(&self.variance_mm2, &reference.variance_mm2, |a, b| a + b),
            ..*self
        })
    }

    /// The mean of several captures of one zone, cell by cell, of those that measured the cell; none without a capture, or
    /// when their grids differ.
    pub fn mean(captures: &[&Self]) -> Option<Self> {
        let (first, others) = captures.split_first()?;
        let shape = |f: &Self| (f.columns, f.rows, f.wear_mm.len());
        if others.iter().any(|other| shape(other) != shape(first)) {
            return None;
        }
        let mut mean = (*first).clone();
        for cell in 0..mean.wear_mm.len() {
            let seen: Vec<&&Self> = captures
                .iter()
                .filter(|field| field.wear_mm[cell].is_finite())
                .collect();
            let count = seen.len() as f64;
            let sum = |of: fn(&Self) -> &[f64]| seen.iter().map(|f| of(f)[cell]).sum::<f64>();
            // Without any, both stay what they are in the first: not measured.
            if count > 0.0 {
                mean.wear_mm[cell] = sum(|f| &f.wear_mm) / count;
                mean.variance_mm2[cell] = sum(|f| &f.variance_mm2) / (count * count);
            }
        }
        Some(mean)
    }

    /// The cells' noise as they themselves show it: as stated, but larger or smaller where the cells around scatter by more
    /// or less than that about the median of their columns. Cores and fringes beat against each other in places; there a
    /// whole region is off by more than its points say, and elsewhere such errors cancel within a cell. Flanks wear evenly
    /// along the height but for a few cells, which medians pass over.
    pub(super) fn noise(&self) -> Noise {
        let medians: Vec<f64> = (0..self.columns)
            .map(|column| median(self.column(column)))
            .collect();
        let even_mm: Vec<f64> = (0..self.wear_mm.len())
            .map(|i| medians[i % self.columns])
            .collect();
        let off = |i: usize| (self.wear_mm[i] - even_mm[i]).abs() / self.variance_mm2[i].sqrt();
        let off: Vec<f64> = (0..self.wear_mm.len()).map(off).collect();
        let variances_mm2: Vec<f64> = (0..self.wear_mm.len())
            .map(|i| self.variance_mm2[i] * self.scale(&off, i).powi(2))
            .collect();
        let (mut sum, mut count) = (0.0, 0.0_f64);
        for i in self.measured() {
            (sum, count) = (sum + variances_mm2[i], count + 1.0);
        }
        Noise {
            mean_mm: (sum / count.max(1.0)).sqrt(),
            variances_mm2,
            even_mm,
        }
    }

    /// The measured wear of a column, mm.
    fn column(&self, column: usize) -> impl Iterator<Item = f64> {
        self.wear_mm
            .iter()
            .skip(column)
            .step_by(self.columns)
            .copied()
    }

    /// How much larger than stated a cell's standard deviation is, from the distances `off` of the cells around it, in stated
    /// ones.
    fn scale(&self, off: &[f64], cell: usize) -> f64 {
        let (column, row) = (cell % self.columns, cell / self.columns);
        let rows = row.saturating_sub(NEAR[1])..(row + NEAR[1] + 1).min(self.rows);
        let columns = column.saturating_sub(NEAR[0])..(column + NEAR[0] + 1).min(self.columns);
        let near: Vec<f64> = rows
            .flat_map(|row| columns.clone().map(move |c| row * self.columns + c))
            .map(|i| off[i])
            .filter(|off| off.is_finite())
            .collect();
        if near.len() < LEAST_NEAR {
            return 1.0;
        }
        // Median of |x| to standard deviation.
        (1.4826 * median(near)).max(LEAST_SCALE)
    }

    /// The cells that share a side with a cell.
    pub(super) fn neighbours(&self, cell: usize) -> impl Iterator<Item = usize> {
        let (column, row) = (cell % self.columns, cell / self.columns);
        let around = [
            (column > 0).then(|| cell - 1),
            (column + 1 < self.columns).then_some(cell + 1),
            (row > 0).then(|| cell - self.columns),
            (row + 1 < self.rows).then_some(cell + self.columns),
        ];
        around.into_iter().flatten()
    }

    /// Groups of neighbouring measured cells that pass `member`, of at least `least` cells each.
    pub(super) fn clusters(&self, member: impl Fn(usize) -> bool, least: usize) -> Vec<Vec<usize>> {
        let mut open: Vec<bool> = (0..self.wear_mm.len())
            .map(|i| self.wear_mm[i].is_finite() && member(i))
            .collect();
        let mut clusters = Vec::new();
        for start in 0..open.len() {
            if !open[start] {
                continue;
            }
            open[start] = false;
            let mut cluster = vec![start];
            let mut next = 0;
            while let Some(&i) = cluster.get(next) {
                next += 1;
                for other in self.neighbours(i) {
                    if std::mem::take(&mut open[other]) {
                        cluster.push(other);
                    }
                }
            }
            if cluster.len() >= least {
                clusters.push(cluster);
            }
        }
        clusters
    }
}

/// The median of the finite values, of an even number the upper of the two in the middle; NaN without any.
fn median(values: impl IntoIterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.into_iter().filter(|v| v.is_finite()).collect();
    if values.is_empty() {
        return f64::NAN;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
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

    fn field(wear_mm: [f64; 3], variance_mm2: [f64; 3]) -> Field {
        Field {
            columns: 3,
            rows: 1,
            cell_mm: [0.25, 0.25],
            wear_mm: wear_mm.into(),
            variance_mm2: variance_mm2.into(),
        }
    }

    #[test]
    fn captures_average_where_they_measured() {
        let gap = f64::NAN;
        let captures = [
            field([1.0, gap, gap], [0.4, gap, gap]),
            field([2.0, 5.0, gap], [0.8, 0.3, gap]),
        ];
        let mean = Field::mean(&[&captures[0], &captures[1]]).unwrap();
        assert_eq!(mean.wear_mm[..2], [1.5, 5.0]);
        assert!((mean.variance_mm2[0] - 1.2 / 4.0).abs() < 1e-15);
        assert_eq!(mean.variance_mm2[1], 0.3);
        assert!(mean.wear_mm[2].is_nan() && mean.variance_mm2[2].is_nan());
        let other = Field {
            columns: 1,
            rows: 3,
            ..captures[0].clone()
        };
        assert!(Field::mean(&[&captures[0], &other]).is_none());
        assert!(Field::mean(&[]).is_none());
    }
}
