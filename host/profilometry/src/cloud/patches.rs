//! Image-space consistency: a surface continues from cell to cell, a wrong fringe order stands alone.

use crate::cells::{DisjointSets, Grid};

/// Cells grouped by connected surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PatchOptions {
    /// Patches with fewer cells are dropped.
    pub min_cells: usize,
    /// Steepest surface: depth per lateral distance. Neighbours within this slope, plus noise, are connected.
    pub max_slope: f64,
}

/// Depth and its uncertainty as the patch search sees them; NaN depth marks a cell without a point.
pub(crate) trait Depths {
    fn depth_mm(&self, cell: usize) -> f64;
    fn sigma_mm(&self, cell: usize) -> f64;
}

/// Neighbouring depths may differ by this many standard deviations on top of the slope.
const NOISE_FACTOR: f64 = 5.0;

/// The cells of all patches that are too small.
///
/// `cell_by_depth` is the lateral size of a cell per unit of depth (cell size in pixels over focal length).
pub(crate) fn small_patches(
    grid: &Grid,
    depths: &impl Depths,
    cell_by_depth: f64,
    options: &PatchOptions,
) -> Vec<usize> {
    let mut patches = DisjointSets::new(grid.len());
    for row in 0..grid.rows() {
        for cell in grid.cells(row) {
            let depth = depths.depth_mm(cell);
            if depth.is_nan() {
                continue;
            }
            let sigma = depths.sigma_mm(cell);
            for neighbour in grid.earlier_neighbours(row, cell).into_iter().flatten() {
                let other = depths.depth_mm(neighbour);
                let variance = sigma * sigma + depths.sigma_mm(neighbour).powi(2);
                let allowed =
                    options.max_slope * cell_by_depth * depth + NOISE_FACTOR * variance.sqrt();
                // A NaN neighbour fails the comparison.
                if (other - depth).abs() <= allowed {
                    patches.join(cell, neighbour);
                }
            }
        }
    }
    (0..grid.len())
        .filter(|&cell| {
            !depths.depth_mm(cell).is_nan() && patches.size_of(cell) < options.min_cells
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cells::CellGrid;

    struct Field(Vec<f64>);

    impl Depths for Field {
        fn depth_mm(&self, cell: usize) -> f64 {
            self.0[cell]
        }
        fn sigma_mm(&self, _: usize) -> f64 {
            0.001
        }
    }

    #[test]
    fn islands_go_and_slopes_stay() {
        let (width, height) = (20, 10);
        let grid = Grid::Blocks(CellGrid::new(width, height, 1, None));
        // A slope of half a cell per cell, a slipped island of 3 cells, a diagonal line of 4, and a hole.
        let mut depth: Vec<f64> = (0..width * height)
            .map(|cell| 100.0 + 0.05 * (cell % width) as f64)
            .collect();
        for cell in [3 * width + 4, 3 * width + 5, 4 * width + 5] {
            depth[cell] += 7.0;
        }
        for i in 0..4 {
            depth[(5 + i) * width + 10 + i] += 3.0;
        }
        depth[0] = f64::NAN;
        let options = |min_cells| PatchOptions {
            min_cells,
            max_slope: 2.0,
        };
        let small =
            |min_cells| small_patches(&grid, &Field(depth.clone()), 0.001, &options(min_cells));
        assert_eq!(small(3), vec![]);
        assert_eq!(small(4), vec![64, 65, 85]);
        assert_eq!(small(5), vec![64, 65, 85, 110, 131, 152, 173]);
    }
}
