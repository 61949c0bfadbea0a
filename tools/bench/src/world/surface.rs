//! How the die's surface sends light back: dull, a little glossy, and not the same everywhere.

use super::WorldError;
use super::random::hash;
use nalgebra::{Point3, Vector3};

/// Diffuse share of a matt sprayed surface, to which highlights are compared.
pub(crate) const SPRAYED_RATIO: f64 = 0.3;

/// Reflectance of the die.
#[derive(Clone, Debug, PartialEq)]
pub struct Surface {
    /// Share of light that comes back diffusely (0.3: sprayed; 0.05: bare steel off its reflection).
    pub diffuse_ratio: f64,
    /// Standard deviation of the diffuse share over the surface, relative.
    pub roughness_ratio: f64,
    /// Size of the patches in which it varies, mm.
    pub grain_mm: f64,
    /// Height of the highlight relative to the sprayed surface's diffuse light.
    pub gloss_ratio: f64,
    /// Sharpness of the highlight: exponent of the cosine between normal and bisector (Blinn 1977).
    pub gloss_exponent: f64,
}

impl Surface {
    /// Matt spray: what a metrologist puts on the tool.
    pub fn sprayed() -> Self {
        Self {
            diffuse_ratio: SPRAYED_RATIO,
            roughness_ratio: 0.03,
            grain_mm: 0.12,
            gloss_ratio: 0.15,
            gloss_exponent: 24.0,
        }
    }

    /// Cleaned steel: dark off the highlight, dazzling in it.
    pub fn bare_steel() -> Self {
        Self {
            diffuse_ratio: 0.05,
            roughness_ratio: 0.25,
            grain_mm: 0.06,
            gloss_ratio: 2.0,
            gloss_exponent: 60.0,
        }
    }

    /// Light towards the eye per light that would fall on a plane facing the lamp. All directions are unit vectors
    /// away from the surface.
    pub(crate) fn returned(
        &self,
        seed: u64,
        p_tool: Point3<f64>,
        normal: Vector3<f64>,
        lamp: Vector3<f64>,
        eye: Vector3<f64>,
    ) -> f64 {
        let incidence = normal.dot(&lamp);
        if incidence <= 0.0 || normal.dot(&eye) <= 0.0 {
            return 0.0;
        }
        let bisector = (lamp + eye).normalize();
        let gloss = self.gloss_ratio
            * SPRAYED_RATIO
            * normal.dot(&bisector).max(0.0).powf(self.gloss_exponent);
        // Three standard deviations at most: no patch turns black or doubles.
        let patch = 1.0
            + self.roughness_ratio * grain(seed, p_tool.coords / self.grain_mm).clamp(-3.0, 3.0);
        (self.diffuse_ratio * patch.max(0.05) + gloss) * incidence
    }

    pub(crate) fn validate(&self) -> Result<(), WorldError> {
        WorldError::check("diffuse_ratio", self.diffuse_ratio, 0.0, 1.0)?;
        WorldError::check("roughness_ratio", self.roughness_ratio, 0.0, 1.0)?;
        WorldError::check("grain_mm", self.grain_mm, 1e-3, 100.0)?;
        WorldError::check("gloss_ratio", self.gloss_ratio, 0.0, 1e3)?;
        WorldError::check("gloss_exponent", self.gloss_exponent, 1.0, 1e5)
    }
}

/// Smooth noise of unit variance over space: random values on a lattice, blended between.
fn grain(seed: u64, p: Vector3<f64>) -> f64 {
    let cell = p.map(f64::floor);
    let s = (p - cell).map(|t| t * t * (3.0 - 2.0 * t));
    let mut sum = 0.0;
    let mut power = 0.0;
    for corner in 0..8u8 {
        let bit = |axis: u8| f64::from((corner >> axis) & 1);
        let weight: f64 = (0..3)
            .map(|axis| {
                let t = s[usize::from(axis)];
                if bit(axis) == 1.0 { t } else { 1.0 - t }
            })
            .product();
        let at = [0u8, 1, 2].map(|axis| cell[usize::from(axis)] as i64 + bit(axis) as i64);
        // Uniform in ±√3: unit variance.
        let value = (hash(seed, at) >> 11) as f64 / (1u64 << 53) as f64;
        sum += weight * 3f64.sqrt() * (2.0 * value - 1.0);
        power += weight * weight;
    }
    sum / power.sqrt()
}
