//! Openings side by side that leave most of a surface in place: their points lie below the surface and never above it.
//!
//! Depths of points in an opening of width w whose floor is hidden are uniform on [0, w / t], t being the tangent of the angle between rays
//! and normal. Where a share s of the surface is open, the third central moment of all points is (w / t)³ s (1 - s)² / 4, which is
//! positive; their variance (w / t)² (s / 3 - s² / 4) is below that of a rough surface if s is small, so that `texture.rs` sees nothing.
//!
//! The null hypothesis is that noise and roughness are symmetric: given the sum of cubes of each cell without its sign, all signs are
//! equally likely, whatever the distribution is and however the points of one cell depend on each other. The ratio
//!
//! ```text
//!  z = Σ c / √(Σ c²),  c = Σ r³ over the points of one cell,  r = residual of a window's surface of second order
//! ```
//!
//! then has mean 0 and variance 1, and P(z > x) <= exp(-x² / 2) (Hoeffding 1963). No single outlier brings it beyond 1.
//!
//! A scratch changes the windows that it crosses, grooves change all of them. A region of nine windows is one-sided if at least three
//! quarters of its windows exceed [`ONE_SIDED`].

use nalgebra::{SMatrix, SVector};

use super::disc::Discs;
use super::field::WearSample;
use super::texture;
use super::unseen::Unseen;

/// Cells along either side of a window, together about a disc.
const WINDOW: usize = 5;
/// Windows along either side of a region, and their number.
const REGION: usize = 3;
const WINDOWS: usize = REGION * REGION;
/// Ratio z beyond which a window is one-sided: one standard deviation, which 16 % of windows exceed on a symmetric surface.
const ONE_SIDED: f64 = 1.0;
/// Share of a region's windows that are one-sided on a grooved surface. On a symmetric one, seven of nine are with a probability of 7e-5.
const MOST: f64 = 0.75;
/// Least number of windows with an estimate in a region.
const LEAST_WINDOWS: usize = 8;
/// Terms of the surface of second order, and the least number of points for each.
const TERMS: usize = 6;
const POINTS_PER_TERM: f64 = 4.0;

type Row = SVector<f64, TERMS>;

/// A window of cells with its ratio z and the residuals of its points.
struct Window {
    cells: Vec<usize>,
    ratio: f64,
    /// Mean wear of its points, mm.
    mean_mm: f64,
    /// Residuals of its points, mm; positive for loss.
    residuals_mm: Vec<f64>,
}

impl Window {
    /// None with too few points.
    fn of_cells(discs: &Discs<'_>, cells: Vec<usize>) -> Option<Self> {
        let points: Vec<(usize, &WearSample)> = cells
            .iter()
            .flat_map(|&cell| discs.of_cell(cell).map(move |point| (cell, point)))
            .collect();
        let count: f64 = points.iter().map(|(_, point)| point.merged).sum();
        if count < POINTS_PER_TERM * TERMS as f64 {
            return None;
        }
        let rows: Vec<Row> = rows(&points);
        let mut normal = SMatrix::<f64, TERMS, TERMS>::zeros();
        let mut right = Row::zeros();
        for (row, (_, point)) in rows.iter().zip(&points) {
            normal += point.merged * row * row.transpose();
            right += point.merged * point.wear_mm * row;
        }
        let fit = normal.cholesky()?.solve(&right);
        let residual =
            |(row, (_, point)): (&Row, &(usize, &WearSample))| point.wear_mm - row.dot(&fit);
        let residuals_mm: Vec<f64> = rows.iter().zip(&points).map(residual).collect();
        let mut cubes_of_cell = std::collections::BTreeMap::<usize, f64>::new();
        for ((cell, point), residual_mm) in points.iter().zip(&residuals_mm) {
            *cubes_of_cell.entry(*cell).or_default() += point.cubes_about_mm3(*residual_mm);
        }
        let sum: f64 = cubes_of_cell.values().sum();
        let squares: f64 = cubes_of_cell.values().map(|cubes| cubes * cubes).sum();
        let ratio = sum / squares.sqrt();
        ratio.is_finite().then(|| Self {
            ratio,
            mean_mm: points
                .iter()
                .map(|(_, p)| p.merged * p.wear_mm)
                .sum::<f64>()
                / count,
            residuals_mm,
            cells,
        })
    }

    fn is_one_sided(&self) -> bool {
        self.ratio > ONE_SIDED
    }

    /// Opening that its points show.
    fn opening(&self, slant: f64) -> Unseen {
        let depths_mm = self.residuals_mm.iter().map(|r| self.mean_mm + r);
        texture::opening(depths_mm.collect(), slant)
    }
}

/// Rows of the surface of second order, from the middle of the points in units of their spread: well conditioned.
fn rows(points: &[(usize, &WearSample)]) -> Vec<Row> {
    let count = points.len() as f64;
    let middle = [0, 1].map(|k| points.iter().map(|(_, p)| p.at_mm[k]).sum::<f64>() / count);
    let spread_mm = |k: usize| {
        let squares = points.iter().map(|(_, p)| (p.at_mm[k] - middle[k]).powi(2));
        (squares.sum::<f64>() / count).sqrt()
    };
    let spread = [0, 1].map(spread_mm);
    let row = |(_, point): &(usize, &WearSample)| {
        let [x, y] = [0, 1].map(|k| (point.at_mm[k] - middle[k]) / spread[k]);
        Row::from([1.0, x, y, x * x, x * y, y * y])
    };
    points.iter().map(row).collect()
}

/// Windows side by side over a zone, row by row; none where too few points lie.
struct Tiles {
    columns: usize,
    rows: usize,
    windows: Vec<Option<Window>>,
}

impl Tiles {
    fn of_zone(discs: &Discs<'_>) -> Self {
        let field = discs.field();
        let [columns, rows] = [field.columns, field.rows].map(|cells| cells.div_ceil(WINDOW));
        let side = |tile: usize, tiles: usize, cells: usize| {
            tile * cells / tiles..(tile + 1) * cells / tiles
        };
        let window = |tile: usize| {
            let across = side(tile % columns, columns, field.columns);
            let up = side(tile / columns, rows, field.rows);
            let cells = up.flat_map(|row| {
                across
                    .clone()
                    .map(move |column| row * field.columns + column)
            });
            Window::of_cells(discs, cells.collect())
        };
        Self {
            columns,
            rows,
            windows: (0..columns * rows).map(window).collect(),
        }
    }

    /// Regions of [`WINDOWS`] neighbours: three by three, longer where the zone is narrower than that.
    fn regions(&self) -> impl Iterator<Item = Vec<&Window>> {
        let across = self.columns.min(REGION);
        let up = self.rows.min(WINDOWS.div_ceil(across));
        let across = self.columns.min(WINDOWS.div_ceil(up)).max(across);
        let corners = (0..=self.rows - up)
            .flat_map(move |row| (0..=self.columns - across).map(move |column| (column, row)));
        corners.map(move |(column, row)| {
            let tiles = (row..row + up)
                .flat_map(|row| (column..column + across).map(move |column| (column, row)));
            tiles
                .filter_map(|(column, row)| self.windows[row * self.columns + column].as_ref())
                .collect()
        })
    }
}

/// Unseen part of every cell by openings that leave most of the surface in place. `slant` is the tangent of the angle between rays and
/// normal.
pub(super) fn of_cells(discs: &Discs<'_>, slant: f64) -> Vec<Unseen> {
    let mut unseen = vec![Unseen::default(); discs.field().wear_mm.len()];
    if unseen.is_empty() {
        return unseen;
    }
    let tiles = Tiles::of_zone(discs);
    for region in tiles.regions().filter(|region| is_one_sided(region)) {
        for window in region.into_iter().filter(|window| window.is_one_sided()) {
            let opening = window.opening(slant);
            for &cell in &window.cells {
                unseen[cell] = unseen[cell].or(opening);
            }
        }
    }
    unseen
}

fn is_one_sided(region: &[&Window]) -> bool {
    let count = region.iter().filter(|window| window.is_one_sided()).count();
    region.len() >= LEAST_WINDOWS && count as f64 >= MOST * region.len() as f64
}
