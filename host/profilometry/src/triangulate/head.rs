//! Triangulation with a whole head: from a pixel and the projector column that lights it to a point.

use super::Triangulator;
use crate::cloud::CellColumn;
use crate::head::HeadModel;
use crate::pattern::Axis;

/// A head, ready to triangulate.
pub(crate) struct HeadTriangulator<'a> {
    head: &'a HeadModel,
    triangulator: Triangulator,
}

impl<'a> HeadTriangulator<'a> {
    pub fn new(head: &'a HeadModel) -> Self {
        Self {
            head,
            triangulator: Triangulator::new(head, Axis::Columns),
        }
    }

    /// The point in the camera frame, if it lies in the measuring volume.
    pub fn point(&self, pixel: [f64; 2], column_px: f64) -> Option<[f64; 3]> {
        let [x, y] = self.head.camera.undistort(pixel)?;
        let z = self.triangulator.intersect([x, y], column_px)?.depth_mm;
        let volume = self.head.volume;
        let inside = volume.is_none_or(|volume| (volume.near_mm..=volume.far_mm).contains(&z));
        inside.then_some([x * z, y * z, z])
    }

    /// The points of all cells that have one.
    pub fn points(&self, cells: &[CellColumn]) -> Vec<[f64; 3]> {
        cells
            .iter()
            .filter_map(|cell| self.point(cell.pixel, cell.column_px?))
            .collect()
    }
}
