//! Reflection by a rough surface of microfacets: Cook and Torrance 1982 with the distribution of Walter et al. 2007 (GGX, alpha
//! is its roughness), shadowing after Smith, and Fresnel's equations.
//!
//! All directions are unit vectors away from the surface.

use nalgebra::Vector3;
use std::f64::consts::{PI, TAU};

/// Fraction of microfacets per solid angle whose normal has this cosine to the mean one.
pub(crate) fn density(cos: f64, alpha: f64) -> f64 {
    let a2 = alpha * alpha;
    let t = cos * cos * (a2 - 1.0) + 1.0;
    a2 / (PI * t * t)
}

/// Fraction of the microfacets visible from a direction with this cosine.
pub(crate) fn visible(cos: f64, alpha: f64) -> f64 {
    let tan2 = (1.0 - cos * cos).max(0.0) / (cos * cos);
    2.0 / (1.0 + (1.0 + alpha * alpha * tan2).sqrt())
}

/// π times the bidirectional reflectance of perfectly reflecting microfacets; to be multiplied by the Fresnel reflectance at the bisector.
pub(crate) fn mirrors(
    alpha: f64,
    normal: &Vector3<f64>,
    bisector: &Vector3<f64>,
    [cos_lamp, cos_eye]: [f64; 2],
) -> f64 {
    let seen = visible(cos_lamp, alpha) * visible(cos_eye, alpha);
    PI * density(normal.dot(bisector), alpha) * seen / (4.0 * cos_lamp * cos_eye)
}

/// Fresnel reflectance of a metal with index `eta - i k` for unpolarised light.
pub(crate) fn metal(cos: f64, eta: f64, k: f64) -> f64 {
    let (cos2, sin2) = (cos * cos, 1.0 - cos * cos);
    let (eta2, k2) = (eta * eta, k * k);
    let below = eta2 - k2 - sin2;
    let both = (below * below + 4.0 * eta2 * k2).sqrt();
    let twice = 2.0 * cos * (0.5 * (both + below)).max(0.0).sqrt();
    let across = (both + cos2 - twice) / (both + cos2 + twice);
    let (even, odd) = (cos2 * both + sin2 * sin2, twice * sin2);
    0.5 * across * (1.0 + (even - odd) / (even + odd))
}

/// Fresnel reflectance of a dielectric with this index in air for unpolarised light.
pub(crate) fn clear(cos: f64, index: f64) -> f64 {
    let inside = refracted_cos(cos, index);
    let across = (cos - index * inside) / (cos + index * inside);
    let along = (index * cos - inside) / (index * cos + inside);
    0.5 * (across * across + along * along)
}

/// Cosine inside a dielectric.
fn refracted_cos(cos: f64, index: f64) -> f64 {
    (1.0 - (1.0 - cos * cos) / (index * index)).max(0.0).sqrt()
}

/// A direction after refraction into a dielectric, still pointing away from the surface (Snell).
pub(crate) fn refracted(
    direction: &Vector3<f64>,
    normal: &Vector3<f64>,
    index: f64,
) -> Vector3<f64> {
    let cos = normal.dot(direction);
    (direction - cos * normal) / index + refracted_cos(cos, index) * normal
}

/// Two unit vectors perpendicular to a normal and to each other (Duff et al. 2017).
pub(crate) fn tangents(n: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let sign = 1f64.copysign(n.z);
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    [
        Vector3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x),
        Vector3::new(b, sign + n.y * n.y * a, -n.y),
    ]
}

/// A cosine-distributed direction from two uniform numbers.
pub(crate) fn by_cosine(normal: &Vector3<f64>, [u, v]: [f64; 2]) -> Vector3<f64> {
    let [along, across] = tangents(normal);
    let (sin, cos) = (TAU * v).sin_cos();
    u.sqrt() * (cos * along + sin * across) + (1.0 - u).sqrt() * normal
}

/// The direction of light that one of the visible microfacets reflects to the eye, from two uniform numbers (Heitz 2018). It may
/// point below the surface.
pub(crate) fn by_mirror(
    alpha: f64,
    normal: &Vector3<f64>,
    eye: &Vector3<f64>,
    [u, v]: [f64; 2],
) -> Vector3<f64> {
    let [along, across] = tangents(normal);
    let local = Vector3::new(eye.dot(&along), eye.dot(&across), eye.dot(normal));
    // Stretching transforms the distribution to that of a hemisphere; the eye sees a disc of it, partly hidden.
    let stretched = Vector3::new(alpha * local.x, alpha * local.y, local.z).normalize();
    let side = Vector3::new(-stretched.y, stretched.x, 0.0)
        .try_normalize(1e-12)
        .unwrap_or_else(Vector3::x);
    let up = stretched.cross(&side);
    let (sin, cos) = (TAU * v).sin_cos();
    let (x, y) = (u.sqrt() * cos, u.sqrt() * sin);
    let share = 0.5 * (1.0 + stretched.z);
    let y = (1.0 - share) * (1.0 - x * x).max(0.0).sqrt() + share * y;
    let out = x * side + y * up + (1.0 - x * x - y * y).max(0.0).sqrt() * stretched;
    let mirror = Vector3::new(alpha * out.x, alpha * out.y, out.z.max(0.0)).normalize();
    let mirror = mirror.x * along + mirror.y * across + mirror.z * normal;
    2.0 * eye.dot(&mirror) * mirror - eye
}

/// Probability density per solid angle of the directions from [`by_mirror`].
pub(crate) fn by_mirror_density(
    alpha: f64,
    normal: &Vector3<f64>,
    bisector: &Vector3<f64>,
    cos_eye: f64,
) -> f64 {
    visible(cos_eye, alpha) * density(normal.dot(bisector), alpha) / (4.0 * cos_eye)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fresnel_is_what_textbooks_say() {
        // Normal incidence: ((n-1)^2 + k^2) / ((n+1)^2 + k^2).
        let at_normal = |n: f64, k: f64| ((n - 1.0).powi(2) + k * k) / ((n + 1.0).powi(2) + k * k);
        assert!((metal(1.0, 2.4, 3.4) - at_normal(2.4, 3.4)).abs() < 1e-12);
        assert!((clear(1.0, 1.47) - at_normal(1.47, 0.0)).abs() < 1e-12);
        // A metal without absorption is a dielectric.
        for cos in [0.05, 0.3, 0.7, 1.0] {
            assert!(
                (metal(cos, 1.5, 0.0) - clear(cos, 1.5)).abs() < 1e-9,
                "{cos}"
            );
        }
        assert!(clear(1e-9, 1.5) > 0.999_999 && metal(1e-9, 2.4, 3.4) > 0.999_999);
        // At Brewster's angle only one polarisation is reflected: ((n^2-1)/(n^2+1))^2 of it.
        let n = 1.5f64;
        let brewster = 1.0 / (1.0 + n * n).sqrt();
        let half = 0.5 * ((n * n - 1.0) / (n * n + 1.0)).powi(2);
        assert!((clear(brewster, n) - half).abs() < 1e-12);
    }

    #[test]
    fn the_mirrors_cover_the_surface_once() {
        // The mean of their projected areas is 1, and so is the visible one along any direction.
        for alpha in [0.15, 0.3, 0.6] {
            let steps = 2_000;
            let area: f64 = (0..steps)
                .map(|i| {
                    let theta = 0.5 * PI * (f64::from(i) + 0.5) / f64::from(steps);
                    let width = 0.5 * PI / f64::from(steps);
                    density(theta.cos(), alpha) * theta.cos() * TAU * theta.sin() * width
                })
                .sum();
            assert!((area - 1.0).abs() < 1e-5, "{alpha}: {area}");
        }
    }
}
