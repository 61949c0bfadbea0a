//! Surfaces that a cloud can be registered to.

use crate::surface::{Closest, Surface};

/// Nearest point of the surface to a point of the cloud.
#[derive(Debug, Clone, Copy)]
pub struct Foot {
    /// Distance along the normal, mm; beyond an open rim the distance to the rim.
    pub signed_distance_mm: f64,
    /// Unit normal.
    pub normal: [f64; 3],
    /// Whether the normal is the gradient of the distance; false at sharp edges and beyond a rim.
    pub smooth: bool,
}

/// A surface that a cloud can be registered to: a CAD surface, or another cloud.
pub trait RegistrationTarget: Sync {
    /// Shows `visit` where each finite point (mm) comes to lie, with what belongs to the point, on this thread.
    fn each_foot<T>(&self, points: &[[f64; 3]], with: &mut [T], visit: impl Fn(&Foot, &mut T));

    /// Distance of one finite point, mm.
    fn distance_mm(&self, point: [f64; 3]) -> f64;
}

impl RegistrationTarget for Surface {
    #[inline(always)]
    fn each_foot<T>(&self, points: &[[f64; 3]], with: &mut [T], visit: impl Fn(&Foot, &mut T)) {
        self.each_closest(points, with, |closest, own| visit(&closest.into(), own));
    }

    fn distance_mm(&self, point: [f64; 3]) -> f64 {
        self.closest(point).signed_distance_mm.abs()
    }
}

impl From<&Closest> for Foot {
    #[inline(always)]
    fn from(closest: &Closest) -> Self {
        Self {
            signed_distance_mm: closest.signed_distance_mm,
            normal: closest.normal,
            smooth: closest.is_smooth(),
        }
    }
}
