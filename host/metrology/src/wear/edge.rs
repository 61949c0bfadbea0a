//! Rounding of the tip edge.
//!
//! A tangent rounding of radius r begins c r before the edge, c = cot(t/2), t being the angle between flank and tip land
//! inside the material; under the flank it takes away the cross-section r2 (c - (c sqrt(1 - c2) + asin c) / 2). That area
//! can be measured although the edge itself blurs, so the radius is taken from it: that of the rounding which has lost as
//! much.

use super::Figure;
use crate::gear::{Flank, FlankPlace, GearData, GearKind};

/// Width of the band along the profile from the tip edge in which rounding is looked for, mm.
const BAND_MM: f64 = 0.5;
/// Width of a bin of the band, mm.
const BIN_MM: f64 = 0.05;
/// A bin with fewer points is not measured.
const LEAST_POINTS: usize = 10;

/// A point in the material near a flank, and its distance from the involute, mm.
#[derive(Debug, Clone, Copy)]
pub(super) struct UnderEdge {
    pub tooth: u32,
    pub flank: Flank,
    pub radius_mm: f64,
    pub height_mm: f64,
    pub deviation_mm: f64,
}

impl UnderEdge {
    /// Place of a point; none unless it lies under the nearer flank, by no more than the width of the band.
    pub fn at_point(gear: &GearData, [x, y, z]: [f64; 3]) -> Option<Self> {
        let (radius_mm, angle_rad) = (x.hypot(y), y.atan2(x));
        let tooth = gear.tooth_at(angle_rad);
        let beside_centre_rad = gear.beside_tooth_centre_rad(tooth, angle_rad);
        let flank = match beside_centre_rad > 0.0 {
            true => Flank::Left,
            false => Flank::Right,
        };
        let beyond_rad = beside_centre_rad.abs() - gear.half_tooth_rad(radius_mm)?;
        let deviation_mm = gear.base_radius_mm() * beyond_rad;
        (-BAND_MM..0.0).contains(&deviation_mm).then_some(Self {
            tooth,
            flank,
            radius_mm,
            height_mm: z,
            deviation_mm,
        })
    }
}

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

    /// Takes a point whose nearest surface is no flank, if it lies in the material under the band: where the edge is worn away,
    /// the tip land is nearer than the flank was. Its loss is its distance from the involute.
    pub fn add_under(&mut self, gear: &GearData, at: &UnderEdge) {
        let (place, wear_mm) = self.place_under(gear, at);
        self.add(&place, wear_mm);
    }

    /// Place on the flank that such a point counts for, and its wear, mm.
    pub fn place_under(&self, gear: &GearData, at: &UnderEdge) -> (FlankPlace, f64) {
        let wear_mm = -at.deviation_mm;
        let place = FlankPlace {
            tooth: at.tooth,
            flank: at.flank,
            radius_mm: at.radius_mm,
            // Normals of an involute are tangents of the base circle: along one, the tangent's length changes as the depth.
            profile_mm: {
                let base = gear.base_radius_mm();
                let tangent = (at.radius_mm * at.radius_mm - base * base).max(0.0).sqrt();
                (tangent - self.inwards * wear_mm).powi(2) / (2.0 * base)
            },
            height_mm: at.height_mm,
        };
        (place, wear_mm)
    }

    /// Loss of the edge beyond the `level_mm` of the rest of the flank; none when less than half of the band
    /// was seen. `local_mm` is the standard uncertainty of deviations that differ between edge and flank.
    ///
    /// A worn edge leaves no points: bins without points count with what the first measured one behind them
    /// has lost, which is the least that they can have lost.
    pub fn loss(&self, gear: &GearData, level_mm: f64, local_mm: f64) -> Option<TipLoss> {
        let first = self.bins.iter().position(|bin| bin.0 >= LEAST_POINTS)?;
        let seen = &self.bins[first..];
        if 2 * first > self.bins.len() || seen.iter().any(|bin| bin.0 < LEAST_POINTS) {
            return None;
        }
        let (mut area, mut variance) = (0.0, 0.0);
        for (i, &(n, sum, sum2)) in seen.iter().enumerate() {
            let n = n as f64;
            let width = BIN_MM * if i == 0 { 1.0 + first as f64 } else { 1.0 };
            area += width * (sum / n - level_mm);
            variance += width * width * (sum2 - sum * sum / n).max(0.0) / (n - 1.0) / n;
        }
        let u_area = (variance + (BAND_MM * local_mm).powi(2)).sqrt();
        let radius = |area: f64| radius_of_loss_mm(gear, area);
        let value = radius(area.max(0.0))?;
        Some(TipLoss {
            area_mm2: Figure {
                value: area,
                u: u_area,
            },
            radius_mm: Figure {
                value,
                // The root is steep near zero: the half width from the upper end of the area is right at 0 and for large
                // radii.
                u: radius(area.max(0.0) + u_area)? - value,
            },
            whole: first == 0,
        })
    }
}

/// Material lost at a tip edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TipLoss {
    /// Cross-section lost under the flank, mm2: what is judged, since noise acts on it evenly.
    pub area_mm2: Figure,
    /// Radius of the tangent rounding that has lost as much, mm.
    pub radius_mm: Figure,
    /// Whether the edge was seen up to its very end.
    pub whole: bool,
}

/// Cross-section under the flank that a tangent rounding of the tip edge takes away, mm2; none where the gear data give no
/// edge.
pub fn tip_loss_mm2(gear: &GearData, radius_mm: f64) -> Option<f64> {
    Some(lost_per_r2(edge_angle_rad(gear)?) * radius_mm * radius_mm)
}

fn radius_of_loss_mm(gear: &GearData, area_mm2: f64) -> Option<f64> {
    Some((area_mm2 / lost_per_r2(edge_angle_rad(gear)?)).sqrt())
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
        GearKind::Internal => slope,
        GearKind::External => -slope,
    };
    Some(std::f64::consts::FRAC_PI_2 + outward.atan())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gear::tests::ring84;

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
            let found = band.loss(&gear, 0.01, 0.0).unwrap().radius_mm.value;
            assert!((found - radius).abs() < 0.01 * radius, "{radius}: {found}");
        }
    }
}
