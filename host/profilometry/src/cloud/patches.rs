//! Image-space consistency: a surface continues from cell to cell, a wrong fringe order stands alone.

use std::ops::Range;

use rayon::prelude::*;

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

/// Rows of a unit of parallel work.
const STRIP_ROWS: usize = 32;

/// The cells of all patches that are too small.
///
/// `cell_by_depth` is the lateral size of a cell per unit of depth (cell size in pixels over focal length).
pub(crate) fn small_patches(
    grid: &Grid,
    depths: &(impl Depths + Sync),
    cell_by_depth: f64,
    options: &PatchOptions,
) -> Vec<usize> {
    let slope = options.max_slope * cell_by_depth;
    let is_joined = |cell: usize, neighbour: usize| {
        let depth = depths.depth_mm(cell);
        let off = (depths.depth_mm(neighbour) - depth).abs();
        let by_slope = slope * depth;
        // Most need no root. A NaN neighbour fails both comparisons.
        off <= by_slope || {
            let variance = depths.sigma_mm(cell).powi(2) + depths.sigma_mm(neighbour).powi(2);
            off <= by_slope + NOISE_FACTOR * variance.sqrt()
        }
    };
    // Each strip for itself, then the seams between them.
    let strips: Vec<Range<usize>> = (0..grid.rows())
        .step_by(STRIP_ROWS)
        .map(|first| first..(first + STRIP_ROWS).min(grid.rows()))
        .collect();
    let of_strip = |rows: Range<usize>| {
        let first = grid.cells(rows.start).start;
        let mut patches = DisjointSets::new(grid.cells(rows.end - 1).end - first);
        let mut seam = Vec::new();
        for row in rows {
            for cell in grid.cells(row) {
                if depths.depth_mm(cell).is_nan() {
                    continue;
                }
                for neighbour in grid.earlier_neighbours(row, cell).into_iter().flatten() {
                    if is_joined(cell, neighbour) {
                        match neighbour.checked_sub(first) {
                            Some(neighbour) => patches.join(cell - first, neighbour),
                            None => seam.push((cell, neighbour)),
                        }
                    }
                }
            }
        }
        (patches, seam)
    };
    let strips: Vec<_> = strips.into_par_iter().map(of_strip).collect();
    let (parts, seams): (Vec<_>, Vec<_>) = strips.into_iter().unzip();
    let mut patches = DisjointSets::beside_each_other(&parts);
    for (cell, neighbour) in seams.into_iter().flatten() {
        patches.join(cell, neighbour);
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

    /// A drawn field of many strips, its patches found by flooding.
    #[test]
    fn patches_go_on_from_strip_to_strip() {
        let (width, height) = (24, 3 * STRIP_ROWS + 5);
        let grid = Grid::Blocks(CellGrid::new(width, height, 1, None));
        let mut random = flankscope_test_requisites::Random(2);
        let depth: Vec<f64> = (0..width * height)
            .map(|_| match random.uniform() {
                draw if draw < 0.2 => f64::NAN,
                draw if draw < 0.6 => 100.0,
                _ => 101.0,
            })
            .collect();
        for min_cells in [2, 5, 20, 100] {
            let options = PatchOptions {
                min_cells,
                max_slope: 2.0,
            };
            let found = small_patches(&grid, &Field(depth.clone()), 0.001, &options);
            let mut seen = vec![false; depth.len()];
            let mut expected = Vec::new();
            for start in 0..depth.len() {
                let mut patch = Vec::new();
                let mut open = vec![start];
                while let Some(cell) = open.pop() {
                    if seen[cell] || depth[cell].is_nan() {
                        continue;
                    }
                    seen[cell] = true;
                    patch.push(cell);
                    let (x, y) = (cell % width, cell / width);
                    for other_y in y.saturating_sub(1)..=(y + 1).min(height - 1) {
                        for other_x in x.saturating_sub(1)..=(x + 1).min(width - 1) {
                            let other = other_y * width + other_x;
                            // Half a millimetre apart is another surface here.
                            if (depth[other] - depth[cell]).abs() < 0.5 {
                                open.push(other);
                            }
                        }
                    }
                }
                if patch.len() < min_cells {
                    expected.extend(patch);
                }
            }
            expected.sort_unstable();
            assert!(!expected.is_empty());
            assert_eq!(found, expected);
        }
    }
}
