//! A cloud as the surface that it samples: every point stands for the plane of its neighbourhood.

use std::num::NonZeroUsize;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use nalgebra::{Matrix3, SymmetricEigen, Vector3};
use rayon::prelude::*;

use crate::deviation::SampleTreeError;
use crate::registration::{Foot, RegistrationTarget};

/// Points that a plane is laid through, the middle one among them.
const NEIGHBOURS: NonZeroUsize = NonZeroUsize::new(20).unwrap();
/// Height over width of a neighbourhood (root mean squares) across an edge of 20 degrees between its faces: for two half
/// discs, tan 10 deg times the square root of 1 - 64 / (9 pi^2).
const EDGE_FLATNESS: f64 = 0.093;
/// Heights up to this many standard deviations of a point are its noise.
const NOISE_SIGMAS: f64 = 2.0;
/// Width over length of a neighbourhood (root mean squares) below which it is a line and determines no plane: a full disc
/// has 1, half of one (at a rim) 0.53.
const LEAST_WIDTH: f64 = 0.2;

/// A cloud ready to be laid on.
pub struct CloudSurface {
    tree: ImmutableKdTree<f64, 3>,
    planes: Vec<Plane>,
}

/// The plane through the neighbours of a point.
#[derive(Clone, Copy)]
struct Plane {
    centre: Vector3<f64>,
    normal: Vector3<f64>,
    /// Radius of the neighbourhood, mm.
    reach_mm: f64,
    smooth: bool,
}

impl CloudSurface {
    /// Lays a plane through the 20 nearest neighbours of each of the finite `points`, mm (Hoppe et al., Surface reconstruction
    /// from unorganized points, SIGGRAPH 1992). Where the neighbours lie farther off it than an edge of 20 degrees or points of
    /// standard deviation `noise_mm` explain, the normal is not used.
    ///
    /// # Errors
    /// [`SampleTreeError`] for fewer than 20 points or too many.
    pub fn new(points: &[[f64; 3]], noise_mm: f64) -> Result<Self, SampleTreeError> {
        let error = SampleTreeError {
            points: points.len(),
            least: NEIGHBOURS.get(),
        };
        if points.len() < error.least {
            return Err(error);
        }
        let tree = ImmutableKdTree::new_from_slice(points).map_err(|_| error)?;
        let plane = |point: &[f64; 3]| {
            let near = tree
                .query(point)
                .nearest_n::<SquaredEuclidean<f64>>(NEIGHBOURS)
                .execute();
            let near: Vec<Vector3<f64>> = near
                .iter()
                .map(|found| points[found.item as usize].into())
                .collect();
            Plane::through(&near, noise_mm)
        };
        let planes = points.par_iter().with_min_len(1024).map(plane).collect();
        Ok(Self { tree, planes })
    }

    fn foot(&self, point: &[f64; 3]) -> Foot {
        let found = self
            .tree
            .query(point)
            .nearest_one::<SquaredEuclidean<f64>>()
            .execute();
        let plane = &self.planes[found.item as usize];
        let from_centre = Vector3::from(*point) - plane.centre;
        let height_mm = from_centre.dot(&plane.normal);
        let aside_mm = (from_centre - height_mm * plane.normal).norm();
        let beside = aside_mm > plane.reach_mm;
        Foot {
            signed_distance_mm: if beside {
                found.distance.sqrt()
            } else {
                height_mm
            },
            normal: plane.normal.into(),
            smooth: plane.smooth && !beside,
        }
    }
}

impl RegistrationTarget for CloudSurface {
    fn each_foot<T>(&self, points: &[[f64; 3]], with: &mut [T], visit: impl Fn(&Foot, &mut T)) {
        for (point, own) in points.iter().zip(with) {
            visit(&self.foot(point), own);
        }
    }

    fn distance_mm(&self, point: [f64; 3]) -> f64 {
        self.foot(&point).signed_distance_mm.abs()
    }
}

impl Plane {
    fn through(points: &[Vector3<f64>], noise_mm: f64) -> Self {
        let n = points.len() as f64;
        let centre = points.iter().sum::<Vector3<f64>>() / n;
        let mut covariance = Matrix3::zeros();
        let mut reach2 = 0.0_f64;
        for point in points {
            let off = point - centre;
            covariance += off * off.transpose();
            reach2 = reach2.max(off.norm_squared());
        }
        let eigen = SymmetricEigen::new(covariance / n);
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
        let [height, width, length] = order.map(|k| eigen.eigenvalues[k].max(0.0).sqrt());
        Self {
            centre,
            normal: eigen.eigenvectors.column(order[0]).into(),
            reach_mm: reach2.sqrt(),
            smooth: width > LEAST_WIDTH * length
                && height <= (EDGE_FLATNESS * width).max(NOISE_SIGMAS * noise_mm),
        }
    }
}
