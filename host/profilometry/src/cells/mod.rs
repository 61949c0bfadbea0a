//! The measurement grid: which pixels make up which cell.

mod blocks;
pub(crate) mod buckets;
mod cores;
mod disjoint_sets;

use std::ops::Range;

pub use blocks::{CellGrid, Span};
pub(crate) use cores::BOX_PX;
pub use cores::CoreGrid;
pub(crate) use disjoint_sets::DisjointSets;

/// Kind of cell: a block of pixels behind a lens, a core behind a fibre bundle.
#[derive(Clone, Debug)]
pub enum Grid {
    /// Blocks of pixels.
    Blocks(CellGrid),
    /// Cores of a bundle.
    Cores(CoreGrid),
}

impl Grid {
    /// Number of cells.
    pub fn len(&self) -> usize {
        match self {
            Self::Blocks(grid) => grid.len(),
            Self::Cores(grid) => grid.len(),
        }
    }

    /// Whether no cell is left.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Pixels that a cell sums.
    pub fn pixels_per_cell(&self) -> usize {
        match self {
            Self::Blocks(grid) => grid.binning * grid.binning,
            Self::Cores(_) => BOX_PX * BOX_PX,
        }
    }

    /// Rows of cells: of blocks, or image rows in which cores' boxes begin.
    pub(crate) fn rows(&self) -> usize {
        match self {
            Self::Blocks(grid) => grid.rows,
            Self::Cores(grid) => grid.rows(),
        }
    }

    /// Rows of cells per unit of parallel work; fixed, so that the split never depends on the machine.
    pub(crate) fn rows_per_band(&self) -> usize {
        match self {
            Self::Blocks(_) => 16,
            Self::Cores(_) => 48,
        }
    }

    pub(crate) fn cells(&self, row: usize) -> Range<usize> {
        match self {
            Self::Blocks(grid) => {
                let span = grid.span(row);
                span.first_cell..span.first_cell + span.len()
            }
            Self::Cores(grid) => grid.cells(row),
        }
    }

    /// For the cells of one row in order: where each is (column and row of the grid of blocks, or the pixel nearest to
    /// the core), and the camera pixel whose ray it measures along.
    pub(crate) fn places(&self, row: usize) -> Vec<([u16; 2], [f64; 2])> {
        match self {
            Self::Blocks(grid) => {
                let span = grid.span(row);
                (span.begin..span.end)
                    .map(|column| ([column as u16, row as u16], grid.centre_px(column, row)))
                    .collect()
            }
            Self::Cores(grid) => grid.seen_px()[grid.cells(row)]
                .iter()
                .map(|&seen| (seen.map(|px| px.round() as u16), seen))
                .collect(),
        }
    }

    /// The neighbours of a cell (of `row`) that have smaller numbers.
    pub(crate) fn earlier_neighbours(&self, row: usize, cell: usize) -> [Option<usize>; 6] {
        match self {
            Self::Blocks(grid) => {
                let span = grid.span(row);
                let column = span.begin + cell - span.first_cell;
                let above = (row > 0).then(|| grid.span(row - 1));
                let left = column.checked_sub(1);
                [
                    left.and_then(|column| span.cell(column)),
                    above.and_then(|above| above.cell(column)),
                    above.and_then(|above| above.cell(left?)),
                    above.and_then(|above| above.cell(column + 1)),
                    None,
                    None,
                ]
            }
            Self::Cores(grid) => grid.earlier_neighbours(cell),
        }
    }

    /// Distance between neighbouring cells.
    pub(crate) fn pitch_px(&self) -> f64 {
        match self {
            Self::Blocks(grid) => grid.binning as f64,
            Self::Cores(grid) => grid.pitch_px(),
        }
    }
}
