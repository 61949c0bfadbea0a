//! Pixels to cells, one row of cells at a time.

use crate::accumulate::Layout;
use crate::cells::{BOX_PX, CoreGrid};
use crate::cells::{CellGrid, Grid};
use crate::frame::FrameView;

/// One row of cells out of the frame's pixel rows.
#[derive(Clone, Debug)]
pub(crate) struct CellRow {
    /// Counts per cell; infinite where a pixel is saturated, so that every sum it enters is marked.
    pub values: Vec<f32>,
    /// Per pixel column of the cell row: the sum, or all ones where a pixel exceeds the limit. Small sums fit the short
    /// ones, of which a vector holds twice as many.
    short: Vec<u16>,
    columns: Vec<u32>,
    excess: Vec<u16>,
}

impl CellRow {
    pub fn new(grid: &Grid) -> Self {
        let (cells, pixels) = match grid {
            Grid::Blocks(grid) if grid.binning > 1 => (grid.columns, grid.columns * grid.binning),
            Grid::Blocks(grid) => (grid.columns, 0),
            Grid::Cores(grid) => {
                let cells = (0..grid.rows()).map(|row| grid.cells(row).len()).max();
                (cells.unwrap_or(0), 0)
            }
        };
        Self {
            values: vec![0.0; cells],
            short: vec![0; pixels],
            columns: vec![0; pixels],
            excess: vec![0; pixels],
        }
    }

    /// Fills `values` and returns the sum of all pixels read.
    #[inline(always)]
    pub fn read(&mut self, layout: &Layout, frame: FrameView<'_>, row: usize) -> u64 {
        let limit = layout.saturation_limit_dn;
        match &layout.grid {
            Grid::Cores(grid) => self.read_cores(grid, limit, frame, row),
            Grid::Blocks(grid) => match grid.binning {
                1 => self.read_pixels(grid, limit, frame, row),
                2 => self.read_blocks::<2>(grid, limit, frame, row),
                3 => self.read_blocks::<3>(grid, limit, frame, row),
                4 => self.read_blocks::<4>(grid, limit, frame, row),
                _ => self.read_large_blocks(grid, limit, frame, row),
            },
        }
    }

    /// Boxes lie where the cores lie: nothing to vectorise, but nine pixels in three runs each.
    #[inline(always)]
    fn read_cores(&mut self, grid: &CoreGrid, limit: u16, frame: FrameView<'_>, row: usize) -> u64 {
        let rows: [&[u16]; BOX_PX] = std::array::from_fn(|y| frame.row(row + y));
        let mut total = 0;
        for (&left, value) in grid.left_px[grid.cells(row)].iter().zip(&mut self.values) {
            let (mut sum, mut brightest) = (0u32, 0u16);
            for row in rows {
                for &pixel in &row[usize::from(left)..][..BOX_PX] {
                    sum += u32::from(pixel);
                    brightest = brightest.max(pixel);
                }
            }
            total += u64::from(sum);
            *value = if brightest > limit {
                f32::INFINITY
            } else {
                sum as f32
            };
        }
        total
    }

    #[inline(always)]
    fn read_pixels(
        &mut self,
        grid: &CellGrid,
        limit: u16,
        frame: FrameView<'_>,
        row: usize,
    ) -> u64 {
        let span = grid.span(row);
        let mut total = 0u32;
        for (&pixel, value) in frame.row(row)[span.begin..span.end]
            .iter()
            .zip(&mut self.values)
        {
            total += u32::from(pixel);
            *value = if pixel > limit {
                f32::INFINITY
            } else {
                f32::from(pixel)
            };
        }
        u64::from(total)
    }

    /// Rows first, since neighbouring columns vectorise; then columns, with the block size known to the compiler.
    #[inline(always)]
    fn read_blocks<const B: usize>(
        &mut self,
        grid: &CellGrid,
        limit: u16,
        frame: FrameView<'_>,
        row: usize,
    ) -> u64 {
        let span = grid.span(row);
        let pixels = span.begin * B..span.end * B;
        let count = pixels.len();
        let rows: [&[u16]; B] =
            std::array::from_fn(|y| &frame.row(row * B + y)[pixels.clone()][..count]);
        if (u64::from(limit) + 1) * ((B * B) as u64) < u64::from(u16::MAX) {
            return self.read_short_blocks(limit, rows);
        }
        let columns = &mut self.columns[..count];
        let excess = &mut self.excess[..count];
        for x in 0..count {
            let (mut sum, mut over) = (0u32, 0u16);
            for row in &rows {
                sum += u32::from(row[x]);
                over |= row[x].saturating_sub(limit);
            }
            columns[x] = sum;
            excess[x] = over;
        }
        let mut total = 0u64;
        let blocks = columns
            .as_chunks::<B>()
            .0
            .iter()
            .zip(excess.as_chunks::<B>().0);
        for ((columns, excess), value) in blocks.zip(&mut self.values) {
            let sum: u32 = columns.iter().sum();
            let over = excess.iter().fold(0, |over, &column| over | column);
            total += u64::from(sum);
            *value = if over > 0 { f32::INFINITY } else { sum as f32 };
        }
        total
    }

    /// The same for cells whose sum fits 16 bits: 12-bit counts and up to 4 x 4 pixels.
    /// Counts beyond the limit enter the brightness as the limit and one.
    #[inline(always)]
    fn read_short_blocks<const B: usize>(&mut self, limit: u16, rows: [&[u16]; B]) -> u64 {
        let count = rows[0].len();
        let short = &mut self.short[..count];
        let mut total = 0u32;
        for x in 0..count {
            let (mut sum, mut largest) = (0u16, 0u16);
            for row in &rows {
                let pixel = row[x].min(limit + 1);
                sum += pixel;
                largest = largest.max(pixel);
            }
            total += u32::from(sum);
            short[x] = if largest > limit { u16::MAX } else { sum };
        }
        for (columns, value) in short.as_chunks::<B>().0.iter().zip(&mut self.values) {
            let sum = columns
                .iter()
                .fold(0u16, |sum, &column| sum.saturating_add(column));
            *value = if sum == u16::MAX {
                f32::INFINITY
            } else {
                f32::from(sum)
            };
        }
        u64::from(total)
    }

    fn read_large_blocks(
        &mut self,
        grid: &CellGrid,
        limit: u16,
        frame: FrameView<'_>,
        row: usize,
    ) -> u64 {
        let span = grid.span(row);
        let binning = grid.binning;
        let mut total = 0;
        for (column, value) in (span.begin..span.end).zip(&mut self.values) {
            let (mut sum, mut over) = (0u32, false);
            for y in row * binning..(row + 1) * binning {
                for &pixel in &frame.row(y)[column * binning..][..binning] {
                    sum += u32::from(pixel);
                    over |= pixel > limit;
                }
            }
            total += u64::from(sum);
            *value = if over { f32::INFINITY } else { sum as f32 };
        }
        total
    }
}
