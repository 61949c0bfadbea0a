//! A matt layer on the die: spray, as thick as a hand laid it.

use super::WorldError;
use super::random::{Normals, Purpose, stream};
use nalgebra::{Point3, Vector3};
use std::f64::consts::TAU;

/// Largest mean thickness, µm.
const MAX_FILM_UM: f64 = 200.0;
/// Standard deviation of the thickness, relative to its mean: assumed, as are the figures below; no map of a sprayed gear is known.
const SPREAD_RATIO: f64 = 0.2;
/// Waves of the variation, and the range of their lengths.
const WAVES: usize = 12;
const WAVELENGTH_MM: [f64; 2] = [0.5, 8.0];
/// A wet film draws towards edges: at the tip's edge it is thicker by this share, and by 1/e of it so far from the edge's radius.
const EDGE_RATIO: f64 = 0.5;
const EDGE_MM: f64 = 0.1;
/// Smallest cosine of the angle between ray and normal: flatter rays meet the layer no farther before the metal than at this one.
const LEAST_COSINE: f64 = 0.2;

/// Thickness of the layer on every point of the die.
#[derive(Clone, Debug)]
pub(crate) struct Film {
    mean_mm: f64,
    tip_radius_mm: f64,
    /// Wave vector in rad/mm, and phase.
    waves: Vec<(Vector3<f64>, f64)>,
}

impl Film {
    /// `None` without a film.
    pub(crate) fn new(
        mean_um: f64,
        tip_radius_mm: f64,
        seed: u64,
    ) -> Result<Option<Self>, WorldError> {
        WorldError::check("film_um", mean_um, 0.0, MAX_FILM_UM)?;
        let mut random = Normals::new(stream(seed, Purpose::Film));
        let mut wave = || {
            let direction = Vector3::from_fn(|_, _| random.next());
            let [short, long] = WAVELENGTH_MM;
            let length_mm = short * (long / short).powf(random.uniform());
            let rad_per_mm = TAU / length_mm / direction.norm().max(f64::MIN_POSITIVE);
            (rad_per_mm * direction, TAU * random.uniform())
        };
        let film = Self {
            mean_mm: 1e-3 * mean_um,
            tip_radius_mm,
            waves: (0..WAVES).map(|_| wave()).collect(),
        };
        Ok((mean_um > 0.0).then_some(film))
    }

    /// Thickness along the normal at a point of the metal, mm.
    pub(crate) fn thickness_mm(&self, point: Point3<f64>) -> f64 {
        let waves = self.waves.iter();
        let sum: f64 = waves
            .map(|(k, phase)| (k.dot(&point.coords) + phase).cos())
            .sum();
        // A cosine of random phase has the variance 1/2.
        let varied = 1.0 + SPREAD_RATIO * (2.0 / WAVES as f64).sqrt() * sum;
        let from_tip_mm = (point.coords.xy().norm() - self.tip_radius_mm).abs();
        let drawn = 1.0 + EDGE_RATIO * (-from_tip_mm / EDGE_MM).exp();
        self.mean_mm * varied.max(0.0) * drawn
    }

    /// How far before the metal a ray meets the layer, at this cosine between normal and ray, mm.
    pub(crate) fn along_ray_mm(&self, point: Point3<f64>, cosine: f64) -> f64 {
        self.thickness_mm(point) / cosine.max(LEAST_COSINE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_thickness_has_the_stated_mean_and_spread_and_grows_towards_edges() {
        // Many films, because the waves of one are the same everywhere.
        let mut sums = [0.0; 3];
        for seed in 0..200 {
            let film = Film::new(12.0, 40.0, seed).expect("a film").expect("some");
            for place in 0..50 {
                let angle = 0.1 * f64::from(place);
                let at = |radius: f64| {
                    Point3::new(radius * angle.cos(), radius * angle.sin(), 30.0 + angle)
                };
                let um = 1e3 * film.thickness_mm(at(41.0));
                let at_edge = 1e3 * film.thickness_mm(at(40.0));
                sums = [sums[0] + um, sums[1] + um * um, sums[2] + at_edge];
            }
        }
        let [mean, squares, edge] = sums.map(|sum| sum / 10_000.0);
        let spread = (squares - mean * mean).sqrt();
        // Twelve waves each: 2400 independent phases of one and a half standard deviations at most.
        assert!((mean - 12.0).abs() < 0.2, "{mean}");
        assert!((spread - 0.2 * 12.0).abs() < 0.2, "{spread}");
        assert!((edge / mean - 1.5).abs() < 0.03, "{edge} {mean}");
        assert!(Film::new(0.0, 40.0, 1).expect("no film").is_none());
        assert!(Film::new(f64::NAN, 40.0, 1).is_err() && Film::new(201.0, 40.0, 1).is_err());
    }
}
