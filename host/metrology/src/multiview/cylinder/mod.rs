//! The deviations of many views over the unrolled bore: merged by quality, in memory that does not grow with the views.
//!
//! Points of one view in one cell share its pose, so they count as one measurement of it: views, not points, are the
//! independent views. Between-view variance after DerSimonian and Laird (Controlled Clinical Trials 7, 1986).

mod around;
mod observation;
mod quality;

pub use around::{Around, Profile};
pub use observation::{CellObservation, cell_observations, moved};
pub use quality::FieldQuality;

use nalgebra::{SMatrix, SVector};

/// Least standard uncertainty of a view's mean over a cell, mm: that of its pose.
const LEAST_VIEW_SIGMA_MM: f64 = 1e-3;

/// Size of the grid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Layout {
    /// Cells around the bore.
    pub columns: usize,
    /// Cells along the axis, from the bottom.
    pub rows: usize,
    /// Lower and upper end, mm.
    pub height_mm: [f64; 2],
    /// Quantity around the bore that the columns divide evenly.
    pub around: Around,
}

#[derive(Debug, Clone, Copy, Default)]
struct CellSums {
    views: u32,
    weight: f64,
    weight2: f64,
    weighted_mm: f64,
    weighted_mm2: f64,
    point: [f64; 3],
    normal: [f64; 3],
}

/// Merged measurement of the surface in one cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cell {
    /// Mean foot of its points on the CAD, mm.
    pub point: [f64; 3],
    /// Mean outward normal, unit.
    pub normal: [f64; 3],
    /// Deviation, mm: inverse-variance mean over the views.
    pub deviation_mm: f64,
    /// Its standard uncertainty, mm: within the views and between them.
    pub sigma_mm: f64,
    /// Views that saw it.
    pub views: u32,
    /// Whether the views contradict each other by more than their uncertainties (chi-square beyond three standard
    /// deviations of its own spread).
    pub inconsistent: bool,
}

impl Cell {
    /// Position of the measured surface: the foot plus the deviation along the normal, mm.
    pub fn measured(&self) -> [f64; 3] {
        [0, 1, 2].map(|axis| self.point[axis] + self.deviation_mm * self.normal[axis])
    }
}

/// Size, ovality and taper of a bore, from its deviations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoreForm {
    /// Mean growth of the radius, mm.
    pub size_mm: f64,
    /// Largest minus smallest radius of the second harmonic, mm.
    pub ovality_mm: f64,
    /// Direction of the largest radius, rad, 0..π.
    pub ovality_rad: f64,
    /// Growth of the radius over the whole height, mm.
    pub taper_mm: f64,
    /// Size, shift in x and y, cosine and sine of the ovality, taper, mm.
    parameters: SVector<f64, 6>,
    height_mm: [f64; 2],
}

impl BoreForm {
    /// Deviation by form and shift of the bore at a place with this outward normal, mm.
    pub fn deviation_mm(&self, point: [f64; 3], normal: [f64; 3]) -> f64 {
        form_row(point, normal, self.height_mm).dot(&self.parameters)
    }
}

/// Derivatives of the deviation at a place by the parameters of the form.
fn form_row([x, y, z]: [f64; 3], normal: [f64; 3], [low, high]: [f64; 2]) -> SVector<f64, 6> {
    let angle = y.atan2(x);
    let radial = normal[0] * angle.cos() + normal[1] * angle.sin();
    SVector::<f64, 6>::new(
        1.0,
        angle.cos(),
        angle.sin(),
        (2.0 * angle).cos(),
        (2.0 * angle).sin(),
        (z - low) / (high - low) - 0.5,
    ) * radial
}

impl Layout {
    /// Number of the cell that a place belongs to; none above and below the grid.
    pub fn cell_of(&self, [x, y, z]: [f64; 3]) -> Option<usize> {
        let around = self.around.share(y.atan2(x));
        let column = ((around * self.columns as f64) as usize).min(self.columns - 1);
        Some(self.row_of(z)? * self.columns + column)
    }

    /// Row of a height; none above and below the grid.
    pub fn row_of(&self, z_mm: f64) -> Option<usize> {
        let [low, high] = self.height_mm;
        let along = (z_mm - low) / (high - low);
        (0.0..1.0)
            .contains(&along)
            .then(|| ((along * self.rows as f64) as usize).min(self.rows - 1))
    }

    /// Middle angle of a column, rad, from −π to π.
    pub fn angle_rad(&self, column: usize) -> f64 {
        self.around
            .angle_rad((column as f64 + 0.5) / self.columns as f64)
    }
}

/// The grid.
#[derive(Debug, Clone)]
pub struct CylinderMap {
    layout: Layout,
    sums: Vec<CellSums>,
}

impl CylinderMap {
    /// An empty grid.
    pub fn new(layout: Layout) -> Self {
        let sums = vec![CellSums::default(); layout.columns * layout.rows];
        Self { layout, sums }
    }

    /// Size of the grid.
    pub fn layout(&self) -> Layout {
        self.layout
    }

    /// Adds one view: what it says of the cells that it saw, and what stands behind each observation's deviation beside its own
    /// scatter, a variance in mm².
    pub fn add_view(
        &mut self,
        view: &[CellObservation],
        further_mm2: impl Fn(&CellObservation) -> f64,
    ) {
        for observation in view {
            let Some(sums) = self.sums.get_mut(observation.cell as usize) else {
                continue;
            };
            let weight = 1.0 / (observation.variance_mm2() + further_mm2(observation));
            let deviation = f64::from(observation.deviation_mm);
            sums.views += 1;
            sums.weight += weight;
            sums.weight2 += weight * weight;
            sums.weighted_mm += weight * deviation;
            sums.weighted_mm2 += weight * deviation * deviation;
            for axis in 0..3 {
                sums.point[axis] += weight * f64::from(observation.point[axis]);
                sums.normal[axis] += weight * f64::from(observation.normal[axis]);
            }
        }
    }

    /// The mean of a observation's cell and the observation's share in it, where another view saw the cell too.
    fn mean_and_leverage(&self, observation: &CellObservation) -> Option<(f64, f64)> {
        let sums = self.sums.get(observation.cell as usize)?;
        let leverage = 1.0 / observation.variance_mm2() / sums.weight;
        (sums.views > 1).then(|| (sums.weighted_mm / sums.weight, leverage))
    }

    /// Merged measurement of a cell; `None` where no view saw it.
    pub fn cell(&self, row: usize, column: usize) -> Option<Cell> {
        let sums = self.sums.get(row * self.layout.columns + column)?;
        if sums.views == 0 {
            return None;
        }
        let deviation_mm = sums.weighted_mm / sums.weight;
        let scatter = (sums.weighted_mm2 - sums.weight * deviation_mm * deviation_mm).max(0.0);
        let freedom = f64::from(sums.views) - 1.0;
        let spread = sums.weight - sums.weight2 / sums.weight;
        let between = if spread > 0.0 && freedom > 0.0 {
            ((scatter - freedom) / spread).max(0.0)
        } else {
            0.0
        };
        let length = sums.normal.iter().map(|n| n * n).sum::<f64>().sqrt();
        Some(Cell {
            point: sums.point.map(|p| p / sums.weight),
            normal: sums.normal.map(|n| n / length.max(f64::MIN_POSITIVE)),
            deviation_mm,
            sigma_mm: (1.0 / sums.weight + between / f64::from(sums.views)).sqrt(),
            views: sums.views,
            inconsistent: scatter > freedom + 3.0 * (2.0 * freedom).sqrt(),
        })
    }

    /// Every cell that was seen.
    pub fn cells(&self) -> impl Iterator<Item = Cell> + '_ {
        let Layout { columns, rows, .. } = self.layout;
        (0..rows).flat_map(move |row| (0..columns).filter_map(move |column| self.cell(row, column)))
    }

    /// Share of the cells that were seen.
    pub fn coverage(&self) -> f64 {
        let seen = self.sums.iter().filter(|sums| sums.views > 0).count();
        seen as f64 / self.sums.len() as f64
    }

    /// Share of the seen cells in which the views contradict each other.
    pub fn inconsistent(&self) -> f64 {
        let (mut seen, mut contradicting) = (0_usize, 0_usize);
        for cell in self.cells() {
            seen += 1;
            contradicting += usize::from(cell.inconsistent);
        }
        contradicting as f64 / seen.max(1) as f64
    }

    /// Fits size, eccentricity, ovality and taper to the deviations along the surface's normals; `None` when too little was
    /// seen to tell them apart.
    pub fn form(&self) -> Option<BoreForm> {
        let height_mm = self.layout.height_mm;
        let mut matrix = SMatrix::<f64, 6, 6>::zeros();
        let mut right = SVector::<f64, 6>::zeros();
        for cell in self.cells() {
            let row = form_row(cell.point, cell.normal, height_mm);
            matrix += row * row.transpose();
            right += row * cell.deviation_mm;
        }
        let parameters = matrix.cholesky()?.solve(&right);
        let [size_mm, _, _, cosine, sine, taper_mm] = parameters.into();
        Some(BoreForm {
            size_mm,
            ovality_mm: 2.0 * f64::hypot(cosine, sine),
            ovality_rad: (0.5 * f64::atan2(sine, cosine)).rem_euclid(std::f64::consts::PI),
            taper_mm,
            parameters,
            height_mm,
        })
    }
}
