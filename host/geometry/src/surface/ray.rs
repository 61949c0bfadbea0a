//! First intersection of a ray with the surface.

use nalgebra::{Point3, Vector3};

use super::{Closest, Surface};

/// A ray has met the surface when it is as near, mm: a twentieth of a cell.
const NEAR_MM: f64 = 5e-3;
/// Steps after which a ray that grazes the surface is given up.
const MOST_STEPS: usize = 64;

impl Surface {
    /// First intersection of a ray of unit `direction` with the surface between two distances from its start; none where it does
    /// not, or grazes. No step is longer than the way to the nearest surface (Hart, Sphere tracing, The Visual Computer 12, 527,
    /// 1996).
    pub fn first_met(
        &self,
        from_mm: [f64; 3],
        direction: [f64; 3],
        [mut along_mm, far_mm]: [f64; 2],
    ) -> Option<Closest> {
        let (from, direction) = (Point3::from(from_mm), Vector3::from(direction));
        for _ in 0..MOST_STEPS {
            let at = from + direction * along_mm;
            let closest = self.closest(at.coords.into());
            let free_mm = closest.signed_distance_mm.abs();
            if free_mm < NEAR_MM {
                return Some(closest);
            }
            along_mm += free_mm;
            if along_mm > far_mm || along_mm.is_nan() {
                return None;
            }
        }
        None
    }
}
