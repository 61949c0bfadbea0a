//! A lens and the poses of a board before it without any guess: Zhang, A flexible new technique for camera calibration (PAMI 2000).

use nalgebra::{DMatrix, Isometry3, Matrix3, SMatrix, Translation3, UnitQuaternion, Vector3};

use crate::head::Pinhole;
use flankscope_foundation::rigid::nearest_rotation;

/// A point of the board and its image.
pub(super) type ImagePair = ([f64; 2], [f64; 2]);

/// The homography `image ~ H (board, 1)` by direct linear transformation of centred and scaled points (Hartley 1997).
pub(super) fn homography(pairs: &[ImagePair]) -> Option<Matrix3<f64>> {
    if pairs.len() < 4 {
        return None;
    }
    let board = Scaling::about_centre(pairs.iter().map(|pair| pair.0))?;
    let image = Scaling::about_centre(pairs.iter().map(|pair| pair.1))?;
    let mut normal = SMatrix::<f64, 9, 9>::zeros();
    for &(from, to) in pairs {
        let ([x, y], [u, v]) = (board.apply(from), image.apply(to));
        let rows = [
            [x, y, 1.0, 0.0, 0.0, 0.0, -u * x, -u * y, -u],
            [0.0, 0.0, 0.0, x, y, 1.0, -v * x, -v * y, -v],
        ];
        for row in rows {
            let row = SMatrix::<f64, 9, 1>::from(row);
            normal += row * row.transpose();
        }
    }
    let eigen = normal.symmetric_eigen();
    let h = eigen.eigenvectors.column(eigen.eigenvalues.imin());
    let scaled = Matrix3::from_row_iterator(h.iter().copied());
    let found = image.matrix().try_inverse()? * scaled * board.matrix();
    found.iter().all(|x| x.is_finite()).then_some(found)
}

/// A shift and a scale that put points about the origin.
struct Scaling {
    centre: [f64; 2],
    scale: f64,
}

impl Scaling {
    fn about_centre(points: impl Iterator<Item = [f64; 2]> + Clone) -> Option<Self> {
        let count = points.clone().count() as f64;
        let sum = points
            .clone()
            .fold([0.0; 2], |sum, p| [sum[0] + p[0], sum[1] + p[1]]);
        let centre = sum.map(|s| s / count);
        let spread: f64 = points
            .map(|p| (p[0] - centre[0]).hypot(p[1] - centre[1]))
            .sum();
        let scale = std::f64::consts::SQRT_2 * count / spread;
        scale.is_finite().then_some(Self { centre, scale })
    }

    fn apply(&self, point: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|axis| self.scale * (point[axis] - self.centre[axis]))
    }

    fn matrix(&self) -> Matrix3<f64> {
        let [x, y] = self.centre.map(|c| -self.scale * c);
        Matrix3::new(self.scale, 0.0, x, 0.0, self.scale, y, 0.0, 0.0, 1.0)
    }
}

/// Lenses of no distortion that the homographies suggest, for images of a size: with the principal point found, and with the principal
/// point in the middle, which suits few or slightly tilted boards better.
pub(super) fn lenses(homographies: &[Matrix3<f64>], size_px: [u32; 2]) -> Vec<Pinhole> {
    let size = size_px.map(f64::from);
    let middle = size.map(|px| 0.5 * (px - 1.0));
    let unit = 0.5 * size[0].max(size[1]);
    // In units of half the image about its middle all unknowns are of one size.
    let to_units = Matrix3::new(
        1.0 / unit,
        0.0,
        -middle[0] / unit,
        0.0,
        1.0 / unit,
        -middle[1] / unit,
        0.0,
        0.0,
        1.0,
    );
    // Two linear constraints per view on b = (B11, B22, B13, B23, B33), where B = K^-T K^-1 without skew (Zhang 2000, eq. 3 and 4).
    let mut equations = DMatrix::zeros(2 * homographies.len(), 5);
    for (view, h) in homographies.iter().enumerate() {
        let h = to_units * h;
        let h = h / h.norm();
        let form = |i: usize, j: usize| {
            let (a, b) = (h.column(i), h.column(j));
            [
                a[0] * b[0],
                a[1] * b[1],
                a[0] * b[2] + a[2] * b[0],
                a[1] * b[2] + a[2] * b[1],
                a[2] * b[2],
            ]
        };
        let (mixed, first, second) = (form(0, 1), form(0, 0), form(1, 1));
        for k in 0..5 {
            equations[(2 * view, k)] = mixed[k];
            equations[(2 * view + 1, k)] = first[k] - second[k];
        }
    }
    let smallest = |columns: &[usize]| {
        let part = equations.select_columns(columns);
        let eigen = (part.transpose() * &part).symmetric_eigen();
        let b = eigen
            .eigenvectors
            .column(eigen.eigenvalues.imin())
            .into_owned();
        (0..5)
            .map(|k| columns.iter().position(|&c| c == k).map_or(0.0, |at| b[at]))
            .collect::<Vec<_>>()
    };
    let lens = |b: Vec<f64>| {
        let [b11, b22, b13, b23, b33] = b.try_into().ok()?;
        let principal = [-b13 / b11, -b23 / b22];
        let scale = b33 - b13 * b13 / b11 - b23 * b23 / b22;
        let focal = [scale / b11, scale / b22].map(f64::sqrt);
        let sound = focal.iter().all(|f| (0.2..50.0).contains(f))
            && principal.iter().all(|p| p.abs() < 3.0);
        sound.then(|| Pinhole {
            width_px: size_px[0],
            height_px: size_px[1],
            focal_px: focal.map(|f| f * unit),
            principal_px: [0, 1].map(|axis| middle[axis] + unit * principal[axis]),
            distortion: [0.0; 5],
            residual: None,
        })
    };
    [vec![0, 1, 2, 3, 4], vec![0, 1, 4]]
        .iter()
        .filter_map(|columns| lens(smallest(columns)))
        .collect()
}

/// The pose of a board by its homography.
pub(super) fn pose(h: &Matrix3<f64>, lens: &Pinhole) -> Option<Isometry3<f64>> {
    let [fx, fy] = lens.focal_px;
    let [cx, cy] = lens.principal_px;
    let inverse = Matrix3::new(
        1.0 / fx,
        0.0,
        -cx / fx,
        0.0,
        1.0 / fy,
        -cy / fy,
        0.0,
        0.0,
        1.0,
    );
    let a = inverse * h;
    let scale = 2.0 / (a.column(0).norm() + a.column(1).norm());
    // The board lies before the lens.
    let scale = if a[(2, 2)] < 0.0 { -scale } else { scale };
    let [x, y, t]: [Vector3<f64>; 3] = [0, 1, 2].map(|k| scale * a.column(k));
    let rotation: UnitQuaternion<f64> =
        nearest_rotation(&Matrix3::from_columns(&[x, y, x.cross(&y)]));
    let pose = Isometry3::from_parts(Translation3::from(t), rotation);
    (t.iter().all(|x| x.is_finite()) && t.z > 0.0).then_some(pose)
}
