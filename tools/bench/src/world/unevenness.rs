//! What a lens does that no drawing shows: light goes a little astray, smoothly but irregularly over the field.

use std::f64::consts::TAU;

use flankscope_profilometry::head::residual::ResidualField;
use nalgebra::Vector2;

use super::random::{Normals, Purpose, stream};

/// Waves that one lens is made of.
const WAVES: usize = 6;
/// Their lengths over the field's diameter: too short for the distortion's polynomial, as long as polishing and index leave.
const LENGTHS: [f64; 2] = [0.4, 0.8];

/// Where light goes astray, over the undistorted image plane `z = 1`.
#[derive(Clone, Debug, PartialEq)]
pub struct Unevenness(Kind);

#[derive(Clone, Debug, PartialEq)]
enum Kind {
    /// A sum of plane waves.
    Waves(Vec<Wave>),
    /// What a head's file says, in pixels of these focal lengths.
    Stated(Box<ResidualField>, [f64; 2]),
}

#[derive(Clone, Debug, PartialEq)]
struct Wave {
    /// Phase per unit of x and y.
    number: Vector2<f64>,
    phase_rad: f64,
    shift: Vector2<f64>,
}

impl Unevenness {
    /// Drawn from `seed`, different for every `lens`: root mean square `rms` along each axis, in units of the image plane, over
    /// a field of radius `field`.
    pub(crate) fn drawn(seed: u64, lens: u8, rms: f64, field: f64) -> Self {
        let mut random = Normals::new(stream(seed, Purpose::Unevenness(lens)));
        // Each wave has half the square of its height on average.
        let height = rms * (2.0 / WAVES as f64).sqrt();
        let waves = (0..WAVES)
            .map(|_| {
                let [shortest, longest] = LENGTHS;
                let length = 2.0 * field * (shortest + (longest - shortest) * random.uniform());
                let unit = |angle: f64| Vector2::new(angle.cos(), angle.sin());
                Wave {
                    number: unit(TAU * random.uniform()) * (TAU / length),
                    phase_rad: TAU * random.uniform(),
                    shift: Vector2::new(random.next(), random.next()) * height,
                }
            })
            .collect();
        Self(Kind::Waves(waves))
    }

    /// The remainder that a head's file states, for a world that is as the file says.
    pub(crate) fn stated(field: &ResidualField, focal_px: [f64; 2]) -> Self {
        Self(Kind::Stated(Box::new(field.clone()), focal_px))
    }

    /// How far light goes astray at a place.
    pub(crate) fn at(&self, place: Vector2<f64>) -> Vector2<f64> {
        match &self.0 {
            Kind::Waves(waves) => waves
                .iter()
                .map(|wave| wave.shift * (wave.number.dot(&place) + wave.phase_rad).sin())
                .sum(),
            Kind::Stated(field, focal_px) => {
                let shift_px = field.shift_px([place.x, place.y]);
                Vector2::from([0, 1].map(|axis| shift_px[axis] / focal_px[axis]))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Over many lenses the mean square is the one asked for: 200 lenses of six waves each, known to 5 %.
    #[test]
    fn as_uneven_as_asked_for() {
        let (mut count, mut squares) = (0.0, 0.0);
        for seed in 0..200 {
            let lens = Unevenness::drawn(seed, 0, 1e-4, 0.227);
            for i in -5..=5 {
                for j in -5..=5 {
                    let place = Vector2::new(f64::from(i), f64::from(j)) * 0.03;
                    squares += lens.at(place).norm_squared();
                    count += 2.0;
                }
            }
        }
        let rms = f64::sqrt(squares / count);
        assert!((rms / 1e-4 - 1.0).abs() < 0.15, "{rms}");
        assert_ne!(
            Unevenness::drawn(1, 0, 1e-4, 0.2),
            Unevenness::drawn(1, 1, 1e-4, 0.2)
        );
    }
}
