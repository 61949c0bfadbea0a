//! Blocks of pixels as cells.

use crate::head::ImageCircle;

/// Cells of `binning` x `binning` pixels, row by row, restricted to those wholly inside the image circle.
///
/// Pixels right and below of the last whole cell are not used. Cells are numbered in row order, without gaps.
#[derive(Clone, Debug, PartialEq)]
pub struct CellGrid {
    /// Pixels along a cell's side.
    pub binning: usize,
    /// Cells along a row, without a circle.
    pub columns: usize,
    /// Cell rows.
    pub rows: usize,
    spans: Vec<Span>,
}

/// The cells of one row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Span {
    /// First cell column.
    pub begin: usize,
    /// One past the last.
    pub end: usize,
    /// Number of the first cell.
    pub first_cell: usize,
}

impl Span {
    /// Cells in the row.
    pub fn len(&self) -> usize {
        self.end - self.begin
    }

    /// Whether the row has no cells.
    pub fn is_empty(&self) -> bool {
        self.begin == self.end
    }

    /// The number of the cell in column `column`, if the row has it.
    pub fn cell(&self, column: usize) -> Option<usize> {
        (self.begin..self.end)
            .contains(&column)
            .then(|| self.first_cell + column - self.begin)
    }
}

impl CellGrid {
    /// A grid over a camera of `width` x `height` pixels. `binning` of 0 counts as 1.
    pub fn new(width: usize, height: usize, binning: usize, circle: Option<&ImageCircle>) -> Self {
        let binning = binning.max(1);
        let (columns, rows) = (width / binning, height / binning);
        let mut first_cell = 0;
        let spans = (0..rows)
            .map(|row| {
                let (begin, end) = match circle {
                    None => (0, columns),
                    Some(circle) => span_inside(circle, row, columns, binning),
                };
                let span = Span {
                    begin,
                    end,
                    first_cell,
                };
                first_cell += span.len();
                span
            })
            .collect();
        Self {
            binning,
            columns,
            rows,
            spans,
        }
    }

    /// Number of cells.
    pub fn len(&self) -> usize {
        self.spans
            .last()
            .map_or(0, |span| span.first_cell + span.len())
    }

    /// Whether no cell is left.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The cells of one row.
    pub fn span(&self, row: usize) -> Span {
        self.spans[row]
    }

    /// The centre of a cell in camera pixels (pixel centres at integers).
    pub fn centre_px(&self, column: usize, row: usize) -> [f64; 2] {
        let half = (self.binning - 1) as f64 / 2.0;
        [
            (column * self.binning) as f64 + half,
            (row * self.binning) as f64 + half,
        ]
    }
}

/// The columns whose cells lie wholly inside: all four corners of the cell's pixel area within the radius.
fn span_inside(circle: &ImageCircle, row: usize, columns: usize, binning: usize) -> (usize, usize) {
    let top = (row * binning) as f64 - 0.5 - circle.centre_px[1];
    let bottom = top + binning as f64;
    let farthest = top.abs().max(bottom.abs());
    let half_chord_squared = circle.radius_px * circle.radius_px - farthest * farthest;
    if half_chord_squared <= 0.0 {
        return (0, 0);
    }
    let half_chord = half_chord_squared.sqrt();
    let size = binning as f64;
    // Cell c covers [c size - 0.5, (c + 1) size - 0.5].
    let begin = ((circle.centre_px[0] - half_chord + 0.5) / size)
        .ceil()
        .max(0.0) as usize;
    let end = ((circle.centre_px[0] + half_chord + 0.5) / size)
        .floor()
        .max(0.0) as usize;
    let end = end.min(columns);
    if begin >= end { (0, 0) } else { (begin, end) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_circle_keeps_exactly_the_cells_inside() {
        let circle = ImageCircle {
            centre_px: [31.3, 22.9],
            radius_px: 17.2,
        };
        for binning in [1, 2, 3, 5] {
            let grid = CellGrid::new(64, 48, binning, Some(&circle));
            let mut next = 0;
            for row in 0..grid.rows {
                for column in 0..grid.columns {
                    let corner = |dx: usize, dy: usize| {
                        let x = ((column + dx) * binning) as f64 - 0.5 - circle.centre_px[0];
                        let y = ((row + dy) * binning) as f64 - 0.5 - circle.centre_px[1];
                        x.hypot(y) <= circle.radius_px
                    };
                    let inside = corner(0, 0) && corner(0, 1) && corner(1, 0) && corner(1, 1);
                    assert_eq!(
                        grid.span(row).cell(column),
                        inside.then_some(next),
                        "binning {binning} cell {column},{row}"
                    );
                    next += usize::from(inside);
                }
            }
            assert_eq!(grid.len(), next);
            assert!(next > 0);
        }
    }
}
