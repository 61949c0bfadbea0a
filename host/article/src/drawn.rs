//! The points of a view that the article's method draws.

use flankscope_metrology::surface::sampling::centre_of_mass;
use nalgebra::{Isometry3, Point3};

use crate::ViewPoint;

/// The drawn points of a view, in its camera's frame.
pub(crate) struct Drawn {
    pub xyz: Vec<[f64; 3]>,
    pub centre_mm: [f64; 3],
    /// Standard uncertainties, mm.
    pub sigma_mm: Vec<f32>,
    /// How much the fringes oscillate around them, counts.
    pub fringes_dn: Vec<f32>,
}

impl Drawn {
    pub fn of(points: &[ViewPoint]) -> Option<Self> {
        let xyz = coordinates(points);
        Some(Self {
            centre_mm: centre_of_mass(&xyz)?,
            sigma_mm: points.iter().map(|point| point[3]).collect(),
            fringes_dn: points.iter().map(|point| point[4]).collect(),
            xyz,
        })
    }
}

/// Points of a view in the tool frame, mm.
pub(crate) fn laid(xyz: &[[f64; 3]], pose: &Isometry3<f64>) -> Vec<[f64; 3]> {
    let points = xyz.iter();
    points.map(|&p| (pose * Point3::from(p)).into()).collect()
}

/// Coordinates of points, mm.
pub(crate) fn coordinates(points: &[ViewPoint]) -> Vec<[f64; 3]> {
    let xyz = |&[x, y, z, ..]: &ViewPoint| [x, y, z].map(f64::from);
    points.iter().map(xyz).collect()
}
