//! Triangulation with a whole head: from a pixel and the projector column that lights it to a point.

use super::Triangulator;
use crate::cloud::CellColumn;
use crate::head::HeadModel;
use crate::pattern::Axis;

/// A head, ready to triangulate.
pub(crate) struct HeadTriangulator<'a> {
    head: &'a HeadModel,
    triangulator: Triangulator,
    /// The same head by its second projector, and how far its points may be apart from the first one's, mm.
    second: Option<(HeadModel, f64)>,
}

/// A second projector's points may be apart from the first one's by so often what 95 % of the cells are.
const APART_ALLOWED: f64 = 2.0;

impl<'a> HeadTriangulator<'a> {
    pub fn new(head: &'a HeadModel) -> Self {
        Self {
            head,
            triangulator: Triangulator::new(head, Axis::Columns),
            second: head
                .with_projector(2)
                .zip(head.calibration.as_ref().and_then(|record| {
                    Some(APART_ALLOWED * 1e-3 * record.second_projector?.allowed_um())
                })),
        }
    }

    /// The points of all cells that have one, in the light of each projector: where both see one, their mean, or none if they
    /// contradict each other.
    pub fn points_of_each(&self, by_each: &[Vec<CellColumn>]) -> Vec<[f64; 3]> {
        let (Some(first), Some((second, allowed_mm))) = (by_each.first(), &self.second) else {
            return by_each
                .first()
                .map_or(Vec::new(), |cells| self.points(cells));
        };
        let second = HeadTriangulator::new(second);
        let seen = |head: &HeadTriangulator<'_>, cell: &CellColumn| {
            head.point(cell.pixel, cell.column_px?)
        };
        let by_second = by_each.get(1).into_iter().flatten().map(Some);
        let pairs = first.iter().zip(by_second.chain(std::iter::repeat(None)));
        let point = |(one, two): (&CellColumn, Option<&CellColumn>)| match (
            seen(self, one),
            two.and_then(|two| seen(&second, two)),
        ) {
            (Some(a), Some(b)) if (a[2] - b[2]).abs() <= *allowed_mm => {
                Some([0, 1, 2].map(|axis| 0.5 * (a[axis] + b[axis])))
            }
            (Some(_), Some(_)) => None,
            (one, two) => one.or(two),
        };
        pairs.filter_map(point).collect()
    }

    /// The point in the camera frame, if it lies in the measuring volume and in fringes that count.
    pub fn point(&self, pixel: [f64; 2], column_px: f64) -> Option<[f64; 3]> {
        let [x, y] = self.head.camera.undistort(pixel)?;
        let hit = self.triangulator.intersect([x, y], column_px)?;
        let z = hit.depth_mm;
        let volume = self.head.volume;
        let inside = volume.is_none_or(|volume| (volume.near_mm..=volume.far_mm).contains(&z));
        let lit = inside && self.triangulator.is_lit(&hit);
        lit.then_some([x * z, y * z, z])
    }

    /// The points of all cells that have one.
    pub fn points(&self, cells: &[CellColumn]) -> Vec<[f64; 3]> {
        cells
            .iter()
            .filter_map(|cell| self.point(cell.pixel, cell.column_px?))
            .collect()
    }
}
