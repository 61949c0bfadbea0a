//! Brightness of each DMD mirror in a pass.

use super::WorldError;

/// Brightness of each mirror relative to its pattern.
#[derive(Clone, Debug, PartialEq)]
pub struct DmdPass {
    size_px: [usize; 2],
    /// Row by row; 0 dark, 255 the full brightness of the pattern.
    brightness: Vec<u8>,
}

impl DmdPass {
    /// From the values of a DMD of this size, row by row.
    ///
    /// # Errors
    /// The number of values differs from the number of mirrors.
    pub fn new(size_px: [usize; 2], brightness: Vec<u8>) -> Result<Self, WorldError> {
        let [got, need] = [brightness.len(), size_px[0] * size_px[1]];
        if got != need {
            return Err(WorldError::Buffer { got, need });
        }
        Ok(Self {
            size_px,
            brightness,
        })
    }

    /// Fraction of the pattern's light at a position of the DMD, pixel centres at integers; 0 beyond its edge.
    pub(crate) fn ratio(&self, at_px: [f64; 2]) -> f64 {
        let brightness = self.mirror(at_px).and_then(|at| self.brightness.get(at));
        brightness.map_or(0.0, |&brightness| f64::from(brightness) / 255.0)
    }

    /// The mirror at a position.
    fn mirror(&self, at_px: [f64; 2]) -> Option<usize> {
        let [column, row] = at_px.map(f64::round);
        let [columns, rows] = self.size_px;
        let inside = column >= 0.0 && row >= 0.0 && column < columns as f64 && row < rows as f64;
        inside.then(|| row as usize * columns + column as usize)
    }
}
