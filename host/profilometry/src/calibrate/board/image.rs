//! A grey image in memory: smoothed, and read between pixels.

use crate::phase::smoothing::Blur;

/// Counts of a view, row by row.
#[derive(Clone)]
pub(super) struct Grey {
    pub columns: usize,
    pub rows: usize,
    pub values: Vec<f32>,
}

impl Grey {
    /// Smoothed by a Gaussian of `sigma_px`.
    pub fn blurred(&self, sigma_px: f64) -> Self {
        let mut values = self.values.clone();
        if let Some(blur) = Blur::new(sigma_px) {
            blur.apply(&mut values, self.columns);
        }
        Self { values, ..*self }
    }

    pub fn at(&self, column: usize, row: usize) -> f64 {
        f64::from(self.values[row * self.columns + column])
    }

    /// The value at a place, bilinear; `None` outside.
    pub fn between(&self, [x, y]: [f64; 2]) -> Option<f64> {
        let inside =
            x >= 0.0 && y >= 0.0 && x < (self.columns - 1) as f64 && y < (self.rows - 1) as f64;
        if !inside {
            return None;
        }
        let (column, row) = (x as usize, y as usize);
        let (dx, dy) = (x - column as f64, y - row as f64);
        let [top, bottom] = [row, row + 1]
            .map(|row| self.at(column, row) * (1.0 - dx) + self.at(column + 1, row) * dx);
        Some(top * (1.0 - dy) + bottom * dy)
    }

    /// Pixels within `reach_px` of a place along columns and rows that are at least `margin` pixels from the border.
    pub fn about(
        &self,
        [x, y]: [f64; 2],
        reach_px: f64,
        margin: usize,
    ) -> impl Iterator<Item = [usize; 2]> + use<> {
        let span = |at: f64, count: usize| {
            let first = (at - reach_px).ceil().max(margin as f64) as usize;
            let end = (at + reach_px).floor() + 1.0;
            first..(end.max(0.0) as usize).min(count.saturating_sub(margin))
        };
        let (columns, rows) = (span(x, self.columns), span(y, self.rows));
        rows.flat_map(move |row| columns.clone().map(move |column| [column, row]))
    }
}
