//! Rounding of the tip edge.
//!
//! A tangent rounding of radius r begins c r before the edge, c = cot(t/2), t being the angle between flank and tip land
//! inside the material; under the flank it takes away the cross-section r2 (c - (c sqrt(1 - c2) + asin c) / 2). That area
//! can be measured although the edge itself blurs, so the radius is taken from it: that of the rounding which has lost as
//! much.

use super::Figure;
use crate::gear::{FlankPlace, GearData, Kind};

/// Width of the band along the profile from the tip edge in which rounding is looked for, mm.
const BAND_MM: f64 = 0.5;
/// Width of a bin of the band, mm.
const BIN_MM: f64 = 0.05;
/// A bin with fewer points is not measured.
const LEAST_POINTS: usize = 10;

/// Collects the band along one flank's tip edge.
#[derive(Debug, Clone)]
pub(super) struct TipBand {
    edge_mm: f64,
    /// +1 when the profile length grows from tip to root (internal), else -1.
    inwards: f64,
    bins: Vec<(usize, f64, f64)>,
}

impl TipBand {
    pub fn new(gear: &GearData) -> Self {
        let [edge_mm, root_mm] =
            [gear.tip_radius_mm, gear.root_radius_mm].map(|r| gear.profile_mm(r));
        Self {
            edge_mm,
            inwards: (root_mm - edge_mm).signum(),
            bins: vec![(0, 0.0, 0.0); (BAND_MM / BIN_MM).round() as usize],
        }
    }

    /// Takes a point's wear, mm, if it lies in the band.
    pub fn add(&mut self, place: &FlankPlace, wear_mm: f64) {
        let along = self.inwards * (place.profile_mm - self.edge_mm) / BIN_MM;
        if along >= 0.0
            && wear_mm.is_finite()
            && let Some(bin) = self.bins.get_mut(along as usize)
        {
            *bin = (bin.0 + 1, bin.1 + wear_mm, bin.2 + wear_mm * wear_mm);
        }
    }

    /// Radius of the rounding, mm, beyond the loss of `level_mm` that the rest of the flank shows; none when the band was
    /// not seen whole. `local_mm` is the standard uncertainty of deviations that differ between edge and flank.
    pub fn radius_mm(&self, gear: &GearData, level_mm: f64, local_mm: f64) -> Option<Figure> {
        if self.bins.iter().any(|bin| bin.0 < LEAST_POINTS) {
            return None;
        }
        let (mut area, mut variance) = (0.0, 0.0);
        for &(n, sum, sum2) in &self.bins {
            let n = n as f64;
            area += BIN_MM * (sum / n - level_mm);
            variance += BIN_MM * BIN_MM * (sum2 - sum * sum / n).max(0.0) / (n - 1.0) / n;
        }
        let per_r2 = lost_per_r2(edge_angle_rad(gear)?);
        let u_area = (variance + (BAND_MM * local_mm).powi(2)).sqrt();
        let value = (area.max(0.0) / per_r2).sqrt();
        // The root is steep near zero: the half width from the upper end of the area is right at 0 and for large radii.
        let upper = ((area.max(0.0) + u_area) / per_r2).sqrt();
        Some(Figure {
            value,
            u: upper - value,
        })
    }
}

/// Cross-section that a tangent rounding takes away under the flank, per squared radius.
fn lost_per_r2(angle_rad: f64) -> f64 {
    let c = (1.0 / (0.5 * angle_rad).tan()).min(1.0);
    c - 0.5 * (c * (1.0 - c * c).sqrt() + c.asin())
}

/// Angle between flank and tip land inside the material, rad.
fn edge_angle_rad(gear: &GearData) -> Option<f64> {
    // Slope of the flank against the radius, from the angle that the tooth gains per radius.
    let (r, step) = (gear.tip_radius_mm, 1e-4);
    let slope =
        r * (gear.half_tooth_rad(r + step)? - gear.half_tooth_rad(r - step)?) / (2.0 * step);
    let outward = match gear.kind {
        Kind::Internal => slope,
        Kind::External => -slope,
    };
    Some(std::f64::consts::FRAC_PI_2 + outward.atan())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gear::{Flank, tests::ring84};

    #[test]
    fn a_rounded_edge_has_its_radius() {
        let gear = ring84();
        let angle = edge_angle_rad(&gear).unwrap();
        for radius in [0.05, 0.1, 0.2] {
            let mut band = TipBand::new(&gear);
            let reach = radius / (0.5 * angle).tan();
            // Distance of a flank point at s from the tangent circle along the flank's normal.
            for i in 0..50_000 {
                let s = 0.5 * (f64::from(i) + 0.5) / 50_000.0;
                let x = reach - s;
                let lost = if x > 0.0 {
                    radius - (radius * radius - x * x).max(0.0).sqrt()
                } else {
                    0.0
                };
                let place = FlankPlace {
                    tooth: 1,
                    flank: Flank::Left,
                    radius_mm: 41.0,
                    profile_mm: gear.profile_mm(gear.tip_radius_mm) + s,
                    height_mm: 1.0,
                };
                band.add(&place, lost + 0.01);
            }
            let found = band.radius_mm(&gear, 0.01, 0.0).unwrap().value;
            assert!((found - radius).abs() < 0.01 * radius, "{radius}: {found}");
        }
    }
}
