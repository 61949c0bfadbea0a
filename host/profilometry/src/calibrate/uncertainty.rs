//! Standard uncertainty of a measured point by the calibration alone, from the covariance of the head's unknowns.

use nalgebra::{DMatrix, Matrix3, SVector, Vector3};

use super::bundle::ViewState;
use super::model::{Scene, head_unknowns};
use super::sharpest::AxialDistance;
use crate::head::HeadModel;
use crate::pattern::Axis;
use crate::triangulate::Triangulator;

/// Places in the field, in units of 0.7 of its radius.
const SAMPLES: [[f64; 2]; 5] = [[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 0.7], [0.0, -0.7]];

/// A head in the light of one of its projectors, with its neighbours along every unknown for numerical derivatives.
pub(crate) struct Lit {
    head: HeadModel,
    view: Vector3<f64>,
    neighbours: Vec<Neighbours>,
    /// Positions of its unknowns among those of the head.
    positions: Vec<usize>,
}

impl Lit {
    /// `scene` is the head's in that light.
    pub fn new(head: &HeadModel, scene: &Scene, positions: Vec<usize>) -> Self {
        let neighbours = head_unknowns(scene).map(|unknown| {
            let step = scene.small_step(unknown);
            let heads = [step, -step].map(|by| {
                let mut scene = scene.clone();
                scene.step(unknown, by);
                scene.head(head)
            });
            Neighbours { heads, step }
        });
        Self {
            neighbours: neighbours.collect(),
            head: head.clone(),
            view: scene.stage_from_camera.rotation * Vector3::z(),
            positions,
        }
    }

    /// Derivatives of the point, in the stage frame, that a pixel sees at a depth, by the head's unknowns, `of` of them.
    fn jacobian(&self, pixel: [f64; 2], depth_mm: f64, of: usize) -> Option<DMatrix<f64>> {
        self.slopes(pixel, depth_mm, of, seen_point)
    }

    /// Derivatives of a function of head, pixel and column by the head's unknowns, at the column that lights a depth.
    fn slopes<const ROWS: usize>(
        &self,
        pixel: [f64; 2],
        depth_mm: f64,
        of: usize,
        made: impl Fn(&HeadModel, [f64; 2], f64) -> Option<SVector<f64, ROWS>>,
    ) -> Option<DMatrix<f64>> {
        let ray = self.head.camera.undistort(pixel)?;
        let (column_px, _) = Triangulator::new(&self.head, Axis::Columns).column(ray, depth_mm)?;
        let made = |head: &HeadModel| made(head, pixel, column_px);
        let mut jacobian = DMatrix::zeros(ROWS, of);
        for (&position, Neighbours { heads, step }) in self.positions.iter().zip(&self.neighbours) {
            let change = (made(&heads[0])? - made(&heads[1])?) / (2.0 * step);
            jacobian.set_column(position, &change);
        }
        Some(jacobian)
    }
}

/// Standard uncertainty, by the calibration alone, of how far apart two projectors see a point along the view, root mean square
/// over the measuring volume, mm. `covariance` is that of the head's unknowns.
pub(crate) fn apart_sigma_mm(
    head: &HeadModel,
    [first, second]: [&Lit; 2],
    covariance: &DMatrix<f64>,
) -> f64 {
    let (mut count, mut squares) = (0.0, 0.0);
    for (pixel, depth_mm) in samples(head).into_iter().flatten() {
        let jacobian = |lit: &Lit| lit.jacobian(pixel, depth_mm, covariance.nrows());
        let Some((one, two)) = jacobian(first).zip(jacobian(second)) else {
            continue;
        };
        let along = first.view.transpose() * (two - one);
        count += 1.0;
        squares += (&along * covariance * along.transpose())[(0, 0)];
    }
    f64::sqrt(squares / count)
}

/// Standard uncertainty of a point by the calibration alone, root mean square over the measuring volume in the stage frame:
/// along the view and across, mm. `covariance` is that of the head's unknowns.
pub(crate) fn volume_sigma_mm(head: &HeadModel, lit: &Lit, covariance: &DMatrix<f64>) -> [f64; 2] {
    let Some(samples) = samples(head) else {
        return [f64::NAN; 2];
    };
    let view = lit.view;
    let (mut count, mut squares) = (0.0, [0.0; 2]);
    for (pixel, depth_mm) in samples {
        let jacobian = lit.jacobian(pixel, depth_mm, covariance.nrows());
        let Some(jacobian) = jacobian else { continue };
        let of_point = &jacobian * covariance * jacobian.transpose();
        let of_point = Matrix3::from_fn(|row, column| of_point[(row, column)]);
        let along = view.dot(&(of_point * view));
        count += 1.0;
        squares[0] += along;
        squares[1] += 0.5 * (of_point.trace() - along);
    }
    squares.map(|sum: f64| (sum / count).sqrt())
}

/// Standard uncertainty, by the calibration alone, of how much farther the projector's pinhole is from the middle of the measuring
/// volume than the camera's, each along its axis, mm; nothing without a volume.
pub(crate) fn farther_sigma_mm(
    head: &HeadModel,
    lit: &Lit,
    covariance: &DMatrix<f64>,
) -> Option<f64> {
    let volume = head.volume?;
    let (pixel, depth_mm) = (
        head.camera.principal_px,
        0.5 * (volume.near_mm + volume.far_mm),
    );
    let slopes = lit.slopes(
        pixel,
        depth_mm,
        covariance.nrows(),
        |head, pixel, column_px| {
            let light = Triangulator::new(head, Axis::Columns);
            Some(SVector::from([AxialDistance::triangulate(
                head, &light, pixel, column_px,
            )?
            .farther_mm]))
        },
    )?;
    Some((&slopes * covariance * slopes.transpose())[(0, 0)].sqrt())
}

/// Pixels and depths spread over the measuring volume of a head; nothing without one.
pub(crate) fn samples(head: &HeadModel) -> Option<impl Iterator<Item = ([f64; 2], f64)>> {
    let volume = head.volume?;
    let middle_px = head.camera.principal_px;
    let radius_px = head
        .image_circle
        .map_or(0.5 * f64::from(head.camera.height_px), |circle| {
            circle.radius_px
        });
    let depths_mm = [
        volume.near_mm,
        0.5 * (volume.near_mm + volume.far_mm),
        volume.far_mm,
    ];
    let at = move |[x, y]: [f64; 2]| {
        [
            middle_px[0] + 0.7 * radius_px * x,
            middle_px[1] + 0.7 * radius_px * y,
        ]
    };
    Some(
        depths_mm
            .into_iter()
            .flat_map(move |depth_mm| SAMPLES.map(move |sample| (at(sample), depth_mm))),
    )
}

/// The point that a head sees at a pixel in the light of a column, in the stage frame.
pub(crate) fn seen_point(
    head: &HeadModel,
    pixel: [f64; 2],
    column_px: f64,
) -> Option<Vector3<f64>> {
    let ray = head.camera.undistort(pixel)?;
    let z = Triangulator::new(head, Axis::Columns)
        .intersect(ray, column_px)?
        .depth_mm;
    Some(Vector3::from(head.stage_from_camera?.point([
        ray[0] * z,
        ray[1] * z,
        z,
    ])))
}

/// The head with one unknown a little more and a little less.
struct Neighbours {
    heads: [HeadModel; 2],
    step: f64,
}
