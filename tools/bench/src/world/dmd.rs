//! What the DMD shows in a pass, mirror by mirror.

use super::WorldError;

/// How bright each mirror is beside what its pattern says, and where the fringes are not straight, which column's they are.
#[derive(Clone, Debug, PartialEq)]
pub struct DmdPass {
    size_px: [usize; 2],
    /// Row by row; 0 dark, 255 as bright as the pattern.
    brightness: Vec<u8>,
    /// Column of straight fringes that a mirror shows, row by row; empty where they are straight.
    columns_px: Vec<f32>,
}

impl DmdPass {
    /// Of a DMD of this size, row by row.
    ///
    /// # Errors
    /// Not one value for each mirror.
    pub fn new(size_px: [usize; 2], brightness: Vec<u8>) -> Result<Self, WorldError> {
        let [got, need] = [brightness.len(), size_px[0] * size_px[1]];
        if got != need {
            return Err(WorldError::Buffer { got, need });
        }
        Ok(Self {
            size_px,
            brightness,
            columns_px: Vec::new(),
        })
    }

    /// The same with fringes that are not straight.
    ///
    /// # Errors
    /// Not one value for each mirror.
    pub fn bent(self, columns_px: Vec<f32>) -> Result<Self, WorldError> {
        let [got, need] = [columns_px.len(), self.brightness.len()];
        if got != need {
            return Err(WorldError::Buffer { got, need });
        }
        Ok(Self { columns_px, ..self })
    }

    /// Columns and rows.
    pub fn size_px(&self) -> [usize; 2] {
        self.size_px
    }

    /// Share of the pattern's light at a place of the DMD, pixel centres at integers; none beyond its edge.
    pub(crate) fn ratio(&self, at_px: [f64; 2]) -> f64 {
        let brightness = self.mirror(at_px).and_then(|at| self.brightness.get(at));
        brightness.map_or(0.0, |&brightness| f64::from(brightness) / 255.0)
    }

    /// Column of straight fringes that is shown at a place, and how much denser than they the fringes are there.
    pub(crate) fn shown(&self, at_px: [f64; 2]) -> (f64, f64) {
        let Some(at) = self.mirror(at_px).filter(|_| !self.columns_px.is_empty()) else {
            return (at_px[0], 1.0);
        };
        let column = at % self.size_px[0];
        let of = |beside: usize| f64::from(self.columns_px[beside]);
        let is_lit = |beside: &usize| self.brightness[*beside] > 0;
        let before = (column > 0).then(|| at - 1).filter(is_lit);
        let after = (column + 1 < self.size_px[0])
            .then_some(at + 1)
            .filter(is_lit);
        let density = match (before, after) {
            (Some(before), Some(after)) => 0.5 * (of(after) - of(before)),
            (Some(before), None) => of(at) - of(before),
            (None, Some(after)) => of(after) - of(at),
            (None, None) => 1.0,
        };
        (of(at) + density * (at_px[0] - column as f64), density)
    }

    /// The mirror at a place.
    fn mirror(&self, at_px: [f64; 2]) -> Option<usize> {
        let [column, row] = at_px.map(f64::round);
        let [columns, rows] = self.size_px;
        let inside = column >= 0.0 && row >= 0.0 && column < columns as f64 && row < rows as f64;
        inside.then(|| row as usize * columns + column as usize)
    }
}
