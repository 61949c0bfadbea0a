//! Overlap of discs and cells.

use super::Discs;

/// Parts along each side of a cell by which its overlap with a disc is counted.
const PARTS: usize = 8;

/// Overlaps of the cells around a cell with a disc on its middle: offsets and shares of the disc.
pub(super) struct Kernel(pub(super) Vec<([isize; 2], f64)>);

impl Discs<'_> {
    /// Overlaps of a disc on the middle of a cell.
    pub(super) fn kernel(&self) -> Kernel {
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
    pub(super) fn middles(&self) -> Vec<[usize; 2]> {
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
}

/// Area that a rectangle shares with a disc about the origin, mm2; exact along one axis, by the midpoint rule along the other.
pub(super) fn overlap_mm2(corner: [f64; 2], size: [f64; 2], radius_mm: f64) -> f64 {
    let strip = size[1] / PARTS as f64;
    (0..PARTS)
        .map(|i| {
            let y = corner[1] + (i as f64 + 0.5) * strip;
            let half = (radius_mm * radius_mm - y * y).max(0.0).sqrt();
            strip * (half.min(corner[0] + size[0]) - (-half).max(corner[0])).max(0.0)
        })
        .sum()
}
